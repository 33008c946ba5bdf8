//! Turns a display file (TOML) into the checked description of panel, lens, sensor and light.

mod check;

use std::path::{Path, PathBuf};

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::io::{read_configuration, write_atomically};

use super::shape::ShapeKind;

/// Everything that decides a simulated PSF: the contents of a display file.
///
/// # Units
/// Each key names its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct DisplayConfig {
    /// The source and the lens.
    pub optics: OpticsConfig,
    /// The sensor.
    pub sensor: PixelConfig,
    /// The light that each colour channel sees.
    pub spectrum: SpectrumConfig,
    /// The grid of the computation; left out, it is chosen.
    pub sampling: SamplingConfig,
    /// The panel.
    pub display: LayoutConfig,
}

/// Distances and sizes of source, display and lens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct OpticsConfig {
    /// z₁: from the point source to the display; `inf` for a star (null where the display stands in a file's origin, JSON
    /// having no other way to say it).
    #[serde(deserialize_with = "distance")]
    pub source_distance_m: f64,
    /// d: from the display to the lens.
    pub display_to_lens_mm: f64,
    /// f: the focal length.
    pub focal_length_mm: f64,
    /// D: the diameter of the pupil at the lens.
    pub aperture_mm: f64,
    /// z₂: from the lens to the sensor; left out, the sensor is in focus for the source.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sensor_distance_mm: Option<f64>,
}

impl Default for OpticsConfig {
    /// A phone's front camera at f/2 behind a panel one millimetre away.
    fn default() -> Self {
        Self {
            source_distance_m: 1.0,
            display_to_lens_mm: 1.0,
            focal_length_mm: 3.8,
            aperture_mm: 1.9,
            sensor_distance_mm: None,
        }
    }
}

/// The sensor's pixels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct PixelConfig {
    /// The side of a square pixel; all of its area collects light.
    pub pixel_pitch_um: f64,
    /// The side of the square PSF in pixels.
    pub size_px: usize,
}

impl Default for PixelConfig {
    fn default() -> Self {
        Self { pixel_pitch_um: 1.12, size_px: 800 }
    }
}

/// Wavelengths in nanometres with their weights, for each colour channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SpectrumConfig {
    /// What the red channel sees.
    #[serde(deserialize_with = "pairs")]
    pub red: Vec<(f64, f64)>,
    /// What the green channel sees.
    #[serde(deserialize_with = "pairs")]
    pub green: Vec<(f64, f64)>,
    /// What the blue channel sees.
    #[serde(deserialize_with = "pairs")]
    pub blue: Vec<(f64, f64)>,
}

/// Reads lists of exactly two numbers; serde alone would pass over a third.
fn pairs<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<(f64, f64)>, D::Error> {
    let lists: Vec<Vec<f64>> = Vec::deserialize(deserializer)?;
    let pair = |list: Vec<f64>| match list[..] {
        [wavelength_nm, weight] => Ok((wavelength_nm, weight)),
        _ => Err(D::Error::custom(format!("expected [wavelength nm, weight], found {} numbers", list.len()))),
    };
    lists.into_iter().map(pair).collect()
}

/// Reads a distance that may be infinite.
fn distance<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}

/// Reads exactly two numbers.
fn two<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 2], D::Error> {
    let list: Vec<f64> = Vec::deserialize(deserializer)?;
    list.try_into().map_err(|list: Vec<f64>| {
        D::Error::custom(format!("expected two numbers, right and down, found {}", list.len()))
    })
}

impl Default for SpectrumConfig {
    /// One wavelength for each channel, as in the paper.
    fn default() -> Self {
        Self { red: vec![(610.0, 1.0)], green: vec![(530.0, 1.0)], blue: vec![(465.0, 1.0)] }
    }
}

impl SpectrumConfig {
    /// The three lists in channel order.
    pub fn channels(&self) -> [&[(f64, f64)]; 3] {
        [&self.red, &self.green, &self.blue]
    }

    /// Each wavelength that has a weight, once, with its weight in each channel.
    pub fn lines(&self) -> Vec<(f64, [f64; 3])> {
        let mut lines: Vec<(f64, [f64; 3])> = Vec::new();
        for (channel, list) in self.channels().into_iter().enumerate() {
            for &(wavelength_nm, weight) in list.iter().filter(|(_, weight)| *weight > 0.0) {
                let known = lines.iter_mut().find(|(known, _)| known.to_bits() == wavelength_nm.to_bits());
                match known {
                    Some((_, weights)) => weights[channel] += weight,
                    None => {
                        let mut weights = [0.0; 3];
                        weights[channel] = weight;
                        lines.push((wavelength_nm, weights));
                    }
                }
            }
        }
        lines
    }

    /// The shortest wavelength that has a weight, in metres.
    pub fn shortest_m(&self) -> f64 {
        self.lines().iter().map(|(wavelength_nm, _)| wavelength_nm * 1e-9).fold(f64::INFINITY, f64::min)
    }

    /// The longest wavelength that has a weight, in metres.
    pub fn longest_m(&self) -> f64 {
        self.lines().iter().map(|(wavelength_nm, _)| wavelength_nm * 1e-9).fold(0.0, f64::max)
    }
}

/// The grid over the pupil, in the lens plane.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct SamplingConfig {
    /// The distance of grid points.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid_pitch_um: Option<f64>,
    /// The number of grid points on a side.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grid_size: Option<usize>,
}

/// What stands between source and lens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LayoutKind {
    /// Nothing: the bare lens.
    #[default]
    None,
    /// Pixels of one green and alternately one red or blue sub-pixel, on the corners and centres of a
    /// square lattice.
    Pentile,
    /// Pixels of a red, a green and a blue sub-pixel side by side.
    Stripe,
    /// A picture, repeated on all sides.
    Image,
}

impl LayoutKind {
    /// The name that the file uses.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Pentile => "pentile",
            Self::Stripe => "stripe",
            Self::Image => "image",
        }
    }
}

/// What the grey values of a layout picture mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Grey {
    /// The factor t of Eq. 2 on the field: a half-covered pixel is 0.5, power follows as t².
    #[default]
    Amplitude,
    /// The share of light that passes; the field gets its square root.
    Power,
}

/// The panel: a pattern that repeats over the pupil, its cell's centre on the optical axis.
///
/// Positions are those that the camera sees looking out: x to the right, y down. All transmittances are
/// factors on the field (t of Eq. 2, the power is t²) from 0 to 1.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct LayoutConfig {
    /// Which kind of pattern.
    pub kind: LayoutKind,
    /// How far the panel is turned, counter-clockwise as the camera sees it.
    pub angle_deg: f64,
    /// How far the panel is moved to the right and down.
    #[serde(deserialize_with = "two")]
    pub offset_um: [f64; 2],
    /// pentile, stripe: the side of a pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pitch_um: Option<f64>,
    /// pentile, stripe: transmittance where nothing else lies; 1 if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub background_transmittance: Option<f64>,
    /// pentile, stripe: the red sub-pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub red: Option<RegionConfig>,
    /// pentile, stripe: the green sub-pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub green: Option<RegionConfig>,
    /// pentile, stripe: the blue sub-pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub blue: Option<RegionConfig>,
    /// pentile, stripe: further regions, once per pixel, over the sub-pixels.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub openings: Vec<OpeningConfig>,
    /// pentile, stripe: lines through every pixel, on top of everything: their transmittance multiplies.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub wiring: Vec<WiringConfig>,
    /// pentile, stripe: what repeats is a larger square of pixels, within which no two are alike; left out, all are.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub irregularity: Option<IrregularityConfig>,
    /// image: the picture, relative to the display file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// image: the side of one of its pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixel_size_um: Option<f64>,
    /// image: what its grey values mean; amplitude if left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub grey: Option<Grey>,
}

/// The shape and transmittance of a sub-pixel or opening.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct RegionConfig {
    /// rectangle, ellipse or diamond.
    pub shape: ShapeKind,
    /// Its extent from left to right.
    pub width_um: f64,
    /// Its extent from top to bottom.
    pub height_um: f64,
    /// The radius of a rectangle's corners.
    #[serde(default)]
    pub corner_um: f64,
    /// Its transmittance.
    pub transmittance: f64,
}

/// A region that says where it lies.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct OpeningConfig {
    /// Its centre, right of the pixel's centre.
    #[serde(default)]
    pub x_um: f64,
    /// Its centre, below the pixel's centre.
    #[serde(default)]
    pub y_um: f64,
    /// rectangle, ellipse or diamond.
    pub shape: ShapeKind,
    /// Its extent from left to right.
    pub width_um: f64,
    /// Its extent from top to bottom.
    pub height_um: f64,
    /// The radius of a rectangle's corners.
    #[serde(default)]
    pub corner_um: f64,
    /// Its transmittance.
    pub transmittance: f64,
}

/// Which way a line runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Direction {
    /// From left to right.
    #[default]
    Horizontal,
    /// From top to bottom.
    Vertical,
}

/// How the pixels of a panel differ from each other: moved and scaled at random, so that its orders fade into a haze
/// between them.
///
/// # Equation
/// Gaussian displacements of standard deviation σ dim the order of spatial frequency ν by exp(−4π²σ²ν²), as heat does to
/// a crystal's (Debye and Waller); what they lose spreads between the orders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct IrregularityConfig {
    /// How many pixels wide and high the square is that repeats: 2 to 16, even for pentile.
    pub pixels: usize,
    /// What decides the random numbers: the same seed, the same panel.
    #[serde(default)]
    pub seed: u64,
    /// Standard deviation of the displacement of each sub-pixel and opening along each axis, and of each line across its
    /// direction.
    #[serde(default)]
    pub jitter_um: f64,
    /// Each sub-pixel and opening is scaled by a factor drawn evenly from 1 − this to 1 + this: from 0 to below 1.
    #[serde(default)]
    pub size_spread: f64,
}

/// A line through every pixel.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct WiringConfig {
    /// Which way it runs.
    pub direction: Direction,
    /// Its middle, below (horizontal) or right of (vertical) the pixel's centre.
    pub position_um: f64,
    /// How wide it is.
    pub width_um: f64,
    /// Its transmittance; opaque if left out.
    #[serde(default)]
    pub transmittance: f64,
}

/// A panel of which the aperture spans fewer pixels is no panel of a camera: their order is told by hundreds of them.
const LEAST_PIXELS: f64 = 4.0;

impl DisplayConfig {
    /// The pixels of the panel that the aperture spans, where they are too few for a panel of a camera.
    pub fn too_few_pixels(&self) -> Option<f64> {
        let pixels = 1e3 * self.optics.aperture_mm / self.display.pitch_um?;
        (pixels < LEAST_PIXELS).then_some(pixels)
    }

    /// Reads a display file, with another side of the PSF in pixels where one is given.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; those of [`parse`](Self::parse).
    pub fn read(path: &Path, size_px: Option<usize>) -> Result<Self> {
        let mut config = Self::parse(&read_configuration(path)?, path)?;
        if let Some(size_px) = size_px {
            config.sensor.size_px = size_px;
        }
        config.check()?;
        Ok(config)
    }

    /// Reads the text of a display file; `origin` names it in errors, and pictures are found beside it.
    ///
    /// # Errors
    /// [`Error::Format`] with line and column for a typing error or an unknown key; [`Error::Config`] for a
    /// value out of range.
    pub fn parse(text: &str, origin: &Path) -> Result<Self> {
        let mut config: Self = parse_toml(text).map_err(|reason| Error::format(origin, reason))?;
        if let (Some(file), Some(folder)) = (&config.display.file, origin.parent()) {
            config.display.file = Some(folder.join(file));
        }
        config.check()?;
        Ok(config)
    }

    /// Writes a display file that reads back as it is; a picture's path is written as it was resolved.
    ///
    /// # Errors
    /// [`Error::Io`] when the file exists and may not be replaced or cannot be written; [`Error::Config`] for numbers that
    /// TOML cannot hold.
    pub fn write(&self, path: &Path, overwrite: bool) -> Result<()> {
        let text = toml::to_string(self).map_err(|error| Error::config("display", error.to_string()))?;
        write_atomically(path, overwrite, |file| file.write_all(text.as_bytes()))
    }

    /// The same camera behind the panel turned about the optical axis by `angle_deg`, counter-clockwise as the camera
    /// sees it and as its pictures are displayed.
    ///
    /// The light of the orders turns with the layout, its offset included; pupil and sensor stay, so that each pixel
    /// collects what falls on it of the turned light: nothing is interpolated.
    #[must_use]
    pub fn turned(&self, angle_deg: f64) -> Self {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let [right, down] = self.display.offset_um;
        let mut turned = self.clone();
        turned.display.angle_deg += angle_deg;
        turned.display.offset_um = [right * cos + down * sin, down * cos - right * sin];
        turned
    }
}

impl LayoutConfig {
    /// Whether nothing of the panel changes when it is turned about the axis.
    pub fn is_bare(&self) -> bool {
        self.kind == LayoutKind::None || self.is_featureless()
    }

    /// Whether a panel has nothing that could diffract light: its PSF is the bare lens's.
    pub fn is_featureless(&self) -> bool {
        matches!(self.kind, LayoutKind::Pentile | LayoutKind::Stripe)
            && [&self.red, &self.green, &self.blue].iter().all(|region| region.is_none())
            && self.openings.is_empty()
            && self.wiring.is_empty()
    }
}

impl OpeningConfig {
    /// The region without its place.
    pub fn region(&self) -> RegionConfig {
        RegionConfig {
            shape: self.shape,
            width_um: self.width_um,
            height_um: self.height_um,
            corner_um: self.corner_um,
            transmittance: self.transmittance,
        }
    }
}
