//! Puts pictures of one scene, their exposure times and dark frames together.

use ndarray::{Array2, Array3};

use super::darks::DarkFrames;
use super::exposure_times::{self, SAME_TIME, relative_times};
use crate::core::error::{Error, Result};

/// Pictures of one scene, equal but for the exposure time.
#[derive(Clone, Debug)]
pub struct Bracket {
    /// Longest first.
    pub(super) exposures: Vec<Exposure>,
    /// The pixels that are good, where a mask says so.
    pub(super) valid: Option<Array2<bool>>,
    /// What the sensor reads without light.
    pub(super) darks: Option<DarkFrames>,
    /// The longest time as it was given, by which others are divided.
    longest: f64,
}

/// The pictures of one exposure time.
#[derive(Clone, Debug)]
pub(super) struct Exposure {
    /// Which of the pictures these were when given, from 1.
    pub(super) numbers: Vec<usize>,
    /// Relative to the longest.
    pub(super) time: f64,
    pub(super) pictures: Vec<Array3<f32>>,
}

/// As many exposures as [`Fused::source`](super::Fused::source) can tell apart.
const MOST_EXPOSURES: usize = 256;

impl Bracket {
    /// Puts pictures and exposure times together, in the same order.
    ///
    /// Only the ratios of the times matter, whatever their unit: the longest becomes 1, so that irradiance 1 is its white.
    /// Pictures of one time, within a hundredth ([`SAME_TIME`]), are averaged; the longest of their times
    /// stands for them.
    ///
    /// # Shapes
    /// Each `[channels, height, width]` with 3 channels (RGB), 1 (a mosaic) or 4 (a packed mosaic).
    ///
    /// # Errors
    /// [`Error::Shape`] for pictures of different sizes or another number than there are times, or none;
    /// [`Error::Config`] for times that are not positive, or further apart than 10⁹, or more than 256 different ones.
    pub fn new(pictures: Vec<Array3<f32>>, times: &[f64]) -> Result<Self> {
        check_times(times, pictures.len())?;
        check_pictures(&pictures)?;
        let mut numbered: Vec<_> = (1..).zip(relative_times(times)).zip(pictures).collect();
        numbered.sort_by(|((_, a), _), ((_, b), _)| b.total_cmp(a));
        let mut exposures: Vec<Exposure> = Vec::new();
        for ((number, time), picture) in numbered {
            match exposures.last_mut().filter(|last| time >= last.time * (1.0 - SAME_TIME)) {
                Some(last) => {
                    last.numbers.push(number);
                    last.pictures.push(picture);
                }
                None => exposures.push(Exposure { numbers: vec![number], time, pictures: vec![picture] }),
            }
        }
        if exposures.len() > MOST_EXPOSURES {
            let reason = format!("may be {MOST_EXPOSURES} different times, found {}", exposures.len());
            return Err(Error::config("exposures", reason));
        }
        let longest = times.iter().copied().fold(0.0, f64::max);
        Ok(Self { exposures, valid: None, darks: None, longest })
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
        let (channels, height, width) = self.exposures[0].pictures[0].dim();
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

    /// Adds pictures that were taken without light, to be subtracted; pixels that shine in them are filled from their
    /// neighbours after merging.
    ///
    /// With `times`, in the order of the frames and the unit of the pictures' times, each exposure takes the mean of the
    /// frames of its time. Without, all frames are averaged, and taken off every exposure.
    ///
    /// # Errors
    /// [`Error::Shape`] for frames of another size than the pictures, another number than there are times, or none;
    /// [`Error::Config`] for times that are not positive.
    pub fn with_darks(mut self, frames: Vec<Array3<f32>>, times: Option<&[f64]>) -> Result<Self> {
        let times = times.map(|times| times.iter().map(|time| time / self.longest).collect());
        self.darks = Some(DarkFrames::new(frames, times, self.exposures[0].pictures[0].dim())?);
        Ok(self)
    }

    /// The exposure times as shares of the longest, which comes first: the order of [`Fused::source`](super::Fused::source).
    pub fn times(&self) -> Vec<f64> {
        self.exposures.iter().map(|exposure| exposure.time).collect()
    }

    /// Which of the pictures that were given each exposure has, from 1.
    pub(super) fn numbers(&self) -> Vec<Vec<usize>> {
        self.exposures.iter().map(|exposure| exposure.numbers.clone()).collect()
    }
}

fn check_times(times: &[f64], pictures: usize) -> Result<()> {
    if times.len() != pictures {
        let expected = format!("{} pictures, one for each exposure time", times.len());
        return Err(Error::shape("bracket", expected, format!("{pictures}")));
    }
    exposure_times::check_times(times)
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
