//! Turns a bracket of exposures into one linear image of high dynamic range.

use ndarray::{Array2, Array3, Axis, Zip};
use serde::{Deserialize, Serialize};

use crate::core::error::{Error, Result};
use crate::core::image::LinearImage;

use super::bayer::{BayerPattern, demosaic, greens_look_swapped, unpack};
use super::inpaint::inpaint;

/// How the exposures of a pixel become one value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MergeRule {
    /// The longest exposure that is not saturated, as in the paper.
    #[default]
    Longest,
    /// The mean of all exposures that are not saturated, weighted by their times.
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
}

impl Default for FuseConfig {
    fn default() -> Self {
        Self { white: 1.0, black: 0.0, saturation: 0.99, merge: MergeRule::Longest, bayer: None }
    }
}

impl FuseConfig {
    fn check(&self) -> Result<()> {
        if !(self.white.is_finite() && self.black.is_finite() && self.black < self.white) {
            let reason = format!("must lie above black {}, found {}", self.black, self.white);
            return Err(Error::config("white", reason));
        }
        if !(self.saturation > 0.0 && self.saturation <= 1.0) {
            let reason = format!("must be a share of white above 0 and up to 1, found {}", self.saturation);
            return Err(Error::config("saturation", reason));
        }
        Ok(())
    }
}

/// Pictures of one scene, equal but for the exposure time.
#[derive(Clone, Debug)]
pub struct Bracket {
    /// Longest first.
    exposures: Vec<Exposure>,
    valid: Option<Array2<bool>>,
}

#[derive(Clone, Debug)]
struct Exposure {
    /// Which of the pictures it was when given, from 1.
    number: usize,
    time: f64,
    planes: Array3<f32>,
}

/// The fewest exposures that span the range of a light source and of its flare.
const FEWEST_EXPOSURES: usize = 3;

impl Bracket {
    /// Puts pictures and exposure times together, in the same order; only the ratios of times matter.
    ///
    /// # Shapes
    /// Each `[channels, height, width]` with 3 channels (RGB), 1 (a mosaic) or 4 (a packed mosaic).
    ///
    /// # Errors
    /// [`Error::Shape`] for pictures of different sizes or another number than there are times, or fewer than
    /// three; [`Error::Config`] for times that are not positive or not distinct; [`Error::Unsupported`] for values
    /// that are not finite.
    pub fn new(pictures: Vec<Array3<f32>>, times: &[f64]) -> Result<Self> {
        check_times(times, pictures.len())?;
        check_pictures(&pictures)?;
        let mut exposures: Vec<Exposure> = pictures
            .into_iter()
            .zip(times)
            .enumerate()
            .map(|(index, (planes, &time))| Exposure { number: index + 1, time, planes })
            .collect();
        exposures.sort_by(|a, b| b.time.total_cmp(&a.time));
        Ok(Self { exposures, valid: None })
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

    /// The exposure times, longest first: the order of [`Fused::source`].
    pub fn times(&self) -> Vec<f64> {
        self.exposures.iter().map(|exposure| exposure.time).collect()
    }
}

fn check_times(times: &[f64], pictures: usize) -> Result<()> {
    if times.len() != pictures {
        let expected = format!("{} pictures, one for each exposure time", times.len());
        return Err(Error::shape("bracket", expected, format!("{pictures}")));
    }
    if pictures < FEWEST_EXPOSURES {
        let expected = format!("at least {FEWEST_EXPOSURES} exposures");
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
    let (channels, height, width) = pictures[0].dim();
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
        if let Some(((c, y, x), value)) = picture.indexed_iter().find(|(_, v)| !v.is_finite()) {
            return Err(Error::Unsupported(format!(
                "picture {number} of the bracket holds {value} at row {y}, column {x}, channel {c}; replace \
                 such pixels by numbers before fusing"
            )));
        }
    }
    Ok(())
}

/// A fused bracket, and where its values come from.
#[derive(Clone, Debug)]
pub struct Fused {
    /// Scene light in units of the value that saturates an exposure of time 1.
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
    /// How many pixels the mask discarded.
    pub discarded: usize,
    /// For each exposure but the longest: the brightness ratio to the next longer one as the pictures show it, where
    /// they have enough pixels in common, over the ratio of the times.
    pub ratio_found: Vec<Option<f64>>,
    /// Whether the declared Bayer pattern seems to have its greens on the wrong diagonal.
    pub greens_look_swapped: bool,
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
/// exposure with v < 0.99, t being its time. Where all are saturated the shortest is taken as it is, and
/// counted. Mosaics are merged before they are demosaiced, so that a saturated neighbour spoils nothing.
///
/// # Errors
/// [`Error::Config`] for levels out of range, exposure times that contradict the pictures, and mosaics without
/// pattern; [`Error::Shape`] for a pattern given with three channels.
///
/// # Panics
/// Never: a bracket has at least three exposures.
pub fn fuse(bracket: &Bracket, config: &FuseConfig) -> Result<Fused> {
    config.check()?;
    let frames = scaled_frames(bracket, config)?;
    check_black(&frames[0], config)?;
    check_order(bracket, &frames)?;
    let times = bracket.times();
    let saturation = config.saturation;

    let mut merged = Array3::<f32>::zeros(frames[0].dim());
    let mut source = Array3::<u8>::zeros(frames[0].dim());
    Zip::indexed(&mut merged).and(&mut source).par_for_each(|place, value, source| {
        let values = frames.iter().map(|frame| frame[place]);
        (*value, *source) = match config.merge {
            MergeRule::Longest => longest(values, &times, saturation),
            MergeRule::Weighted => weighted(values, &times, saturation),
        };
    });
    let is_good = |y, x| bracket.valid.as_ref().is_none_or(|valid| valid[[y, x]]);
    let shortest = frames.last().expect("a bracket has at least three exposures");
    let saturated = shortest
        .outer_iter()
        .map(|plane| {
            let full = |&((y, x), &v): &((usize, usize), &f32)| f64::from(v) >= saturation && is_good(y, x);
            plane.indexed_iter().filter(full).count()
        })
        .collect();
    if let Some(valid) = &bracket.valid {
        let step = if config.bayer.is_some() { 2 } else { 1 };
        merged.outer_iter_mut().for_each(|plane| inpaint(plane, valid, step));
    }
    let mosaic = config.bayer.map(|pattern| (merged.index_axis(Axis(0), 0), pattern));
    let greens_look_swapped = mosaic.is_some_and(|(mosaic, pattern)| greens_look_swapped(mosaic, pattern));
    let planes = match mosaic {
        Some((mosaic, pattern)) => demosaic(mosaic, pattern)?,
        None => merged,
    };
    Ok(Fused {
        image: LinearImage::from_planes(planes)?,
        source,
        saturated,
        discarded: bracket.valid.as_ref().map_or(0, |valid| valid.iter().filter(|v| !**v).count()),
        ratio_found: ratios_found(&frames, &times, saturation),
        greens_look_swapped,
    })
}

/// Brings the pictures to black = 0 and white = 1, mosaics to one plane.
fn scaled_frames(bracket: &Bracket, config: &FuseConfig) -> Result<Vec<Array3<f32>>> {
    let channels = bracket.exposures[0].planes.dim().0;
    match (channels, config.bayer) {
        (3, None) | (1 | 4, Some(_)) => {}
        (3, Some(_)) => {
            return Err(Error::shape("bracket with a Bayer pattern", "1 or 4 channels", "3 channels"));
        }
        _ => {
            let reason = format!("pictures of {channels} channels are mosaics; say rggb, bggr, grbg or gbrg");
            return Err(Error::config("bayer", reason));
        }
    }
    let scale = 1.0 / (config.white - config.black);
    #[expect(clippy::cast_possible_truncation, reason = "pictures are kept in 32 bit")]
    let scaled = |value: f32| ((f64::from(value) - config.black) * scale) as f32;
    let frame = |exposure: &Exposure| {
        let mut planes = if channels == 4 { unpack(exposure.planes.view()) } else { exposure.planes.clone() };
        planes.par_mapv_inplace(scaled);
        planes
    };
    Ok(bracket.exposures.iter().map(frame).collect())
}

/// Refuses a black level that the longest exposure mostly stays below: noise alone puts only half there.
fn check_black(longest: &Array3<f32>, config: &FuseConfig) -> Result<()> {
    let below = longest.iter().filter(|v| **v < 0.0).count();
    if 4 * below > 3 * longest.len() {
        let percent = 100.0 * below as f64 / longest.len() as f64;
        let reason =
            format!("{} lies above {percent:.0} % of the longest exposure's values; lower it", config.black);
        return Err(Error::config("black", reason));
    }
    Ok(())
}

/// A difference, in shares of white, that no noise of a usable picture makes.
const CLEAR_DIFFERENCE: f32 = 0.02;

/// Refuses a shorter exposure that is brighter than a longer one.
fn check_order(bracket: &Bracket, frames: &[Array3<f32>]) -> Result<()> {
    for (pair, exposures) in frames.windows(2).zip(bracket.exposures.windows(2)) {
        let pixels = || pair[0].iter().zip(&pair[1]);
        let brighter = pixels().filter(|(long, short)| **short > **long + CLEAR_DIFFERENCE).count();
        let darker = pixels().filter(|(long, short)| **long > **short + CLEAR_DIFFERENCE).count();
        if brighter > darker {
            let (long, short) = (&exposures[0], &exposures[1]);
            return Err(Error::config(
                "exposures",
                format!(
                    "picture {} (exposure {}) is brighter than picture {} (exposure {}); give the times in the \
                     order of the files",
                    short.number,
                    show_time(short.time),
                    long.number,
                    show_time(long.time)
                ),
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

fn longest(values: impl Iterator<Item = f32>, times: &[f64], saturation: f64) -> (f32, u8) {
    let mut last = (0.0, 0);
    for ((index, value), time) in (0u8..).zip(values).zip(times) {
        last = (quotient(f64::from(value), *time), index);
        if f64::from(value) < saturation {
            break;
        }
    }
    last
}

fn weighted(values: impl Iterator<Item = f32>, times: &[f64], saturation: f64) -> (f32, u8) {
    let (mut light, mut time_sum, mut source) = (0.0, 0.0, None);
    let mut last = (0.0, 0);
    for ((index, value), &time) in (0u8..).zip(values).zip(times) {
        let value = f64::from(value);
        if value < saturation {
            light += value;
            time_sum += time;
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

/// Pixels in common from which on a brightness ratio is believed.
const ENOUGH_PIXELS: usize = 100;

/// Compares neighbouring exposures where the longer one is bright and neither is saturated.
fn ratios_found(frames: &[Array3<f32>], times: &[f64], saturation: f64) -> Vec<Option<f64>> {
    let compare = |pair: &[Array3<f32>], times: &[f64]| {
        let usable = |(long, short): &(&f32, &f32)| {
            **long > 0.5 && f64::from(**long) < saturation && f64::from(**short) < saturation
        };
        let (mut count, mut long_sum, mut short_sum) = (0, 0.0, 0.0);
        for (long, short) in pair[0].iter().zip(&pair[1]).filter(usable) {
            count += 1;
            long_sum += f64::from(*long);
            short_sum += f64::from(*short);
        }
        (count >= ENOUGH_PIXELS).then(|| short_sum / long_sum * times[0] / times[1])
    };
    frames.windows(2).zip(times.windows(2)).map(|(pair, times)| compare(pair, times)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMES: [f64; 3] = [1.0, 1.0 / 32.0, 1.0 / 768.0];

    fn scene() -> Array3<f32> {
        Array3::from_shape_fn((3, 20, 24), |(c, y, x)| 0.01 * 1.6f32.powi((x + c) as i32 - (y / 4) as i32))
    }

    fn expose(scene: &Array3<f32>, time: f64) -> Array3<f32> {
        scene.mapv(|v| (v * time as f32).min(1.0))
    }

    fn bracket(scene: &Array3<f32>) -> Bracket {
        Bracket::new(TIMES.iter().map(|t| expose(scene, *t)).collect(), &TIMES).unwrap()
    }

    #[test]
    fn takes_the_longest_exposure_that_is_not_saturated() {
        let scene = scene();
        let fused = fuse(&bracket(&scene), &FuseConfig::default()).unwrap();
        for (place, &value) in scene.indexed_iter() {
            let source = TIMES.iter().position(|t| f64::from(value * *t as f32) < 0.99).unwrap_or(2);
            assert_eq!(usize::from(fused.source[place]), source);
            assert!((fused.image.planes()[place] / value.min(768.0) - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn counts_what_is_saturated_everywhere() {
        let mut scene = scene();
        scene.fill(0.1);
        scene[[1, 3, 3]] = 5000.0;
        let fused = fuse(&bracket(&scene), &FuseConfig::default()).unwrap();
        assert_eq!(fused.saturated, [0, 1, 0]);
        assert!((fused.image.planes()[[1, 3, 3]] - 768.0).abs() < 1e-3);
    }

    #[test]
    fn the_order_of_the_pictures_does_not_matter_as_long_as_the_times_agree() {
        let scene = scene();
        let times = [TIMES[2], TIMES[0], TIMES[1]];
        let shuffled = Bracket::new(times.iter().map(|t| expose(&scene, *t)).collect(), &times).unwrap();
        let config = FuseConfig::default();
        assert_eq!(fuse(&shuffled, &config).unwrap().image, fuse(&bracket(&scene), &config).unwrap().image);
    }

    #[test]
    fn refuses_times_in_a_wrong_order() {
        let scene = scene();
        let wrong = [TIMES[1], TIMES[0], TIMES[2]];
        let bracket = Bracket::new(TIMES.iter().map(|t| expose(&scene, *t)).collect(), &wrong).unwrap();
        let message = fuse(&bracket, &FuseConfig::default()).unwrap_err().to_string();
        assert!(message.contains("picture 1 (exposure 1/32) is brighter than picture 2"), "{message}");
    }

    #[test]
    fn refuses_brackets_that_do_not_fit() {
        let picture = || Array3::zeros((3, 4, 4));
        let two = Bracket::new(vec![picture(), picture()], &[1.0, 0.5]).unwrap_err().to_string();
        assert!(two.contains("at least 3"), "{two}");
        let sizes = vec![picture(), Array3::zeros((3, 4, 5)), picture()];
        let sizes = Bracket::new(sizes, &TIMES).unwrap_err().to_string();
        assert!(sizes.contains("picture 2") && sizes.contains("4 × 5"), "{sizes}");
        assert!(Bracket::new(vec![picture(); 3], &[1.0, 0.5, 0.5]).is_err());
        assert!(Bracket::new(vec![picture(); 3], &[1.0, 0.5, 0.0]).is_err());
        assert!(Bracket::new(vec![picture(); 3], &[1.0, 0.5]).is_err());
        let grey = Bracket::new(vec![Array3::zeros((1, 4, 4)); 3], &TIMES).unwrap();
        assert!(fuse(&grey, &FuseConfig::default()).unwrap_err().to_string().starts_with("bayer"));
    }

    #[test]
    fn removes_black_and_scales_to_white() {
        let scene = scene();
        let raw = |t: &f64| expose(&scene, *t).mapv(|v| 64.0 + v * (1023.0 - 64.0));
        let bracket = Bracket::new(TIMES.iter().map(raw).collect(), &TIMES).unwrap();
        let config = FuseConfig { white: 1023.0, black: 64.0, ..FuseConfig::default() };
        let fused = fuse(&bracket, &config).unwrap();
        // The level of 64 leaves 1023·2⁻²⁴ of rounding on values of some 10⁻³ · 959.
        for (found, value) in fused.image.planes().iter().zip(&scene) {
            let expected = value.min(768.0);
            assert!((found / expected - 1.0).abs() < 1e-3, "{found} instead of {expected}");
        }
    }

    #[test]
    fn refuses_a_black_level_above_the_signal() {
        let config = FuseConfig { black: 0.3, ..FuseConfig::default() };
        let dim = Array3::from_elem((3, 9, 9), 0.2);
        assert!(fuse(&bracket(&dim), &config).unwrap_err().to_string().starts_with("black: 0.3"));
    }

    #[test]
    fn weighting_by_time_averages_all_usable_exposures() {
        let times = [1.0, 0.5, 0.25];
        let pictures = [0.5, 0.3, 0.1].map(|v| Array3::from_elem((3, 4, 4), v));
        let bracket = Bracket::new(pictures.to_vec(), &times).unwrap();
        let config = FuseConfig { merge: MergeRule::Weighted, ..FuseConfig::default() };
        let fused = fuse(&bracket, &config).unwrap();
        assert!((fused.image.planes()[[0, 0, 0]] - 0.9 / 1.75).abs() < 1e-6);
    }

    #[test]
    fn masked_pixels_are_filled_and_not_counted_as_saturated() {
        let mut scene = Array3::from_elem((3, 9, 9), 0.2);
        scene[[0, 4, 4]] = 1e6;
        let valid = Array2::from_shape_fn((9, 9), |place| place != (4, 4));
        let fused = fuse(&bracket(&scene).with_mask(valid).unwrap(), &FuseConfig::default()).unwrap();
        assert!((fused.image.planes()[[0, 4, 4]] - 0.2).abs() < 1e-6);
        assert_eq!((fused.saturated, fused.discarded), (vec![0, 0, 0], 1));
        assert!(bracket(&scene).with_mask(Array2::from_elem((9, 8), true)).is_err());
    }

    /// Times off by a quarter show in the pictures.
    #[test]
    fn compares_the_times_with_the_pictures() {
        let scene = Array3::from_shape_fn((3, 40, 40), |(_, y, _)| 0.1 + y as f32 / 4.0);
        let times = [1.0, 0.25, 0.05];
        let wrong = [1.0, 0.2, 0.05];
        let bracket = Bracket::new(times.iter().map(|t| expose(&scene, *t)).collect(), &wrong).unwrap();
        let found = fuse(&bracket, &FuseConfig::default()).unwrap().ratio_found;
        assert!((found[0].unwrap() - 1.25).abs() < 1e-4 && (found[1].unwrap() - 0.8).abs() < 1e-4);
    }

    #[test]
    fn a_mosaic_is_merged_before_it_is_demosaiced() {
        let pattern = BayerPattern::Grbg;
        let colour = [0.3, 20.0, 0.6];
        let mosaic = Array3::from_shape_fn((1, 12, 12), |(_, y, x)| colour[pattern.channel(y, x)]);
        let config = FuseConfig { bayer: Some(pattern), ..FuseConfig::default() };
        let fused = fuse(&bracket(&mosaic), &config).unwrap();
        let planes = fused.image.planes();
        let flat =
            (0..3).all(|c| planes.index_axis(Axis(0), c).iter().all(|v| (v / colour[c] - 1.0).abs() < 1e-4));
        assert!(flat);
        assert_eq!(fused.source.dim(), (1, 12, 12));
    }
}
