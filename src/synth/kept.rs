//! Tells whether scenes are still those that the kept images of a dataset were made of.
//!
//! The list of triplets holds the SHA-256 of each scene's file, and so does a ground truth's EXR. Where neither does, as in lists of
//! earlier versions with NumPy files, the scene is compared with the ground truth itself, which tells neither a margin from
//! another nor light above x_max: that is warned of.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

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

/// What finished triplets tell of the scene that they were made of.
#[derive(Clone, Copy)]
struct Known<'a> {
    gt: &'a str,
    sha256: Option<&'a str>,
}

/// Whether a scene is the one that its kept images were made of.
enum Kept {
    /// By its hash.
    Unchanged,
    /// As far as its ground truth tells.
    Alike,
    Changed,
}

/// Refuses scenes that are others than those that finished triplets were made of; says of how many that is not known for
/// certain, in words for a warning.
///
/// # Errors
/// [`Error::Config`] naming the first such scene; else of reading a file.
pub(super) fn check_scenes(
    root: &Path,
    synthesis: &Synthesis,
    finished: &[Triplet],
) -> Result<Option<String>> {
    let mut known: BTreeMap<&str, Known<'_>> = BTreeMap::new();
    for Triplet { id, gt, scene_sha256, .. } in finished {
        let of_scene = known.entry(id).or_insert(Known { gt, sha256: None });
        of_scene.sha256 = of_scene.sha256.or(scene_sha256.as_deref());
    }
    let formation = synthesis.formation()?;
    let alike = AtomicUsize::new(0);
    let fault = |scene: &Scene| {
        let known = *known.get(scene.id.as_str())?;
        match compare(scene, root, known, (synthesis, &formation)) {
            Ok(Kept::Unchanged) => None,
            Ok(Kept::Alike) => {
                alike.fetch_add(1, Ordering::Relaxed);
                None
            }
            Ok(Kept::Changed) => Some(Error::config("output", is_another(root, scene))),
            Err(error) => Some(error),
        }
    };
    synthesis.scenes.par_iter().find_map_first(fault).map_or(Ok(()), Err)?;
    let count = alike.into_inner();
    Ok((count > 0).then(|| {
        format!(
            "the list of triplets does not say which files {count} of the scenes were read from; they look as their ground truths, \
             which show no light above x-max and none around the frame: if such light has changed, make them anew with --overwrite"
        )
    }))
}

fn is_another(root: &Path, scene: &Scene) -> String {
    format!(
        "{} has images of another {} than the one that is there now; make them anew with --overwrite, or in another folder",
        root.display(),
        scene.path.display()
    )
}

fn compare(
    scene: &Scene,
    root: &Path,
    Known { gt, sha256 }: Known<'_>,
    (synthesis, formation): (&Synthesis, &Formation),
) -> Result<Kept> {
    let of_hash = |known: &str| -> Result<Kept> {
        let is_it = io::sha256_of_file(&scene.path)? == known;
        Ok(if is_it { Kept::Unchanged } else { Kept::Changed })
    };
    if let Some(known) = sha256 {
        return of_hash(known);
    }
    let truth = root.join(gt);
    let provenance = io::read_provenance(&truth)?;
    if let Some(known) = provenance.as_ref().and_then(|p| p.config.get(SCENE_SHA256)?.as_str()) {
        return of_hash(known);
    }
    let stored = io::read_image::<Linear>(&truth)?;
    let size = io::read_image_size::<Linear>(&scene.path, synthesis.told)?;
    if synthesis.config.formation.frame_size(size)? != sides(&stored) {
        return Ok(Kept::Changed);
    }
    let (image, _) = io::read_image_told::<Linear>(&scene.path, synthesis.told)?;
    let is_alike = is_same(&stored, &formation.ground_truth(&image)?, synthesis.config.half);
    Ok(if is_alike { Kept::Alike } else { Kept::Changed })
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
