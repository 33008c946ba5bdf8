//! Expands what a user names — files, folders, patterns — to a list of image files.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::path::{Component, Path, PathBuf};

use super::archive::is_file;
use super::foreign::is_foreign_raw;
use super::format::Format;
use super::layer::{locate, split, with_layer};
use crate::core::error::{Error, Result};

/// Expands files, folders and globs to image files.
///
/// A folder stands for the image files directly inside of it that are not hidden, a pattern for the files that match, as in
/// a shell: hidden ones only if the pattern spells the dot. A pattern that ends in `**` stands for the images in all folders
/// below. Both are sorted by name. Files keep the order in which they are named. Behind each may stand a colon and the layer
/// that is meant of its files.
///
/// # Errors
/// [`Error::Io`] when a name does not exist, or an image in a folder or of a pattern is a link to what does not;
/// [`Error::Format`] when a folder or a pattern yields no file.
pub fn expand_inputs(inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for input in inputs {
        files.extend(expand(input)?);
    }
    Ok(files)
}

fn expand(input: &Path) -> Result<Vec<PathBuf>> {
    if input.is_dir() {
        return images_of_folder(input);
    }
    // A file whose name holds pattern characters is that file.
    if input.exists() || is_file(input) {
        return Ok(vec![input.to_owned()]);
    }
    if locate(input).1.is_some() {
        return Ok(vec![input.to_owned()]);
    }
    if let (folder, Some(layer)) = split(input, Path::is_dir) {
        let files = images_of_folder(folder)?;
        return Ok(files.iter().map(|file| with_layer(file, layer)).collect());
    }
    match input.to_str().filter(|text| text.contains(['*', '?', '['])) {
        Some(pattern) => files_of_pattern(pattern).or_else(|error| layers_of_pattern(pattern).ok_or(error)),
        None => {
            let reason = std::io::Error::new(std::io::ErrorKind::NotFound, "there is no such file or folder");
            Err(Error::io("read", input, reason))
        }
    }
}

/// The layers in the files that match what stands before the last colon of a pattern; none where that is nothing.
fn layers_of_pattern(pattern: &str) -> Option<Vec<PathBuf>> {
    let (pattern, layer) = pattern.rsplit_once(':')?;
    let files = files_of_pattern(pattern).ok()?;
    Some(files.iter().map(|file| with_layer(file, layer)).collect())
}

fn images_of_folder(folder: &Path) -> Result<Vec<PathBuf>> {
    let read_error = |source| Error::io("read", folder, source);
    let (mut files, mut raws) = (Vec::new(), 0);
    for entry in std::fs::read_dir(folder).map_err(read_error)? {
        let path = entry.map_err(read_error)?.path();
        let is_shown = is_image(&path) && !path.file_name().is_some_and(is_hidden);
        if is_shown {
            check_link(&path)?;
        }
        if is_shown && path.is_file() {
            files.push(path);
        } else if path.extension().and_then(OsStr::to_str).is_some_and(is_foreign_raw) {
            raws += 1;
        }
    }
    if files.is_empty() {
        let of_raws = match raws {
            0 => String::new(),
            count => format!(
                ", but {count} raw files of cameras: convert them to DNG, by `dnglab convert` or Adobe DNG Converter"
            ),
        };
        let reason = format!("the folder holds no image (.exr, .npy, .hdr, .png, .tif, .dng, .jpg){of_raws}");
        return Err(Error::format(folder, reason));
    }
    files.sort();
    Ok(files)
}

/// Whether the name is that of an image: of a format that is written, or of a camera's raw file.
fn is_image(path: &Path) -> bool {
    let is_raw = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("dng"));
    is_raw || Format::known_extension(path).is_some()
}

/// Refuses a link to what is not there, which would be left out without a word.
fn check_link(path: &Path) -> Result<()> {
    if path.symlink_metadata().is_ok() && !path.exists() {
        let reason = "it is a link to a file that is not there; mend the link, or remove it";
        return Err(Error::io("read", path, std::io::Error::new(std::io::ErrorKind::NotFound, reason)));
    }
    Ok(())
}

/// Whether a file's name begins with a dot, as those of temporary files and of what macOS keeps beside others.
pub fn is_hidden(name: impl AsRef<OsStr>) -> bool {
    name.as_ref().as_encoded_bytes().starts_with(b".")
}

fn files_of_pattern(pattern: &str) -> Result<Vec<PathBuf>> {
    // `**` stands for folders: at the end of a pattern, it stands for the images below too.
    let names_all = Path::new(pattern).file_name().is_some_and(|name| name == "**");
    let expanded =
        if names_all { format!("{}/*", pattern.trim_end_matches('/')) } else { pattern.to_owned() };
    let input = Path::new(&expanded);
    let paths = glob::glob(&expanded).map_err(|error| Error::format(pattern, error.to_string()))?;
    let mut files = Vec::new();
    for path in paths {
        let path = path.map_err(|error| {
            let folder = error.path().to_owned();
            Error::io("read", folder, error.into())
        })?;
        if !is_shown(input, &path) {
            continue;
        }
        if is_image(&path) {
            check_link(&path)?;
        }
        if path.is_file() && (!names_all || is_image(&path)) {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(Error::format(pattern, "no file matches this pattern"));
    }
    files.sort();
    Ok(files)
}

/// Whether a shell would show what matches a pattern: what is hidden only where the pattern spells its dot.
fn is_shown(pattern: &Path, path: &Path) -> bool {
    let names = |path: &Path| -> Vec<Vec<u8>> {
        let normal = path.components().filter_map(|part| match part {
            Component::Normal(name) => Some(name.as_encoded_bytes().to_vec()),
            _ => None,
        });
        normal.collect()
    };
    let (pattern, path) = (names(pattern), names(path));
    let is_any = |part: &Vec<u8>| part == b"**";
    let spells = |pattern: &[Vec<u8>], path: &[Vec<u8>]| {
        pattern.iter().zip(path).all(|(pattern, name)| !name.starts_with(b".") || pattern.starts_with(b"."))
    };
    let (Some(first), Some(last)) = (pattern.iter().position(is_any), pattern.iter().rposition(is_any))
    else {
        return spells(&pattern, &path);
    };
    // Folders that `**` stands for have no pattern of their own.
    let tail = pattern.len() - last - 1;
    let Some(between) = path.get(first..path.len().saturating_sub(tail)) else { return false };
    spells(&pattern[..first], &path)
        && between.iter().all(|name| !name.starts_with(b"."))
        && spells(&pattern[last + 1..], &path[path.len() - tail..])
}

/// Leaves out files that are named again, by overlapping patterns or by another path to their folder.
pub fn without_repeats(mut files: Vec<PathBuf>) -> Vec<PathBuf> {
    let mut seen = BTreeSet::new();
    files.retain(|file| seen.insert(identity(file)));
    files
}

/// Refuses files or folders of which two are the same, whatever paths lead to them: what is made of all would count it twice.
///
/// # Errors
/// [`Error::Config`] under `key`, naming both.
pub fn check_distinct(key: &str, all: &[PathBuf]) -> Result<()> {
    let mut seen: BTreeMap<PathBuf, &PathBuf> = BTreeMap::new();
    for path in all {
        // What comes with the program is no file, and known by its name.
        let place = path.canonicalize().unwrap_or_else(|_| path.clone());
        if let Some(other) = seen.insert(place, path) {
            let (other, path) = (other.display().to_string(), path.display().to_string());
            let as_other = if other == path { String::new() } else { format!(", as {other} too") };
            return Err(Error::config(key, format!("names {path} twice{as_other}; name it once")));
        }
    }
    Ok(())
}

/// One path for all ways to name a file; a link is a file of its own.
pub fn identity(file: &Path) -> PathBuf {
    let folder = match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    match (folder.canonicalize(), file.file_name()) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => file.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pattern_shows_hidden_names_where_it_spells_the_dot() {
        let shown = |pattern: &str, path: &str| is_shown(Path::new(pattern), Path::new(path));
        assert!(
            shown("a/*.exr", "a/b.exr") && shown("./a/*.exr", "a/b.exr") && shown("../*.exr", "../b.exr")
        );
        assert!(!shown("a/*.exr", "a/.b.exr") && shown("a/.*.exr", "a/.b.exr"));
        assert!(!shown("*/*.exr", ".a/b.exr") && shown(".a/*.exr", ".a/b.exr"));
        assert!(!shown("**/*.exr", "a/.b/c.exr") && !shown("**/*.exr", "a/b/.c.exr"));
        assert!(shown("**/*.exr", "a/b/c.exr") && shown("**/*.exr", "c.exr"));
        assert!(shown("x/**/.b*", "x/a/.bc") && !shown("x/**/.b*", "x/.a/.bc"));
    }

    /// As those that a disk that is not mounted leaves: fewer scenes than there are would be taken for all.
    #[cfg(unix)]
    #[test]
    fn an_image_that_is_a_link_to_nothing_is_refused() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path();
        let link = |name: &str, to: &Path| std::os::unix::fs::symlink(to, folder.join(name)).unwrap();
        std::fs::write(folder.join("a.exr"), "").unwrap();
        link("linked.exr", &folder.join("a.exr"));
        // What is no image, or hidden, is left out as ever.
        link("notes", Path::new("/nowhere"));
        link(".b.exr", Path::new("/nowhere"));
        let inputs = || ["", "*", "*.exr", "**"].map(|pattern| folder.join(pattern));
        for input in inputs() {
            let found = expand_inputs(std::slice::from_ref(&input)).unwrap();
            assert_eq!(found, ["a.exr", "linked.exr"].map(|name| folder.join(name)), "{input:?}");
        }
        link("b.exr", Path::new("/nowhere"));
        for input in inputs() {
            let said = expand_inputs(std::slice::from_ref(&input)).unwrap_err().to_string();
            assert!(said.contains("b.exr"), "{said}");
        }
    }

    #[test]
    fn a_file_is_named_once_whatever_the_path_to_it() {
        let scratch = tempfile::tempdir().unwrap();
        let inner = scratch.path().join("inner");
        std::fs::create_dir(&inner).unwrap();
        let [a, b] = ["a.exr", "b.exr"].map(|name| scratch.path().join(name));
        let files = vec![a.clone(), b.clone(), a.clone(), inner.join("../a.exr")];
        assert_eq!(without_repeats(files), [a, b]);
    }

    #[test]
    fn what_is_named_by_two_paths_is_one() {
        let scratch = tempfile::tempdir().unwrap();
        let at = |name: &str| scratch.path().join(name);
        ["a", "b"].iter().for_each(|name| std::fs::create_dir(at(name)).unwrap());
        let check =
            |names: &[&str]| check_distinct("data", &names.iter().map(|name| at(name)).collect::<Vec<_>>());
        check(&["a", "b", "guided"]).unwrap();
        let said = check(&["a", "b", "b/../a"]).unwrap_err().to_string();
        assert!(said.contains("b/../a twice, as ") && said.starts_with("data: "), "{said}");
        assert!(
            check(&["guided", "guided"]).unwrap_err().to_string().ends_with("guided twice; name it once")
        );
    }
}
