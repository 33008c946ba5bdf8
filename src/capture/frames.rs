//! Turns the pictures of a bracket into one frame of each exposure time: levelled, dark frames subtracted, averaged.

use ndarray::{Array2, Array3, Zip};

use super::alignment::{check_motion, motions_within};
use super::bracket::Bracket;
use super::brightness::brightness_ratio;
use super::darks::Darks;
use super::fuse::FuseConfig;
use super::scaling::{check_black, check_finite, scaled_frames};
use crate::core::error::Result;

/// Pictures of one exposure time that are not equally bright, or that nobody knows to be.
#[derive(Clone, Debug, PartialEq)]
pub struct Uneven {
    /// Their places among the pictures that were given, from 1.
    pub pictures: [usize; 2],
    /// The brightness of the second over that of the first; none where both hold too little light to tell.
    pub ratio: Option<f64>,
}

/// A larger difference of brightness, as a share, is no flicker.
const UNEVEN: f64 = 0.1;

/// The exposures of a bracket, ready to be merged.
pub(super) struct Frames {
    /// One of each exposure time, longest first; at least 1 where any of its pictures is saturated.
    pub(super) frames: Vec<Array3<f32>>,
    /// The mean of the shortest exposure as it is where some of its pictures are saturated: at most as bright as the light.
    pub(super) clipped: Option<Array3<f32>>,
    /// The exposure times.
    pub(super) times: Vec<f64>,
    /// The places of the pictures that were averaged, from 1.
    pub(super) numbers: Vec<Vec<usize>>,
    /// The pixels that are good, where a mask says so.
    pub(super) valid: Option<Array2<bool>>,
    pub(super) darks: Option<Darks>,
    pub(super) uneven: Vec<Uneven>,
}

impl Frames {
    /// Levels, calibrates and averages the pictures.
    pub(super) fn of(bracket: Bracket, config: &FuseConfig) -> Result<Self> {
        let (numbers, times) = (bracket.numbers(), bracket.times());
        let Bracket { exposures, valid, darks, .. } = bracket;
        let pictures = exposures.into_iter().flat_map(|exposure| exposure.pictures).collect();
        let mut pictures = scaled_frames(pictures, config)?;
        check_finite(&mut pictures, valid.as_ref(), &numbers.concat())?;
        check_black(&pictures, config)?;
        let darks = darks.map(|darks| Darks::of(darks, &times, valid.as_ref(), config)).transpose()?;
        let mut pictures = pictures.into_iter();
        let (mut frames, mut uneven) = (Vec::with_capacity(times.len()), Vec::new());
        let mut clipped = None;
        for (exposure, numbers) in numbers.iter().enumerate() {
            let mut group: Vec<Array3<f32>> = pictures.by_ref().take(numbers.len()).collect();
            if let Some(darks) = &darks {
                darks.subtract(&mut group, exposure, numbers, config.saturation)?;
            }
            let motions = motions_within(&group, config.saturation)?;
            let pairs = numbers[1..].iter().map(|&number| [numbers[0], number]);
            check_motion(&motions, pairs, config.max_motion_px)?;
            uneven.extend(unequal(&group, numbers, config.saturation));
            let (frame, mean) = average(group, config.saturation);
            frames.push(frame);
            clipped = mean;
        }
        Ok(Self { frames, clipped, times, numbers, valid, darks, uneven })
    }

    /// The first picture of each exposure.
    pub(super) fn first_numbers(&self) -> Vec<usize> {
        self.numbers.iter().map(|numbers| numbers[0]).collect()
    }

    /// How many pictures each exposure has.
    pub(super) fn counts(&self) -> Vec<usize> {
        self.numbers.iter().map(Vec::len).collect()
    }

    /// Whether a value that was taken of an exposure was measured, not to be filled from its neighbours.
    pub(super) fn is_good(&self, exposure: u8, place @ (_, y, x): (usize, usize, usize)) -> bool {
        let is_hot = self.darks.as_ref().is_some_and(|darks| darks.is_hot(usize::from(exposure), place));
        !is_hot && self.valid.as_ref().is_none_or(|valid| valid[[y, x]])
    }
}

/// The pictures of one time that are not as bright as the first, or too dark to be compared with it.
fn unequal(group: &[Array3<f32>], numbers: &[usize], saturation: f64) -> Vec<Uneven> {
    let compare = |(picture, &number): (&Array3<f32>, &usize)| {
        let ratio = brightness_ratio([&group[0], picture], [saturation; 2]);
        let is_even = ratio.is_some_and(|ratio| (ratio - 1.0).abs() <= UNEVEN);
        (!is_even).then_some(Uneven { pictures: [numbers[0], number], ratio })
    };
    group.iter().zip(numbers).skip(1).filter_map(compare).collect()
}

/// The mean of pictures, at least 1 where any of them is saturated; and the mean as it is, where there are several.
///
/// The mean of those that happen to be unsaturated would be one of low noise alone: too dark near white, and the more so the
/// more pictures there are.
fn average(mut group: Vec<Array3<f32>>, saturation: f64) -> (Array3<f32>, Option<Array3<f32>>) {
    if group.len() == 1 {
        return (group.remove(0), None);
    }
    let mut mean = Array3::<f32>::zeros(group[0].dim());
    let mut frame = mean.clone();
    Zip::indexed(&mut mean).and(&mut frame).par_for_each(|place, mean, value| {
        let values = || group.iter().map(|picture| f64::from(picture[place]));
        #[expect(clippy::cast_possible_truncation, reason = "a mean of 32-bit values")]
        let of_all = (values().sum::<f64>() / group.len() as f64) as f32;
        *mean = of_all;
        *value = if values().any(|value| value >= saturation) { of_all.max(1.0) } else { of_all };
    });
    (frame, Some(mean))
}
