//! Which of the files that a user names belong to one capture.

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use crate::core::error::{Error, Result};
use crate::io::{
    expand_inputs, identity, is_hidden, list_folder, names_folder, stem_of_input, without_repeats,
};

/// Where the published dataset keeps its captures.
const PUBLISHED_CAPTURES: &str = "real_data/input";

/// The files of one capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CaptureFiles {
    /// What its results are called.
    pub name: String,
    /// One file, or those of a bracket.
    pub files: Vec<PathBuf>,
}

/// The captures that a user names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CaptureGroups {
    /// The captures, each once.
    pub captures: Vec<CaptureFiles>,
    /// Whether their results belong in a folder, however many they are.
    pub in_folder: bool,
    /// What was left out, and why.
    pub warnings: Vec<String>,
}

impl CaptureFiles {
    fn new(named: &Path, files: Vec<PathBuf>, name: Option<&OsStr>) -> Self {
        let name = name.unwrap_or(named.as_os_str()).to_string_lossy().into_owned();
        Self { name, files }
    }
}

impl CaptureGroups {
    /// Takes each file for a capture; the folder of the published dataset stands for its real ones.
    ///
    /// # Errors
    /// As [`expand_inputs`].
    pub fn of_files(inputs: &[PathBuf]) -> Result<Self> {
        let of_published = |input: &PathBuf| {
            let published = input.join(PUBLISHED_CAPTURES);
            if published.is_dir() { published } else { input.clone() }
        };
        let files = without_repeats(expand_inputs(&inputs.iter().map(of_published).collect::<Vec<_>>())?);
        let captures =
            files.into_iter().map(|file| CaptureFiles { name: stem_of_input(&file), files: vec![file] });
        let in_folder = inputs.iter().any(|input| names_folder(input));
        let warnings = inputs.iter().filter_map(|input| folders_left_out(&of_published(input))).collect();
        Ok(Self { captures: captures.collect(), in_folder, warnings })
    }

    /// Takes each folder of pictures for a bracket, and all files that are named themselves for one; of a folder that holds
    /// folders, each of these.
    ///
    /// # Errors
    /// As [`expand_inputs`]; [`Error::Unsupported`] when no folder holds images.
    pub fn of_brackets(inputs: &[PathBuf]) -> Result<Self> {
        let (folders, files): (Vec<PathBuf>, Vec<PathBuf>) =
            inputs.iter().cloned().partition(|input| input.is_dir());
        if let Some(folder) = files.iter().find(|input| names_folder(input)) {
            let reason =
                format!("{}: name the layer of each file of a bracket, not of its folder", folder.display());
            return Err(Error::Unsupported(reason));
        }
        let mut groups = Self { captures: Vec::new(), in_folder: false, warnings: Vec::new() };
        if !files.is_empty() {
            let files = without_repeats(expand_inputs(&files)?);
            let first = files[0].clone();
            groups.captures.push(CaptureFiles { name: stem_of_input(&first), files });
        }
        for folder in folders {
            groups.add_folder(folder)?;
        }
        if groups.captures.is_empty() {
            let reason = "no folder holds images; each folder inside of the one that is named is a bracket";
            return Err(Error::Unsupported(reason.to_owned()));
        }
        let mut seen = BTreeSet::new();
        let identities =
            |capture: &CaptureFiles| capture.files.iter().map(|file| identity(file)).collect::<Vec<_>>();
        groups.captures.retain(|capture| seen.insert(identities(capture)));
        Ok(groups)
    }

    fn add_folder(&mut self, folder: PathBuf) -> Result<()> {
        let names = list_folder(&folder)?;
        let shown = names.iter().filter(|name| !is_hidden(name));
        let inner: Vec<PathBuf> = shown.map(|name| folder.join(name)).filter(|path| path.is_dir()).collect();
        let is_flat = inner.is_empty();
        self.in_folder |= !is_flat;
        if !is_flat && let Ok(beside) = expand_inputs(std::slice::from_ref(&folder)) {
            let images = if beside.len() == 1 { "image" } else { "images" };
            self.warnings.push(format!(
                "{}: {} {images} of no bracket left out, beside the folders of brackets: each bracket wants a folder of its own",
                folder.display(),
                beside.len()
            ));
        }
        for bracket in if is_flat { vec![folder] } else { inner } {
            let files = match expand_inputs(std::slice::from_ref(&bracket)) {
                Err(error @ Error::Format { .. }) if !is_flat => {
                    self.warnings.push(format!("{error}; it is left out"));
                    continue;
                }
                files => files?,
            };
            // `.` has no name of its own.
            let place = bracket.canonicalize().unwrap_or_else(|_| bracket.clone());
            self.captures.push(CaptureFiles::new(&bracket, files, place.file_name()));
        }
        Ok(())
    }
}

/// What to tell of the folders inside of one whose images are taken, if some hold images, too.
fn folders_left_out(folder: &Path) -> Option<String> {
    let names = if folder.is_dir() { list_folder(folder).ok()? } else { return None };
    let holds_images = |name: &&String| {
        let path = folder.join(name);
        !is_hidden(name) && path.is_dir() && expand_inputs(&[path]).is_ok()
    };
    let inner: Vec<&String> = names.iter().filter(holds_images).collect();
    let which = match inner[..] {
        [] => return None,
        [one] => format!("the folder {one}"),
        [first, ..] => format!("{} folders, {first} for one,", inner.len()),
    };
    Some(format!(
        "{}: images in {which} inside of it are left out; to take them, name each folder or a pattern such as '{}'",
        folder.display(),
        folder.join("*/*").display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_folder_inside_of_a_folder_is_a_bracket_unless_it_holds_no_image() {
        let scratch = tempfile::tempdir().unwrap();
        for name in ["a/1.exr", "a/2.exr", "b/1.exr", "notes/read.me"] {
            let path = scratch.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        let found =
            CaptureGroups::of_brackets(&[scratch.path().to_owned(), scratch.path().join("b")]).unwrap();
        let names: Vec<_> =
            found.captures.iter().map(|capture| (&capture.name[..], capture.files.len())).collect();
        assert_eq!((names, found.in_folder), (vec![("a", 2), ("b", 1)], true));
        assert!(found.warnings[0].contains("notes") && found.warnings[0].ends_with("left out"));
        std::fs::write(scratch.path().join("3.exr"), "").unwrap();
        let found = CaptureGroups::of_brackets(&[scratch.path().to_owned()]).unwrap();
        assert_eq!(found.captures.len(), 2);
        assert!(found.warnings[0].contains("1 image of no bracket"), "{:?}", found.warnings);
        assert!(CaptureGroups::of_brackets(&[scratch.path().join("notes")]).is_err());
    }

    #[test]
    fn folders_inside_of_a_folder_of_captures_are_told_of() {
        let scratch = tempfile::tempdir().unwrap();
        for name in ["1.exr", "a/1.exr", "notes/read.me", ".hidden/1.exr"] {
            let path = scratch.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "").unwrap();
        }
        let found = CaptureGroups::of_files(&[scratch.path().to_owned()]).unwrap();
        assert_eq!(found.captures.len(), 1);
        assert!(found.warnings[0].contains("images in the folder a inside"), "{:?}", found.warnings);
        let found =
            CaptureGroups::of_files(&[scratch.path().join("a"), scratch.path().join("1.exr")]).unwrap();
        assert_eq!(found.warnings, [""; 0]);
    }
}
