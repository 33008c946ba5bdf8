//! Structural similarity.

use rayon::prelude::*;

use super::{Mask, MetricDefinition, Planes, Pool, counts};
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, ToneMappedImage};

/// (0.01·L)² and (0.03·L)² of the definition, for the peak L = 1.
const C1: f64 = 0.0001;
const C2: f64 = 0.0009;

/// Weighted sums that the index needs: of a, b, a² + b² and a·b.
const MOMENTS: usize = 4;

/// The structural similarity of an image and its ground truth; 1 for equal images.
///
/// # Equation
/// The mean of `(2·μₐμᵦ + C₁)(2·σₐᵦ + C₂) / ((μₐ² + μᵦ² + C₁)(σₐ² + σᵦ² + C₂))` with moments under a Gaussian
/// window, C₁ = 0.01², C₂ = 0.03² (Wang et al., "Image quality assessment", 2004).
///
/// The window is separable: each row of the result gathers its rows first (all moments at once), then its
/// columns, so that memory stays at a few rows for each thread.
///
/// # Errors
/// [`Error::Shape`] when the images differ in size or are smaller than the window; [`Error::Config`] when the
/// window is not odd.
pub fn ssim(
    image: &ToneMappedImage,
    ground_truth: &ToneMappedImage,
    definition: &MetricDefinition,
) -> Result<f64> {
    let pool = structural_index(image, ground_truth, definition, None)?;
    Ok(pool.sum / pool.count as f64)
}

/// The index of every channel and whole window whose middle pixel is in the mask.
///
/// # Errors
/// As [`ssim`].
pub fn structural_index(
    image: &ToneMappedImage,
    ground_truth: &ToneMappedImage,
    definition: &MetricDefinition,
    mask: Option<&Mask>,
) -> Result<Pool> {
    let window = gaussian(definition)?;
    definition.check(image, ground_truth, window.len())?;
    let (a, b) = (definition.values_of(image), definition.values_of(ground_truth));
    let height = a.height - window.len() + 1;
    let middle = a.border + window.len() / 2;
    let index_of_row = |gathered: &mut Vec<[f64; MOMENTS]>, row: usize| {
        let top = row % height;
        gather_rows(gathered, &a, &b, &window, (row / height, top));
        let windows = gathered.windows(window.len()).enumerate();
        let counted = windows.filter(|(left, _)| counts(mask, top + middle, left + middle));
        Pool::of(counted.map(|(_, columns)| index(columns, &window)))
    };
    let rows: Vec<Pool> = (0..CHANNELS * height)
        .into_par_iter()
        .map_init(Vec::new, |gathered, row| index_of_row(gathered, row))
        .collect();
    Ok(Pool::total(&rows))
}

fn gaussian(definition: &MetricDefinition) -> Result<Vec<f64>> {
    let (side, sigma) = (definition.ssim_window, definition.ssim_sigma);
    if side % 2 == 0 || sigma.is_nan() || sigma <= 0.0 {
        let reason = format!("an odd side and a positive σ are needed, found {side} and {sigma}");
        return Err(Error::config("ssim-window", reason));
    }
    let middle = (side / 2) as f64;
    let weights: Vec<f64> = (0..side).map(|i| (-0.5 * ((i as f64 - middle) / sigma).powi(2)).exp()).collect();
    let sum: f64 = weights.iter().sum();
    Ok(weights.into_iter().map(|weight| weight / sum).collect())
}

/// Sums the moments of each column over the window's rows from `top` on.
fn gather_rows(
    gathered: &mut Vec<[f64; MOMENTS]>,
    a: &Planes,
    b: &Planes,
    window: &[f64],
    (channel, top): (usize, usize),
) {
    gathered.clear();
    gathered.resize(a.width, [0.0; MOMENTS]);
    for (i, weight) in window.iter().enumerate() {
        let rows = a.row(channel, top + i).iter().zip(b.row(channel, top + i));
        for (sums, (&a, &b)) in gathered.iter_mut().zip(rows) {
            let (a, b) = (f64::from(a), f64::from(b));
            for (sum, moment) in sums.iter_mut().zip([a, b, a * a + b * b, a * b]) {
                *sum += weight * moment;
            }
        }
    }
}

/// The index of one pixel from the moments of the columns of its window.
fn index(columns: &[[f64; MOMENTS]], window: &[f64]) -> f64 {
    let mut sums = [0.0; MOMENTS];
    for (column, weight) in columns.iter().zip(window) {
        sums.iter_mut().zip(column).for_each(|(sum, moment)| *sum += weight * moment);
    }
    let [mean_a, mean_b, squares, product] = sums;
    let means = mean_a * mean_a + mean_b * mean_b;
    let covariance = product - mean_a * mean_b;
    let luminance = (2.0 * mean_a * mean_b + C1) / (means + C1);
    luminance * (2.0 * covariance + C2) / (squares - means + C2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn image(height: usize, width: usize, value: impl Fn(usize, usize) -> f32) -> ToneMappedImage {
        ToneMappedImage::from_planes(Array3::from_shape_fn((3, height, width), |(_, y, x)| value(y, x)))
            .unwrap()
    }

    #[test]
    fn of_equal_images_is_one() {
        let texture = image(20, 17, |y, x| ((y * 7 + x * 3) % 11) as f32 / 11.0);
        let found = ssim(&texture, &texture, &MetricDefinition::float()).unwrap();
        assert!((found - 1.0).abs() < 1e-12, "{found}");
    }

    #[test]
    fn of_flat_images_compares_their_means() {
        let (a, b) = (image(11, 30, |_, _| 0.25), image(11, 30, |_, _| 0.75));
        let found = ssim(&a, &b, &MetricDefinition::float()).unwrap();
        let expected = (2.0 * 0.25 * 0.75 + C1) / (0.25 * 0.25 + 0.75 * 0.75 + C1);
        assert!((found - expected).abs() < 1e-12, "{found} for {expected}");
    }

    /// One window, computed by its definition: deviations from weighted means.
    #[test]
    fn of_one_window_follows_the_definition() {
        let a = |y: usize, x: usize| ((y * 5 + x * 2) % 13) as f32 / 13.0;
        let b = |y: usize, x: usize| ((y * 3 + x * 7) % 17) as f32 / 17.0;
        let definition = MetricDefinition::float();
        let found = ssim(&image(11, 11, a), &image(11, 11, b), &definition).unwrap();
        let weights = gaussian(&definition).unwrap();
        let mean = |f: &dyn Fn(usize, usize) -> f64| -> f64 {
            (0..121).map(|i| weights[i / 11] * weights[i % 11] * f(i / 11, i % 11)).sum()
        };
        let (a, b) = (|y, x| f64::from(a(y, x)), |y, x| f64::from(b(y, x)));
        let (mean_a, mean_b) = (mean(&a), mean(&b));
        let variances = mean(&|y, x| (a(y, x) - mean_a).powi(2) + (b(y, x) - mean_b).powi(2));
        let covariance = mean(&|y, x| (a(y, x) - mean_a) * (b(y, x) - mean_b));
        let expected = (2.0 * mean_a * mean_b + C1) * (2.0 * covariance + C2)
            / ((mean_a.powi(2) + mean_b.powi(2) + C1) * (variances + C2));
        assert!((found - expected).abs() < 1e-10, "{found} for {expected}");
    }

    #[test]
    fn refuses_an_image_smaller_than_its_window() {
        let small = image(10, 30, |_, _| 0.5);
        let message = ssim(&small, &small, &MetricDefinition::float()).unwrap_err().to_string();
        assert!(message.contains("at least 11 × 11"), "{message}");
    }
}
