//! Keeps the scenes that a dataset is made of from being replaced by its own images: a scene may lie in the folder that the
//! dataset is written to.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::core::error::{Error, Result};
use crate::io;

use super::archives::is_archive;
use super::synthesis::Synthesis;

/// Refuses scenes whose files the dataset's images would replace, or whose archives a new beginning would remove.
///
/// # Errors
/// [`Error::Config`] naming the first such scene.
pub(super) fn check_sources(root: &Path, synthesis: &Synthesis) -> Result<()> {
    // What is not there yet holds no scene.
    let Ok(root) = root.canonicalize() else { return Ok(()) };
    let degraded =
        (0..synthesis.bank.len()).map(|index| root.join("degraded").join(synthesis.bank.kernel_name(index)));
    let folders = degraded.chain([root.join("gt")]).filter_map(|folder| folder.canonicalize().ok());
    let folders: BTreeSet<PathBuf> = folders.collect();
    let extension = &synthesis.config.image_format;
    let names = synthesis.scenes.iter().map(|scene| format!("{}.{extension}", scene.id));
    let names: BTreeSet<String> = names.collect();
    let has_name = |file: &Path| {
        file.file_name().and_then(|name| name.to_str()).is_some_and(|name| names.contains(name))
    };
    let is_image =
        |file: &Path| file.parent().is_some_and(|folder| folders.contains(folder)) && has_name(file);
    let is_in_archive = |file: &Path| {
        let first = file.strip_prefix(&root).ok().and_then(|inner| inner.iter().next()?.to_str());
        first.is_some_and(|name| is_archive(name) && root.join(name).is_file())
    };
    for scene in &synthesis.scenes {
        // The file, and the one that it links to.
        let files = [Some(io::identity(&scene.path)), scene.path.canonicalize().ok()];
        if files.iter().flatten().any(|file| is_image(file) || is_in_archive(file)) {
            let reason = format!(
                "{} holds the scene {}, which the dataset's own files would replace; name another folder",
                root.display(),
                scene.path.display()
            );
            return Err(Error::config("output", reason));
        }
    }
    Ok(())
}
