//! Turns a reference picture into the means of its channels, in the colours that the finished picture has.

use std::path::Path;

use super::{ColorMatrix, channel_means, each_pixel};
use crate::core::color::{srgb_decode, srgb_encode};
use crate::core::error::{Error, Result};
use crate::core::primaries::{ColorSpace, Primaries};
use crate::io::{Pixels, read_pixels};

/// What is taken over of a reference picture.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Reference {
    /// The mean of each channel, in display values of the colours that were asked for.
    pub(super) means: [f64; 3],
    /// What the file says of its colours and is not heeded, to be warned of.
    pub(super) doubt: Option<String>,
}

impl Reference {
    /// Reads a picture, whose values are display values of sRGB or of the primaries that its file says, and converts it to `space`.
    ///
    /// # Errors
    /// As [`read_pixels`]; [`Error::Format`] for a grey picture.
    pub(super) fn read(path: &Path, space: ColorSpace) -> Result<Self> {
        let pixels = read_pixels(path)?;
        if pixels.planes.dim().0 != 3 {
            return Err(Error::format(path, "is grey; a reference picture has three channels"));
        }
        let doubt = doubt_of(&pixels).map(|doubt| {
            format!("{}: {doubt}; a reference's values are taken for those of sRGB's curve", path.display())
        });
        let said = pixels.capture.as_ref().and_then(|capture| capture.primaries);
        let (from, to) = (said.unwrap_or(Primaries::SRGB), space.primaries());
        let mut planes = pixels.planes;
        if let Some(matrix) = from.matrix_to(&to).filter(|_| !from.is_near(&to)) {
            let matrix = ColorMatrix::of(matrix);
            #[expect(clippy::cast_possible_truncation, reason = "images are f32")]
            let through = |curve: fn(f64) -> f64| move |value: f32| curve(f64::from(value)) as f32;
            each_pixel(&mut planes, |pixel| {
                matrix.apply_to(pixel.map(through(srgb_decode))).map(through(srgb_encode))
            });
        }
        Ok(Self { means: channel_means(&planes), doubt })
    }
}

/// Curves other than that of sRGB, and primaries that are not known.
fn doubt_of(pixels: &Pixels) -> Option<String> {
    let tags = pixels.color_tags.iter().filter(|tag| !tag.is_converted());
    let said: Vec<String> = tags.map(|tag| format!("its {} says {}", tag.place, tag.says)).collect();
    (!said.is_empty()).then(|| said.join(", and "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{PixelOptions, write_pixels};
    use ndarray::Array3;

    /// Display P3 (0.5, 0.5, 0.5) is grey in sRGB too; (1, 0, 0) is redder than sRGB's red, and (0.9, 0.3, 0.3) lies inside.
    #[test]
    fn a_picture_of_other_primaries_is_converted_to_those_of_the_output() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("phone.png");
        let planes = Array3::from_shape_fn((3, 4, 4), |(c, ..)| [0.9, 0.3, 0.3][c]);
        let options = PixelOptions { color_space: Some(ColorSpace::DisplayP3), ..PixelOptions::default() };
        write_pixels(&path, &Pixels::of_planes(planes), options).unwrap();
        let means = |space| {
            let reference = Reference::read(&path, space).unwrap();
            assert_eq!(reference.doubt, None);
            reference.means
        };
        let near = |found: [f64; 3], expected: [f64; 3]| {
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 2e-3), "{found:?}");
        };
        near(means(ColorSpace::DisplayP3), [0.9, 0.3, 0.3]);
        // The matrix of CSS Color 4 on light of 0.7874, 0.0732, 0.0732.
        near(means(ColorSpace::Srgb), [0.977, 0.230, 0.270]);
    }
}
