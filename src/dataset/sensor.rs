//! A sensor that captures a bracket, and the scale that its images are counted on.

use serde::{Deserialize, Serialize};

use crate::core::error::{Error, Result};
use crate::core::saturation::SATURATED_SHARE;

/// A sensor that captures a bracket of exposures, which are fused again.
///
/// # Units
/// Electrons (`_e`) and digital numbers (`_dn`). Irradiance is relative: it is counted as captures are, 1 being white
/// of the longest exposure in the most sensitive channel, unless the file says another `white-irradiance`.
///
/// # Files
/// A file says `white-irradiance` (1 without it), and the electrons follow: `full-well-e / (white-irradiance · largest
/// channel gain · longest exposure)`. Or it says `electrons-per-unit` itself, and the white follows. Both only if they
/// agree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SensorFile", rename_all = "kebab-case")]
pub struct SensorConfig {
    /// Electrons at which a pixel saturates: it reads white.
    pub full_well_e: f64,
    /// Standard deviation of the read-out noise.
    pub read_noise_e: f64,
    /// Bits of the analogue-to-digital converter.
    pub bits: u32,
    /// Digital number of a dark pixel.
    pub black_level_dn: f64,
    /// Electrons that one unit of irradiance yields in an exposure of 1.
    pub electrons_per_unit: f64,
    /// Relative exposures of the bracket, longest first.
    pub exposures: Vec<f64>,
    /// Relative sensitivity of red, green and blue.
    pub channel_gains: [f64; 3],
}

impl Default for SensorConfig {
    /// A 10-bit phone sensor of 1.1 µm pixels with the paper's scene bracket: the longest exposure saturates at an
    /// irradiance of 1, the shortest at 16.
    fn default() -> Self {
        Self {
            full_well_e: 6000.0,
            read_noise_e: 2.5,
            bits: 10,
            black_level_dn: 64.0,
            electrons_per_unit: 6000.0,
            exposures: vec![1.0, 1.0 / 4.0, 1.0 / 16.0],
            channel_gains: [1.0; 3],
        }
    }
}

/// What a sensor's file may say.
#[derive(Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
struct SensorFile {
    full_well_e: f64,
    read_noise_e: f64,
    bits: u32,
    black_level_dn: f64,
    white_irradiance: Option<f64>,
    electrons_per_unit: Option<f64>,
    exposures: Vec<f64>,
    channel_gains: [f64; 3],
}

impl Default for SensorFile {
    fn default() -> Self {
        let SensorConfig {
            full_well_e, read_noise_e, bits, black_level_dn, exposures, channel_gains, ..
        } = SensorConfig::default();
        let (white_irradiance, electrons_per_unit) = (None, None);
        Self {
            full_well_e,
            read_noise_e,
            bits,
            black_level_dn,
            white_irradiance,
            electrons_per_unit,
            exposures,
            channel_gains,
        }
    }
}

impl TryFrom<SensorFile> for SensorConfig {
    type Error = Error;

    /// Finds the electrons of a unit from the irradiance of white, or checks that both agree.
    fn try_from(file: SensorFile) -> Result<Self> {
        /// Decimals that a file may leave out.
        const AGREEMENT: f64 = 1e-3;
        let white = file.white_irradiance.unwrap_or(1.0);
        require("white-irradiance", white, white > 0.0, "positive")?;
        let SensorFile { full_well_e, read_noise_e, bits, black_level_dn, exposures, channel_gains, .. } =
            file;
        let mut sensor = Self {
            full_well_e,
            read_noise_e,
            bits,
            black_level_dn,
            electrons_per_unit: 1.0,
            exposures,
            channel_gains,
        };
        sensor.validate()?;
        let derived = sensor.white_irradiance() / white;
        sensor.electrons_per_unit = file.electrons_per_unit.unwrap_or(derived);
        sensor.validate()?;
        if file.white_irradiance.is_some() && (sensor.electrons_per_unit / derived - 1.0).abs() > AGREEMENT {
            let reason = format!(
                "is {}, and with white-irradiance = {white} the longest exposure is full at {derived:.4} electrons in a \
                 unit; leave one of the two out",
                sensor.electrons_per_unit
            );
            return Err(Error::config("electrons-per-unit", reason));
        }
        Ok(sensor)
    }
}

/// Digital numbers from black to white at least: one between them, wherever black lies between two, tells light that is
/// neither none nor too much. With less than half of one, darkness itself would be rounded to white.
const LEAST_RANGE_DN: f64 = 2.0;

impl SensorConfig {
    /// Checks every parameter's range.
    pub(super) fn validate(&self) -> Result<()> {
        let positive = [("full-well-e", self.full_well_e), ("electrons-per-unit", self.electrons_per_unit)];
        for (key, value) in positive {
            require(key, value, value > 0.0, "positive")?;
        }
        require("read-noise-e", self.read_noise_e, self.read_noise_e >= 0.0, "0 or more")?;
        require("bits", f64::from(self.bits), (2..=24).contains(&self.bits), "between 2 and 24")?;
        let black_fits = (0.0..=self.white_level_dn() - LEAST_RANGE_DN).contains(&self.black_level_dn);
        require("black-level-dn", self.black_level_dn, black_fits, "at least 0 and at most 2^bits − 3")?;
        for gain in self.channel_gains {
            require("channel-gains", gain, gain > 0.0, "positive")?;
        }
        if self.exposures.is_empty() {
            return Err(Error::config("exposures", "must name at least one exposure, such as [1.0]"));
        }
        for exposure in &self.exposures {
            require("exposures", *exposure, *exposure > 0.0, "positive")?;
        }
        if self.exposures.windows(2).any(|pair| pair[0] <= pair[1]) {
            return Err(Error::config("exposures", "must be listed from the longest to the shortest"));
        }
        Ok(())
    }

    /// The largest digital number.
    pub fn white_level_dn(&self) -> f64 {
        2f64.powi(self.bits.cast_signed()) - 1.0
    }

    /// The irradiance at which the longest exposure is full, in the most sensitive channel.
    pub fn white_irradiance(&self) -> f64 {
        self.white_of(self.exposures.first())
    }

    /// The irradiance at which the shortest exposure is full too, in the most sensitive channel: the bracket tells no
    /// more. It is the x_max that belongs to this sensor.
    pub fn saturation(&self) -> f64 {
        self.white_of(self.exposures.last())
    }

    /// The irradiance at which the least sensitive channel is full in the shortest exposure: nothing above is recorded.
    pub fn highest(&self) -> f64 {
        let largest = self.channel_gains.iter().copied().fold(0.0, f64::max);
        let smallest = self.channel_gains.iter().copied().fold(f64::INFINITY, f64::min);
        self.saturation() * largest / smallest
    }

    /// [`saturation`](Self::saturation) as the x_max of an image formation.
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    pub fn x_max(&self) -> f32 {
        self.saturation() as f32
    }

    fn white_of(&self, exposure: Option<&f64>) -> f64 {
        let gain = self.channel_gains.iter().copied().fold(0.0, f64::max);
        self.full_well_e / (self.electrons_per_unit * gain * exposure.copied().unwrap_or(1.0))
    }

    /// The standard deviation of the light that a channel records of an irradiance, from the longest exposure that is not
    /// saturated, or the shortest.
    ///
    /// # Equation
    /// `√(x·q·g·t + σ² + G²/12) / (q·g·t)`: photons, read-out, rounding.
    pub fn deviation(&self, channel: usize, irradiance: f64) -> f64 {
        let (gain, x) = (self.gain_e_per_dn(), irradiance.max(0.0));
        let full = SATURATED_SHARE * self.full_well_e;
        let electrons_per_unit =
            |exposure: &f64| self.electrons_per_unit * self.channel_gains[channel] * exposure;
        let mut exposures = self.exposures.iter().map(electrons_per_unit);
        let electrons =
            exposures.clone().find(|electrons| x * electrons < full).or(exposures.next_back()).unwrap_or(1.0);
        (x * electrons + self.read_noise_e.powi(2) + gain * gain / 12.0).sqrt() / electrons
    }

    /// Electrons per digital number: the full well lies at the white level.
    pub fn gain_e_per_dn(&self) -> f64 {
        self.full_well_e / (self.white_level_dn() - self.black_level_dn)
    }
}

/// Refuses a value that is out of its range, or no number.
pub(super) fn require(key: &str, value: f64, holds: bool, range: &str) -> Result<()> {
    if holds && value.is_finite() {
        Ok(())
    } else {
        Err(Error::config(key, format!("must be {range}, found {value}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensor(text: &str) -> std::result::Result<SensorConfig, toml::de::Error> {
        toml::from_str(text)
    }

    /// A bracket 1, 1/4, 1/16 saturates at 16 times white of the longest exposure, in whatever units times are given.
    #[test]
    fn a_sensor_saturates_where_a_capture_of_its_bracket_does() {
        let exactly = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-12, "{found}");
        for text in [
            "",
            "exposures = [0.5, 0.125, 0.03125]",
            "channel-gains = [0.7, 0.9, 0.4]",
            "full-well-e = 900.0",
        ] {
            let sensor = sensor(text).unwrap();
            exactly(sensor.white_irradiance(), 1.0);
            exactly(sensor.saturation(), 16.0);
        }
        exactly(sensor("white-irradiance = 31.25").unwrap().electrons_per_unit, 192.0);
        exactly(sensor("white-irradiance = 31.25").unwrap().saturation(), 500.0);
        // Files from before the scale was one.
        exactly(sensor("electrons-per-unit = 192.0").unwrap().white_irradiance(), 31.25);
        exactly(
            sensor("electrons-per-unit = 192.0\nwhite-irradiance = 31.25").unwrap().electrons_per_unit,
            192.0,
        );
        let message = sensor("electrons-per-unit = 192.0\nwhite-irradiance = 1.0").unwrap_err().to_string();
        assert!(
            message.contains("192") && message.contains("6000") && message.contains("leave one"),
            "{message}"
        );
        assert!(sensor("white-irradiance = 0.0").is_err() && sensor("electrons-per-unit = -1.0").is_err());
        assert!(sensor("channel-gains = [0.0, 0.0, 0.0]").is_err() && sensor("exposures = []").is_err());
    }

    #[test]
    fn refuses_sensors_that_cannot_exist() {
        let refused = |change: fn(&mut SensorConfig)| {
            let mut sensor = SensorConfig::default();
            change(&mut sensor);
            sensor.validate().is_err()
        };
        assert!(refused(|s| s.full_well_e = 0.0));
        assert!(refused(|s| s.read_noise_e = f64::NAN));
        assert!(refused(|s| s.bits = 0));
        for black_level_dn in [1023.0, 1022.9, 1021.5, -1.0] {
            assert!(SensorConfig { black_level_dn, ..SensorConfig::default() }.validate().is_err());
        }
        assert!(!refused(|s| s.black_level_dn = 1021.0));
        assert!(refused(|s| (s.bits, s.black_level_dn) = (1, 0.0)));
        assert!(!refused(|s| (s.bits, s.black_level_dn) = (2, 1.0)));
        assert!(refused(|s| s.exposures = vec![0.25, 1.0]));
        assert!(refused(|s| s.exposures.clear()));
        assert!(!refused(|_| ()));
    }
}
