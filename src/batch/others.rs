//! Images that lie in the folder of a run's, and which it does not make: of an earlier run, perhaps, that made more.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::core::error::Result;
use crate::io::{Format, is_hidden, list_folder};

/// Tells of the images in a folder that are none of those which a run makes there, in words for a warning; none where there
/// are none, or no folder. Whoever takes the folder for the run's takes these too.
///
/// # Errors
/// [`Error::Io`](crate::core::error::Error::Io) when the folder cannot be listed.
pub fn tell_of_others(folder: &Path, made: impl Iterator<Item = PathBuf>) -> Result<Option<String>> {
    if !folder.is_dir() {
        return Ok(None);
    }
    let made: BTreeSet<PathBuf> = made.collect();
    let is_other = |name: &String| {
        let is_image = Format::of_extension(Path::new(name)).is_ok();
        is_image && !is_hidden(name) && !made.contains(&folder.join(name))
    };
    let others: Vec<String> = list_folder(folder)?.into_iter().filter(is_other).collect();
    Ok(others.first().map(|first| {
        format!(
            "{} holds {} images that this run does not make, first {first}: they stay, and whatever reads the folder takes \
             them too; remove them, or name another folder",
            folder.display(),
            others.len()
        )
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_of_an_earlier_run_are_told_of() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path();
        for name in ["a_01.exr", "a_02.exr", "a_03.npy", ".a_04.exr", "read.me"] {
            std::fs::write(folder.join(name), "").unwrap();
        }
        let tell =
            |names: &[&str]| tell_of_others(folder, names.iter().map(|name| folder.join(name))).unwrap();
        let said = tell(&["a_01.exr", "a_09.exr"]).unwrap();
        assert!(said.contains("2 images that this run does not make, first a_02.exr"), "{said}");
        assert_eq!(tell(&["a_01.exr", "a_02.exr", "a_03.npy"]), None);
        assert_eq!(tell_of_others(&folder.join("absent"), std::iter::empty()).unwrap(), None);
    }
}
