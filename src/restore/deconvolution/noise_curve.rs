//! The noise of captures where it is told, and need not be estimated.

use crate::core::image::CHANNELS;
use crate::dataset::NoiseConfig;

/// Samples an octave, and the octaves below and above an irradiance of 1 that are sampled: to counts of 14 bits.
const PER_OCTAVE: f32 = 2.0;
const OCTAVES: f32 = 14.0;
const SAMPLES: usize = 57;

/// The standard deviation of a capture's light by that light, in each channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseCurve {
    deviations: [[f32; SAMPLES]; CHANNELS],
}

impl NoiseCurve {
    /// Samples the deviation that a noise has at every irradiance.
    pub fn of(noise: &NoiseConfig) -> Self {
        #[expect(clippy::cast_precision_loss, reason = "a few samples")]
        let light = |sample: usize| (sample as f32 / PER_OCTAVE - OCTAVES).exp2();
        let deviation = |channel, sample| noise.deviation(channel, f64::from(light(sample)));
        #[expect(clippy::cast_possible_truncation, reason = "light is of 32 bits")]
        let of_channel = |channel: usize| std::array::from_fn(|sample| deviation(channel, sample) as f32);
        Self { deviations: std::array::from_fn(of_channel) }
    }

    /// The deviation of so much light in a channel, interpolated on a logarithmic scale.
    pub(super) fn at(&self, channel: usize, light: f32) -> f32 {
        #[expect(clippy::cast_precision_loss, reason = "a few samples")]
        let last = (SAMPLES - 1) as f32;
        let place = ((light.max(f32::MIN_POSITIVE).log2() + OCTAVES) * PER_OCTAVE).clamp(0.0, last);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the samples")]
        let before = (place as usize).min(SAMPLES - 2);
        let [low, high] = [before, before + 1].map(|sample| self.deviations[channel][sample]);
        #[expect(clippy::cast_precision_loss, reason = "a few samples")]
        let part = place - before as f32;
        low + (high - low) * part
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::SensorConfig;

    /// Between samples that are half an octave apart, photon noise is off by a percent.
    #[test]
    fn samples_say_what_the_noise_says() {
        let gaussian = NoiseCurve::of(&NoiseConfig::Gaussian { sigma: 0.02 });
        assert!([0.0, 0.3, 1e6].into_iter().all(|light| gaussian.at(1, light) == 0.02));
        let sensor =
            SensorConfig { channel_gains: [0.5, 1.0, 1.0], exposures: vec![1.0], ..Default::default() };
        let noise = NoiseConfig::Sensor(sensor);
        let curve = NoiseCurve::of(&noise);
        for (channel, light) in [(0, 0.011), (1, 0.2), (2, 0.77)] {
            let expected = noise.deviation(channel, f64::from(light));
            let found = f64::from(curve.at(channel, light));
            assert!((found / expected - 1.0).abs() < 0.015, "{light}: {found} {expected}");
        }
    }
}
