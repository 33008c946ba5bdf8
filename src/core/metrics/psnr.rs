//! Peak signal-to-noise ratio.

use rayon::prelude::*;

use super::{Mask, MetricDefinition, Planes, Pool, counts};
use crate::core::error::Result;
use crate::core::image::{CHANNELS, ToneMappedImage};

/// The peak signal-to-noise ratio of an image against its ground truth, in decibels.
///
/// # Equation
/// `−10·log₁₀(mean (a − b)²)` over all pixels and channels, the peak being 1; infinite for equal images.
///
/// # Errors
/// [`Error::Shape`](crate::core::error::Error::Shape) when the images differ in size.
pub fn psnr(
    image: &ToneMappedImage,
    ground_truth: &ToneMappedImage,
    definition: &MetricDefinition,
) -> Result<f64> {
    let pool = squared_error(image, ground_truth, definition, None)?;
    Ok(decibels(pool.sum / pool.count as f64))
}

/// The level of a mean squared error below the peak of 1.
pub(super) fn decibels(mean_squared_error: f64) -> f64 {
    -10.0 * mean_squared_error.log10()
}

/// The squared differences of an image and its ground truth over all channels of the mask's pixels.
///
/// # Errors
/// As [`psnr`].
pub fn squared_error(
    image: &ToneMappedImage,
    ground_truth: &ToneMappedImage,
    definition: &MetricDefinition,
    mask: Option<&Mask>,
) -> Result<Pool> {
    definition.check(image, ground_truth, 1)?;
    let (a, b) = (definition.values_of(image), definition.values_of(ground_truth));
    let rows: Vec<Pool> =
        (0..CHANNELS * a.height).into_par_iter().map(|row| row_error(&a, &b, mask, row)).collect();
    Ok(Pool::total(&rows))
}

fn row_error(a: &Planes, b: &Planes, mask: Option<&Mask>, row: usize) -> Pool {
    let (channel, y) = (row / a.height, row % a.height);
    let pairs = a.row(channel, y).iter().zip(b.row(channel, y)).enumerate();
    let counted = pairs.filter(|(x, _)| counts(mask, y + a.border, x + a.border));
    Pool::of(counted.map(|(_, (&a, &b))| (f64::from(a) - f64::from(b)).powi(2)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn flat(value: f32) -> ToneMappedImage {
        ToneMappedImage::from_planes(Array3::from_elem((3, 4, 6), value)).unwrap()
    }

    #[test]
    fn of_a_uniform_error_is_its_level_in_decibels() {
        let found = psnr(&flat(0.25), &flat(0.35), &MetricDefinition::float()).unwrap();
        assert!((found - 20.0).abs() < 1e-5, "{found}");
        // 0.25·255 = 63.75 and 0.35·255 = 89.25 round to 64 and 89.
        let found = psnr(&flat(0.25), &flat(0.35), &MetricDefinition::released()).unwrap();
        assert!((found + 20.0 * (25.0f64 / 255.0).log10()).abs() < 1e-5, "{found}");
    }

    #[test]
    fn clamps_what_cannot_be_shown() {
        assert_eq!(psnr(&flat(1.7), &flat(1.0), &MetricDefinition::float()).unwrap(), f64::INFINITY);
        assert_eq!(psnr(&flat(-1.7), &flat(0.0), &MetricDefinition::released()).unwrap(), f64::INFINITY);
    }

    #[test]
    fn leaves_the_border_out() {
        let mut planes = Array3::from_elem((3, 4, 6), 0.5);
        planes[[1, 0, 3]] = 1.0;
        let spoiled = ToneMappedImage::from_planes(planes).unwrap();
        let definition = MetricDefinition { border: 1, ..MetricDefinition::float() };
        assert_eq!(psnr(&spoiled, &flat(0.5), &definition).unwrap(), f64::INFINITY);
        let definition = MetricDefinition { border: 2, ..definition };
        assert!(psnr(&spoiled, &flat(0.5), &definition).is_err(), "nothing is left");
    }

    #[test]
    fn names_both_sizes_when_they_differ() {
        let other = ToneMappedImage::from_planes(Array3::zeros((3, 5, 6))).unwrap();
        let message = psnr(&other, &flat(0.5), &MetricDefinition::float()).unwrap_err().to_string();
        assert!(message.contains("expected 4 × 6, found 5 × 6"), "{message}");
    }
}
