//! Keeps the module tree's promises: who may import whom, who opens files, who prints, where unsafe code is.

mod code;
mod code_tests;

use std::fs;
use std::path::{Path, PathBuf};

use code::{code_of, named_modules};

/// The top-level modules from the ground up: each may import those that stand before it.
const FLOW: &[&str] = &[
    "kernels",
    "core",
    "io",
    "dataset",
    "batch",
    "network",
    "capture",
    "psf",
    "codes",
    "crop",
    "scenes",
    "synth",
    "finish",
    "perceptual",
    "restore",
    "examples",
    "train",
    "experiment",
    "report",
    "plan",
    "inspect",
    "doctor",
];

struct Source {
    /// Path below `src`, with forward slashes.
    name: String,
    /// First path component without extension.
    module: String,
    /// What is compiled without tests, with spaces for comments and the contents of literals.
    code: String,
}

impl Source {
    /// The module that the file is, from the crate's root on.
    fn place(&self) -> Vec<&str> {
        let mut parts: Vec<&str> = self.name.trim_end_matches(".rs").split('/').collect();
        parts.pop_if(|last| *last == "mod" || *last == "lib");
        parts
    }
}

fn sources() -> Vec<Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    collect(&root, &mut files);
    assert!(files.len() > 20, "found only {} files below {}", files.len(), root.display());
    files.iter().map(|path| source(&root, path)).filter(|source| !is_test(&source.name)).collect()
}

/// Unit tests that stand in a file or folder of their own beside the code.
fn is_test(name: &str) -> bool {
    name.split('/')
        .any(|part| matches!(part, "tests" | "tests.rs" | "testing.rs") || part.ends_with("_tests.rs"))
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("src is readable") {
        let path = entry.expect("src is readable").path();
        if path.is_dir() {
            collect(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

fn source(root: &Path, path: &Path) -> Source {
    let name = path.strip_prefix(root).expect("below src").to_string_lossy().replace('\\', "/");
    let module = name.split('/').next().expect("not empty").trim_end_matches(".rs").to_owned();
    let text = fs::read_to_string(path).expect("sources are text");
    let code = code_of(&text);
    Source { name, module, code }
}

/// The lines in which a source of the given modules does what `is_offence` describes.
fn offences(applies: impl Fn(&Source) -> bool, is_offence: impl Fn(&Source, &str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    for source in sources().iter().filter(|source| applies(source)) {
        for line in source.code.lines().filter(|line| is_offence(source, line)) {
            found.push(format!("{}: {}", source.name, line.trim()));
        }
    }
    found
}

#[test]
fn data_flows_one_way() {
    let place = |module: &str| FLOW.iter().position(|name| *name == module);
    let mut found = Vec::new();
    for source in sources() {
        let Some(own) = place(&source.module) else { continue };
        let mut named = named_modules(&source.code, &source.place());
        named.retain(|module| place(module).is_some_and(|other| other > own));
        named.dedup();
        found.extend(named.into_iter().map(|module| format!("{}: {module}", source.name)));
    }
    assert!(found.is_empty(), "imports against the flow:\n{}", found.join("\n"));
}

#[test]
fn every_module_has_its_place_in_the_flow() {
    let outside = ["main", "lib", "commands"];
    let unplaced: Vec<_> = sources()
        .into_iter()
        .map(|source| source.module)
        .filter(|module| !outside.contains(&module.as_str()) && !FLOW.contains(&module.as_str()))
        .collect();
    assert!(unplaced.is_empty(), "modules without a place in FLOW: {unplaced:?}");
}

#[test]
fn only_kernels_hold_unsafe_code() {
    let found = offences(|source| source.module != "kernels", |_, line| line.contains("unsafe "));
    assert!(found.is_empty(), "unsafe code outside of the kernels:\n{}", found.join("\n"));
}

/// Implementations of a trait's methods are safe to call when what the trait says holds.
#[test]
fn every_unsafe_function_says_when_it_is_safe_to_call() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    for source in sources() {
        let text = fs::read_to_string(root.join(&source.name)).expect("sources are text");
        let lines: Vec<&str> = text.lines().collect();
        for (at, line) in lines.iter().enumerate().filter(|(_, line)| line.contains("unsafe fn ")) {
            let above = lines[..at].iter().rev();
            let is_between = |line: &&&str| !line.is_empty() && !line.trim_start().starts_with('}');
            let says = above.clone().take_while(is_between).any(|line| line.contains("/// # Safety"));
            let indent = |line: &str| line.len() - line.trim_start().len();
            let mut around = above.filter(|above| !above.is_empty() && indent(above) < indent(line));
            let of_a_trait = around
                .any(|line| line.contains("impl") && line.contains(" for ") || line.contains("macro_rules!"));
            if !line.trim_start().starts_with("//") && !says && !of_a_trait {
                found.push(format!("{}: {}", source.name, line.trim()));
            }
        }
    }
    assert!(found.is_empty(), "unsafe functions without `# Safety`:\n{}", found.join("\n"));
}

#[test]
fn the_library_prints_nothing() {
    let prints = ["println!", "print!(", "eprint!(", "dbg!(", "stdout", "stderr", "Stdout", "Stderr"];
    let found = offences(
        |source| !["commands", "main"].contains(&source.module.as_str()),
        |_, line| prints.iter().any(|print| line.contains(print)),
    );
    assert!(found.is_empty(), "prints in the library:\n{}", found.join("\n"));
}

#[test]
fn only_io_opens_files() {
    let opens = ["File::open", "File::create", "fs::read", "fs::write", "OpenOptions"];
    let found = offences(
        |source| source.module != "io" && !["commands", "main"].contains(&source.module.as_str()),
        |_, line| opens.iter().any(|open| line.contains(open)),
    );
    assert!(found.is_empty(), "files opened outside of io:\n{}", found.join("\n"));
}

#[test]
fn every_file_says_what_it_is() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let silent: Vec<_> = sources()
        .into_iter()
        .filter(|source| {
            let text = fs::read_to_string(root.join(&source.name)).expect("sources are text");
            !text.starts_with("//!")
        })
        .map(|source| source.name)
        .collect();
    assert!(silent.is_empty(), "files without a first paragraph: {silent:?}");
}

/// The Python package has a lock of its own, which is not built here: it must know what this crate depends on.
#[test]
fn the_python_package_locks_every_dependency() {
    let read = |file: &str| -> toml::Table {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
        fs::read_to_string(path).expect("the file is there").parse().expect("it is TOML")
    };
    let lock = read("python/Cargo.lock");
    let packages = lock["package"].as_array().expect("a list");
    let own = packages.iter().find(|package| package["name"].as_str() == Some(env!("CARGO_PKG_NAME")));
    let locked = own.expect("the crate is in it")["dependencies"].as_array().expect("a list");
    // A name, and its version behind where there are two.
    let locked: Vec<&str> = locked.iter().filter_map(|name| name.as_str()?.split(' ').next()).collect();
    let manifest = read("Cargo.toml");
    let needed = manifest["dependencies"].as_table().expect("a table").keys();
    let missing: Vec<&String> = needed.filter(|name| !locked.contains(&name.as_str())).collect();
    assert!(missing.is_empty(), "run `cargo metadata` in python/: its lock lacks {missing:?}");
}
