//! How likely a window of a capture is behind each kernel, whatever the scene.
//!
//! # Model
//! At each frequency f the spectra of the three channels are y = K x + n with K = diag(OTFs). Scenes are taken as
//! Gaussian: x has the covariance C, which changes slowly with f and carries no phase between channels (real), n is
//! white. So y has the covariance `S = K C K* + N`, and only the product of the OTFs with a slowly varying C can
//! explain its ripples (the diffraction orders of a panel) and the phases between its channels (the orders stand at
//! another distance for each wavelength, while scenes have their edges in the same place in all colours).
//!
//! C is constant in a cell of the frequency plane, one of [`RINGS`] × [`SECTORS`]; expectation–maximisation
//! estimates it for each kernel anew, so that a sharper kernel gains nothing by its sharpness. Real scenes have
//! outliers: the Gaussian is a Student t of 2·[`FREEDOM`] degrees of freedom.
//!
//! # Sources
//! Whittle, "The analysis of multiple stationary time series" (1953), for the likelihood; Riedel and Sidorenko,
//! "Minimum bias multiple taper spectral estimation" (1995), for the tapers; Liu and Rubin, "ML estimation of the
//! t distribution using EM" (1995), for the weights.

use ndarray::{Array2, ArrayView3, Axis};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use crate::core::error::Result;
use crate::core::fft::{Boundary, Convolver};
use crate::core::image::CHANNELS;
use crate::core::psf::Psf;

/// Sine tapers along each axis.
const TAPERS: usize = 2;

/// Frequencies above this, in cycles per pixel, hold more noise than scene.
const HIGHEST_FREQUENCY: f64 = 0.2;

/// Frequencies below this, in cycles per window, are blurred into each other by the tapers.
const LOWEST_CYCLES: f64 = 2.5;

/// From here on, in cycles per pixel, the spectrum is taken for noise.
const NOISE_FREQUENCY: f64 = 0.42;

/// Divisions of the frequency plane, in equal ratios of the radius.
const RINGS: usize = 12;

/// Divisions of each ring's half circle.
const SECTORS: usize = 8;

/// Rings with fewer frequencies than this per sector are not divided.
const FEWEST_FREQUENCIES: usize = 16;

/// Half the degrees of freedom of the t distribution.
const FREEDOM: f64 = 8.0;

/// Steps of expectation–maximisation from the spectra to the covariance behind one kernel.
const FIRST_STEPS: usize = 8;

/// Steps from there to the covariance behind another.
const NEXT_STEPS: usize = 1;

/// The least variance of the noise, as a part of the mean power: no capture is more exact than its PSF.
const LEAST_NOISE: f64 = 1e-6;

type Spectra = [Complex64; CHANNELS];
type Covariance = [[f64; CHANNELS]; CHANNELS];

/// What the likelihoods of windows of one size share.
pub(super) struct WindowModel {
    convolver: Convolver,
    tapers: Vec<Array2<f64>>,
    /// The frequencies of each cell, as places in a half spectrum.
    cells: Vec<Vec<usize>>,
    /// The frequencies that tell the noise.
    noise: Vec<usize>,
    /// The OTFs of each kernel at the frequencies of each cell.
    kernels: Vec<Vec<Vec<Spectra>>>,
    /// The least variance of the noise in a cell, as a part of its mean power.
    misfit: f64,
}

/// What is told of the samples of one cell.
#[derive(Clone, Debug)]
pub(super) struct OfCell {
    /// How many they are.
    pub(super) samples: usize,
    /// The log-likelihood behind each kernel, in nats, up to a common constant.
    pub(super) log_likelihoods: Vec<f64>,
}

impl WindowModel {
    /// Plans the comparison of `psfs`, at least one and all of one size, on windows of `[height, width]`.
    ///
    /// # Errors
    /// Those of [`Convolver::new`].
    pub(super) fn new(size: [usize; 2], psfs: &[Psf]) -> Result<Self> {
        let convolver = Convolver::new(size, [psfs[0].height(), psfs[0].width()], Boundary::Periodic)?;
        let (cells, noise) = divide(size);
        let kernels = psfs
            .par_iter()
            .map(|psf| {
                let channel = |c| convolver.kernel_spectrum(psf.channel(c));
                let otfs = [channel(0)?, channel(1)?, channel(2)?];
                let at = |&bin: &usize| std::array::from_fn(|c| otfs[c][bin]);
                Ok(cells.iter().map(|cell| cell.iter().map(at).collect()).collect())
            })
            .collect::<Result<_>>()?;
        Ok(Self { convolver, tapers: tapers(size), cells, noise, kernels, misfit: 0.0 })
    }

    /// Believes no cell of the spectrum to be more exact than this part of its mean power: windows cut off what PSFs throw further, and
    /// without noise that would tell more than the kernels.
    pub(super) fn with_misfit(self, misfit: f64) -> Self {
        Self { misfit, ..self }
    }

    /// The log-likelihood of a window of linear light behind each kernel, in nats, up to a common constant; none
    /// when the window is constant.
    pub(super) fn log_likelihoods(&self, window: ArrayView3<'_, f32>) -> Option<Vec<f64>> {
        let mut sums = vec![0.0; self.kernels.len()];
        for cell in self.by_cell(window)? {
            sums.iter_mut().zip(cell.log_likelihoods).for_each(|(sum, value)| *sum += value);
        }
        Some(sums)
    }

    /// The same of each cell of the frequency plane by itself.
    pub(super) fn by_cell(&self, window: ArrayView3<'_, f32>) -> Option<Vec<OfCell>> {
        let spectra = self.whitened_spectra(window)?;
        let of_cell = |(index, cell): (usize, &Vec<usize>)| {
            let mut samples: Vec<[Spectra; TAPERS * TAPERS]> = cell
                .iter()
                .map(|&bin| std::array::from_fn(|t| std::array::from_fn(|c| spectra[c][t][bin])))
                .collect();
            if self.misfit > 0.0 {
                bring_down(&mut samples, self.misfit);
            }
            let kernels: Vec<&[Spectra]> = self.kernels.iter().map(|cells| &*cells[index]).collect();
            let log_likelihoods = cell_log_likelihoods(&samples, &kernels);
            OfCell { samples: TAPERS * TAPERS * samples.len(), log_likelihoods }
        };
        Some(self.cells.par_iter().enumerate().map(of_cell).collect())
    }

    /// The half spectra of every taper of every channel, in units of the channel's noise; zeros for a channel that is
    /// constant, none when all are.
    fn whitened_spectra(&self, window: ArrayView3<'_, f32>) -> Option<Vec<Vec<Vec<Complex64>>>> {
        let whiten = |channel: usize| {
            let plane = window.index_axis(Axis(0), channel).mapv(f64::from);
            let weights = self.tapers[0].mapv(|t| t * t);
            let mean = (&plane * &weights).sum() / weights.sum();
            let mut spectra: Vec<Vec<Complex64>> = self
                .tapers
                .par_iter()
                .map(|taper| {
                    #[expect(clippy::cast_possible_truncation, reason = "rounds to an image's precision")]
                    let tapered = ((&plane - mean) * taper).mapv(|v| v as f32);
                    self.convolver.plane_spectrum(tapered.view())
                })
                .collect();
            let deviation = self.noise_variance(&spectra).sqrt();
            if deviation > 0.0 {
                for value in spectra.iter_mut().flatten() {
                    *value /= deviation;
                }
            }
            (spectra, deviation > 0.0)
        };
        let (spectra, varies): (Vec<_>, Vec<_>) = (0..CHANNELS).map(whiten).unzip();
        varies.contains(&true).then_some(spectra)
    }

    /// The variance of the noise in one channel's spectra: what the median of an exponential distribution says.
    fn noise_variance(&self, spectra: &[Vec<Complex64>]) -> f64 {
        let power_at = |bins: &[usize]| -> Vec<f64> {
            spectra.iter().flat_map(|spectrum| bins.iter().map(|&bin| spectrum[bin].norm_sqr())).collect()
        };
        let mut noise = power_at(&self.noise);
        let middle = noise.len() / 2;
        let median = *noise.select_nth_unstable_by(middle, f64::total_cmp).1;
        let (mut sum, mut count) = (0.0, 0usize);
        for cell in &self.cells {
            sum += power_at(cell).iter().sum::<f64>();
            count += cell.len() * spectra.len();
        }
        (median / std::f64::consts::LN_2).max(LEAST_NOISE * sum / count as f64)
    }
}

/// The corners of windows that cover a frame, both `[height, width]`.
pub(super) fn corners(frame: [usize; 2], window: [usize; 2]) -> Vec<[usize; 2]> {
    let starts = |axis: usize| {
        let (whole, side) = (frame[axis], window[axis]);
        let count = whole.div_ceil(side);
        (0..count).map(move |index| (whole - side) * index / (count - 1).max(1))
    };
    starts(0).flat_map(|top| starts(1).map(move |left| [top, left])).collect()
}

/// The variance of the means of blocks of 8 × 8 pixels, in which noise counts little.
pub(super) fn contrast(window: ArrayView3<'_, f32>) -> f64 {
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    for block in window.exact_chunks((CHANNELS, 8, 8)) {
        let mean = f64::from(block.mean().unwrap_or(0.0));
        sum += mean;
        squares += mean * mean;
        count += 1.0;
    }
    squares / count - (sum / count).powi(2)
}

/// The frequencies of each cell, and those of the noise, as places in the half spectrum `[kx][ky]`.
fn divide([height, width]: [usize; 2]) -> (Vec<Vec<usize>>, Vec<usize>) {
    let mut rings = vec![vec![Vec::new(); SECTORS]; RINGS];
    let mut noise = Vec::new();
    let lowest = LOWEST_CYCLES / height.min(width) as f64;
    for kx in 0..=width / 2 {
        for ky in 0..height {
            let bin = kx * height + ky;
            let rows = if 2 * ky <= height { ky as f64 } else { ky as f64 - height as f64 };
            let (x, y) = (kx as f64 / width as f64, rows / height as f64);
            let radius = x.hypot(y);
            if radius > NOISE_FREQUENCY {
                noise.push(bin);
            } else if radius > lowest && radius < HIGHEST_FREQUENCY && (kx > 0 || rows > 0.0) {
                let ring = (radius / lowest).ln() / (HIGHEST_FREQUENCY / lowest).ln();
                let sector = y.atan2(x).rem_euclid(std::f64::consts::PI) / std::f64::consts::PI;
                rings[division(ring, RINGS)][division(sector, SECTORS)].push(bin);
            }
        }
    }
    let cells = rings.into_iter().flat_map(|sectors| {
        let divided = sectors.iter().all(|sector| sector.len() >= FEWEST_FREQUENCIES);
        if divided { sectors } else { vec![sectors.concat()] }
    });
    (cells.filter(|cell| !cell.is_empty()).collect(), noise)
}

/// Into which of `count` equal divisions of `[0, 1]` a part falls.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "parts lie between 0 and 1")]
fn division(part: f64, count: usize) -> usize {
    ((part * count as f64) as usize).min(count - 1)
}

/// The products of the first sine tapers of both axes, the lowest first.
fn tapers([height, width]: [usize; 2]) -> Vec<Array2<f64>> {
    let sine = |order: usize, place: usize, length: usize| {
        let phase = std::f64::consts::PI * (order + 1) as f64 * (place + 1) as f64 / (length + 1) as f64;
        phase.sin()
    };
    let orders = (0..TAPERS).flat_map(|rows| (0..TAPERS).map(move |columns| (rows, columns)));
    orders
        .map(|(rows, columns)| {
            Array2::from_shape_fn((height, width), |(y, x)| sine(rows, y, height) * sine(columns, x, width))
        })
        .collect()
}

/// The log-likelihood of the samples of one cell behind each kernel.
fn cell_log_likelihoods(samples: &[[Spectra; TAPERS * TAPERS]], kernels: &[&[Spectra]]) -> Vec<f64> {
    let advance = |kernel: &[Spectra], mut covariance: Covariance, steps: usize| {
        for _ in 0..steps {
            let (_, gradient) = evaluate(samples, kernel, &covariance);
            let change = product(&covariance, &product(&gradient, &covariance));
            for (row, change) in covariance.iter_mut().zip(change) {
                for (value, change) in row.iter_mut().zip(change) {
                    *value += change;
                }
            }
        }
        covariance
    };
    let shared = advance(kernels[kernels.len() / 2], mean_power(samples), FIRST_STEPS);
    let score = |kernel: &&[Spectra]| evaluate(samples, kernel, &advance(kernel, shared, NEXT_STEPS)).0;
    kernels.iter().map(score).collect()
}

/// Brings the power of samples in units of their noise down to that of noise which is this part of it at least.
fn bring_down(samples: &mut [[Spectra; TAPERS * TAPERS]], misfit: f64) {
    let power = mean_power(samples);
    let factors: [f64; CHANNELS] =
        std::array::from_fn(|channel| (misfit * power[channel][channel]).max(1.0).sqrt().recip());
    for sample in samples.iter_mut().flatten() {
        sample.iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
    }
}

/// The mean of y y*, its real part: where the covariance starts.
fn mean_power(samples: &[[Spectra; TAPERS * TAPERS]]) -> Covariance {
    let count = (samples.len() * TAPERS * TAPERS) as f64;
    let mut power = [[0.0; CHANNELS]; CHANNELS];
    for sample in samples.iter().flatten() {
        for (row, a) in power.iter_mut().zip(sample) {
            for (value, b) in row.iter_mut().zip(sample) {
                *value += (a * b.conj()).re / count;
            }
        }
    }
    power
}

/// The log-likelihood of the samples, and G such that C + C G C is the next estimate of the covariance C.
///
/// With `S = K C K* + 1 = L L*` and `M = L⁻¹`, a sample's squared distance is `q = |M y|²` and its weight
/// `(FREEDOM + 3) / (FREEDOM + q)`; `G = ⟨Re(weight · g g* − (M K)* M K)⟩` with `g = K* S⁻¹ y`.
fn evaluate(
    samples: &[[Spectra; TAPERS * TAPERS]],
    kernel: &[Spectra],
    covariance: &Covariance,
) -> (f64, Covariance) {
    const EXPONENT: f64 = FREEDOM + CHANNELS as f64;
    let tapers = (TAPERS * TAPERS) as f64;
    let mut log_likelihood = 0.0;
    let mut gradient = [[0.0; CHANNELS]; CHANNELS];
    for (tapered, k) in samples.iter().zip(kernel) {
        let entry = |i: usize, j: usize| k[i] * k[j].conj() * covariance[i][j];
        let l00 = (1.0 + entry(0, 0).re).sqrt();
        let (l10, l20) = (entry(1, 0) / l00, entry(2, 0) / l00);
        let l11 = (1.0 + entry(1, 1).re - l10.norm_sqr()).sqrt();
        let l21 = (entry(2, 1) - l20 * l10.conj()) / l11;
        let l22 = (1.0 + entry(2, 2).re - l20.norm_sqr() - l21.norm_sqr()).sqrt();
        let (m00, m11, m22) = (1.0 / l00, 1.0 / l11, 1.0 / l22);
        let (m10, m21) = (-l10 * (m00 * m11), -l21 * (m11 * m22));
        let m20 = -(l20 * m00 + l21 * m10) * m22;
        log_likelihood -= tapers * 2.0 * (l00 * l11 * l22).ln();

        let mk = [
            [k[0] * m00, 0.0.into(), 0.0.into()],
            [m10 * k[0], k[1] * m11, 0.0.into()],
            [m20 * k[0], m21 * k[1], k[2] * m22],
        ];
        for (i, row) in gradient.iter_mut().enumerate() {
            for (j, value) in row.iter_mut().enumerate() {
                *value -= tapers * mk.iter().map(|m: &Spectra| (m[i].conj() * m[j]).re).sum::<f64>();
            }
        }
        for y in tapered {
            let z = [y[0] * m00, m10 * y[0] + y[1] * m11, m20 * y[0] + m21 * y[1] + y[2] * m22];
            let distance: f64 = z.iter().map(Complex64::norm_sqr).sum();
            log_likelihood -= EXPONENT * (distance / FREEDOM).ln_1p();
            let weight = EXPONENT / (FREEDOM + distance);
            let g: Spectra = std::array::from_fn(|i| (0..CHANNELS).map(|a| mk[a][i].conj() * z[a]).sum());
            for (row, a) in gradient.iter_mut().zip(&g) {
                for (value, b) in row.iter_mut().zip(&g) {
                    *value += weight * (a * b.conj()).re;
                }
            }
        }
    }
    let count = samples.len() as f64 * tapers;
    (log_likelihood, gradient.map(|row| row.map(|value| value / count)))
}

fn product(a: &Covariance, b: &Covariance) -> Covariance {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..CHANNELS).map(|k| a[i][k] * b[k][j]).sum()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frequency_belongs_to_one_cell() {
        for size in [[256, 256], [97, 140], [64, 512]] {
            let (cells, noise) = divide(size);
            let mut bins = [cells.concat(), noise].concat();
            let count = bins.len();
            bins.sort_unstable();
            bins.dedup();
            assert_eq!(bins.len(), count);
            assert!(bins.iter().all(|&bin| bin < (size[1] / 2 + 1) * size[0]));
            assert!(cells.len() > RINGS / 2, "{} cells", cells.len());
        }
    }

    #[test]
    fn tapers_are_orthogonal() {
        let tapers = tapers([31, 20]);
        for (i, a) in tapers.iter().enumerate() {
            for (j, b) in tapers.iter().enumerate() {
                let product = (a * b).sum() / (32.0 * 21.0 / 4.0);
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-12, "{i} {j}: {product}");
            }
        }
    }

    /// Samples of one colour without noise, of which the noise is then 1: K = 1 and S = C + 1 = ⟨y y*⟩ for a Gaussian.
    #[test]
    fn expectation_maximisation_raises_the_likelihood_to_its_stationary_point() {
        let mut phase = 0.3f64;
        let samples: Vec<[Spectra; TAPERS * TAPERS]> = (0..200)
            .map(|n| {
                std::array::from_fn(|t| {
                    std::array::from_fn(|c| {
                        phase = (phase * 7.13 + 0.37 + 0.01 * (n + t + c) as f64).fract();
                        Complex64::from_polar(3.0 + phase, 6.0 * phase * (1 + c) as f64)
                    })
                })
            })
            .collect();
        let kernel =
            vec![[Complex64::new(0.8, 0.1), Complex64::new(0.6, -0.2), Complex64::new(0.9, 0.0)]; 200];
        let mut covariance = mean_power(&samples);
        let mut before = f64::NEG_INFINITY;
        for _ in 0..400 {
            let (value, gradient) = evaluate(&samples, &kernel, &covariance);
            assert!(value >= before - 1e-9 * value.abs(), "{value} after {before}");
            before = value;
            let change = product(&covariance, &product(&gradient, &covariance));
            for (row, change) in covariance.iter_mut().zip(change) {
                for (value, change) in row.iter_mut().zip(change) {
                    *value += change;
                }
            }
        }
        let step = 1e-5;
        for i in 0..CHANNELS {
            for j in 0..=i {
                let moved = |by: f64| {
                    let mut moved = covariance;
                    moved[i][j] += by;
                    moved[j][i] = moved[i][j];
                    evaluate(&samples, &kernel, &moved).0
                };
                let slope = (moved(step) - moved(-step)) / (2.0 * step);
                assert!(slope.abs() < 0.05, "the slope along ({i}, {j}) is {slope}");
            }
        }
    }
}
