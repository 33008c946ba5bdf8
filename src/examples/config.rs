//! What examples are made of, and how much their kinds vary: the section `[examples]` of a training's configuration.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::dataset::Split;
use crate::io;
use crate::scenes::natural::NaturalKind;

/// Two numbers between which a third is drawn.
pub type Range = [f64; 2];

/// How examples for a network that restores captures of any panel are made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ExamplesConfig {
    /// Seed of all that is drawn.
    pub seed: u64,
    /// Number of examples, those for validation included.
    pub count: usize,
    /// Share of the examples that are for validation.
    pub validation_share: f64,
    /// Side of an example in pixels.
    pub side_px: usize,
    /// α of the tone mapping.
    pub alpha: f32,
    /// Share of the examples beyond whose border there is darkness; light from outside enters all others.
    pub zero_border_share: f64,
    /// The panels.
    pub panels: PanelsConfig,
    /// The scenes.
    pub scenes: ScenesConfig,
    /// The sensors.
    pub sensor: SensorsConfig,
    /// Captures that are unlike those of the simulator.
    pub harder: HarderConfig,
}

impl Default for ExamplesConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            count: 4000,
            validation_share: 0.025,
            side_px: 288,
            alpha: 0.25,
            zero_border_share: 0.25,
            panels: PanelsConfig::default(),
            scenes: ScenesConfig::default(),
            sensor: SensorsConfig::default(),
            harder: HarderConfig::default(),
        }
    }
}

/// The panels that captures are made through: drawn at random, or a single one that is given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct PanelsConfig {
    /// Number of panels, those for validation included.
    pub count: usize,
    /// Number of panels that only examples for validation are made with.
    pub validation: usize,
    /// Side of the PSFs in pixels.
    pub psf_side_px: usize,
    /// How far panels are turned about the axis.
    pub angle_deg: Range,
    /// The PSF of the only panel, for a network that is to restore captures of no other; none are drawn then.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psf: Option<PathBuf>,
}

impl Default for PanelsConfig {
    fn default() -> Self {
        Self { count: 120, validation: 12, psf_side_px: 401, angle_deg: [-180.0, 180.0], psf: None }
    }
}

/// The scenes that captures are made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ScenesConfig {
    /// Equirectangular panoramas, twice as wide as high, that views are cut out of.
    pub panoramas: Vec<PathBuf>,
    /// Number of panoramas that only examples for validation are cut out of.
    pub validation_panoramas: usize,
    /// Share of the scenes that are painted.
    pub procedural_share: f64,
    /// What these show, each as often; none for the usual kinds by their shares.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub kinds: Vec<NaturalKind>,
    /// How many pixels of the panorama a pixel in the middle of a view spans, at least and at most.
    pub texels_per_pixel: Range,
    /// How far views look up or down at most.
    pub pitch_deg: f64,
    /// The median of a scene's green light.
    pub brightness: Range,
}

impl Default for ScenesConfig {
    fn default() -> Self {
        Self {
            panoramas: Vec::new(),
            validation_panoramas: 3,
            procedural_share: 0.5,
            kinds: Vec::new(),
            texels_per_pixel: [1.0, 1.6],
            pitch_deg: 45.0,
            brightness: [0.03, 0.5],
        }
    }
}

/// The sensors that record captures, each by a bracket of exposures whose longest is white at an irradiance of 1.
///
/// # Units
/// Electrons (`_e`). A pixel of 1.1 µm holds 6000 electrons at ISO 100, of which 190 are white at ISO 3200.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SensorsConfig {
    /// Share of the captures without noise.
    pub noise_free_share: f64,
    /// Electrons at white, drawn on a logarithmic scale.
    pub full_well_e: Range,
    /// Standard deviation of the read-out noise, drawn on a logarithmic scale.
    pub read_noise_e: Range,
    /// The irradiance at which the shortest exposure saturates, drawn on a logarithmic scale.
    pub x_max: Range,
    /// That of usual captures.
    pub usual_x_max: Range,
    /// Share of usual captures.
    pub usual_share: f64,
}

impl Default for SensorsConfig {
    fn default() -> Self {
        Self {
            noise_free_share: 0.15,
            full_well_e: [190.0, 24_000.0],
            read_noise_e: [1.0, 4.0],
            x_max: [1.0, 500.0],
            usual_x_max: [4.0, 32.0],
            usual_share: 0.6,
        }
    }
}

/// Captures that are unlike those of the simulator, so that no network learns its peculiarities: a mosaic that was
/// demosaiced, each channel with its own gain and saturation, a PSF of twice the support and of another spectrum than the
/// one that is handed over, stray light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct HarderConfig {
    /// Share of these examples.
    pub share: f64,
    /// How far the wavelengths are off at most.
    pub spectrum_shift_nm: f64,
    /// The gain of the white balance for red.
    pub red_gain: Range,
    /// That for blue.
    pub blue_gain: Range,
    /// The share of the light that is stray, drawn on a logarithmic scale.
    pub stray_light: Range,
}

impl Default for HarderConfig {
    fn default() -> Self {
        Self {
            share: 0.5,
            spectrum_shift_nm: 3.0,
            red_gain: [1.2, 2.4],
            blue_gain: [1.1, 2.2],
            stray_light: [0.003, 0.05],
        }
    }
}

/// The part of a file that is read here; a training reads the others.
#[derive(Deserialize)]
struct Section {
    examples: Option<ExamplesConfig>,
}

impl ExamplesConfig {
    /// Reads the section `[examples]` of a configuration.
    ///
    /// # Errors
    /// [`Error::Config`] with the line and column of a mistake, or when there is no such section.
    pub fn from_toml(text: &str) -> Result<Self> {
        let Section { examples } =
            parse_toml(text).map_err(|reason| Error::config("configuration", reason))?;
        examples.ok_or_else(|| {
            let reason = "says nothing of examples; add a section [examples], as configs/guided.toml has";
            Error::config("configuration", reason)
        })
    }

    /// Checks every value's range.
    ///
    /// # Errors
    /// [`Error::Config`] naming the first key that is out of range.
    pub fn validate(&self) -> Result<()> {
        let Self { panels, scenes, sensor, harder, .. } = self;
        let sides = [
            ("count", self.count, 1..=1_000_000),
            ("side-px", self.side_px, 16..=4096),
            ("panels.psf-side-px", panels.psf_side_px, 3..=2047),
            ("panels.count", panels.count, 1..=10_000),
            ("panels.validation", panels.validation, 0..=panels.count.saturating_sub(1)),
        ];
        for (key, value, range) in sides {
            within(key, value as f64, *range.start() as f64..=*range.end() as f64)?;
        }
        let shares = [
            ("validation-share", self.validation_share),
            ("zero-border-share", self.zero_border_share),
            ("scenes.procedural-share", scenes.procedural_share),
            ("sensor.noise-free-share", sensor.noise_free_share),
            ("sensor.usual-share", sensor.usual_share),
            ("harder.share", harder.share),
        ];
        shares.into_iter().try_for_each(|(key, share)| within(key, share, 0.0..=1.0))?;
        within("alpha", f64::from(self.alpha), 1e-6..=1e6)?;
        within("scenes.pitch-deg", scenes.pitch_deg, 0.0..=90.0)?;
        within("harder.spectrum-shift-nm", harder.spectrum_shift_nm, 0.0..=50.0)?;
        let ranges = [
            ("panels.angle-deg", panels.angle_deg, -360.0..=360.0),
            ("scenes.texels-per-pixel", scenes.texels_per_pixel, 0.01..=100.0),
            ("scenes.brightness", scenes.brightness, 1e-6..=1e6),
            ("sensor.full-well-e", sensor.full_well_e, 1.0..=1e9),
            ("sensor.read-noise-e", sensor.read_noise_e, 1e-3..=1e6),
            ("sensor.x-max", sensor.x_max, 1.0..=1e5),
            ("sensor.usual-x-max", sensor.usual_x_max, 1.0..=1e5),
            ("harder.red-gain", harder.red_gain, 1.0..=16.0),
            ("harder.blue-gain", harder.blue_gain, 1.0..=16.0),
            ("harder.stray-light", harder.stray_light, 1e-6..=0.5),
        ];
        for (key, [low, high], range) in ranges {
            within(key, low, range.clone())?;
            within(key, high, low..=*range.end())?;
        }
        self.check_validation()
    }

    /// The numbers of the panels that examples of a split are seen through.
    pub(super) fn panels_of(&self, split: Split) -> std::ops::Range<usize> {
        let PanelsConfig { count, validation, psf, .. } = &self.panels;
        match (psf, split) {
            (Some(_), _) => 0..1,
            (None, Split::Train) => 0..count - validation,
            (None, _) => count - validation..*count,
        }
    }

    /// Takes the size of PSFs from the one that is given; returns its SHA-256 too.
    ///
    /// # Errors
    /// Those of [`io::read_psf`].
    pub(super) fn resolved(&self) -> Result<(Self, Option<String>)> {
        let mut config = self.clone();
        let Some(path) = &self.panels.psf else { return Ok((config, None)) };
        let psf = io::read_psf(path)?;
        config.panels.psf_side_px = psf.height().max(psf.width());
        Ok((config, Some(psf.sha256())))
    }

    /// Number of panoramas that are kept for validation.
    pub(super) fn panoramas_kept(&self) -> usize {
        if self.validation_share > 0.0 { self.scenes.validation_panoramas.max(1) } else { 0 }
    }

    /// Checks that what is kept for validation leaves something to learn from, and the other way round.
    fn check_validation(&self) -> Result<()> {
        let refuse = |key: &str, reason: &str| Err(Error::config(format!("examples.{key}"), reason));
        let validates = self.validation_share > 0.0;
        if validates && self.panels.validation == 0 && self.panels.psf.is_none() {
            return refuse("panels.validation", "is 0, and examples for validation want panels of their own");
        }
        let ScenesConfig { panoramas, procedural_share, .. } = &self.scenes;
        if *procedural_share >= 1.0 {
            return Ok(());
        }
        let kept = self.panoramas_kept();
        if panoramas.len() <= kept {
            let reason = format!(
                "names {} panoramas, of which {kept} are kept for validation; name more with --scenes, or paint all scenes \
                 with scenes.procedural-share = 1.0",
                panoramas.len()
            );
            return refuse("scenes.panoramas", &reason);
        }
        Ok(())
    }
}

fn within(key: &str, value: f64, range: RangeInclusive<f64>) -> Result<()> {
    if range.contains(&value) {
        return Ok(());
    }
    let reason = format!("must be between {} and {}, found {value}", range.start(), range.end());
    Err(Error::config(format!("examples.{key}"), reason))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(change: fn(&mut ExamplesConfig)) -> String {
        let mut config = ExamplesConfig::default();
        config.scenes.procedural_share = 1.0;
        config.validate().unwrap();
        change(&mut config);
        config.validate().unwrap_err().to_string()
    }

    #[test]
    fn reads_its_section_among_others() {
        let text =
            "iterations = 3\n[examples]\nseed = 7\n[examples.sensor]\nx-max = [1.0, 4.0]\n[data]\ncrop = 9";
        let config = ExamplesConfig::from_toml(text).unwrap();
        assert_eq!((config.seed, config.sensor.x_max), (7, [1.0, 4.0]));
        assert_eq!(config.panels, PanelsConfig::default());
        let message = ExamplesConfig::from_toml("[examples]\nsede = 7").unwrap_err().to_string();
        assert!(message.contains("line 2, column 1") && message.contains("sede"), "{message}");
        let message = ExamplesConfig::from_toml("iterations = 3").unwrap_err().to_string();
        assert!(message.contains("add a section [examples]"), "{message}");
    }

    #[test]
    fn values_out_of_range_are_named() {
        for (message, key) in [
            (refusal(|c| c.count = 0), "examples.count: must be between 1"),
            (refusal(|c| c.panels.count = 0), "examples.panels.count"),
            (refusal(|c| c.panels.validation = 200), "examples.panels.validation"),
            (refusal(|c| c.panels.validation = 0), "panels of their own"),
            (refusal(|c| c.harder.share = 1.5), "examples.harder.share"),
            (refusal(|c| c.sensor.x_max = [16.0, 4.0]), "examples.sensor.x-max: must be between 16"),
            (refusal(|c| c.sensor.full_well_e = [f64::NAN, 4.0]), "examples.sensor.full-well-e"),
            (refusal(|c| c.scenes.procedural_share = 0.5), "name more with --scenes"),
        ] {
            assert!(message.contains(key), "{message}");
        }
    }
}
