//! Turns a reference picture into the means of its channels, in the colours that the finished picture has.

use std::path::Path;

use ndarray::Array3;

use super::{ColorMatrix, channel_means, each_pixel};
use crate::core::color::{srgb_decode, srgb_encode};
use crate::core::error::{Error, Result};
use crate::core::image::first_non_finite;
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
    /// As [`read_pixels`]; [`Error::Format`] for a picture without three channels, with a value that is not finite, or without any light:
    /// whatever is scaled to that is all white or all black.
    pub(super) fn read(path: &Path, space: ColorSpace) -> Result<Self> {
        let pixels = read_pixels(path)?;
        check(path, &pixels.planes)?;
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

/// Refuses what no picture can be scaled to.
fn check(path: &Path, planes: &Array3<f32>) -> Result<()> {
    if planes.dim().0 != 3 {
        return Err(Error::format(path, "is grey; a reference picture has three channels"));
    }
    if let Some(((channel, row, column), value)) = first_non_finite(planes) {
        let reason = format!(
            "the image holds {value} at row {row}, column {column}, channel {channel}; replace such pixels by numbers before \
             using it"
        );
        return Err(Error::format(path, reason));
    }
    if channel_means(planes).iter().all(|mean| *mean <= 0.0) {
        return Err(Error::format(path, "is black; name a reference picture that shows something"));
    }
    Ok(())
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

    #[test]
    fn only_pictures_with_light_are_references() {
        let mut planes = Array3::zeros((3, 2, 2));
        let refusal = |planes: &Array3<f32>| check(Path::new("a.npy"), planes).unwrap_err().to_string();
        assert!(refusal(&planes).starts_with("a.npy: is black"));
        planes[[1, 0, 1]] = 2.0;
        assert!(check(Path::new("a.npy"), &planes).is_ok());
        for value in [f32::NAN, f32::INFINITY] {
            planes[[2, 1, 0]] = value;
            let said = refusal(&planes);
            assert!(said.contains(&format!("holds {value} at row 1, column 0, channel 2")), "{said}");
        }
        assert!(refusal(&Array3::ones((1, 2, 2))).contains("is grey"));
    }
}
