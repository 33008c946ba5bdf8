//! Names the panoramas that views are cut out of, and divides them: none is both learned from and validated with.

use std::path::PathBuf;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::config::ExamplesConfig;
use crate::core::error::{Error, Result};
use crate::core::image::Linear;
use crate::crop::Panorama;
use crate::dataset::Split;
use crate::io;

/// A panorama that views are cut out of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct PanoramaFile {
    /// Its file's name without extension.
    pub name: String,
    /// Its file.
    pub path: PathBuf,
    /// SHA-256 of the file.
    pub sha256: String,
    /// What it is for.
    pub split: Split,
}

impl PanoramaFile {
    /// Reads it.
    pub(super) fn read(&self) -> Result<Panorama> {
        self.read_with_doubts().map(|(panorama, _)| panorama)
    }

    /// Reads it, with what is to be warned of.
    fn read_with_doubts(&self) -> Result<(Panorama, Option<String>)> {
        let doing = |error: Error| error.while_doing(format!("reading the panorama {}", self.path.display()));
        let (image, doubts) = io::read_image_told::<Linear>(&self.path, None).map_err(doing)?;
        Ok((Panorama::new(image).map_err(doing)?, doubts))
    }
}

/// Names and divides the configuration's panoramas, and says what of their files is to be warned of: the same names are always kept for
/// validation under a seed. They are sorted by name, so that the order in which files are named decides nothing.
///
/// # Errors
/// [`Error::Config`] when two have one name; those of reading a file that is no panorama.
pub(super) fn list_panoramas(config: &ExamplesConfig) -> Result<(Vec<PanoramaFile>, Vec<String>)> {
    if config.scenes.procedural_share >= 1.0 {
        return Ok((Vec::new(), Vec::new()));
    }
    let open = |path: &PathBuf| {
        let name = io::stem_of_input(path);
        let sha256 = io::sha256_of_file(path)?;
        let file = PanoramaFile { name, path: path.clone(), sha256, split: Split::Train };
        let (_, doubts) = file.read_with_doubts()?;
        Ok((file, doubts))
    };
    let mut opened: Vec<(PanoramaFile, Option<String>)> =
        config.scenes.panoramas.par_iter().map(open).collect::<Result<_>>()?;
    opened.sort_by(|(a, _), (b, _)| a.name.cmp(&b.name));
    let (mut files, doubts): (Vec<PanoramaFile>, Vec<Option<String>>) = opened.into_iter().unzip();
    if let Some(pair) = files.windows(2).find(|pair| pair[0].name == pair[1].name) {
        let [one, other] = [&pair[0], &pair[1]].map(|file| file.path.display());
        let reason = format!("{one} and {other} are both named {}; rename one of them", pair[0].name);
        return Err(Error::config("examples.scenes.panoramas", reason));
    }
    let mut ranked: Vec<_> = (0..files.len()).map(|i| (rank(&files[i].name, config.seed), i)).collect();
    ranked.sort_unstable();
    for (_, index) in ranked.into_iter().take(config.panoramas_kept()) {
        files[index].split = Split::Val;
    }
    Ok((files, doubts.into_iter().flatten().collect()))
}

/// A number that depends on the name and the seed only.
fn rank(name: &str, seed: u64) -> [u8; 32] {
    let mut hash = Sha256::new();
    hash.update(seed.to_le_bytes());
    hash.update(name.as_bytes());
    hash.finalize().into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::LinearImage;
    use ndarray::Array3;
    use std::path::Path;

    fn write(path: PathBuf, width: usize) -> PathBuf {
        io::create_folder(path.parent().unwrap()).unwrap();
        let image = LinearImage::from_planes(Array3::from_elem((3, 4, width), 0.5)).unwrap();
        io::write_image(&path, &image, &io::WriteOptions::default()).unwrap();
        path
    }

    fn list(paths: &[&PathBuf]) -> Result<Vec<PanoramaFile>> {
        let mut config = ExamplesConfig::default();
        config.scenes.panoramas = paths.iter().map(|&path| path.clone()).collect();
        config.scenes.validation_panoramas = 2;
        list_panoramas(&config).map(|(files, _)| files)
    }

    #[test]
    fn the_order_of_files_decides_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b, c] = ["a.npy", "b.npy", "c.npy"].map(|name| write(folder.path().join(name), 8));
        let files = list(&[&c, &a, &b]).unwrap();
        assert_eq!(list(&[&a, &b, &c]).unwrap(), files);
        assert_eq!(files.iter().filter(|file| file.split == Split::Val).count(), 2);
    }

    #[test]
    fn two_of_one_name_and_what_is_no_panorama_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(Path::new(name));
        let (one, other, view) = (write(at("a.npy"), 8), write(at("b/a.npy"), 8), write(at("c.npy"), 9));
        assert!(list(&[&one, &other]).unwrap_err().to_string().contains("both named a"));
        let message = list(&[&one, &view]).unwrap_err().in_full();
        assert!(message.contains("twice as wide as high"), "{message}");
    }
}
