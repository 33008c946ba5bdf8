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
    /// Pixels by which scenes are larger than the frame on each side: what shines there spreads light into the frame.
    pub margin: usize,
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
            margin: 0,
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

    /// The frame of a scene of `[height, width]`: its middle, without the margin.
    ///
    /// # Errors
    /// [`Error::Shape`] when the margin leaves nothing of the scene.
    pub fn frame_size(&self, scene: [usize; 2]) -> Result<[usize; 2]> {
        let inner =
            |side: usize| side.checked_sub(self.margin)?.checked_sub(self.margin).filter(|&side| side > 0);
        match scene.map(inner) {
            [Some(height), Some(width)] => Ok([height, width]),
            _ => {
                let expected = format!("more than twice the margin of {} pixels", self.margin);
                Err(Error::shape("scene", expected, format!("{} × {}", scene[0], scene[1])))
            }
        }
    }

    /// The same model for scenes of which only the frame is left, such as stored ground truths.
    ///
    /// Where a margin shone into the frame, the frame's border stands for what is no longer known: it goes on, rather
    /// than ending in darkness.
    #[must_use]
    pub fn of_frames(&self) -> Self {
        if self.margin == 0 {
            return self.clone();
        }
        let boundary = match self.boundary {
            Boundary::Zero | Boundary::Periodic => Boundary::Replicate,
            boundary => boundary,
        };
        Self { margin: 0, boundary, ..self.clone() }
    }

    /// What is wrong between the clipping and the noise's sensor, where they saturate at different irradiance.
    ///
    /// Either is right by itself; together they clip what the sensor records, or never reach x_max.
    pub fn scale_warning(&self) -> Option<String> {
        /// A converter that ends a little before or behind the full well is no other scale.
        const TOLERANCE: f64 = 1.1;
        let NoiseConfig::Sensor(sensor) = &self.noise else { return None };
        let (saturation, x_max) = (sensor.saturation(), f64::from(self.x_max));
        let consequence = match saturation / x_max {
            ratio if ratio > TOLERANCE => "what it records above x-max is clipped",
            ratio if ratio < 1.0 / TOLERANCE => "nothing above that is ever recorded",
            _ => return None,
        };
        Some(format!(
            "x-max is {x_max}, and the sensor's shortest exposure saturates at an irradiance of {saturation:.4}: \
             {consequence}; leave --x-max out to take it from the sensor, or set white-irradiance = {:.4} in its file",
            sensor.white_irradiance() * x_max / saturation
        ))
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

    /// The irradiance at which the longest exposure is full, in the most sensitive channel.
    pub fn white_irradiance(&self) -> f64 {
        self.white_of(self.exposures.first())
    }

    /// The irradiance at which the shortest exposure is full too, in the most sensitive channel: the bracket tells no
    /// more. It is the x_max that belongs to this sensor.
    pub fn saturation(&self) -> f64 {
        self.white_of(self.exposures.last())
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
    fn a_clipping_that_is_not_the_sensors_is_named() {
        let config = |x_max| {
            let noise = NoiseConfig::Sensor(SensorConfig::default());
            FormationConfig { x_max, noise, ..FormationConfig::default() }
        };
        assert_eq!(config(16.0).scale_warning(), None);
        let message = config(500.0).scale_warning().unwrap();
        assert!(
            message.contains("nothing above") && message.contains("white-irradiance = 31.25"),
            "{message}"
        );
        assert!(config(4.0).scale_warning().unwrap().contains("is clipped"));
        assert_eq!(FormationConfig::default().scale_warning(), None);
    }

    #[test]
    fn the_frame_is_the_middle_of_the_scene() {
        let config = FormationConfig { margin: 3, ..FormationConfig::default() };
        assert_eq!(config.frame_size([10, 7]).unwrap(), [4, 1]);
        assert!(config.frame_size([10, 6]).unwrap_err().to_string().contains("margin of 3"));
        let left = config.of_frames();
        assert_eq!((left.margin, left.boundary), (0, Boundary::Replicate));
        assert_eq!(FormationConfig::default().of_frames(), FormationConfig::default());
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
