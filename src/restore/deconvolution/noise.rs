//! Estimates how noisy a capture is, from its finest diagonal detail.

use ndarray::{Array2, ArrayView2};
use rustfft::num_complex::Complex64;
use std::f64::consts::PI;

/// The median of the modulus of a standard normal variable.
const MEDIAN_OF_NORMAL: f64 = 0.6745;

/// Estimates the standard deviation of the noise of `log(capture + α)`, white from pixel to pixel.
///
/// # Equation
/// With d₁ and d₂ the median moduli of the diagonal Haar details of 2 × 2 pixels and of 2 × 2 blocks of 2 × 2
/// pixels, white noise has d₁ = d₂, while detail that went through the PSF has `d₁² ≈ κ·d₂²`, κ being the
/// quotient of the mean |H|² over both bands. `σ² = max(0, d₁² − κ·max(0, d₂² − d₁²))`: d₁² for noise alone, zero
/// for noise-free captures, since natural scenes have less detail the finer it is. Checkerboards have more; what
/// they are mistaken for, a tenth of their contrast in noise, does little harm.
pub(super) fn estimate(
    capture: ArrayView2<'_, f32>,
    (otf, column): (&[Complex64], usize),
    grid_width: usize,
    alpha: f32,
) -> f64 {
    let logarithm = capture.mapv(|v| (v.max(0.0) + alpha).ln());
    let Some((fine, coarse)) = details(&logarithm) else { return 0.0 };
    let kappa = band_energy(otf, column, grid_width, 1) / band_energy(otf, column, grid_width, 2);
    let (fine, coarse) = (fine * fine, coarse * coarse);
    (fine - kappa * (coarse - fine).max(0.0)).max(0.0).sqrt()
}

/// The robust standard deviations of the details of both bands; `None` for an image of less than 4 × 4.
fn details(plane: &Array2<f32>) -> Option<(f64, f64)> {
    let halved = |plane: &Array2<f32>| {
        let (height, width) = plane.dim();
        Array2::from_shape_fn((height / 2, width / 2), |(y, x)| {
            let at = |dy, dx| plane[[2 * y + dy, 2 * x + dx]];
            // Half the sum of four: white noise keeps its variance.
            (at(0, 0) + at(0, 1) + at(1, 0) + at(1, 1)) / 2.0
        })
    };
    Some((spread(plane)?, spread(&halved(plane))?))
}

fn spread(plane: &Array2<f32>) -> Option<f64> {
    let (height, width) = plane.dim();
    let mut details: Vec<f32> = (0..height / 2)
        .flat_map(|y| (0..width / 2).map(move |x| (2 * y, 2 * x)))
        .map(|(y, x)| {
            (plane[[y, x]] - plane[[y, x + 1]] - plane[[y + 1, x]] + plane[[y + 1, x + 1]]).abs() / 2.0
        })
        .collect();
    if details.is_empty() {
        return None;
    }
    let middle = details.len() / 2;
    let (_, median, _) = details.select_nth_unstable_by(middle, f32::total_cmp);
    Some(f64::from(*median) / MEDIAN_OF_NORMAL)
}

/// The mean of |H|² over the frequencies of a diagonal Haar detail of blocks of `block` pixels.
fn band_energy(otf: &[Complex64], column: usize, grid_width: usize, block: usize) -> f64 {
    let response = |k: usize, samples: usize| {
        let half = PI * k as f64 / samples as f64;
        let smooth = if block == 1 { 1.0 } else { half.cos().powi(2) };
        smooth * (block as f64 * half).sin().powi(2)
    };
    let along_y: Vec<f64> = (0..column).map(|ky| response(ky, column)).collect();
    let (mut energy, mut weight) = (0.0, 0.0);
    for (kx, spectrum) in otf.chunks_exact(column).enumerate() {
        let along_x = response(kx, grid_width);
        for (h, along_y) in spectrum.iter().zip(&along_y) {
            energy += along_x * along_y * h.norm_sqr();
            weight += along_x * along_y;
        }
    }
    energy / weight.max(f64::MIN_POSITIVE)
}
