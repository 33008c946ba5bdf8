//! Analytic truth: sensor. The photon transfer curve: how the variance of a reading grows with its mean.

use std::path::PathBuf;

use ndarray::Array3;
use udc::dataset::{FormationConfig, NoiseConfig, SensorConfig};
use udc::synth::Formation;

const SIDE: usize = 128;

fn sensor() -> SensorConfig {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("configs/sensor/phone-10bit.toml");
    let sensor: SensorConfig = toml::from_str(&std::fs::read_to_string(file).unwrap()).unwrap();
    // One exposure, so that every level is read by the same gain.
    SensorConfig { exposures: vec![1.0], ..sensor }
}

/// Mean and variance, in digital numbers above black, of each channel of a flat picture in which green has `share` of
/// its full well.
fn reading(sensor: &SensorConfig, share: f64) -> [(f64, f64); 3] {
    let noise = NoiseConfig::Sensor(sensor.clone());
    let formation = Formation::new(FormationConfig { noise, ..FormationConfig::default() }, 9).unwrap();
    let irradiance = share * sensor.full_well_e / sensor.electrons_per_unit;
    let flat = Array3::from_elem((3, SIDE, SIDE), irradiance as f32);
    let image = formation.record(flat, &format!("flat {share}")).unwrap();
    [0, 1, 2].map(|channel| {
        let dn_per_unit = sensor.electrons_per_unit * sensor.channel_gains[channel] / sensor.gain_e_per_dn();
        let values = || image.channel(channel).into_iter().map(|&v| f64::from(v) * dn_per_unit);
        let count = (SIDE * SIDE) as f64;
        let mean = values().sum::<f64>() / count;
        (mean, values().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0))
    })
}

/// Variance = mean/G + (σ/G)² + 1/12 for G electrons per digital number and read noise σ, in every channel alike.
///
/// The variance of n = 16384 readings scatters by √(2/n) = 1.1 %; the line through ten of them, weighted equally in
/// relative terms, by about 0.5 %. Five of these are allowed.
#[test]
fn variance_grows_with_the_mean_by_the_gain() {
    let sensor = sensor();
    let gain = sensor.gain_e_per_dn();
    let readings: Vec<_> = (1..=10).map(|step| reading(&sensor, 0.08 * f64::from(step))).collect();
    for channel in 0..3 {
        let floor = (sensor.read_noise_e / gain).powi(2) + 1.0 / 12.0;
        let slopes: Vec<f64> = readings.iter().map(|r| (r[channel].1 - floor) / r[channel].0).collect();
        let slope = slopes.iter().sum::<f64>() / slopes.len() as f64;
        assert!((slope * gain - 1.0).abs() < 0.025, "channel {channel}: {slope} instead of {}", 1.0 / gain);
    }
}

/// Means are proportional to the light until the well is full; there the curve falls to nothing, for what is full does
/// not vary and the converter ends there too.
#[test]
fn the_curve_falls_where_the_well_is_full() {
    let sensor = sensor();
    let [_, half, _] = reading(&sensor, 0.4);
    let [_, most, _] = reading(&sensor, 0.8);
    assert!((most.0 / half.0 - 2.0).abs() < 0.005, "{} {}", most.0, half.0);
    let [red, green, _] = reading(&sensor, 1.3);
    let white = sensor.white_level_dn() - sensor.black_level_dn;
    assert!((green.0 / white - 1.0).abs() < 0.005 && green.1 < 0.2 * most.1, "{green:?}");
    // Red has 0.7 of the sensitivity, and is not full yet.
    assert!(red.1 > 0.8 * most.1, "{red:?}");
}

/// A capture is counted so that 1 is white of the longest exposure, and white is a full well of F electrons: at an
/// irradiance x below 1 it holds x·F photons, read with σ electrons of noise in steps of G, and varies by
/// (x·F + σ² + G²/12) / F². The variance of n = 16384 readings scatters by √(2/n); five of these are allowed.
#[test]
fn synthetic_noise_has_as_many_photons_as_a_capture_of_the_same_full_well() {
    let file = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("configs/sensor/phone-10bit.toml");
    let sensor: SensorConfig = toml::from_str(&std::fs::read_to_string(file).unwrap()).unwrap();
    let (full_well, gain) = (sensor.full_well_e, sensor.gain_e_per_dn());
    let noise = NoiseConfig::Sensor(sensor.clone());
    let formation = Formation::new(FormationConfig { noise, ..FormationConfig::default() }, 4).unwrap();
    for irradiance in [0.1, 0.5, 0.9] {
        let flat = Array3::from_elem((3, SIDE, SIDE), irradiance as f32);
        let image = formation.record(flat, &format!("flat {irradiance}")).unwrap();
        // Green is the most sensitive channel, the one that white is counted by.
        let green: Vec<f64> = image.channel(1).iter().map(|&v| f64::from(v)).collect();
        let count = green.len() as f64;
        let mean = green.iter().sum::<f64>() / count;
        let variance = green.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let expected =
            (irradiance * full_well + sensor.read_noise_e.powi(2) + gain * gain / 12.0) / full_well.powi(2);
        assert!((mean - irradiance).abs() < 5.0 * (expected / count).sqrt(), "{mean} of {irradiance}");
        assert!(
            (variance / expected - 1.0).abs() < 5.0 * (2.0 / count).sqrt(),
            "{variance}, expected {expected}"
        );
    }
    // The bracket 1, 1/4, 1/16 tells irradiance up to 16, as `udc fuse` does for captures.
    assert!((sensor.saturation() - 16.0).abs() < 1e-9, "{}", sensor.saturation());
}
