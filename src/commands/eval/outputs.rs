//! The folder of an evaluation's results.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};

use udc::core::io;
use udc::eval::Evaluation;

/// The files that every evaluation writes.
pub(in crate::commands) const RESULTS: [&str; 3] = ["metrics.json", "metrics.csv", "table.md"];

/// A folder whose files may be written.
pub(in crate::commands) struct Outputs<'a> {
    folder: &'a Path,
    overwrite: bool,
}

impl<'a> Outputs<'a> {
    /// Makes the folder and checks, before the work starts, that files of these names may be written.
    pub(in crate::commands) fn prepare(folder: &'a Path, names: &[String], overwrite: bool) -> Result<Self> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("creating the folder {}", folder.display()))?;
        let paths = names.iter().map(|name| folder.join(name));
        paths.collect::<Vec<PathBuf>>().iter().try_for_each(|path| io::check_output(path, overwrite))?;
        Ok(Self { folder, overwrite })
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
}
