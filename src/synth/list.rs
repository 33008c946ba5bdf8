//! Reads the lists of triplets that runs leave in a dataset's folder.

use std::collections::BTreeSet;
use std::path::Path;

use rayon::prelude::*;

use crate::core::error::Result;
use crate::core::image::Linear;
use crate::dataset::Triplet;
use crate::io;

/// The file of a scene's ground truth, or of its image through a kernel, in a dataset's folder.
pub(super) fn file_of(id: &str, kernel: Option<&str>, extension: &str) -> String {
    match kernel {
        Some(kernel) => format!("degraded/{kernel}/{id}.{extension}"),
        None => format!("gt/{id}.{extension}"),
    }
}

/// The line of a triplet.
pub(super) fn to_line(triplet: &Triplet) -> String {
    serde_json::to_string(triplet).expect("triplets are plain data")
}

/// The triplets of a list; lines that a killed run left unfinished are skipped.
pub(super) fn listed(list: &Path) -> Result<Vec<Triplet>> {
    let text = io::read_text(list)?;
    let triplets = text.lines().filter_map(|line| serde_json::from_str(line).ok());
    Ok(triplets.filter(|triplet: &Triplet| triplet.check_paths().is_ok()).collect())
}

/// The triplets of a list whose files are there: the degraded image with the recorded hash, and a ground truth, whose
/// hash nobody recorded, that can be read.
pub(super) fn finished_triplets(root: &Path, list: &Path) -> Result<Vec<Triplet>> {
    if !list.is_file() {
        return Ok(Vec::new());
    }
    let triplets = listed(list)?;
    let truths: BTreeSet<&str> = triplets.iter().map(|triplet| triplet.gt.as_str()).collect();
    let truths: BTreeSet<String> = truths
        .into_par_iter()
        .filter(|gt| io::read_image::<Linear>(&root.join(gt)).is_ok())
        .map(str::to_owned)
        .collect();
    let intact = |triplet: &Triplet| {
        truths.contains(&triplet.gt)
            && io::sha256_of_file(&root.join(&triplet.degraded)).ok() == triplet.sha256
            && triplet.sha256.is_some()
    };
    Ok(triplets.into_par_iter().filter(intact).collect())
}
