//! Turns a PSF into what a camera records of it: a bracket of noisy, quantised, clipping exposures.

use ndarray::Array3;
use rand_distr::{Distribution as _, Normal, Poisson};

use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::core::psf::Psf;
use crate::core::rng;

/// Exposures of the bracket, relative to the longest: the paper's for PSFs.
pub const EXPOSURES: [f64; 3] = [1.0, 1.0 / 32.0, 1.0 / 768.0];

/// Electrons of a full pixel, electrons of read-out noise, and the largest digital number of 14 bits: a large
/// sensor, as used on an optical bench.
const FULL_WELL_E: f64 = 30_000.0;
const READ_NOISE_E: f64 = 3.0;
const WHITE_DN: f64 = 16_383.0;

/// Share of white that the PSF's peak reaches in the shortest exposure: bright, and not saturated.
const PEAK_SHARE: f64 = 0.8;

/// Stray light of the dark room, as a share of white in the longest exposure.
const BACKGROUND: f64 = 5e-4;

/// Records `psf` with each of [`EXPOSURES`]: shot noise, read-out noise, saturation at 1, 14 bits.
///
/// # Errors
/// Those of [`LinearImage::from_planes`].
pub fn expose(psf: &Psf, seed: u64) -> Result<Vec<LinearImage>> {
    let peak = psf.as_slice().iter().copied().fold(0.0, f32::max);
    let shortest = EXPOSURES[EXPOSURES.len() - 1];
    let whites_per_unit = PEAK_SHARE / (f64::from(peak) * shortest);
    EXPOSURES.iter().map(|exposure| record(psf, whites_per_unit, *exposure, seed)).collect()
}

fn record(psf: &Psf, whites_per_unit: f64, exposure: f64, seed: u64) -> Result<LinearImage> {
    let mut rng = rng::stream(seed, &format!("psf/exposure/{exposure:.9}"));
    let read_noise = Normal::new(0.0, READ_NOISE_E).expect("the read noise is a number");
    let planes: Array3<f32> = psf.planes().mapv(|value| {
        let light = (f64::from(value) * whites_per_unit + BACKGROUND) * exposure;
        let electrons = Poisson::new(light * FULL_WELL_E).map_or(0.0, |shot| shot.sample(&mut rng));
        let signal = (electrons + read_noise.sample(&mut rng)) / FULL_WELL_E;
        quantise(signal)
    });
    LinearImage::from_planes(planes)
}

#[expect(clippy::cast_possible_truncation, reason = "between 0 and 1")]
fn quantise(signal: f64) -> f32 {
    ((signal.clamp(0.0, 1.0) * WHITE_DN).round() / WHITE_DN) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_shortest_exposure_holds_the_peak() {
        let psf = Psf::from_energy(Array3::from_shape_fn((3, 9, 9), |(_, y, x)| {
            1.0 / (1.0 + ((y as f32 - 4.0).powi(2) + (x as f32 - 4.0).powi(2)).powi(2))
        }));
        let frames = expose(&psf.unwrap(), 1).unwrap();
        let peaks: Vec<f32> = frames.iter().map(LinearImage::max).collect();
        assert_eq!((peaks[0], peaks[1]), (1.0, 1.0));
        // 24 000 electrons with √24 000 of shot noise, six standard deviations.
        assert!((peaks[2] - 0.8).abs() < 6.0 * 155.0 / 30_000.0, "{}", peaks[2]);
        let codes = frames[2].as_slice().iter().map(|v| f64::from(*v) * WHITE_DN);
        assert!(codes.into_iter().all(|code| (code - code.round()).abs() < 1e-3));
    }
}
