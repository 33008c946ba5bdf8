//! Synthesises a dataset: every scene through every kernel, into a folder.

use std::path::Path;

use crate::core::error::Result;
use crate::core::image::Linear;
use crate::core::progress::Progress;
use crate::dataset::CONFIG_FILE;
use crate::io;

use super::existing::Existing;
use super::folder::DatasetFolder;
use super::scene_run::{Run, SceneReport};
use super::sources::check_sources;
use super::synthesis::Synthesis;

/// What a synthesis tells of as it goes on.
#[derive(Clone, Copy, Debug)]
pub enum SynthesisReport<'a> {
    /// What becomes of images that were there, in words for a warning.
    Warning(&'a str),
    /// A scene is done.
    Scene(&'a SceneReport),
}

impl Synthesis {
    /// Makes the dataset in the folder `root`, telling `on_report` what becomes of it.
    ///
    /// # Errors
    /// [`Error::Config`](crate::core::error::Error::Config) when the folder must not be touched, as one that a scene
    /// would be replaced in, or memory does not suffice;
    /// [`Error::Interrupted`](crate::core::error::Error::Interrupted) after an interrupt, whatever is finished staying; else
    /// of reading or writing a file.
    pub fn run(
        &self,
        root: &Path,
        existing: Existing,
        progress: &Progress,
        mut on_report: impl FnMut(SynthesisReport<'_>),
    ) -> Result<()> {
        let names: Vec<_> = (0..self.bank.len()).map(|index| self.bank.kernel_name(index)).collect();
        let formation = self.formation()?;
        check_sources(root, self)?;
        if let (Some(first), false) = (self.scenes.first(), root.join(CONFIG_FILE).is_file()) {
            // A header does not show all that is wrong; nothing is begun that cannot go on.
            io::read_image_told::<Linear>(&first.path, self.told)?;
        }
        let folder = DatasetFolder::prepare(root, self, existing)?;
        folder.warnings.iter().for_each(|warning| on_report(SynthesisReport::Warning(warning)));
        folder.create_image_folders(&names)?;
        let bar = progress.bar((self.scenes.len() * names.len()) as u64, "images");
        let mut run = Run { synthesis: self, formation, folder, names, kernels: None };
        let made = self.scenes.iter().try_for_each(|scene| {
            let todo = run.unfinished(scene);
            bar.inc((run.names.len() - todo.len()) as u64);
            if !todo.is_empty() {
                progress.check()?;
                let report = run.make(scene, &todo, |images| {
                    bar.inc(images as u64);
                    progress.check()
                })?;
                on_report(SynthesisReport::Scene(&report));
            }
            Ok(())
        });
        // Whatever happened: what is made is kept.
        let kept = run.folder.finish();
        bar.finish_and_clear();
        made.and(kept)?;
        run.folder.complete()
    }
}
