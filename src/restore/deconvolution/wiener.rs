//! Restores a plane by the Wiener–Hunt filter.

use ndarray::{Array2, ArrayView2, s};
use rustfft::num_complex::Complex64;

use super::spectral::Spectral;
use super::{DeconvolutionConfig, saturation};
use crate::core::error::Result;

/// Filters a plane.
///
/// # Equation
/// `X = Y · H̄ / (|H|² + balance · |Λ|²)` with Λ the transform of the Laplacian (Hunt 1973; Orieux et al. 2010,
/// Eq. 2).
pub(super) fn restore(
    plane: ArrayView2<'_, f32>,
    psf: ArrayView2<'_, f32>,
    config: &DeconvolutionConfig,
) -> Result<Array2<f32>> {
    let spectral = Spectral::new([plane.nrows(), plane.ncols()], psf, config.border)?;
    let filter = spectral.wiener_filter(1.0, f64::from(config.balance));
    let plane = if config.mask_saturated {
        fill_saturated(plane, &spectral, &filter, saturation::level(config.saturation))
    } else {
        plane.to_owned()
    };
    Ok(apply(&spectral, plane.view(), &filter))
}

/// Replaces saturated pixels by what the filter's own result, convolved again, says of them.
pub(super) fn fill_saturated(
    plane: ArrayView2<'_, f32>,
    spectral: &Spectral,
    filter: &[Complex64],
    level: f32,
) -> Array2<f32> {
    let mut filled = plane.to_owned();
    if !saturation::any(plane, level) {
        return filled;
    }
    let again: Vec<Complex64> = filter.iter().zip(spectral.otf()).map(|(g, h)| g * h).collect();
    for _ in 0..saturation::FILL_ROUNDS {
        let predicted = apply(spectral, filled.view(), &again);
        filled = saturation::fill(plane, level, &predicted);
    }
    filled
}

fn apply(spectral: &Spectral, plane: ArrayView2<'_, f32>, filter: &[Complex64]) -> Array2<f32> {
    let restored = spectral.inverse(&spectral.transform(plane), filter);
    restored.slice(s![..plane.nrows(), ..plane.ncols()]).to_owned()
}
