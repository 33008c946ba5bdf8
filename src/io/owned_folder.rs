//! A folder whose entries a command makes, and makes anew: what else stands in it is somebody else's.

use std::fs::File;
use std::path::Path;

use super::{create_folder, list_folder, read_text, remove, try_lock_folder, write_atomically};
use crate::core::error::{Error, Result};

/// The layout of a folder that one command fills.
#[derive(Clone, Copy, Debug)]
pub struct OwnedFolder<'a> {
    /// What the folder holds, in words, as in `a demo`.
    pub owner: &'a str,
    /// Names and contents of the texts that it begins with; by their first lines it is known again.
    pub marks: &'a [(&'a str, &'a str)],
    /// Folders in it that are made at the beginning.
    pub folders: &'a [&'a str],
    /// What is written into it later.
    pub results: &'a [&'a str],
}

impl OwnedFolder<'_> {
    /// Makes the folder, or removes what an earlier run wrote to it; what else it holds stays. The folder is held until the
    /// returned file is dropped, where folders can be locked.
    ///
    /// # Errors
    /// [`Error::Format`] when another process holds the folder; [`Error::Unsupported`] when it holds anything and may not be
    /// replaced, or is not known again; [`Error::Io`] when it cannot be written.
    pub fn prepare(&self, root: &Path, overwrite: bool) -> Result<Option<File>> {
        create_folder(root)?;
        let held = try_lock_folder(root)?;
        if !list_folder(root)?.is_empty() {
            self.check_replaceable(root, overwrite)?;
            let marks = self.marks.iter().map(|(name, _)| name);
            let entries = marks.chain(self.folders).chain(self.results);
            entries.into_iter().try_for_each(|entry| remove(&root.join(entry)))?;
        }
        self.folders.iter().try_for_each(|folder| create_folder(&root.join(folder)))?;
        self.marks.iter().try_for_each(|(name, text)| {
            write_atomically(&root.join(name), true, |file| file.write_all(text.as_bytes()))
        })?;
        Ok(held)
    }

    fn check_replaceable(&self, root: &Path, overwrite: bool) -> Result<()> {
        let reason = match (overwrite, self.is_known(root)) {
            (true, true) => return Ok(()),
            (false, _) => "exists already; name another folder with -o, or add --overwrite".to_owned(),
            (true, false) => {
                format!("holds something else than {}; name another folder with -o", self.owner)
            }
        };
        Err(Error::Unsupported(format!("{} {reason}", root.display())))
    }

    /// Whether all texts begin as they are written.
    fn is_known(&self, root: &Path) -> bool {
        self.marks.iter().all(|(name, text)| {
            let found = read_text(&root.join(name)).unwrap_or_default();
            found.lines().next() == text.lines().next()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replaces_what_its_owner_writes_and_nothing_else() {
        let scratch = tempfile::tempdir().unwrap();
        let owned = OwnedFolder {
            owner: "a demo",
            marks: &[("panel.toml", "# Panel\nkind = 1\n"), ("training.toml", "# Training\n")],
            folders: &["psf", "scenes"],
            results: &["results", "report.html"],
        };
        let prepare = |overwrite| owned.prepare(scratch.path(), overwrite);
        let write = |name: &str| {
            let path = scratch.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, "precious").unwrap();
        };
        let is_there = |name: &str| scratch.path().join(name).exists();

        write("panel.toml");
        write("training.toml");
        assert!(prepare(true).unwrap_err().to_string().contains("something else than a demo"));
        assert!(is_there("panel.toml") && !is_there("psf"));
        std::fs::remove_file(scratch.path().join("panel.toml")).unwrap();
        std::fs::remove_file(scratch.path().join("training.toml")).unwrap();

        let held = prepare(false).unwrap();
        assert!(is_there("panel.toml") && is_there("scenes"));
        #[cfg(unix)]
        assert!(prepare(true).unwrap_err().to_string().contains("another process is writing there"));
        drop(held);
        for name in ["notes.txt", "mine/a.exr", "results/metrics.json", "report.html", "psf/a.exr"] {
            write(name);
        }
        assert!(prepare(false).unwrap_err().to_string().contains("--overwrite"));
        prepare(true).unwrap();
        assert!(is_there("notes.txt") && is_there("mine/a.exr") && is_there("psf"));
        assert!(!is_there("results") && !is_there("report.html") && !is_there("psf/a.exr"));
    }
}
