//! What made a dataset, as `dataset.toml` says it: the formation model with its noise, the bank, the seed.

use serde::{Deserialize, Serialize};

use crate::core::error::{Error, Result};
use crate::core::fft::Boundary;
use crate::core::tone::ToneCurve;

/// The value of `format` in every `dataset.toml`.
pub const FORMAT: &str = "udc-dataset";

/// The layout that this program writes, and the newest that it reads.
pub const VERSION: u32 = 1;

/// The contents of `dataset.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct DatasetConfig {
    /// Always [`FORMAT`].
    pub format: String,
    /// The layout's version.
    pub version: u32,
    /// The program that wrote the folder: `udc 0.1.0`.
    pub program: String,
    /// Kernel bank, relative to the folder.
    pub bank: String,
    /// Identity of the bank: SHA-256 of its file's header and codes, the header holding the PSFs' own hash
    /// ([`bank_sha256`](crate::core::io::bank_sha256)). Other software may record the SHA-256 of the whole file: such
    /// a dataset opens, with the identity in its place.
    pub bank_sha256: String,
    /// SHA-256 of the PSFs of the field file [`FIELD_FILE`](super::FIELD_FILE), where the PSF changes over the frame; the
    /// bank then holds the PSF in its middle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field_sha256: Option<String>,
    /// `srgb` where the scenes were pictures that were decoded by the curve of sRGB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene_domain: Option<String>,
    /// Seed of the noise and of the split; TOML holds at most `i64::MAX`.
    pub seed: u64,
    /// How the sources (panoramas) were divided: `test-fraction 0.15`, `all train`; behind it, the splits that were added
    /// since: `all train, test`.
    pub division: String,
    /// Extension of the images: `exr` or `npy`.
    pub image_format: String,
    /// Whether the images are stored as half floats.
    pub half: bool,
    /// The image formation model.
    pub formation: FormationConfig,
}

/// The parameters of the image formation model `ŷ = φ(C(x∗k + n))` (paper, Eq. 1).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct FormationConfig {
    /// x_max of the clipping C.
    pub x_max: f32,
    /// α of the tone mapping φ. Stored images are linear; training and evaluation tone-map them with it.
    pub alpha: f32,
    /// What lies beyond the scene's border.
    pub boundary: Boundary,
    /// Whether the scene is clipped to `[0, x_max]` before the convolution, as the released data were.
    pub clip_ground_truth: bool,
    /// n.
    pub noise: NoiseConfig,
}

impl Default for FormationConfig {
    /// Eq. 1 as printed, without noise.
    fn default() -> Self {
        let curve = ToneCurve::default();
        Self {
            x_max: curve.x_max,
            alpha: curve.alpha,
            boundary: Boundary::Zero,
            clip_ground_truth: false,
            noise: NoiseConfig::None,
        }
    }
}

impl FormationConfig {
    /// What the released training data were made with: the ground truth is clipped too.
    pub fn released() -> Self {
        Self { clip_ground_truth: true, ..Self::default() }
    }

    /// The clipping and tone mapping φ∘C.
    ///
    /// # Errors
    /// [`Error::Config`] when α or x_max is not positive.
    pub fn curve(&self) -> Result<ToneCurve> {
        ToneCurve::new(self.alpha, self.x_max)
    }
}

/// The noise n of the image formation model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum NoiseConfig {
    /// n = 0.
    #[default]
    None,
    /// Independent normal noise of one standard deviation, in units of irradiance.
    Gaussian {
        /// The standard deviation.
        sigma: f32,
    },
    /// The noise of a sensor: photons, read-out, saturation, quantisation.
    Sensor(SensorConfig),
}

/// A sensor that captures a bracket of exposures, which are fused again.
///
/// # Units
/// Electrons (`_e`) and digital numbers (`_dn`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SensorConfig {
    /// Electrons that a pixel holds before it saturates.
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
    /// A 10-bit phone sensor of 1.1 µm pixels with the paper's scene bracket. `electrons-per-unit` is set
    /// so that the shortest exposure saturates at x_max = 500: 6000 e · 16 / 500 = 192 e.
    fn default() -> Self {
        Self {
            full_well_e: 6000.0,
            read_noise_e: 2.5,
            bits: 10,
            black_level_dn: 64.0,
            electrons_per_unit: 192.0,
            exposures: vec![1.0, 1.0 / 4.0, 1.0 / 16.0],
            channel_gains: [1.0; 3],
        }
    }
}

impl NoiseConfig {
    /// Checks every parameter's range.
    ///
    /// # Errors
    /// [`Error::Config`] naming the first parameter that is out of range.
    pub fn validate(&self) -> Result<()> {
        match self {
            Self::None => Ok(()),
            Self::Gaussian { sigma } => require("noise sigma", f64::from(*sigma), *sigma >= 0.0, "0 or more"),
            Self::Sensor(sensor) => sensor.validate(),
        }
    }
}

impl SensorConfig {
    fn validate(&self) -> Result<()> {
        let positive = [("full-well-e", self.full_well_e), ("electrons-per-unit", self.electrons_per_unit)];
        for (key, value) in positive {
            require(key, value, value > 0.0, "positive")?;
        }
        require("read-noise-e", self.read_noise_e, self.read_noise_e >= 0.0, "0 or more")?;
        require("bits", f64::from(self.bits), (1..=24).contains(&self.bits), "between 1 and 24")?;
        let black_fits = (0.0..self.white_level_dn()).contains(&self.black_level_dn);
        require("black-level-dn", self.black_level_dn, black_fits, "at least 0 and below 2^bits − 1")?;
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

    /// Electrons per digital number: the full well lies at the white level.
    pub fn gain_e_per_dn(&self) -> f64 {
        self.full_well_e / (self.white_level_dn() - self.black_level_dn)
    }
}

fn require(key: &str, value: f64, holds: bool, range: &str) -> Result<()> {
    if holds && value.is_finite() {
        Ok(())
    } else {
        Err(Error::config(key, format!("must be {range}, found {value}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn round_trips_through_toml() {
        for noise in [
            NoiseConfig::None,
            NoiseConfig::Gaussian { sigma: 0.1 },
            NoiseConfig::Sensor(SensorConfig::default()),
        ] {
            let config = FormationConfig { noise, boundary: Boundary::Reflect, ..FormationConfig::default() };
            let text = toml::to_string(&config).unwrap();
            assert_eq!(toml::from_str::<FormationConfig>(&text).unwrap(), config, "{text}");
        }
    }

    #[test]
    fn names_a_misspelt_key() {
        let message = toml::from_str::<FormationConfig>("x-mux = 3.0").unwrap_err().to_string();
        assert!(message.contains("x-mux"), "{message}");
        let sensor = "[noise]\nkind = \"sensor\"\nfull-wall-e = 3.0";
        let message = toml::from_str::<FormationConfig>(sensor).unwrap_err().to_string();
        assert!(message.contains("full-wall-e"), "{message}");
    }

    #[test]
    fn refuses_sensors_that_cannot_exist() {
        let refused = |change: fn(&mut SensorConfig)| {
            let mut sensor = SensorConfig::default();
            change(&mut sensor);
            NoiseConfig::Sensor(sensor).validate().is_err()
        };
        assert!(refused(|s| s.full_well_e = 0.0));
        assert!(refused(|s| s.read_noise_e = f64::NAN));
        assert!(refused(|s| s.bits = 0));
        assert!(refused(|s| s.black_level_dn = 1023.0));
        assert!(refused(|s| s.exposures = vec![0.25, 1.0]));
        assert!(refused(|s| s.exposures.clear()));
        assert!(!refused(|_| ()));
    }
}
