//! Makes thumbnails of images and PSFs, small enough for a terminal.

use std::path::Path;

use ndarray::{Array3, Axis, concatenate, s};

use super::Inspection;
use crate::core::error::Result;
use crate::core::psf::Psf;
use crate::io::{DomainTag, Format, Pixels, PsfOptions, inspect_psf, read_bank, read_pixels};

/// A small picture, three bytes a pixel: red, green, blue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Thumbnail {
    /// Number of columns.
    pub width: usize,
    /// Row by row.
    pub pixels: Vec<[u8; 3]>,
}

/// What stands for pixels without any finite value.
const NOT_FINITE: [u8; 3] = [255, 0, 255];

/// Of linear light, what 99 % of the pixels stay below is white.
const WHITE_SHARE: f64 = 0.99;

/// A PSF is shown over so many decades below its brightest place.
const PSF_DECADES: f32 = 6.0;

/// How values become brightness.
#[derive(Clone, Copy, Debug)]
enum Stretch {
    /// They are shown as they are.
    None,
    /// Light, as a share of white, is encoded for a screen.
    Light { white: f32 },
    /// Decades below the brightest.
    Decades { brightest: f32 },
}

impl Thumbnail {
    /// Number of rows.
    pub fn height(&self) -> usize {
        self.pixels.len() / self.width.max(1)
    }

    /// Makes a thumbnail of what was found in a file: at most so many pixels wide, and twice as high; the PSFs of a
    /// bank side by side; none of what is no picture.
    ///
    /// # Errors
    /// Those of reading the file.
    pub fn of(path: &Path, found: &Inspection, options: PsfOptions, columns: usize) -> Result<Option<Self>> {
        Ok(match found {
            Inspection::Psf(_) => {
                Some(Self::of_psf(inspect_psf(path, options)?.psf.planes().to_owned(), columns))
            }
            Inspection::Image(image) if image.is_likely_psf() => {
                Some(Self::of_psf(read_pixels(path)?.planes, columns))
            }
            Inspection::Image(_) => Some(Self::of_image(path, read_pixels(path)?, columns)),
            Inspection::KernelBank(_) => {
                let bank = read_bank(path)?;
                let side_by_side: Vec<_> = bank.psfs.iter().map(Psf::planes).collect();
                let planes = concatenate(Axis(2), &side_by_side);
                planes.ok().map(|planes| Self::of_psf(planes, columns))
            }
            _ => None,
        })
    }

    fn of_psf(planes: Array3<f32>, columns: usize) -> Self {
        let small = shrunk(&colored(planes), columns);
        let brightest = small.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::max);
        Self::developed(&small, Stretch::Decades { brightest })
    }

    fn of_image(path: &Path, pixels: Pixels, columns: usize) -> Self {
        let is_float = Format::of_extension(path).is_ok_and(Format::holds_light);
        let is_light = match pixels.domain {
            Some(DomainTag::Linear) => true,
            Some(_) => false,
            None => is_float || pixels.raw.is_some(),
        };
        let small = shrunk(&colored(pixels.planes), columns);
        let stretch = if is_light { Stretch::Light { white: white_of(&small) } } else { Stretch::None };
        Self::developed(&small, stretch)
    }

    fn developed(planes: &Array3<f32>, stretch: Stretch) -> Self {
        let (_, height, width) = planes.dim();
        let pixel = |y: usize, x: usize| {
            let values = [0, 1, 2].map(|channel| planes[[channel, y, x]]);
            if values.iter().any(|value| value.is_nan()) {
                NOT_FINITE
            } else {
                values.map(|value| stretch.byte(value))
            }
        };
        let pixels =
            (0..height).flat_map(|y| (0..width).map(move |x| (y, x))).map(|(y, x)| pixel(y, x)).collect();
        Self { width, pixels }
    }
}

impl Stretch {
    fn byte(self, value: f32) -> u8 {
        let share = match self {
            Self::None => value,
            Self::Light { white } => encoded(value / white),
            Self::Decades { brightest } => 1.0 + (value / brightest).log10() / PSF_DECADES,
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped; no number is black"
        )]
        let byte = (share.clamp(0.0, 1.0) * 255.0).round() as u8;
        byte
    }
}

/// The curve of sRGB (IEC 61966-2-1).
fn encoded(light: f32) -> f32 {
    if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}

/// What all but the brightest stay below; 1 where all is dark.
fn white_of(planes: &Array3<f32>) -> f32 {
    let mut values: Vec<f32> =
        planes.iter().copied().filter(|value| *value > 0.0 && value.is_finite()).collect();
    values.sort_unstable_by(f32::total_cmp);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a place in the list")]
    let place = (values.len() as f64 * WHITE_SHARE) as usize;
    values.get(place.min(values.len().saturating_sub(1))).copied().unwrap_or(1.0)
}

/// Three channels: those that there are, or the mean of another number in each.
fn colored(planes: Array3<f32>) -> Array3<f32> {
    let (channels, height, width) = planes.dim();
    if channels == 3 {
        return planes;
    }
    #[expect(clippy::cast_precision_loss, reason = "images have few channels")]
    let mean = planes.sum_axis(Axis(0)) / channels as f32;
    Array3::from_shape_fn((3, height, width), |(_, y, x)| mean[[y, x]])
}

/// The means over the pixels' areas, at most so many columns wide and twice as many rows high; NaN where no value of an
/// area is finite.
fn shrunk(planes: &Array3<f32>, columns: usize) -> Array3<f32> {
    let (channels, height, width) = planes.dim();
    let factor = (width as f64 / columns as f64).max(height as f64 / (2 * columns) as f64).max(1.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "smaller than the image")]
    let [rows, columns] = [height, width].map(|side| ((side as f64 / factor).round() as usize).max(1));
    let edge = |index: usize, count: usize, side: usize| index * side / count;
    Array3::from_shape_fn((channels, rows, columns), |(channel, row, column)| {
        let area = s![
            channel,
            edge(row, rows, height)..edge(row + 1, rows, height),
            edge(column, columns, width)..edge(column + 1, columns, width)
        ];
        let finite = planes
            .slice(area)
            .into_iter()
            .filter(|value| value.is_finite())
            .fold((0.0, 0.0), |(sum, count), v| (sum + f64::from(*v), count + 1.0));
        #[expect(clippy::cast_possible_truncation, reason = "a mean of 32-bit floats")]
        let mean = (finite.0 / finite.1) as f32;
        mean
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_shrunk_and_keeps_its_sides() {
        let planes = Array3::from_shape_fn((3, 40, 80), |(_, _, x)| if x < 40 { 0.0 } else { 1.0 });
        let found = Thumbnail::developed(&shrunk(&planes, 8), Stretch::None);
        assert_eq!((found.width, found.height()), (8, 4));
        assert_eq!((found.pixels[3], found.pixels[4]), ([0; 3], [255; 3]));
        let tall = shrunk(&Array3::zeros((3, 1000, 1)), 10);
        assert_eq!(tall.dim(), (3, 20, 1));
        assert_eq!(shrunk(&Array3::zeros((3, 1, 1)), 10).dim(), (3, 1, 1));
    }

    #[test]
    fn what_is_not_finite_stands_out() {
        let mut planes = Array3::from_elem((3, 2, 4), 0.5);
        planes[[0, 0, 0]] = f32::NAN;
        planes.slice_mut(s![.., .., 2..]).fill(f32::INFINITY);
        let found = Thumbnail::developed(&shrunk(&planes, 2), Stretch::None);
        assert_eq!(found.pixels, [[128; 3], NOT_FINITE]);
    }

    #[test]
    fn a_psf_is_shown_by_decades() {
        let stretch = Stretch::Decades { brightest: 10.0 };
        let bytes = [10.0, 1e-2, 1e-5, 1e-9, 0.0].map(|value| stretch.byte(value));
        assert_eq!(bytes, [255, 128, 0, 0, 0]);
    }

    #[test]
    fn dark_and_grey_pictures_have_a_white() {
        assert!((white_of(&Array3::zeros((3, 2, 2))) - 1.0).abs() < f32::EPSILON);
        assert_eq!(colored(Array3::from_elem((4, 2, 2), 0.25)), Array3::from_elem((3, 2, 2), 0.25));
    }
}
