//! Tells whether scenes are still those that the kept images of a dataset were made of.
//!
//! A ground truth's EXR holds the SHA-256 of its scene's file. Where it does not (as NumPy files and those of earlier versions),
//! the scene is compared with the ground truth itself, which tells neither a margin from another nor light above x_max.

use std::collections::BTreeMap;
use std::path::Path;

use rayon::prelude::*;

use crate::core::error::{Error, Result};
use crate::core::image::{Linear, LinearImage};
use crate::dataset::Triplet;
use crate::io;

use super::Formation;
use super::scenes::Scene;
use super::synthesis::Synthesis;

/// The key of the provenance of a ground truth.
const SCENE_SHA256: &str = "scene-sha256";

/// Refuses scenes that are others than those that finished triplets were made of.
///
/// # Errors
/// [`Error::Config`] naming the first such scene; else of reading a file.
pub(super) fn check_scenes(root: &Path, synthesis: &Synthesis, finished: &[Triplet]) -> Result<()> {
    let truths: BTreeMap<&str, &str> = finished.iter().map(|t| (t.id.as_str(), t.gt.as_str())).collect();
    let formation = synthesis.formation()?;
    let fault = |scene: &Scene| {
        let truth = root.join(truths.get(scene.id.as_str())?);
        match is_unchanged(scene, &truth, synthesis, &formation) {
            Ok(true) => None,
            Ok(false) => Some(Error::config("output", is_another(root, scene))),
            Err(error) => Some(error),
        }
    };
    synthesis.scenes.par_iter().find_map_first(fault).map_or(Ok(()), Err)
}

fn is_another(root: &Path, scene: &Scene) -> String {
    format!(
        "{} has images of another {} than the one that is there now; make them anew with --overwrite, or in another folder",
        root.display(),
        scene.path.display()
    )
}

fn is_unchanged(scene: &Scene, truth: &Path, synthesis: &Synthesis, formation: &Formation) -> Result<bool> {
    let provenance = io::read_provenance(truth)?;
    if let Some(known) = provenance.as_ref().and_then(|p| p.config.get(SCENE_SHA256)?.as_str()) {
        return Ok(io::sha256_of_file(&scene.path)? == known);
    }
    let stored = io::read_image::<Linear>(truth)?;
    let size = io::read_image_size::<Linear>(&scene.path, synthesis.told)?;
    if synthesis.config.formation.frame_size(size)? != sides(&stored) {
        return Ok(false);
    }
    let (image, _) = io::read_image_told::<Linear>(&scene.path, synthesis.told)?;
    Ok(is_same(&stored, &formation.ground_truth(&image)?, synthesis.config.half))
}

fn sides(image: &LinearImage) -> [usize; 2] {
    [image.height(), image.width()]
}

/// Whether a stored image is that of a scene, but for the rounding of half floats.
fn is_same(stored: &LinearImage, image: &LinearImage, half: bool) -> bool {
    let (relative, absolute) = if half { (1.0 / 1024.0, 1e-7) } else { (0.0, 0.0) };
    let near = |(a, b): (&f32, &f32)| (a - b).abs() <= relative * b.abs() + absolute;
    sides(stored) == sides(image) && stored.as_slice().iter().zip(image.as_slice()).all(near)
}
