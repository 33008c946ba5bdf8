//! The README and the book of `docs/`: every command line is run, in the order of its page, in a folder of its own.
#![cfg(unix)]

mod page;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use super::common::{succeed, udc};
use page::{Block, Step, calls, steps};

/// Tests of pages, one each, so that they run beside each other.
macro_rules! pages {
    ($($test:ident: $path:literal,)+) => {
        const PAGES: &[&str] = &[$($path),+];
        $(
            #[test]
            fn $test() {
                run_page($path);
            }
        )+
    };
}

pages! {
    readme: "README.md",
    introduction: "docs/src/introduction.md",
    quick_start: "docs/src/quick-start.md",
    measuring: "docs/src/measuring.md",
    simulating: "docs/src/simulating.md",
    restoring: "docs/src/restoring.md",
    raw: "docs/src/raw.md",
    finishing: "docs/src/finishing.md",
    adapting: "docs/src/adapting.md",
    datasets: "docs/src/datasets.md",
    published: "docs/src/published.md",
    training: "docs/src/training.md",
    evaluating: "docs/src/evaluating.md",
    commands: "docs/src/commands.md",
    formats: "docs/src/formats.md",
    light: "docs/src/light.md",
    performance: "docs/src/performance.md",
    sharing: "docs/src/sharing.md",
    determinism: "docs/src/determinism.md",
    limits: "docs/src/limits.md",
    questions: "docs/src/questions.md",
    glossary: "docs/src/glossary.md",
    sources: "docs/src/sources.md",
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// A shell in a folder, to which `udc` is this build of it and `$ROOT` the repository.
fn shell(folder: &Path, script: &str) -> Output {
    let program = Path::new(env!("CARGO_BIN_EXE_udc")).parent().expect("the program is in a folder");
    let mut places = vec![program.to_owned()];
    places.extend(std::env::var_os("PATH").iter().flat_map(std::env::split_paths));
    Command::new("sh")
        .args(["-eu", "-c", &format!("exec 2>&1\n{script}")])
        .current_dir(folder)
        .env("PATH", std::env::join_paths(places).expect("folders without colons"))
        .env("ROOT", root())
        .output()
        .expect("there is a shell")
}

/// Runs everything that a page shows, as it stands in the repository's folder.
fn run_page(name: &str) {
    let text = fs::read_to_string(root().join(name)).unwrap();
    let scratch = tempfile::tempdir().unwrap();
    for folder in ["configs", "assets"] {
        std::os::unix::fs::symlink(root().join(folder), scratch.path().join(folder)).unwrap();
    }
    let mut replacements: Vec<(String, String, bool)> = Vec::new();
    for step in steps(&text) {
        match step {
            Step::Setup(script) => {
                let output = shell(scratch.path(), &script);
                assert!(output.status.success(), "{name}: {script}\n{}", text_of(&output));
            }
            Step::Replace(long, short) => replacements.push((long, short, false)),
            Step::Block(block) => run_block(name, &block, scratch.path(), &mut replacements),
        }
    }
    for (long, _, is_used) in replacements {
        assert!(is_used, "{name}: no line holds {long:?}, which is to be replaced");
    }
}

fn run_block(name: &str, block: &Block, folder: &Path, replacements: &mut [(String, String, bool)]) {
    let at = format!("{name}, line {}", block.line);
    let mut script = block.script.clone();
    for (long, short, is_used) in replacements {
        *is_used |= script.contains(&*long);
        script = script.replace(&*long, short);
    }
    if block.not_run.is_some() || script != block.script {
        calls(&block.script).iter().for_each(|call| check_flags(&at, call, folder));
    }
    if block.not_run.is_some() {
        return;
    }
    let output = shell(folder, &script);
    let said = text_of(&output);
    assert_eq!(output.status.success(), !block.fails, "{at}: {script}\n{said}");
    assert!(!said.contains("panicked"), "{at}: {script}\n{said}");
    let lines: Vec<String> = said.lines().map(without_numbers).collect();
    let mut rest = &lines[..];
    for expected in block.said.iter().filter(|line| !line.trim().is_empty() && line.trim() != "…") {
        let wanted = without_numbers(expected);
        let says = |line: &String| match wanted.strip_suffix('…') {
            Some(beginning) => line.starts_with(beginning),
            None => *line == wanted,
        };
        let found = rest.iter().position(says);
        let found = found.unwrap_or_else(|| panic!("{at}: {script}\ndoes not say {expected:?}, but\n{said}"));
        rest = &rest[found + 1..];
    }
}

/// Checks that the program knows every flag of a line that is not run as it stands, and takes its values: it reads them in
/// order before it comes to the last.
fn check_flags(at: &str, call: &str, folder: &Path) {
    let output = shell(folder, &format!("{call} --help"));
    assert!(output.status.success(), "{at}: {call}\n{}", text_of(&output));
}

fn text_of(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// A line whose numbers, and the spaces that align them, count for nothing: they are those of smaller inputs.
fn without_numbers(line: &str) -> String {
    let is_of_number = |c: char| c.is_ascii_digit() || "+-−.±∞".contains(c);
    let words = line.split_whitespace().map(|word| {
        let mut plain = String::new();
        for c in word.chars() {
            match is_of_number(c) {
                true if plain.ends_with('#') => {}
                true => plain.push('#'),
                false => plain.push(c),
            }
        }
        plain.replace("#e#", "#")
    });
    words.collect::<Vec<_>>().join(" ")
}

/// The pages that the book's summary lists.
fn listed() -> BTreeSet<String> {
    let summary = fs::read_to_string(root().join("docs/src/SUMMARY.md")).unwrap();
    let targets = summary.split("](").skip(1).filter_map(|rest| rest.split(')').next());
    targets.map(|target| format!("docs/src/{}", target.trim_start_matches("./"))).collect()
}

#[test]
fn every_page_of_the_book_is_listed_and_run() {
    let is_page = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "md");
    let entries = fs::read_dir(root().join("docs/src")).unwrap().map(|entry| entry.unwrap().path());
    let names = entries.filter(is_page).map(|path| path.file_name().unwrap().to_string_lossy().into_owned());
    let pages: BTreeSet<String> =
        names.filter(|name| name != "SUMMARY.md").map(|name| format!("docs/src/{name}")).collect();
    let run: BTreeSet<String> =
        PAGES.iter().filter(|page| page.starts_with("docs/")).map(|page| (*page).to_owned()).collect();
    assert_eq!(pages, run, "pages, and those that are run");
    assert_eq!(listed(), run, "the summary's pages, and those that are run");
}

#[test]
fn every_command_is_in_the_book() {
    let help = succeed(root(), &["--help"]);
    let commands = help.lines().skip_while(|line| !line.starts_with("Commands:")).skip(1);
    let names: Vec<&str> = commands
        .take_while(|line| !line.is_empty())
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .collect();
    assert!(names.len() > 15, "{names:?}");
    let page = fs::read_to_string(root().join("docs/src/commands.md")).unwrap();
    let missing: Vec<&&str> =
        names.iter().filter(|name| !page.contains(&format!("| `udc {name}` |"))).collect();
    assert!(missing.is_empty(), "docs/src/commands.md lacks {missing:?}");
}

/// What this module promises: a wrong flag in a page is noticed, whether its line is run or not.
#[test]
fn a_wrong_flag_is_noticed() {
    for (flags, is_right) in [("--count 3 --size 32x40", true), ("--cuont 3", false), ("--size huge", false)]
    {
        let arguments: Vec<&str> =
            ["scenes", "-o", "x"].into_iter().chain(flags.split(' ')).chain(["--help"]).collect();
        assert_eq!(udc(root(), &arguments).status.success(), is_right, "{flags}");
    }
}
