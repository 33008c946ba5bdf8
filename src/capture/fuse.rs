//! Turns a bracket of exposures into one linear image of high dynamic range.

use ndarray::{Array2, Array3, ArrayView2, Axis, Zip};
use serde::{Deserialize, Serialize};

use crate::core::error::{Error, Result};
use crate::core::image::LinearImage;
use crate::core::saturation::SATURATED_SHARE;

use super::alignment::{Motion, check_motion, motions};
use super::bayer::{BayerPattern, demosaic, demosaic_scene, greens_look_swapped};
use super::bracket::Bracket;
use super::cut_off::{CutOff, ceilings, cut_offs, end_below_white, end_far_below_white};
use super::exposure_times::{check_order, estimate_times, ratios_found};
use super::frames::{Frames, Uneven};
use super::inpaint::inpaint;
use super::lone::count_lone;
use super::pedestal::pedestal;
use super::point_source::core_share;

/// How the exposures of a pixel become one value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MergeRule {
    /// The longest exposure that is not saturated, as in the paper.
    #[default]
    Longest,
    /// The mean of all exposures that are not saturated, weighted by their times, and by how many pictures they have.
    ///
    /// # Equation
    /// Photon noise has a variance proportional to the signal: v/t has x/t, so that weights ∝ t are best and the
    /// mean is Σv / Σt.
    Weighted,
}

/// How a bracket is read and merged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct FuseConfig {
    /// The value that a full photosite reads.
    pub white: f64,
    /// The value that a dark photosite reads.
    pub black: f64,
    /// The share of white above black from which on a value counts as saturated.
    pub saturation: f64,
    /// How the exposures are combined.
    pub merge: MergeRule,
    /// The colours of the mosaic; none for images of three channels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bayer: Option<BayerPattern>,
    /// Whether the colours of a mosaic are interpolated in linear light, which keeps energy, as that of a point source is to be, or
    /// compressed, which keeps lamps from spoiling what is around them.
    pub demosaic_linear: bool,
    /// Gains of red, green and blue, applied before demosaicing.
    pub white_balance: [f64; 3],
    /// Whether the ratios of the exposure times are taken from the pictures instead.
    pub estimate_exposures: bool,
    /// Whether a mosaic alone whose values end below white, where its sensor was full, has its white there.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub finds_white: bool,
    /// The largest displacement between two exposures, in pixels; none allows any.
    pub max_motion_px: Option<f64>,
}

impl Default for FuseConfig {
    fn default() -> Self {
        Self {
            white: 1.0,
            black: 0.0,
            saturation: SATURATED_SHARE,
            merge: MergeRule::Longest,
            bayer: None,
            demosaic_linear: false,
            white_balance: [1.0; 3],
            estimate_exposures: false,
            finds_white: false,
            max_motion_px: Some(1.0),
        }
    }
}

impl FuseConfig {
    /// Checks levels, saturation and gains.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key that is out of range.
    pub fn check(&self) -> Result<()> {
        if !(self.white.is_finite() && self.black.is_finite() && self.black < self.white) {
            let reason = format!("must lie above black {}, found {}", self.black, self.white);
            return Err(Error::config("white", reason));
        }
        if !(self.saturation > 0.0 && self.saturation <= 1.0) {
            let reason = format!("must be a share of white above 0 and up to 1, found {}", self.saturation);
            return Err(Error::config("saturation", reason));
        }
        if self.white_balance.iter().any(|gain| !(gain.is_finite() && *gain > 0.0)) {
            let reason = format!("must be three positive gains, found {:?}", self.white_balance);
            return Err(Error::config("white-balance", reason));
        }
        Ok(())
    }
}

/// A fused bracket, and where its values come from.
#[derive(Clone, Debug)]
pub struct Fused {
    /// Scene light in units of the value that saturates the longest exposure.
    ///
    /// Noise around black may be negative.
    pub image: LinearImage,
    /// Which exposure, from 0 = longest, each value was taken of (the longest, where several were).
    ///
    /// # Shapes
    /// `[3, height, width]`, or `[1, height, width]` for a mosaic.
    pub source: Array3<u8>,
    /// For each plane of `source`, how many values were saturated in every exposure; they are at least as
    /// bright as stated.
    pub saturated: Vec<usize>,
    /// The irradiance of red, green and blue of a full photosite in the shortest exposure, after white balance: the
    /// white level, of which [`saturated_from`](crate::core::saturation::saturated_from) takes the saturated share.
    pub saturation: [f64; 3],
    /// How many pixels the mask discarded.
    pub discarded: usize,
    /// For each exposure but the longest: the brightness ratio to the next longer one as the pictures show it, where
    /// they have enough light in common, over the ratio of the [`times`](Self::times).
    pub ratio_found: Vec<Option<f64>>,
    /// For each exposure but the longest: its displacement against the next longer one.
    pub motion: Vec<Option<Motion>>,
    /// The exposure times that were used as shares of the longest, which comes first.
    pub times: Vec<f64>,
    /// Whether the declared Bayer pattern seems to have its greens on the wrong diagonal.
    pub greens_look_swapped: bool,
    /// Of a mosaic whose energy is kept, as that of a point source: the [share](super::point_source::core_share) of the light
    /// that one photosite of the core has.
    pub core_share: Option<f64>,
    /// How many pictures each exposure is the mean of.
    pub averaged: Vec<usize>,
    /// The pictures of one exposure time whose brightness differs by more than a tenth, or could not be compared.
    pub uneven: Vec<Uneven>,
    /// The exposures that end below the white that was told.
    pub cut_off: Vec<CutOff>,
    /// Where the values of a mosaic alone end, as a share of the white that was told, which that was taken for.
    pub white_found: Option<f64>,
    /// Where the values of a picture alone end far below the white that was told, as a share of it, as if cut off there.
    pub white_doubted: Option<f64>,
    /// What all exposures have alike whatever their time, as a share of white: a black level that was left in.
    pub pedestal: Option<f64>,
    /// How many pixels shine in the dark frames, where there were any; they are filled from their neighbours wherever
    /// they do in the dark frame of the exposure that their value was taken of.
    pub hot_pixels: Option<usize>,
    /// Of a point source without dark frames: how many values stand alone in one colour, as those of hot pixels do.
    pub looks_hot: usize,
}

impl Fused {
    /// The share of values taken from each exposure, longest first.
    pub fn shares(&self, exposures: usize) -> Vec<f64> {
        let mut counts = vec![0usize; exposures];
        self.source.iter().for_each(|&source| counts[usize::from(source)] += 1);
        counts.into_iter().map(|count| count as f64 / self.source.len() as f64).collect()
    }
}

/// Merges a bracket.
///
/// # Equation
/// With `v = (value − black) / (white − black)`, the irradiance of a pixel and channel is v/t of the longest
/// exposure with v < 0.99, t being its time as a share of the longest. Where all are saturated the shortest is taken as it is, and
/// counted. Pictures of one time are averaged first; where any of them is saturated, the mean counts as saturated. A dark frame is levelled like
/// its pictures and subtracted from them; v is compared with 0.99 before. Mosaics are merged before they are demosaiced, so that a saturated neighbour spoils nothing.
///
/// # Errors
/// [`Error::Config`] for levels out of range, exposure times that contradict the pictures, dark frames that saw light or
/// belong to other exposure times, and mosaics without pattern; [`Error::Shape`] for a pattern given with three
/// channels; [`Error::Unsupported`] when the camera moved, or a pixel that no mask discards holds no finite number.
///
/// # Panics
/// Never: a bracket has at least one exposure.
pub fn fuse(bracket: Bracket, config: &FuseConfig) -> Result<Fused> {
    config.check()?;
    let mut exposures = Frames::of(bracket, config)?;
    let numbers = exposures.first_numbers();
    let (mut times, mut frames) = (exposures.times.clone(), std::mem::take(&mut exposures.frames));
    let white_found = find_white(&mut frames, exposures.clipped.as_mut(), config);
    let (white_doubted, pedestal) = (end_far_below_white(&frames), pedestal(&frames, &times));
    check_order(&frames, &times, &numbers)?;
    let cut_off = cut_offs(&frames, &times, config.saturation);
    let ceilings = ceilings(&cut_off, frames.len(), config.saturation);
    let mut ratio_found = ratios_found(&frames, &times, &ceilings);
    if config.estimate_exposures {
        times = estimate_times(&times, &ratio_found)?;
        ratio_found = ratios_found(&frames, &times, &ceilings);
    }
    let motion = motions(&frames, &times, config.saturation)?;
    check_motion(&motion, numbers.windows(2).map(|pair| [pair[0], pair[1]]), config.max_motion_px)?;

    let (mut merged, source) = merge(&frames, &times, &exposures.counts(), config);
    if let Some(clipped) = &exposures.clipped {
        take_clipped(&mut merged, &source, [&frames[frames.len() - 1], clipped], &times, config.saturation);
    }
    let is_good = |place| exposures.is_good(source[place], place);
    let shortest = frames.last().expect("a bracket has at least one exposure");
    let saturated = count_saturated(shortest, config.saturation, is_good);
    drop(frames);
    balance(&mut merged, config);
    let valid = &exposures.valid;
    let step = if config.bayer.is_some() { 2 } else { 1 };
    if valid.is_some() || exposures.darks.is_some() {
        fill(&mut merged, is_good, step);
    }
    let is_unchecked = config.demosaic_linear && exposures.darks.is_none();
    let looks_hot = if is_unchecked { count_lone(&merged, step) } else { 0 };
    let mosaic = config.bayer.map(|pattern| (merged.index_axis(Axis(0), 0), pattern));
    let greens_look_swapped = mosaic.is_some_and(|(mosaic, pattern)| greens_look_swapped(mosaic, pattern));
    let core_share = mosaic.filter(|_| config.demosaic_linear).map(|(mosaic, _)| core_share(mosaic));
    let planes = match mosaic {
        Some((mosaic, pattern)) if config.demosaic_linear => demosaic(mosaic, pattern)?,
        Some((mosaic, pattern)) => demosaic_scene(mosaic, pattern)?,
        None => merged,
    };
    Ok(Fused {
        image: LinearImage::from_planes(planes)?,
        source,
        saturated,
        saturation: config.white_balance.map(|gain| gain * (1.0 / times[times.len() - 1])),
        discarded: valid.as_ref().map_or(0, |valid| valid.iter().filter(|v| !**v).count()),
        ratio_found,
        motion,
        times,
        greens_look_swapped,
        core_share,
        averaged: exposures.counts(),
        uneven: exposures.uneven,
        cut_off,
        white_found,
        white_doubted,
        pedestal,
        hot_pixels: exposures.darks.map(|darks| darks.hot_pixels()),
        looks_hot,
    })
}

/// Fills the values that are not good from their neighbours of the same colour, `step` pixels apart.
fn fill(merged: &mut Array3<f32>, is_good: impl Fn((usize, usize, usize)) -> bool, step: usize) {
    for (channel, plane) in merged.outer_iter_mut().enumerate() {
        let good = Array2::from_shape_fn(plane.dim(), |(y, x)| is_good((channel, y, x)));
        inpaint(plane, &good, step);
    }
}

/// Takes what a mosaic alone ends at below white for white, if it does.
fn find_white(
    frames: &mut [Array3<f32>],
    clipped: Option<&mut Array3<f32>>,
    config: &FuseConfig,
) -> Option<f64> {
    let [mosaic] = frames else { return None };
    let looks = config.finds_white && config.bayer.is_some();
    let found = looks.then(|| end_below_white(mosaic, config.saturation)).flatten()?;
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    let white = found as f32;
    [Some(mosaic), clipped].into_iter().flatten().for_each(|values| values.mapv_inplace(|v| v / white));
    Some(found)
}

/// For each plane of the shortest exposure, how many of the good values are saturated.
fn count_saturated(
    shortest: &Array3<f32>,
    saturation: f64,
    is_good: impl Fn((usize, usize, usize)) -> bool,
) -> Vec<usize> {
    let full = |channel: usize, plane: ArrayView2<'_, f32>| {
        let is_full =
            |&((y, x), &v): &((usize, usize), &f32)| f64::from(v) >= saturation && is_good((channel, y, x));
        plane.indexed_iter().filter(is_full).count()
    };
    shortest.outer_iter().enumerate().map(|(channel, plane)| full(channel, plane)).collect()
}

/// The merged values, and which exposure each was taken of.
fn merge(
    frames: &[Array3<f32>],
    times: &[f64],
    counts: &[usize],
    config: &FuseConfig,
) -> (Array3<f32>, Array3<u8>) {
    let mut merged = Array3::<f32>::zeros(frames[0].dim());
    let mut source = Array3::<u8>::zeros(frames[0].dim());
    Zip::indexed(&mut merged).and(&mut source).par_for_each(|place, value, source| {
        let values = frames.iter().map(|frame| frame[place]);
        (*value, *source) = match config.merge {
            MergeRule::Longest => longest(values, times, config.saturation),
            MergeRule::Weighted => weighted(values.zip(counts), times, config.saturation),
        };
    });
    (merged, source)
}

/// Where all exposures are saturated, takes the mean of the shortest one's pictures as it is.
fn take_clipped(
    merged: &mut Array3<f32>,
    source: &Array3<u8>,
    [shortest, clipped]: [&Array3<f32>; 2],
    times: &[f64],
    saturation: f64,
) {
    let last = times.len() - 1;
    Zip::from(merged).and(source).and(shortest).and(clipped).par_for_each(|value, &source, &frame, &mean| {
        if usize::from(source) == last && f64::from(frame) >= saturation {
            *value = quotient(f64::from(mean), times[last]);
        }
    });
}

/// Applies the gains of the white balance to planes or to a mosaic.
fn balance(merged: &mut Array3<f32>, config: &FuseConfig) {
    if config.white_balance.iter().all(|gain| (gain - 1.0).abs() < f64::EPSILON) {
        return;
    }
    #[expect(clippy::cast_possible_truncation, reason = "images are kept in 32 bit")]
    let gains = config.white_balance.map(|gain| gain as f32);
    Zip::indexed(merged).par_for_each(|(plane, y, x), value| {
        *value *= gains[config.bayer.map_or(plane, |pattern| pattern.channel(y, x))];
    });
}

fn longest(values: impl Iterator<Item = f32>, times: &[f64], saturation: f64) -> (f32, u8) {
    let mut last = (0.0, 0);
    for ((index, value), time) in (0..=u8::MAX).zip(values).zip(times) {
        last = (quotient(f64::from(value), *time), index);
        if f64::from(value) < saturation {
            break;
        }
    }
    last
}

/// Each value is the mean of so many pictures.
fn weighted<'a>(values: impl Iterator<Item = (f32, &'a usize)>, times: &[f64], saturation: f64) -> (f32, u8) {
    let (mut light, mut time_sum, mut source) = (0.0, 0.0, None);
    let mut last = (0.0, 0);
    for ((index, (value, &count)), &time) in (0..=u8::MAX).zip(values).zip(times) {
        let (value, count) = (f64::from(value), count as f64);
        if value < saturation {
            light += count * value;
            time_sum += count * time;
            source = source.or(Some(index));
        }
        last = (quotient(value, time), index);
    }
    source.map_or(last, |source| (quotient(light, time_sum), source))
}

#[expect(clippy::cast_possible_truncation, reason = "images are kept in 32 bit")]
fn quotient(value: f64, time: f64) -> f32 {
    (value / time) as f32
}

#[cfg(test)]
mod tests;
