//! What finishing a picture needs to know of the capture that it was made of, carried along with the image.

use serde::{Deserialize, Serialize};

use super::camera_color::CameraColor;
use super::exif::Exif;
use super::orientation::Orientation;
use super::primaries::Primaries;

/// What is known of a capture beside its light.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case")]
pub struct CaptureInfo {
    /// The irradiance of a full photosite in red, green and blue, after white balance: the white levels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub saturation: Option<[f32; 3]>,
    /// How the picture lies on the sensor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub orientation: Option<Orientation>,
    /// By how many stops the camera wants its captures brightened.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub baseline_exposure_ev: Option<f64>,
    /// The gains of red, green and blue that were applied.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub white_balance: Option<[f64; 3]>,
    /// The camera's colours.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color: Option<CameraColor>,
    /// The image's red, green and blue, where these are others than those of sRGB and no camera's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub primaries: Option<Primaries>,
    /// The standard deviation of what the coding of a JPEG makes wrong in its values of red, green and blue before they are decoded by
    /// the curve of sRGB, of which white is 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coding_error: Option<[f32; 3]>,
    /// What the camera says of the picture for those who look at it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exif: Option<Exif>,
}

impl CaptureInfo {
    /// What is known of light of these primaries and of nothing else.
    pub fn of_primaries(primaries: Primaries) -> Self {
        Self { primaries: Some(primaries), ..Self::default() }
    }

    /// Reads what [`to_json`](Self::to_json) wrote.
    ///
    /// # Errors
    /// What is wrong with the text, where it is damaged or holds numbers that no capture has.
    pub fn from_json(text: &str) -> Result<Self, String> {
        let info: Self = serde_json::from_str(text).map_err(|error| error.to_string())?;
        if info.saturation.iter().flatten().any(|level| !is_level(*level)) {
            return Err("saturation at no light that a sensor has".to_owned());
        }
        if info.white_balance.iter().flatten().any(|gain| !(gain.is_finite() && *gain > 0.0)) {
            return Err("gains that are not positive".to_owned());
        }
        if info.coding_error.iter().flatten().any(|error| !(0.0..=1.0).contains(error)) {
            return Err("an error of coding that is no part of white".to_owned());
        }
        if info.baseline_exposure_ev.is_some_and(|stops| !is_exposure(stops)) {
            return Err("a baseline exposure of more than ten stops".to_owned());
        }
        if info.primaries.is_some_and(|primaries| primaries.matrix_to(&Primaries::SRGB).is_none()) {
            return Err("primaries that span no colours".to_owned());
        }
        Ok(info)
    }

    /// The JSON text that files carry.
    ///
    /// # Panics
    /// Never: the fields are plain data.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).expect("what is known of a capture is plain data")
    }

    /// What is known of the capture where its light is cut at `most`: above, nothing saturates any more.
    pub fn cut_at(self, most: f32) -> Self {
        Self { saturation: self.saturation.map(|levels| levels.map(|level| level.min(most))), ..self }
    }

    /// The matrix from the image's colours to linear sRGB, where the camera says its colours and gains were applied, or the
    /// image has other primaries.
    pub fn color_matrix(&self) -> Option<[[f64; 3]; 3]> {
        match (&self.color, self.white_balance) {
            (Some(color), Some(gains)) => color.matrix(gains),
            _ => self.primaries?.matrix_to(&Primaries::SRGB),
        }
    }
}

/// Whether light is such that a sensor may saturate there, in units of white of its longest exposure.
pub fn is_level(level: f32) -> bool {
    (1e-6..=1e9).contains(&level)
}

/// Whether a number of stops is one that cameras ask for.
pub fn is_exposure(stops: f64) -> bool {
    stops.abs() <= 10.0
}

/// Reads a level of one channel.
///
/// # Errors
/// What to write, when the text is no level.
pub fn parse_level(text: &str) -> Result<f32, String> {
    let level = text.trim().parse().ok().filter(|level| is_level(*level));
    level.ok_or_else(|| "write three numbers from 1e-6 to 1e9, for red, green and blue: 1.9,1,1.6".to_owned())
}

/// Reads a number of stops.
///
/// # Errors
/// What to write, when the text is no number that cameras ask for.
pub fn parse_exposure(text: &str) -> Result<f64, String> {
    let stops = text.trim().parse().ok().filter(|stops| is_exposure(*stops));
    stops.ok_or_else(|| "write a number of stops from -10 to 10".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_and_stops_are_read_in_their_range() {
        assert_eq!(parse_level(" 1.9"), Ok(1.9));
        assert_eq!(parse_exposure("-0.5 "), Ok(-0.5));
        assert!(["0", "1e10", "nan", "white"].iter().all(|text| parse_level(text).is_err()));
        assert!(["11", "-11", "inf", ""].iter().all(|text| parse_exposure(text).is_err()));
    }

    #[test]
    fn what_is_known_returns_from_its_text() {
        let info = CaptureInfo {
            saturation: Some([1.9, 1.0, 1.6]),
            orientation: Orientation::from_exif(6),
            baseline_exposure_ev: Some(0.35),
            primaries: Some(Primaries::DISPLAY_P3),
            exif: Some(Exif { make: Some("Maker".to_owned()), iso: Some(100.0), ..Exif::default() }),
            ..CaptureInfo::default()
        };
        assert_eq!(CaptureInfo::from_json(&info.to_json()), Ok(info));
        assert_eq!(CaptureInfo::from_json("{}"), Ok(CaptureInfo::default()));
        for damaged in [
            "{",
            r#"{"orientation": 9}"#,
            r#"{"saturation": [1, 0, 1]}"#,
            r#"{"saturation": [1, 1e-44, 1]}"#,
            r#"{"white-balance": [1, -1, 1]}"#,
            r#"{"baseline-exposure-ev": 1e9}"#,
            r#"{"primaries": {"red": [0, 0], "green": [0, 0], "blue": [0, 0], "white": [0, 0]}}"#,
        ] {
            assert!(CaptureInfo::from_json(damaged).is_err(), "{damaged}");
        }
    }
}
