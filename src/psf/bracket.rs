//! Puts pictures of one scene and their exposure times together.

use ndarray::{Array2, Array3};

use super::exposure_times::relative_times;
use crate::core::error::{Error, Result};

/// Pictures of one scene, equal but for the exposure time.
#[derive(Clone, Debug)]
pub struct Bracket {
    /// Longest first.
    pub(super) exposures: Vec<Exposure>,
    /// The pixels that are good, where a mask says so.
    pub(super) valid: Option<Array2<bool>>,
}

/// One picture of a bracket.
#[derive(Clone, Debug)]
pub(super) struct Exposure {
    /// Which of the pictures it was when given, from 1.
    pub(super) number: usize,
    /// Relative to the longest.
    pub(super) time: f64,
    pub(super) planes: Array3<f32>,
}

impl Bracket {
    /// Puts pictures and exposure times together, in the same order.
    ///
    /// Only the ratios of the times matter, whatever their unit: the longest becomes 1, so that irradiance 1 is its white.
    ///
    /// # Shapes
    /// Each `[channels, height, width]` with 3 channels (RGB), 1 (a mosaic) or 4 (a packed mosaic).
    ///
    /// # Errors
    /// [`Error::Shape`] for pictures of different sizes or another number than there are times, or none;
    /// [`Error::Config`] for times that are not positive or not distinct.
    pub fn new(pictures: Vec<Array3<f32>>, times: &[f64]) -> Result<Self> {
        check_times(times, pictures.len())?;
        check_pictures(&pictures)?;
        let mut exposures: Vec<Exposure> = pictures
            .into_iter()
            .zip(relative_times(times))
            .enumerate()
            .map(|(index, (planes, time))| Exposure { number: index + 1, time, planes })
            .collect();
        exposures.sort_by(|a, b| b.time.total_cmp(&a.time));
        Ok(Self { exposures, valid: None })
    }

    /// Takes a single picture for a bracket of exposure time 1, so that it is levelled and demosaiced like one.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn single(picture: Array3<f32>) -> Result<Self> {
        Self::new(vec![picture], &[1.0])
    }

    /// Says which pixels are good; the others are filled from their neighbours after merging.
    ///
    /// # Errors
    /// [`Error::Shape`] when the mask has another size than the pictures (a packed mosaic unpacked), or discards
    /// everything.
    pub fn with_mask(mut self, valid: Array2<bool>) -> Result<Self> {
        let (channels, height, width) = self.exposures[0].planes.dim();
        let factor = if channels == 4 { 2 } else { 1 };
        let expected = (height * factor, width * factor);
        if valid.dim() != expected {
            let found = format!("{} × {}", valid.nrows(), valid.ncols());
            return Err(Error::shape("mask", format!("{} × {}", expected.0, expected.1), found));
        }
        if !valid.iter().any(|&valid| valid) {
            return Err(Error::shape("mask", "white where pixels are good", "black everywhere"));
        }
        self.valid = Some(valid);
        Ok(self)
    }

    /// The exposure times as shares of the longest, which comes first: the order of [`Fused::source`](super::Fused::source).
    pub fn times(&self) -> Vec<f64> {
        self.exposures.iter().map(|exposure| exposure.time).collect()
    }

    /// Which of the pictures that were given each exposure is, from 1.
    pub(super) fn numbers(&self) -> Vec<usize> {
        self.exposures.iter().map(|exposure| exposure.number).collect()
    }
}

fn check_times(times: &[f64], pictures: usize) -> Result<()> {
    if times.len() != pictures {
        let expected = format!("{} pictures, one for each exposure time", times.len());
        return Err(Error::shape("bracket", expected, format!("{pictures}")));
    }
    for (index, &time) in times.iter().enumerate() {
        if !(time.is_finite() && time > 0.0) {
            return Err(Error::config("exposures", format!("must be positive times, found {time}")));
        }
        if times[..index].iter().any(|&other| (other / time - 1.0).abs() < 1e-6) {
            return Err(Error::config(
                "exposures",
                format!("must differ from each other, found {time} twice"),
            ));
        }
    }
    Ok(())
}

fn check_pictures(pictures: &[Array3<f32>]) -> Result<()> {
    let Some(first) = pictures.first() else {
        return Err(Error::shape("bracket", "at least one picture", "none"));
    };
    let (channels, height, width) = first.dim();
    if !matches!(channels, 1 | 3 | 4) || height == 0 || width == 0 {
        let found = format!("{channels} channels of {height} × {width}");
        return Err(Error::shape("bracket", "pictures of 1, 3 or 4 channels", found));
    }
    for (index, picture) in pictures.iter().enumerate() {
        let number = index + 1;
        if picture.dim() != (channels, height, width) {
            let (c, h, w) = picture.dim();
            return Err(Error::shape(
                format!("picture {number} of the bracket"),
                format!("{channels} channels of {height} × {width} like the first"),
                format!("{c} channels of {h} × {w}"),
            ));
        }
    }
    Ok(())
}

/// Writes a time as photographers do: 1/32.
pub fn show_time(time: f64) -> String {
    let inverse = 1.0 / time;
    if time < 1.0 && (inverse - inverse.round()).abs() < 1e-6 * inverse {
        format!("1/{}", inverse.round())
    } else {
        format!("{time}")
    }
}
