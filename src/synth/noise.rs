//! Adds the noise n of the image formation model: none, Gaussian, or that of a sensor.
//!
//! Every row of every channel draws from its own stream, named by seed, label, channel and row: results do
//! not depend on the order of work or the number of threads.

use ndarray::{Array3, ArrayViewMut1, Axis};
use rand_distr::{Distribution, Poisson, StandardNormal};
use rayon::prelude::*;

use crate::core::rng::{Rng, stream};
use crate::core::saturation::SATURATED_SHARE;
use crate::dataset::{NoiseConfig, SensorConfig};

/// Photon counts of this many standard deviations above the full well are above it without being drawn.
const CERTAIN_SIGMAS: f64 = 9.0;

/// Electrons above which their shot noise, 1/√mean of them, is below 2⁻²⁴, to which images of 32-bit floats are rounded; long
/// before the distribution can no longer be drawn from, at 1.8·10¹⁹.
const NOISELESS_ELECTRONS: f64 = 1e15;

/// Adds noise to irradiance, `[3, height, width]`.
///
/// Noise may make values negative; the clipping C comes after it.
pub fn add_noise(irradiance: &mut Array3<f32>, noise: &NoiseConfig, seed: u64, label: &str) {
    match noise {
        NoiseConfig::None => {}
        NoiseConfig::Gaussian { sigma } => each_row(irradiance, seed, label, |_, row, rng| {
            for value in row {
                let normal: f32 = StandardNormal.sample(rng);
                *value += sigma * normal;
            }
        }),
        NoiseConfig::Sensor(sensor) => each_row(irradiance, seed, label, |channel, row, rng| {
            for value in row {
                *value = capture(sensor, channel, *value, rng);
            }
        }),
    }
}

fn each_row(
    planes: &mut Array3<f32>,
    seed: u64,
    label: &str,
    change: impl Fn(usize, ArrayViewMut1<'_, f32>, &mut Rng) + Sync,
) {
    for (channel, mut plane) in planes.outer_iter_mut().enumerate() {
        plane.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(y, row)| {
            change(channel, row, &mut stream(seed, &format!("noise/{label}/{channel}/{y}")));
        });
    }
}

/// Captures one pixel with every exposure that is needed and returns the irradiance that is read off.
///
/// # Equation
/// For an exposure t, the longest whose reading is below saturation, of a pixel of irradiance x:
/// 1. electrons `e = Poisson(x·q·g·t)`, q electrons per unit, g the channel's gain;
/// 2. reading `d = round((e + σ·N) / G + b)` within `0..=2^bits − 1`, with σ the read noise, N standard
///    normal, G electrons per digital number, b the black level;
/// 3. irradiance `(d − b) · G / (q·g·t)`.
///
/// A full well reads white: it is the converter that ends there, after the read noise, as in a camera whose gain suits
/// its wells or is above that. Were the electrons to end there instead, read noise would take half of all saturated
/// pixels below white, and with small wells some so far that they pass for unsaturated, of whatever light.
///
/// Below saturation its variance is `(x·q·g·t + σ² + G²/12) / (q·g·t)²`.
fn capture(sensor: &SensorConfig, channel: usize, irradiance: f32, rng: &mut Rng) -> f32 {
    let white = sensor.white_level_dn();
    let saturated = sensor.black_level_dn + SATURATED_SHARE * (white - sensor.black_level_dn);
    let gain = sensor.gain_e_per_dn();
    let mut result = 0.0;
    for exposure in &sensor.exposures {
        let electrons_per_unit = sensor.electrons_per_unit * sensor.channel_gains[channel] * exposure;
        let mean = f64::from(irradiance.max(0.0)) * electrons_per_unit;
        let electrons = photo_electrons(mean, sensor.full_well_e, rng);
        let noise: f64 = StandardNormal.sample(rng);
        let reading = (electrons + sensor.read_noise_e * noise) / gain + sensor.black_level_dn;
        let reading = reading.round().clamp(0.0, white);
        result = (reading - sensor.black_level_dn) * gain / electrons_per_unit;
        if reading < saturated {
            break;
        }
    }
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    let result = result as f32;
    result
}

fn photo_electrons(mean: f64, full_well: f64, rng: &mut Rng) -> f64 {
    if mean > NOISELESS_ELECTRONS || mean > full_well + CERTAIN_SIGMAS * mean.sqrt() {
        return mean;
    }
    match Poisson::new(mean) {
        Ok(poisson) => poisson.sample(rng),
        // No light: the distribution wants a positive mean.
        Err(_) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 128;

    fn samples(noise: &NoiseConfig, irradiance: f32) -> Vec<f64> {
        let mut planes = Array3::from_elem((3, SIDE, SIDE), irradiance);
        add_noise(&mut planes, noise, 1, "test");
        planes.iter().map(|&v| f64::from(v)).collect()
    }

    fn mean_and_variance(samples: &[f64]) -> (f64, f64) {
        let n = samples.len() as f64;
        let mean = samples.iter().sum::<f64>() / n;
        (mean, samples.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0))
    }

    /// A sample variance of n normal values scatters by √(2/n) of itself, a mean by √(variance/n); five of
    /// these are allowed.
    fn agrees(noise: &NoiseConfig, irradiance: f32, expected_variance: f64) {
        let samples = samples(noise, irradiance);
        let n = samples.len() as f64;
        let (mean, variance) = mean_and_variance(&samples);
        let bias = (mean - f64::from(irradiance)).abs();
        assert!(bias < 5.0 * (expected_variance / n).sqrt(), "mean {mean} of irradiance {irradiance}");
        let relative = (variance / expected_variance - 1.0).abs();
        assert!(relative < 5.0 * (2.0 / n).sqrt(), "variance {variance}, expected {expected_variance}");
    }

    #[test]
    fn gaussian_noise_has_its_variance() {
        agrees(&NoiseConfig::Gaussian { sigma: 0.3 }, 2.0, 0.09);
    }

    #[test]
    fn sensor_noise_is_shot_noise_read_noise_and_quantisation() {
        let sensor = SensorConfig::default();
        let gain = sensor.gain_e_per_dn();
        // Half of white is read from the longest exposure, 3 times white from the second, 9 times from the shortest.
        for (irradiance, exposure) in [(0.5f32, 1.0), (3.0, 0.25), (9.0, 0.0625)] {
            let q = sensor.electrons_per_unit * exposure;
            let electrons = f64::from(irradiance) * q;
            let variance = (electrons + sensor.read_noise_e.powi(2) + gain * gain / 12.0) / (q * q);
            let noise = NoiseConfig::Sensor(sensor.clone());
            agrees(&noise, irradiance, variance);
            let told = noise.deviation(1, f64::from(irradiance)).powi(2);
            assert!((told / variance - 1.0).abs() < 1e-9, "{told} {variance}");
        }
    }

    #[test]
    fn a_less_sensitive_channel_is_noisier() {
        let sensor = SensorConfig { channel_gains: [0.25, 1.0, 1.0], ..SensorConfig::default() };
        let samples = samples(&NoiseConfig::Sensor(sensor), 0.5);
        let (_, red) = mean_and_variance(&samples[..SIDE * SIDE]);
        let (_, green) = mean_and_variance(&samples[SIDE * SIDE..2 * SIDE * SIDE]);
        assert!(red > 3.5 * green, "red {red}, green {green}");
    }

    /// However dim its captures are: read noise takes nothing that is brighter below white, so that no longer exposure
    /// passes for unsaturated either.
    #[test]
    fn a_sensor_saturates_at_the_full_well_of_its_shortest_exposure() {
        for full_well_e in [6000.0, 375.0, 190.0] {
            let sensor =
                SensorConfig { full_well_e, electrons_per_unit: full_well_e, ..SensorConfig::default() };
            // Shot and read noise of fifteen standard deviations above white, and much more than can be drawn.
            let clear = 16.0 * (1.0 + 15.0 * (full_well_e.sqrt() + sensor.read_noise_e) / full_well_e);
            for irradiance in [clear as f32, 1e6] {
                for value in samples(&NoiseConfig::Sensor(sensor.clone()), irradiance) {
                    assert!(
                        (value / 16.0 - 1.0).abs() < 1e-6,
                        "{value} of {irradiance} with {full_well_e} electrons"
                    );
                }
            }
        }
    }

    #[test]
    fn darkness_reads_read_noise_around_zero() {
        let samples = samples(&NoiseConfig::Sensor(SensorConfig::default()), 0.0);
        let (mean, variance) = mean_and_variance(&samples);
        assert!(mean.abs() < 1e-3 && variance > 0.0);
    }

    /// No light was recorded of what was beyond the distribution's largest mean.
    #[test]
    fn light_is_read_whatever_the_full_well() {
        for full_well_e in [1e6, 1e14, 1e16, 1e19, 1e20, 1e30] {
            let sensor = SensorConfig {
                full_well_e,
                electrons_per_unit: full_well_e,
                exposures: vec![1.0],
                ..SensorConfig::default()
            };
            // Little more than half a digital number, for values are rounded themselves, and seven standard deviations of
            // photons.
            let tolerance =
                0.51 / (sensor.white_level_dn() - sensor.black_level_dn) + 7.0 * (0.5 / full_well_e).sqrt();
            for value in samples(&NoiseConfig::Sensor(sensor.clone()), 0.5) {
                assert!((value - 0.5).abs() <= tolerance, "{value} with {full_well_e} electrons");
            }
        }
    }

    #[test]
    fn no_noise_changes_nothing() {
        assert!(samples(&NoiseConfig::None, 1.25).iter().all(|&v| (v - 1.25).abs() < f64::EPSILON));
    }
}
