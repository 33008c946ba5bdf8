//! What a camera says of a picture for those who look at it, as EXIF (CIPA DC-008) names it.

use serde::{Deserialize, Serialize};

/// What is kept of a picture's EXIF: who took it with what, when, where and how.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case")]
pub struct Exif {
    /// The camera's maker.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub make: Option<String>,
    /// The camera.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// The lens.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lens: Option<String>,
    /// Who took it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub artist: Option<String>,
    /// Whose rights it is under.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub copyright: Option<String>,
    /// When it was taken, as EXIF writes it: `2026:11:23 12:30:00`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taken: Option<String>,
    /// Fractions of that second: its digits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taken_subsecond: Option<String>,
    /// That clock's distance from UTC: `+01:00`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taken_offset: Option<String>,
    /// The exposure time in seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure_s: Option<f64>,
    /// Focal length over the diameter of the pupil.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub f_number: Option<f64>,
    /// The sensitivity (ISO).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iso: Option<f64>,
    /// By how many stops the photographer corrected the exposure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure_bias_ev: Option<f64>,
    /// The focal length.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_length_mm: Option<f64>,
    /// That of the same field of view on 36 mm × 24 mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_length_35mm: Option<f64>,
    /// Where it was taken.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<Position>,
}

/// A place on Earth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case")]
pub struct Position {
    /// North of the equator; south is negative.
    pub latitude_deg: f64,
    /// East of Greenwich; west is negative.
    pub longitude_deg: f64,
    /// Above the sea.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub altitude_m: Option<f64>,
    /// The day in UTC: `2026:11:23`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub date: Option<String>,
    /// Hours, minutes and seconds of UTC.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_utc: Option<[f64; 3]>,
}

impl Exif {
    /// Whether nothing is said.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}
