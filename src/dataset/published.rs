//! The published dataset, read in place: `synthetic_data/GT`, `synthetic_data/input/<name>_<i>`,
//! `PSF/kernel_code/<name>_code_<i>.npy` and `real_data/input`.

use std::path::Path;

use crate::core::error::{Error, Result};
use crate::io;

use super::config::FormationConfig;
use super::{Dataset, Split, Triplet};

/// The folder that tells the published dataset.
pub(super) const SYNTHETIC: &str = "synthetic_data";

const CODES: &str = "PSF/kernel_code";
const REAL: &str = "real_data/input";

/// Number of rotations in the published kernel set.
const KERNELS: usize = 9;

pub(super) fn open(root: &Path) -> Result<Dataset> {
    let name = set_name(root)?;
    let codes = (1..=KERNELS)
        .map(|i| {
            let path = root.join(CODES).join(format!("{name}_code_{i}.npy"));
            if !path.is_file() {
                let reason = format!("is missing; the set has {KERNELS} codes, copy them all to {CODES}/");
                return Err(Error::format(&path, reason));
            }
            io::read_code(&path)
        })
        .collect::<Result<Vec<_>>>()?;
    let mut triplets = Vec::new();
    for split in [Split::Train, Split::Test, Split::Val] {
        triplets.extend(list_split(root, &name, split)?);
    }
    if triplets.is_empty() {
        let reason = format!("{SYNTHETIC}/GT has no .npy files in train/ or test/; unpack the dataset there");
        return Err(Error::format(root, reason));
    }
    let real = root.join(REAL);
    let real_captures = if real.is_dir() {
        npy_files(&real)?.into_iter().map(|name| real.join(name)).collect()
    } else {
        Vec::new()
    };
    Ok(Dataset {
        root: root.to_owned(),
        formation: FormationConfig::released(),
        config: None,
        bank: None,
        triplets,
        real_captures,
        kernels: (1..=KERNELS).map(|i| format!("{name}_{i}")).collect(),
        codes,
    })
}

/// Finds `<name>` of `<name>_code_<i>.npy`.
fn set_name(root: &Path) -> Result<String> {
    let folder = root.join(CODES);
    if !folder.is_dir() {
        return Err(Error::format(
            root,
            format!("has {SYNTHETIC}/ and no {CODES}/; copy the kernel codes too"),
        ));
    }
    let files = npy_files(&folder)?;
    let mut names = files.iter().filter_map(|file| file.strip_suffix("_code_1.npy"));
    match (names.next(), names.next()) {
        (Some(name), None) => Ok(name.to_owned()),
        (None, _) => Err(Error::format(folder, "has no <name>_code_1.npy; copy the kernel codes there")),
        (Some(a), Some(b)) => {
            Err(Error::format(folder, format!("has codes of two kernel sets, {a} and {b}; keep one of them")))
        }
    }
}

fn list_split(root: &Path, name: &str, split: Split) -> Result<Vec<Triplet>> {
    let ground_truth = format!("{SYNTHETIC}/GT/{}", split.name());
    if !root.join(&ground_truth).is_dir() {
        return Ok(Vec::new());
    }
    let mut triplets = Vec::new();
    for file in npy_files(&root.join(&ground_truth))? {
        for i in 1..=KERNELS {
            let input = format!("{SYNTHETIC}/input/{name}_{i}");
            let with_split = format!("{input}/{}", split.name());
            let folder = if root.join(&with_split).is_dir() { with_split } else { input };
            let id = file.trim_end_matches(".npy");
            triplets.push(Triplet {
                id: id.to_owned(),
                split,
                gt: format!("{ground_truth}/{file}"),
                degraded: format!("{folder}/{file}"),
                kernel: format!("{name}_{i}"),
                angle_deg: Some(angle_deg(i)),
                source: id.to_owned(),
                sha256: None,
                scene_sha256: None,
            });
        }
    }
    Ok(triplets)
}

/// The folders of images through other kernels than `kernels`.
pub(super) fn other_inputs(root: &Path, kernels: &[String]) -> Result<Vec<String>> {
    let inputs = root.join(SYNTHETIC).join("input");
    if !inputs.is_dir() {
        return Ok(Vec::new());
    }
    let is_other = |name: &String| {
        let is_numbered = name.rsplit_once('_').is_some_and(|(_, i)| i.parse::<usize>().is_ok());
        is_numbered && !kernels.contains(name)
    };
    Ok(io::list_folder(&inputs)?.into_iter().filter(is_other).collect())
}

/// The rotation of kernel `i` (from 1): −12 to 12 degrees in steps of 3.
fn angle_deg(i: usize) -> f64 {
    3.0 * (i as f64 - 5.0)
}

fn npy_files(folder: &Path) -> Result<Vec<String>> {
    Ok(io::list_folder(folder)?.into_iter().filter(|name| name.ends_with(".npy")).collect())
}
