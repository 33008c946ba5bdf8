//! Restores a plane by the Wiener–Hunt filter.

use ndarray::{Array2, ArrayView2, s};
use rustfft::num_complex::Complex64;

use super::spectral::Spectral;
use super::{DeconvolutionConfig, saturation};
use crate::core::error::Result;
use crate::core::progress::Progress;

/// Filters a plane.
///
/// # Equation
/// `X = Y · H̄ / (|H|² + balance · |Λ|²)` with Λ the transform of the Laplacian (Hunt 1973; Orieux et al. 2010,
/// Eq. 2).
pub(super) fn restore(
    plane: ArrayView2<'_, f32>,
    psf: ArrayView2<'_, f32>,
    config: &DeconvolutionConfig,
    channel: usize,
    progress: &Progress,
) -> Result<Array2<f32>> {
    let spectral = Spectral::new([plane.nrows(), plane.ncols()], psf, config.border)?;
    let filter = spectral.wiener_filter(1.0, f64::from(config.balance));
    let plane = if config.mask_saturated {
        fill_saturated(plane, &spectral, &filter, config.saturated_from(channel), progress)?
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
    progress: &Progress,
) -> Result<Array2<f32>> {
    let mut filled = plane.to_owned();
    if !saturation::any(plane, level) {
        return Ok(filled);
    }
    let again: Vec<Complex64> = filter.iter().zip(spectral.otf()).map(|(g, h)| g * h).collect();
    for _ in 0..saturation::FILL_ROUNDS {
        progress.check()?;
        let predicted = apply(spectral, filled.view(), &again);
        filled = saturation::fill(plane, level, &predicted);
    }
    Ok(filled)
}

fn apply(spectral: &Spectral, plane: ArrayView2<'_, f32>, filter: &[Complex64]) -> Array2<f32> {
    let restored = spectral.inverse(&spectral.transform(plane), filter);
    restored.slice(s![..plane.nrows(), ..plane.ncols()]).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::fft::{Boundary, Convolver};
    use crate::restore::deconvolution::{Border, Method};

    fn psf() -> Array2<f32> {
        let k = Array2::from_shape_fn((17, 17), |(y, x)| {
            let r2 = (y as f32 - 8.0).powi(2) + (x as f32 - 8.0).powi(2);
            (-r2 / 2.0).exp() + 0.002
        });
        let sum = k.sum();
        k / sum
    }

    /// A bright left half and a dark right one, so that the frame's opposite sides do not fit.
    fn scene(size: usize) -> Array2<f32> {
        Array2::from_shape_fn((size, size), |(y, x)| {
            let texture = 0.2 * ((y as f32) * 0.9).sin() * ((x as f32) * 0.7).cos();
            texture + if x < size / 2 { 2.0 } else { 0.5 } + y as f32 / size as f32
        })
    }

    fn blurred(scene: &Array2<f32>) -> Array2<f32> {
        let (height, width) = scene.dim();
        let convolver = Convolver::new([height, width], [17, 17], Boundary::Replicate).unwrap();
        convolver.convolve_plane(scene.view(), &convolver.kernel_spectrum(psf().view()).unwrap())
    }

    fn rmse(a: ArrayView2<'_, f32>, b: ArrayView2<'_, f32>) -> f32 {
        ((&a - &b).mapv(|v| v * v).sum() / a.len() as f32).sqrt()
    }

    fn config(border: Border) -> DeconvolutionConfig {
        DeconvolutionConfig { border, balance: 1e-3, ..DeconvolutionConfig::of_method(Method::Wiener) }
    }

    /// The frame is cut out of a larger scene, whose light comes in over the border.
    #[test]
    fn does_not_ring_at_the_border() {
        let scene = scene(96);
        let capture = blurred(&scene);
        let inside = s![24..72, 24..72];
        let error = |border| {
            let restored =
                restore(capture.slice(inside), psf().view(), &config(border), 0, &Progress::default())
                    .unwrap();
            let scene = scene.slice(inside);
            let whole = rmse(restored.view(), scene);
            (whole, rmse(restored.slice(s![12..36, 12..36]), scene.slice(s![12..36, 12..36])))
        };
        let (smooth, inner) = error(Border::Smooth);
        let (periodic, _) = error(Border::Periodic);
        assert!(smooth < 0.5 * periodic, "{smooth} against {periodic}");
        assert!(smooth < 3.0 * inner, "{smooth} with the border, {inner} without");
    }

    #[test]
    fn masked_saturated_pixels_ring_less() {
        let mut scene = scene(64);
        scene.slice_mut(s![30..33, 40..43]).fill(60.0);
        let capture = blurred(&scene).mapv(|v| v.min(20.0));
        // Ringing is what is wrong outside of the lamp, whose own light the capture does not hold.
        let lamp = s![28..35, 38..45];
        let error = |mask_saturated| {
            let config =
                DeconvolutionConfig { mask_saturated, saturation: [20.0; 3], ..config(Border::Smooth) };
            let mut restored =
                restore(capture.view(), psf().view(), &config, 0, &Progress::default()).unwrap();
            restored.slice_mut(lamp).assign(&scene.slice(lamp));
            rmse(restored.view(), scene.view())
        };
        let (masked, plain) = (error(true), error(false));
        assert!(masked < 0.9 * plain, "{masked} against {plain}");
    }
}
