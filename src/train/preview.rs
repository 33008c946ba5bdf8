//! Turns what a validation saw into pictures, so that a training can be looked at.

use std::path::Path;

use ndarray::{Axis, concatenate};

use super::data::Patch;
use crate::core::error::{Error, Result};
use crate::core::image::ToneMappedImage;
use crate::io::{self, PixelOptions, Pixels};

/// Enough to see what a network does; more would fill the disk over a long training.
const COUNT: usize = 4;

/// Writes degraded, restored and clean image side by side as `<index + 1>.png`, tone-mapped values from 0 to 1 in 8
/// bits; only for the first few images.
pub(super) fn write(folder: &Path, index: usize, patch: &Patch, restored: &ToneMappedImage) -> Result<()> {
    if index >= COUNT {
        return Ok(());
    }
    io::create_folder(folder)?;
    let path = folder.join(format!("{}.png", index + 1));
    let images = [patch.degraded.planes(), restored.planes(), patch.ground_truth.planes()];
    let row = concatenate(Axis(2), &images).map_err(|error| Error::format(&path, error.to_string()))?;
    let options = PixelOptions { overwrite: true, clip: true, eight_bit: true, ..PixelOptions::default() };
    io::write_pixels(&path, &Pixels::of_planes(row), options)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Planes;
    use ndarray::Array3;

    #[test]
    fn shows_degraded_restored_and_clean_image_from_left_to_right() {
        let folder = tempfile::tempdir().unwrap();
        let flat = |value| ToneMappedImage::from_planes(Array3::from_elem((3, 2, 4), value)).unwrap();
        let patch =
            Patch { degraded: flat(0.2), ground_truth: flat(1.0), code: None, planes: Planes::default() };
        for index in 0..COUNT + 1 {
            write(folder.path(), index, &patch, &flat(-0.5)).unwrap();
        }
        assert_eq!(io::list_folder(folder.path()).unwrap(), ["1.png", "2.png", "3.png", "4.png"]);
        let planes = io::read_pixels(&folder.path().join("1.png")).unwrap().planes;
        assert_eq!(planes.dim(), (3, 2, 12));
        for (x, value) in [(0, 0.2), (3, 0.2), (4, 0.0), (7, 0.0), (8, 1.0), (11, 1.0)] {
            assert!((planes[[1, 1, x]] - value).abs() < 1e-6, "column {x}");
        }
    }
}
