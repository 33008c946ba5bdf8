//! Restores a plane by the Wiener–Hunt filter whose noise and regularisation are estimated from the data.

use ndarray::{Array2, ArrayView2, s};
use rand_distr::{Distribution, Gamma, StandardNormal};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use super::spectral::Spectral;
use super::{DeconvolutionConfig, wiener};
use crate::core::error::{Error, Result};
use crate::core::fft::PlaneSpectrum;
use crate::core::progress::Progress;
use crate::core::rng;

/// Samples that are drawn before the mean is taken: the chain forgets its start in a few steps.
const BURN_IN: usize = 15;

/// The shortest and the longest chain.
const MIN_SAMPLES: usize = 30;
const MAX_SAMPLES: usize = 200;

/// The mean is good when a further sample moves it by less than this part of itself.
const THRESHOLD: f64 = 1e-4;

/// The weight of the first, rough filter that fills saturated pixels in.
const FILL_BALANCE: f64 = 1e-2;

/// The two quadratic norms that the precisions are drawn from.
#[derive(Clone, Copy, Default)]
struct Norms {
    /// ‖y − H x‖².
    residual: f64,
    /// ‖Λ x‖².
    roughness: f64,
}

/// Estimates noise and regularisation, and filters a plane with their posterior mean.
///
/// # Equation
/// Gibbs sampling of Orieux, Giovannelli and Rodet (2010), Sec. 3: with the precisions γₙ of the noise and γₓ
/// of the scene's Laplacian, `x | γ ~ N(μ, (γₙ|H|² + γₓ|Λ|²)⁻¹)` at every frequency,
/// `μ = γₙ·H̄·y / (γₙ|H|² + γₓ|Λ|²)`; `γₙ | x ~ Gamma(N/2, 2/‖y − H x‖²)` and
/// `γₓ | x ~ Gamma((N − 1)/2, 2/‖Λ x‖²)`, under Jeffreys' priors. The result is the mean of the conditional
/// means μ, which has the posterior mean's expectation and less variance than a mean of samples.
pub(super) fn restore(
    plane: ArrayView2<'_, f32>,
    psf: ArrayView2<'_, f32>,
    config: &DeconvolutionConfig,
    channel: usize,
    progress: &Progress,
) -> Result<Array2<f32>> {
    let spectral = Spectral::new([plane.nrows(), plane.ncols()], psf, config.border)?;
    let plane = if config.mask_saturated {
        let filter = spectral.wiener_filter(1.0, FILL_BALANCE);
        let level = config.saturated_from(channel);
        wiener::fill_saturated(plane, &spectral, &filter, level, progress)?
    } else {
        plane.to_owned()
    };
    let data = spectral.transform(plane.view());
    let mut filter = mean_filter(&spectral, &data, &format!("{}/{channel}", config.seed), progress)?;
    for (filter, data) in filter.iter_mut().zip(&data) {
        *filter *= data;
    }
    let whole = vec![Complex64::new(1.0, 0.0); data.len()];
    let restored = spectral.inverse(&filter, &whole);
    Ok(restored.slice(s![..plane.nrows(), ..plane.ncols()]).to_owned())
}

/// The mean over the chain of the filters `γₙ·H̄ / (γₙ|H|² + γₓ|Λ|²)`.
fn mean_filter(
    spectral: &Spectral,
    data: &[Complex64],
    seed: &str,
    progress: &Progress,
) -> Result<PlaneSpectrum> {
    let mut sum = vec![Complex64::default(); data.len()];
    let (mut noise, mut scene) = (1.0_f64, 1.0_f64);
    let mut kept = 0_usize;
    for iteration in 0..MAX_SAMPLES {
        progress.check()?;
        let norms = sample_norms(spectral, data, [noise, scene], &format!("{seed}/{iteration}"));
        let mut rng = rng::stream(0, &format!("{seed}/{iteration}/precisions"));
        let count = (spectral.height() * spectral.width()) as f64;
        noise = draw_precision(count / 2.0, norms.residual, &mut rng)?;
        scene = draw_precision((count - 1.0) / 2.0, norms.roughness, &mut rng)?;
        if iteration < BURN_IN {
            continue;
        }
        kept += 1;
        let change = accumulate(&mut sum, &spectral.wiener_filter(1.0, scene / noise), kept);
        if iteration >= MIN_SAMPLES && change < THRESHOLD {
            break;
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "a chain has at most 200 samples")]
    let scale = 1.0 / kept as f64;
    sum.iter_mut().for_each(|value| *value *= scale);
    Ok(sum)
}

/// Adds a filter to the sum; the part of itself by which the mean of `kept` filters has moved.
#[expect(clippy::cast_precision_loss, reason = "a chain has at most 200 samples")]
fn accumulate(sum: &mut [Complex64], filter: &[Complex64], kept: usize) -> f64 {
    let previous = (kept - 1).max(1) as f64;
    let current = kept as f64;
    let (mut moved, mut size) = (0.0, 0.0);
    for (sum, value) in sum.iter_mut().zip(filter) {
        let before = *sum / previous;
        *sum += value;
        let now = *sum / current;
        moved += (now - before).norm_sqr();
        size += now.norm_sqr();
    }
    (moved / size.max(f64::MIN_POSITIVE)).sqrt()
}

fn draw_precision(shape: f64, norm: f64, rng: &mut rng::Rng) -> Result<f64> {
    // A plane of darkness has no norm: any large precision describes it.
    let scale = 2.0 / norm.max(f64::MIN_POSITIVE.sqrt());
    let gamma = Gamma::new(shape, scale)
        .map_err(|error| Error::Unsupported(format!("the image has no noise to estimate: {error}")))?;
    Ok(gamma.sample(rng))
}

/// Draws a scene x | γ and takes the norms of it; every column of the spectrum has random numbers of its own.
fn sample_norms(spectral: &Spectral, data: &[Complex64], precisions: [f64; 2], label: &str) -> Norms {
    let height = spectral.height();
    let columns: Vec<Norms> = data
        .par_chunks(height)
        .enumerate()
        .map(|(kx, data)| {
            let mut rng = rng::stream(0, &format!("{label}/{kx}"));
            let of_column = |spectrum: &[Complex64]| spectrum[kx * height..][..height].to_vec();
            let (otf, laplacian) = (of_column(spectral.otf()), of_column(spectral.laplacian()));
            let mut norms = Norms::default();
            for ((y, h), l) in data.iter().zip(otf).zip(laplacian) {
                let sample = draw_scene(*y, h, l, precisions, spectral, &mut rng);
                norms.residual += norm(*y - sample * h);
                norms.roughness += norm(sample * l);
            }
            // The half spectrum holds one of every two conjugate columns.
            let is_single = kx == 0 || 2 * kx == spectral.width();
            norms.scaled(if is_single { 1.0 } else { 2.0 })
        })
        .collect();
    let sum = columns.iter().fold(Norms::default(), |sum, column| Norms {
        residual: sum.residual + column.residual,
        roughness: sum.roughness + column.roughness,
    });
    // Parseval: our transforms are not normalised.
    sum.scaled(1.0 / (height * spectral.width()) as f64)
}

impl Norms {
    fn scaled(self, factor: f64) -> Self {
        Self { residual: self.residual * factor, roughness: self.roughness * factor }
    }
}

fn norm(z: Complex64) -> f64 {
    z.norm_sqr()
}

#[expect(
    clippy::too_many_arguments,
    reason = "one inner loop's state; a struct would be taken apart at once"
)]
fn draw_scene(
    y: Complex64,
    h: Complex64,
    l: Complex64,
    [noise, scene]: [f64; 2],
    spectral: &Spectral,
    rng: &mut rng::Rng,
) -> Complex64 {
    let precision = noise * norm(h) + scene * norm(l);
    if precision <= 0.0 {
        return Complex64::default();
    }
    let samples = (spectral.height() * spectral.width()) as f64;
    // Complex noise of variance 1/precision in the unitary transform, `samples` times that in ours.
    let spread = (0.5 * samples / precision).sqrt();
    let (re, im): (f64, f64) = (StandardNormal.sample(rng), StandardNormal.sample(rng));
    h.conj() * y * (noise / precision) + Complex64::new(re * spread, im * spread)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::fft::{Boundary, Convolver};
    use crate::restore::deconvolution::{Border, Method};

    const SIZE: usize = 48;

    fn psf() -> Array2<f32> {
        let k = Array2::from_shape_fn((9, 9), |(y, x)| {
            (-((y as f32 - 4.0).powi(2) + (x as f32 - 4.0).powi(2)) / 3.0).exp()
        });
        let sum = k.sum();
        k / sum
    }

    fn scene() -> Array2<f32> {
        Array2::from_shape_fn((SIZE, SIZE), |(y, x)| if (y / 12 + x / 8) % 2 == 0 { 1.0 } else { 0.2 })
    }

    /// The scene through the PSF, periodic, with noise of `sigma`.
    fn capture(sigma: f32) -> Array2<f32> {
        let convolver = Convolver::new([SIZE, SIZE], [9, 9], Boundary::Periodic).unwrap();
        let otf = convolver.kernel_spectrum(psf().view()).unwrap();
        let mut rng = rng::stream(11, "capture");
        convolver.convolve_plane(scene().view(), &otf).mapv(|v| {
            let normal: f32 = StandardNormal.sample(&mut rng);
            v + sigma * normal
        })
    }

    fn config(seed: u64) -> DeconvolutionConfig {
        let default = DeconvolutionConfig::of_method(Method::WienerOrieux);
        DeconvolutionConfig { border: Border::Periodic, seed, ..default }
    }

    fn restored(capture: &Array2<f32>, seed: u64) -> Array2<f32> {
        restore(capture.view(), psf().view(), &config(seed), 0, &Progress::default()).unwrap()
    }

    fn rmse(a: &Array2<f32>, b: &Array2<f32>) -> f32 {
        ((a - b).mapv(|v| v * v).sum() / a.len() as f32).sqrt()
    }

    /// The estimate is the most probable balance, not the one of the smallest error: 10 % for the difference.
    #[test]
    fn finds_about_the_best_balance_for_any_noise() {
        for sigma in [0.003, 0.02, 0.1] {
            let capture = capture(sigma);
            let ours = rmse(&restored(&capture, 1), &scene());
            let of_balance = |exponent: i32| {
                let config = DeconvolutionConfig { balance: 10f32.powf(exponent as f32 / 4.0), ..config(1) };
                let restored =
                    wiener::restore(capture.view(), psf().view(), &config, 0, &Progress::default());
                rmse(&restored.unwrap(), &scene())
            };
            let best = (-24..=8).map(of_balance).fold(f32::INFINITY, f32::min);
            assert!(ours < 1.1 * best, "noise of {sigma}: {ours} where {best} is possible");
        }
    }

    #[test]
    fn repeats_itself_and_depends_little_on_the_seed() {
        let capture = capture(0.02);
        let first = restored(&capture, 1);
        assert_eq!(first, restored(&capture, 1));
        let other = restored(&capture, 2);
        assert!(first != other && rmse(&first, &other) < 0.05 * rmse(&first, &capture));
    }

    #[test]
    fn a_dark_frame_stays_dark() {
        assert!(restored(&Array2::zeros((12, 10)), 1).iter().all(|&v| v == 0.0));
    }
}
