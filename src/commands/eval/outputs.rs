//! The folder of an evaluation's results.

use std::path::Path;

use anyhow::{Context as _, Result};

use udc::experiment::Evaluation;
use udc::io;

use super::pictures::{self, PictureName};
use super::{LDR, MISMATCH, REGIONS_CSV, plots};

/// The files that every evaluation writes.
pub(in crate::commands) const RESULTS: [&str; 3] = ["metrics.json", "metrics.csv", "table.md"];

/// A folder whose files may be written.
pub(in crate::commands) struct Outputs<'a> {
    folder: &'a Path,
    overwrite: bool,
}

impl<'a> Outputs<'a> {
    /// Makes the folder and checks, before the work starts, that files of these names may be written, and that those of
    /// an earlier evaluation may be removed.
    pub(in crate::commands) fn prepare(folder: &'a Path, names: &[String], overwrite: bool) -> Result<Self> {
        let outputs = Self { folder, overwrite };
        let earlier = outputs.earlier_results()?.into_iter().chain(outputs.earlier_pictures()?);
        for path in names.iter().cloned().chain(earlier).map(|name| folder.join(name)) {
            if path.symlink_metadata().is_ok() {
                io::check_output(&path, overwrite)?;
            }
        }
        std::fs::create_dir_all(folder)
            .with_context(|| format!("creating the folder {}", folder.display()))?;
        Ok(outputs)
    }

    pub(in crate::commands) fn write(&self, name: &str, contents: &[u8]) -> Result<()> {
        let path = self.folder.join(name);
        Ok(io::write_atomically(&path, self.overwrite, |file| file.write_all(contents))?)
    }

    /// Writes the files of [`RESULTS`].
    pub(in crate::commands) fn write_results(&self, evaluation: &Evaluation) -> Result<()> {
        let json = format!("{:#}\n", evaluation.to_json());
        for (name, text) in RESULTS.iter().zip([json, evaluation.to_csv(), evaluation.to_markdown()]) {
            self.write(name, text.as_bytes())?;
        }
        Ok(())
    }

    /// Removes the pictures of an earlier evaluation, which may be of other images or methods.
    pub(super) fn remove_earlier_pictures(&self) -> Result<()> {
        self.remove(&self.earlier_pictures()?)
    }

    /// Removes the results of an earlier evaluation, which may have had more of them.
    pub(super) fn remove_earlier_results(&self) -> Result<()> {
        self.remove(&self.earlier_results()?)
    }

    fn remove(&self, names: &[String]) -> Result<()> {
        names.iter().try_for_each(|name| Ok(io::remove(&self.folder.join(name))?))
    }

    fn earlier_results(&self) -> Result<Vec<String>> {
        let is_own = |name: &String| {
            let own = RESULTS.iter().chain(&MISMATCH).chain(&LDR).chain([&REGIONS_CSV]);
            own.into_iter().any(|own| own == name) || plots::is_plot(name)
        };
        Ok(list(self.folder)?.into_iter().filter(is_own).collect())
    }

    fn earlier_pictures(&self) -> Result<Vec<String>> {
        let mut names = list(&self.folder.join(pictures::FOLDER))?;
        names.retain(|name| PictureName::of_file(name).is_some());
        Ok(names.into_iter().map(|name| format!("{}/{name}", pictures::FOLDER)).collect())
    }
}

/// The names in a folder; none where there is none.
fn list(folder: &Path) -> Result<Vec<String>> {
    if folder.is_dir() { Ok(io::list_folder(folder)?) } else { Ok(Vec::new()) }
}
