//! What made a dataset, as `dataset.toml` says it: the formation model with its noise, the bank, the seed.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::core::fft::Boundary;
use crate::core::primaries::Primaries;
use crate::core::tone::ToneCurve;
use crate::io;

use super::sensor::{SensorConfig, require};

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
    /// ([`bank_sha256`](crate::io::bank_sha256)). Other software may record the SHA-256 of the whole file: such
    /// a dataset opens, with the identity in its place.
    pub bank_sha256: String,
    /// SHA-256 of the PSFs of the field file [`FIELD_FILE`](super::FIELD_FILE), where the PSF changes over the frame; the
    /// bank then holds the PSF in its middle.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field_sha256: Option<String>,
    /// `srgb` where the scenes were pictures that were decoded by the curve of sRGB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene_domain: Option<String>,
    /// The red, green and blue of all scenes, where these are others than those of sRGB.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene_primaries: Option<Primaries>,
    /// Seed of the noise and of the split; TOML holds at most `i64::MAX`.
    pub seed: u64,
    /// How the sources (panoramas) were divided: `test-fraction 0.15`, `all train`; behind it, the splits that were added
    /// since: `all train, test`.
    pub division: String,
    /// Extension of the images: `exr` or `npy`.
    pub image_format: String,
    /// Whether the images are stored as half floats.
    pub half: bool,
    /// Bytes of images from which on another tar archive is begun, where they are not a file each.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archive_bytes: Option<u64>,
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

    /// What is wrong between the clipping and the noise's sensor, where they saturate at different irradiance; `x_max` is
    /// what the user calls the former, nothing where a dataset says it.
    ///
    /// Either is right by itself; together they clip what the sensor records, or never reach x_max.
    pub fn scale_warning(&self, x_max: Option<&str>) -> Option<String> {
        /// A converter that ends a little before or behind the full well is no other scale.
        const TOLERANCE: f64 = 1.1;
        let NoiseConfig::Sensor(sensor) = &self.noise else { return None };
        let (saturation, highest, clipping) = (sensor.saturation(), sensor.highest(), f64::from(self.x_max));
        let consequence = match saturation / clipping {
            ratio if ratio > TOLERANCE => "what it records above x-max is clipped".to_owned(),
            ratio if ratio < 1.0 / TOLERANCE && highest > saturation => format!(
                "nothing above that is ever recorded in the most sensitive channel, nor above {highest:.4} in the least"
            ),
            ratio if ratio < 1.0 / TOLERANCE => "nothing above that is ever recorded".to_owned(),
            _ => return None,
        };
        let white = sensor.white_irradiance() * clipping / saturation;
        let advice = match x_max {
            Some(key) => format!(
                "leave {key} out to take it from the sensor, or let the sensor have white-irradiance = {white:.4}"
            ),
            None => "to change it, make the dataset anew, without --x-max".to_owned(),
        };
        Some(format!(
            "x-max is {clipping}, and the sensor's shortest exposure saturates at an irradiance of {saturation:.4}: \
             {consequence}; {advice}"
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

impl NoiseConfig {
    /// Reads the noise that a text names: `none`, `gaussian:SIGMA`, `sensor`, or `sensor:FILE.toml` with a file that
    /// describes the sensor.
    ///
    /// # Errors
    /// [`Error::Config`] for any other text, or parameters out of range; those of reading the sensor's file.
    pub fn parse(text: &str) -> Result<Self> {
        let noise = match text.split_once(':') {
            None if text == "none" => Self::None,
            None if text == "sensor" => Self::Sensor(SensorConfig::default()),
            Some(("gaussian", sigma)) => {
                let expected = "expected gaussian:SIGMA such as gaussian:0.01";
                let sigma = sigma
                    .parse()
                    .map_err(|_| Error::config("noise", format!("{expected}, found `{text}`")))?;
                Self::Gaussian { sigma }
            }
            Some(("sensor", "")) => {
                let expected = "expected sensor:FILE.toml, or sensor for the one that is built in";
                return Err(Error::config("noise", format!("{expected}, found `{text}`")));
            }
            Some(("sensor", file)) => {
                let path = Path::new(file);
                let sensor = parse_toml(&io::read_configuration(path)?);
                Self::Sensor(sensor.map_err(|reason| Error::format(path, reason))?)
            }
            _ => {
                let expected = "expected none, gaussian:SIGMA, sensor or sensor:FILE.toml";
                return Err(Error::config("noise", format!("{expected}, found `{text}`")));
            }
        };
        noise.validate()?;
        Ok(noise)
    }

    /// The standard deviation of the light that a channel records of an irradiance below saturation.
    pub fn deviation(&self, channel: usize, irradiance: f64) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Gaussian { sigma } => f64::from(*sigma),
            Self::Sensor(sensor) => sensor.deviation(channel, irradiance),
        }
    }

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
    fn a_clipping_that_is_not_the_sensors_is_named() {
        let config = |x_max| {
            let noise = NoiseConfig::Sensor(SensorConfig::default());
            FormationConfig { x_max, noise, ..FormationConfig::default() }
        };
        assert_eq!(config(16.0).scale_warning(Some("--x-max")), None);
        let message = config(500.0).scale_warning(Some("--x-max")).unwrap();
        assert!(
            message.contains("is ever recorded; leave --x-max out")
                && message.contains("white-irradiance = 31.25"),
            "{message}"
        );
        let mut uneven = config(500.0);
        let channel_gains = [0.7, 1.0, 0.8];
        uneven.noise = NoiseConfig::Sensor(SensorConfig { channel_gains, ..SensorConfig::default() });
        let message = uneven.scale_warning(Some("data.formation.x-max")).unwrap();
        assert!(message.contains("most sensitive channel, nor above 22.8571 in the least"), "{message}");
        assert!(message.contains("leave data.formation.x-max out"), "{message}");
        assert!(!config(500.0).scale_warning(None).unwrap().contains("leave"));
        assert!(config(4.0).scale_warning(None).unwrap().contains("is clipped"));
        assert_eq!(FormationConfig::default().scale_warning(None), None);
    }

    #[test]
    fn noise_is_named_by_its_kind_and_parameter() {
        let parse = |text| NoiseConfig::parse(text).map_err(|error| error.to_string());
        assert_eq!(parse("none"), Ok(NoiseConfig::None));
        assert_eq!(parse("gaussian:0.5"), Ok(NoiseConfig::Gaussian { sigma: 0.5 }));
        assert_eq!(parse("sensor"), Ok(NoiseConfig::Sensor(SensorConfig::default())));
        assert!(parse("gaussian:much").unwrap_err().contains("such as gaussian:0.01, found `gaussian:much`"));
        assert!(parse("sensor:").unwrap_err().contains("expected sensor:FILE.toml, or sensor"));
        for text in ["gaussian:-1", "gaussian", "poisson", "sensor:absent.toml"] {
            assert!(parse(text).is_err(), "{text}");
        }
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
}
