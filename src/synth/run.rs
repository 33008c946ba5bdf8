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

impl Synthesis {
    /// Makes the dataset in the folder `root`, telling `on_scene` of each scene as it is done.
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
        mut on_scene: impl FnMut(&SceneReport),
    ) -> Result<()> {
        let names: Vec<_> = (0..self.bank.len()).map(|index| self.bank.kernel_name(index)).collect();
        let formation = self.formation()?;
        check_sources(root, self)?;
        if let (Some(first), false) = (self.scenes.first(), root.join(CONFIG_FILE).is_file()) {
            // A header does not show all that is wrong; nothing is begun that cannot go on.
            io::read_image_told::<Linear>(&first.path, self.told)?;
        }
        let folder = DatasetFolder::prepare(root, self, existing)?;
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
                on_scene(&report);
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
