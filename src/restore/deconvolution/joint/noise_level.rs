//! Estimates from a capture how noisy its light is, dark and bright.

use std::ops::Range;

use ndarray::{Array2, ArrayView2, s};
use rayon::prelude::*;

use super::super::noise::{BANDS, Detail, MEDIAN_OF_NORMAL, of_details};
use crate::core::image::row_of;
use crate::kernels::vectorised;

/// Classes of brightness, each of as many pixels: photon and read noise change over stops, not within one.
const CLASSES: usize = 6;

/// Pixels that a class needs for its noise to be told from its detail: the median of so many is known to 6 %.
const LEAST_PIXELS: usize = 400;

/// Pixels that noise is estimated from: the median of a class of so many is known to a percent.
const MOST_PIXELS: usize = 1 << 19;

/// Rows of a strip: more than twice the taps of the widest band.
const STRIP_ROWS: usize = 16;

/// Standard deviation below which a capture counts as free of noise: 80 dB below one half of φ.
const LEAST: f32 = 1e-4;

/// Noise below which a capture is a computed one: 70 dB, half a step of 12 bits.
pub(crate) const NOISE_FREE: f32 = 3e-4;

/// The standard deviation of the noise of `log(y + α)` by the capture's brightness.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NoiseLevel {
    /// `ln(y + α)` and the deviation there, from dark to bright.
    knots: Vec<(f32, f32)>,
    /// That of all pixels as one class.
    overall: f32,
}

impl NoiseLevel {
    /// Estimates the noise of one channel, as [`of_details`] does in each class of brightness; `left` are the parts of the
    /// scene's detail that the PSF leaves in each band.
    pub(crate) fn estimate(
        capture: ArrayView2<'_, f32>,
        (alpha, saturated_from): (f32, f32),
        left: [f64; 3],
    ) -> Self {
        let strips = logarithms(capture, alpha);
        let limits = limits_of_classes(&strips, saturated_from);
        let of_bands = BANDS.par_iter().map(|band| {
            let mut classes = vec![Vec::new(); limits.len()];
            for (strip, logarithm) in &strips {
                band.visit(logarithm, |(y, x), details| {
                    let pixels = row_of(*strip, y)[x..].iter().zip(&row_of(logarithm.view(), y)[x..]);
                    for (detail, (captured, level)) in details.iter().zip(pixels) {
                        if *captured < saturated_from {
                            let class = limits.iter().filter(|(_, most)| most < level).count();
                            classes[class.min(limits.len() - 1)].push(detail.abs());
                        }
                    }
                });
            }
            classes
        });
        let mut of_bands: Vec<Vec<Vec<f32>>> = of_bands.collect();
        let is_told: Vec<bool> = of_bands[0].iter().map(|details| details.len() >= LEAST_PIXELS).collect();
        let deviations = of_bands.par_iter_mut().map(|classes| {
            let told = classes.iter_mut().zip(&is_told).filter(|(_, is_told)| **is_told);
            let told: Vec<&mut Vec<f32>> = told.map(|(details, _)| details).collect();
            let mut all: Vec<f32> = told.iter().flat_map(|details| details.iter()).copied().collect();
            (variance_of(&mut all), told.into_iter().map(|details| variance_of(details)).collect::<Vec<_>>())
        });
        let variances: Vec<(f64, Vec<f64>)> = deviations.collect();
        let overall = deviation(std::array::from_fn(|band| variances[band].0), left);
        let middles = limits.iter().zip(&is_told).filter(|(_, is_told)| **is_told);
        let of_class = |class: usize| deviation(std::array::from_fn(|band| variances[band].1[class]), left);
        let mut knots: Vec<_> =
            middles.enumerate().map(|(class, ((middle, _), _))| (*middle, of_class(class))).collect();
        if knots.is_empty() {
            knots.push((0.0, LEAST));
        }
        Self { knots: steadied(knots), overall }
    }

    /// The same deviation at any brightness.
    pub(crate) fn even(deviation: f32) -> Self {
        Self { knots: vec![(0.0, deviation)], overall: deviation }
    }

    /// Whether most channels of a capture show no noise, each by itself.
    pub(crate) fn hide(channels: &[Self]) -> bool {
        let hiding = channels.iter().filter(|channel| channel.overall <= NOISE_FREE).count();
        2 * hiding > channels.len()
    }

    /// Lets the channels of a capture agree whether there is noise: one sensor took them all, and detail passes for noise in one of them,
    /// as does noise for detail.
    ///
    /// There is some where all pixels of most channels show it together, and none where those of no channel do; where those of one alone
    /// do, channels are left as they are. A channel that shows none is given its own of all pixels, or as much as another has at least.
    pub(crate) fn agree(channels: &mut [Self]) {
        let noise = channels.iter().map(|channel| channel.overall).filter(|noise| *noise > NOISE_FREE);
        let noise: Vec<f32> = noise.collect();
        for channel in channels {
            let noise = match noise[..] {
                [] => LEAST,
                [_] => continue,
                _ if channel.middle() > NOISE_FREE => continue,
                _ if channel.overall > NOISE_FREE => channel.overall,
                ref others => others.iter().copied().fold(f32::INFINITY, f32::min),
            };
            *channel = Self::even(noise);
        }
    }

    /// The noise of one channel where the standard deviation of its light is known, at the brightness that the capture has.
    pub(crate) fn told(
        capture: ArrayView2<'_, f32>,
        (alpha, saturated_from): (f32, f32),
        deviation: impl Fn(f32) -> f32,
    ) -> Self {
        let of_class = |(middle, _): (f32, f32)| {
            let brightness = middle.exp();
            (middle, (deviation((brightness - alpha).max(0.0)) / brightness).max(LEAST))
        };
        let limits = limits_of_classes(&logarithms(capture, alpha), saturated_from);
        let knots: Vec<_> = limits.into_iter().map(of_class).collect();
        Self { overall: knots[knots.len() / 2].1, knots }
    }

    /// At each brightness the larger one of two deviations.
    pub(crate) fn or_more(self, other: &Self) -> Self {
        let knots = self.knots.into_iter().map(|(level, noise)| (level, noise.max(other.at(level.exp()))));
        Self { knots: knots.collect(), overall: self.overall.max(other.overall) }
    }

    /// The deviation at a brightness, `y + α`.
    pub(crate) fn at(&self, brightness: f32) -> f32 {
        let level = brightness.ln();
        let after = self.knots.partition_point(|(knot, _)| *knot < level);
        match (after.checked_sub(1).map(|before| self.knots[before]), self.knots.get(after)) {
            (Some((from, low)), Some((to, high))) => {
                low + (high - low) * (level - from) / (to - from).max(f32::MIN_POSITIVE)
            }
            (Some((_, value)), None) | (None, Some(&(_, value))) => value,
            (None, None) => LEAST,
        }
    }

    /// Replaces the brightness of pixels, `y + α`, by the standard deviation of their light, as [`at`](Self::at) tells it to 10⁻⁶; zero
    /// stays.
    pub(crate) fn replace_by_deviations(&self, brightness: &mut [f32]) {
        let ramp = |pair: &[(f32, f32)]| {
            let [(from, low), (to, high)] = [pair[0], pair[1]];
            let length = (to - from).max(SHORTEST_RAMP);
            Ramp { from, length, slope: (high - low) / length }
        };
        let ramps: Vec<Ramp> = self.knots.windows(2).map(ramp).collect();
        times_ramps(brightness, self.knots[0].1, &ramps);
    }

    /// The deviation of the middle class.
    pub(crate) fn middle(&self) -> f32 {
        self.knots[self.knots.len() / 2].1
    }
}

/// The length of a ramp between two knots at one brightness, as of a capture of which much is flat: a step.
const SHORTEST_RAMP: f32 = 1e-5;

/// How a deviation changes from one knot to the next.
#[derive(Clone, Copy)]
struct Ramp {
    from: f32,
    length: f32,
    slope: f32,
}

vectorised! {
    /// Multiplies each brightness by the deviation there: the first knot's, and what all ramps below add to it.
    fn times_ramps<'a>(brightness: &'a mut [f32], first: f32, ramps: &'a [Ramp]) -> () {
        const LANES: usize = 16;
        for values in brightness.chunks_mut(LANES) {
            let mut levels = [0.0; LANES];
            levels.iter_mut().zip(&*values).for_each(|(level, n)| *level = logarithm(*n));
            let mut deviations = [first; LANES];
            for ramp in ramps {
                for (deviation, level) in deviations.iter_mut().zip(&levels) {
                    *deviation += ramp.slope * (level - ramp.from).max(0.0).min(ramp.length);
                }
            }
            values.iter_mut().zip(&deviations).for_each(|(n, deviation)| *n *= deviation);
        }
    }
}

/// The natural logarithm of a positive number, to 2·10⁻⁷; a large negative one of zero.
///
/// # Equation
/// With `x = 2ᵉ·m`, m from √½ to √2: `ln x = e·ln 2 + 2·artanh(z)`, `z = (m − 1)/(m + 1)`, of whose series five terms tell 10⁻⁸.
#[inline(always)]
fn logarithm(x: f32) -> f32 {
    const ROOT_OF_HALF: i32 = std::f32::consts::FRAC_1_SQRT_2.to_bits().cast_signed();
    const MANTISSA_BITS: u32 = 23;
    let bits = x.to_bits().cast_signed();
    let exponent = (bits - ROOT_OF_HALF) >> MANTISSA_BITS;
    let mantissa = f32::from_bits((bits - (exponent << MANTISSA_BITS)).cast_unsigned());
    let z = (mantissa - 1.0) / (mantissa + 1.0);
    let square = z * z;
    let series = 1.0 + square * (1.0 / 3.0 + square * (0.2 + square * (1.0 / 7.0 + square / 9.0)));
    #[expect(clippy::cast_precision_loss, reason = "exponents are small")]
    let exponent = exponent as f32;
    exponent * std::f32::consts::LN_2 + 2.0 * z * series
}

/// The deviation of the noise of pixels whose details have these variances in each band.
fn deviation(variances: [f64; 3], left: [f64; 3]) -> f32 {
    let details = std::array::from_fn(|band| Detail { variance: variances[band], left: left[band] });
    narrow(of_details(details)).max(LEAST)
}

/// The strips that noise is estimated from, with `ln(y + α)`.
fn logarithms(capture: ArrayView2<'_, f32>, alpha: f32) -> Vec<(ArrayView2<'_, f32>, Array2<f32>)> {
    strips(capture.dim(), MOST_PIXELS)
        .into_iter()
        .map(|rows| capture.slice_move(s![rows, ..]))
        .map(|strip| (strip, strip.mapv(|y| (y.max(0.0) + alpha).ln())))
        .collect()
}

/// The rows that detail is looked at in: all, or strips over the whole height with so many pixels at most.
pub(super) fn strips((height, width): (usize, usize), most: usize) -> Vec<Range<usize>> {
    let count = (most / (STRIP_ROWS * width)).max(1);
    if height * width <= most || count * STRIP_ROWS >= height {
        return std::iter::once(0..height).collect();
    }
    let strip = |index: usize| (2 * index + 1) * (height - STRIP_ROWS) / (2 * count);
    (0..count).map(strip).map(|first| first..first + STRIP_ROWS).collect()
}

/// The middle and the upper end of each class of what is not saturated.
fn limits_of_classes(strips: &[(ArrayView2<'_, f32>, Array2<f32>)], saturated_from: f32) -> Vec<(f32, f32)> {
    let mut levels: Vec<f32> = strips
        .iter()
        .flat_map(|(strip, logarithm)| strip.iter().zip(logarithm))
        .filter(|(y, _)| **y < saturated_from)
        .map(|(_, level)| *level)
        .collect();
    if levels.is_empty() {
        return vec![(0.0, f32::MAX)];
    }
    let parts: Vec<usize> = (0..=2 * CLASSES).map(|part| (levels.len() - 1) * part / (2 * CLASSES)).collect();
    put_in_place(&mut levels, &parts, 0);
    let at = |part: usize| levels[parts[part]];
    (0..CLASSES).map(|class| (at(2 * class + 1), at(2 * class + 2))).collect()
}

/// Orders values as far as those at these places, in ascending order, are what they were if all were ordered; the values begin at the
/// place `first`.
fn put_in_place(values: &mut [f32], places: &[usize], first: usize) {
    let middle = places.len() / 2;
    let Some(place) = places.get(middle) else { return };
    let (below, _, above) = values.select_nth_unstable_by(place - first, f32::total_cmp);
    // Of few values several places are one.
    let lower = &places[..places.partition_point(|lower| lower < place)];
    let upper = &places[places.partition_point(|upper| upper <= place)..];
    rayon::join(|| put_in_place(below, lower, first), || put_in_place(above, upper, place + 1));
}

/// Replaces each deviation by the median of it and its neighbours: one class of mere texture is no noise.
fn steadied(knots: Vec<(f32, f32)>) -> Vec<(f32, f32)> {
    let last = knots.len() - 1;
    let around = |i: usize| {
        let mut near = [knots[i.saturating_sub(1)].1, knots[i].1, knots[(i + 1).min(last)].1];
        near.sort_unstable_by(f32::total_cmp);
        near[1]
    };
    (0..knots.len()).map(|i| (knots[i].0, around(i))).collect()
}

/// The robust variance of detail of which these are the moduli; zero of none.
pub(super) fn variance_of(moduli: &mut [f32]) -> f64 {
    median(moduli).map_or(0.0, |median| (f64::from(median) / MEDIAN_OF_NORMAL).powi(2))
}

pub(super) fn median(values: &mut [f32]) -> Option<f32> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng;
    use rand_distr::{Distribution, StandardNormal};

    const ALPHA: f32 = 0.25;

    /// A ramp of brightness with noise of y + α that grows with it.
    fn capture((height, width): (usize, usize), [dark, bright]: [f32; 2]) -> Array2<f32> {
        let mut rng = rng::stream(3, "noise level");
        Array2::from_shape_fn((height, width), |(_, x)| {
            let part = x as f32 / width as f32;
            let normal: f32 = StandardNormal.sample(&mut rng);
            let sigma = dark + (bright - dark) * part;
            (0.1 + 4.0 * part + ALPHA) * (sigma * normal).exp() - ALPHA
        })
    }

    fn estimate(capture: &Array2<f32>) -> NoiseLevel {
        NoiseLevel::estimate(capture.view(), (ALPHA, 16.0), [0.01, 0.03, 0.1])
    }

    /// Classes of 4000 pixels, and of every sixteenth row of a large frame, tell their median to some percent.
    #[test]
    fn finds_the_noise_of_dark_and_bright_light() {
        for size in [(150, 160), (1024, 1024)] {
            let noise = estimate(&capture(size, [0.02, 0.05]));
            for (part, expected) in [(0.1, 0.023), (0.5, 0.035), (0.9, 0.047)] {
                let found = noise.at(0.1 + 4.0 * part + ALPHA);
                assert!((found / expected - 1.0).abs() < 0.15, "{size:?} at {part}: {found} of {expected}");
            }
        }
    }

    #[test]
    fn many_deviations_are_those_of_each() {
        let knots = vec![(-3.0, 0.02), (-1.5, 0.05), (0.5, 0.01), (2.0, 0.03)];
        for noise in [NoiseLevel { knots, overall: 0.02 }, NoiseLevel::even(0.013)] {
            let brightness: Vec<f32> = (0..400).map(|index| 1e-3 * 1.035f32.powi(index)).collect();
            let mut deviations = [&brightness[..], &[0.0]].concat();
            noise.replace_by_deviations(&mut deviations);
            assert_eq!(deviations.pop(), Some(0.0));
            for (n, found) in brightness.iter().zip(deviations) {
                assert!((found / (n * noise.at(*n)) - 1.0).abs() < 2e-6, "{n}: {found} {}", n * noise.at(*n));
            }
        }
    }

    /// Two classes whose middle pixels are one flat area.
    #[test]
    fn deviations_step_where_knots_are_at_one_brightness() {
        let noise = NoiseLevel { knots: vec![(-2.0, 0.02), (-1.0, 0.03), (-1.0, 0.05)], overall: 0.03 };
        let mut deviations = [0.3, 0.36, 0.37, 0.38, 1.0];
        let expected = deviations.map(|n| n * noise.at(n));
        noise.replace_by_deviations(&mut deviations);
        for (found, expected) in deviations.into_iter().zip(expected) {
            assert!((found / expected - 1.0f32).abs() < 2e-6, "{found} {expected}");
        }
    }

    /// Noise that is told is taken at the brightness that the capture has.
    #[test]
    fn what_is_told_is_not_estimated() {
        let capture = capture((150, 160), [0.02, 0.05]);
        let noise = NoiseLevel::told(capture.view(), (ALPHA, 16.0), |light| 0.01 * (light + ALPHA));
        assert!((noise.middle() - 0.01).abs() < 1e-5 && (noise.at(1.0) - 0.01).abs() < 1e-5);
        let photons = NoiseLevel::told(capture.view(), (ALPHA, 16.0), |light| 0.02 * light.sqrt());
        let expected = 0.02 * 2.1f32.sqrt() / (2.1 + ALPHA);
        assert!((photons.middle() / expected - 1.0).abs() < 0.1, "{} {expected}", photons.middle());
    }

    #[test]
    fn noise_hides_where_most_channels_show_none() {
        let levels = |deviations: [f32; 3]| deviations.map(NoiseLevel::even);
        assert!(NoiseLevel::hide(&levels([LEAST; 3])) && NoiseLevel::hide(&levels([LEAST, 0.01, LEAST])));
        assert!(!NoiseLevel::hide(&levels([0.01, LEAST, 0.01])));
        assert_eq!([0.1, 1.0, 10.0].map(|brightness| NoiseLevel::even(0.02).at(brightness)), [0.02; 3]);
    }

    /// Of one sensor: what a channel alone shows for noise is detail, and what it hides is noise.
    #[test]
    fn colours_agree_whether_there_is_noise() {
        let level = |middle: f32, overall: f32| NoiseLevel { knots: vec![(0.0, middle)], overall };
        let agreed = |levels: [[f32; 2]; 3]| {
            let mut levels = levels.map(|[middle, overall]| level(middle, overall));
            NoiseLevel::agree(&mut levels);
            levels.map(|level| level.middle())
        };
        assert_eq!(agreed([[9e-3, LEAST], [1e-2, LEAST], [LEAST, LEAST]]), [LEAST; 3]);
        assert_eq!(agreed([[0.013, 0.013], [LEAST, 0.008], [LEAST, LEAST]]), [0.013, 0.008, 0.008]);
        assert_eq!(agreed([[0.02, 0.02], [0.03, 0.03], [0.01, LEAST]]), [0.02, 0.03, 0.01]);
        assert_eq!(agreed([[LEAST, LEAST], [0.01, 0.01], [LEAST, LEAST]]), [LEAST, 0.01, LEAST]);
    }

    #[test]
    fn values_at_some_places_are_those_of_all_in_order() {
        for length in [1, 2, 7, 1000] {
            let mut values: Vec<f32> = (0..length).map(|index| ((index * 7919 + 13) % 1009) as f32).collect();
            let mut ordered = values.clone();
            ordered.sort_unstable_by(f32::total_cmp);
            let places: Vec<usize> = (0..=12).map(|part| (length - 1) * part / 12).collect();
            put_in_place(&mut values, &places, 0);
            assert!(places.iter().all(|place| values[*place] == ordered[*place]), "{length}");
        }
    }

    #[test]
    fn nothing_known_is_no_noise() {
        let full = Array2::from_elem((30, 30), 20.0);
        for capture in [full, Array2::zeros((1, 1)), Array2::zeros((64, 64))] {
            let noise = estimate(&capture);
            assert_eq!([noise.at(0.25), noise.middle(), noise.at(100.0)], [LEAST; 3]);
        }
    }

    #[test]
    fn strips_are_spread_over_the_height_and_few() {
        assert!(strips((500, 1000), MOST_PIXELS).into_iter().eq(std::iter::once(0..500)));
        let strips = strips((2448, 3264), MOST_PIXELS);
        assert_eq!(strips.len() * STRIP_ROWS * 3264 / 100_000, 5);
        assert!(strips[0].start < 200 && strips.last().unwrap().end > 2248);
        assert!(strips.windows(2).all(|pair| pair[0].end <= pair[1].start));
    }
}
