//! Finds the value at which a channel's brightest pixels end like a cut: what a sensor's white looks like in any units.

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

/// Pixels that have to be equally bright to be taken for saturated, in a channel or, where all channels end at the same value, in
/// all of them: fewer may be the core of a lamp.
const LEAST_PIXELS: usize = 16;

/// How much darker than the brightest pixel of a plateau its darkest may be, and saturated pixels for each that is nearly as
/// bright: a sensor's white ends like a cut, a lamp's image like a bell. First what rounding to half floats leaves of a white;
/// then what lossy compression, gains for single pixels, or lenses whose shading was taken out make of it. Of 237 channels of
/// synthetic captures these find the same 86 that are saturated, and most of those still when their white is spread by 0.2 %
/// or shaded by 5 %.
const SPREADS: [(f32, usize); 4] = [(0.002, 2), (0.006, 6), (0.015, 6), (0.04, 6)];

/// Spreads below a plateau whose pixels are nearly as bright, but no larger part of it than the other: lamps of a shaded picture
/// have edges.
const NEAR: f32 = 6.0;
const MOST_NEAR: f32 = 0.12;

/// A plateau of a larger spread is taken for one that is cut too, if it has so many times the pixels: of lamps in several places of a
/// picture whose shading was taken out, the brightest end in a plateau of their own.
const MANY_MORE: f32 = 1.25;

/// Equal pixels of all channels together that tell a white by its value, though an eighth as many be brighter.
const LEAST_OF_WHITE: usize = 64;

/// How many powers of two below the brightest pixel such a white is looked for.
const WHITES: i32 = 3;

/// How far above a plateau that another channel has pixels may be part of it.
const ALIKE: f32 = 0.002;

/// Of so many pixels one may be saturated: an image that is flat for the most part is of something flat.
const MOST_OF: usize = 2;

/// The next value below the brightest of coarsely quantised light, as a part of it: that far down, pixels are nearly as bright.
const NEXT: f32 = 0.9;

/// The same where they are exactly equal, and no others of the channel are, or where all channels end at a value that whites have.
const LEAST_EQUAL: usize = 3;

/// Pixels of a channel that are looked at to see whether such as are not saturated are equal, and of how many one may be.
const LOOKED_AT: usize = 4096;
const EQUAL_OF: usize = 100;

/// Steps of a converter that a white is above darkness at least: what ends below is dim light in coarse steps.
const LEAST_STEPS: usize = 48;

/// Of so many pixels one may be above the plateau: hot pixels, and what compression makes of edges.
const OUTLIERS_OF: usize = 10_000;

/// Of so many pixels of a plateau one may be above it.
const PLATEAU_OF: usize = 8;

/// The brightest values of a channel.
pub(super) struct Top {
    /// From the brightest on down, as far as a plateau and what is nearly as bright may reach.
    values: Vec<f32>,
    /// How many of them may be above a plateau.
    outliers: usize,
    pixels: usize,
    /// Whether its brightest is many steps of a converter above darkness.
    is_many_steps: bool,
    /// Whether pixels are equal by chance alone, as of light that is not quantised.
    are_unlike: bool,
}

/// Pixels that share the brightest value of a channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Plateau {
    /// Brighter than this are outliers alone.
    pub(super) brightest: f32,
    /// No pixel of it is darker.
    pub(super) darkest: f32,
    /// How many pixels it has.
    pub(super) pixels: usize,
    near: usize,
    cut: usize,
}

impl Top {
    pub(super) fn of(plane: ArrayView2<'_, f32>) -> Self {
        let pixels = plane.len();
        let outliers = pixels.div_ceil(OUTLIERS_OF).min(pixels.saturating_sub(1));
        let brightest = least_of_top(plane, outliers + 1);
        let (widest, _) = SPREADS[SPREADS.len() - 1];
        let least = brightest * ((1.0 - widest) * (1.0 - MOST_NEAR)).min(NEXT * (1.0 - SPREADS[0].0));
        let mut values: Vec<f32> =
            plane.iter().copied().filter(|value| *value >= least && *value > 0.0).collect();
        values.par_sort_unstable_by(|a, b| b.total_cmp(a));
        Self {
            values,
            outliers,
            pixels,
            is_many_steps: is_many_steps(plane, brightest),
            are_unlike: are_unlike(plane, brightest),
        }
    }

    /// Its brightest value but for outliers; zero of a dark channel.
    pub(super) fn brightest(&self) -> f32 {
        self.values.get(self.outliers).or(self.values.last()).copied().unwrap_or(0.0)
    }

    /// Its plateau, if it ends like a cut.
    pub(super) fn plateau(&self) -> Option<Plateau> {
        SPREADS
            .into_iter()
            .filter_map(|spread| self.flattest(spread))
            .filter(|found| found.is_cut(self, found.pixels))
            .reduce(Plateau::or_wide)
    }

    /// Where another channel ends like a cut: what ends there in this one too, though less plainly, or in most of its pixels.
    pub(super) fn plateau_as(&self, other: &Plateau) -> Option<Plateau> {
        let above = self.values.partition_point(|value| *value > (1.0 + ALIKE) * other.brightest);
        let end = self.end_at(other.darkest);
        let pixels = end - above;
        let near = self.end_at((1.0 - MOST_NEAR) * other.darkest) - end;
        let is_plain = pixels >= LEAST_PIXELS.max(near).max(PLATEAU_OF * above);
        (is_plain && self.is_many_steps).then_some(Plateau { pixels, near, ..*other })
    }

    /// What may be its plateau with the least spread, cut or not.
    pub(super) fn narrowest(&self) -> Option<Plateau> {
        self.flattest(SPREADS[0])
    }

    /// The most pixels within a spread, below no more outliers than there may be.
    fn flattest(&self, (spread, cut): (f32, usize)) -> Option<Plateau> {
        let values = &self.values;
        let starts = (0..=self.outliers.min(values.len().saturating_sub(1)))
            .filter(|start| *start == 0 || values[*start] < values[start - 1]);
        let candidate = |start: usize| {
            let brightest = *values.get(start)?;
            let end = self.end_at((1.0 - spread) * brightest);
            (PLATEAU_OF * start <= end - start).then_some((start, end, brightest))
        };
        let most = starts
            .filter_map(candidate)
            .reduce(|most, next| if next.1 - next.0 > most.1 - most.0 { next } else { most });
        most.map(|(start, end, brightest)| {
            let next = values.get(end).copied().unwrap_or(0.0);
            let near = self.end_at((1.0 - (NEAR * spread).min(MOST_NEAR)) * brightest);
            let as_next =
                if next >= NEXT * brightest { self.end_at((1.0 - SPREADS[0].0) * next) } else { end };
            let darkest = values[end - 1];
            Plateau { brightest, darkest, pixels: end - start, near: near.max(as_next) - end, cut }
        })
    }

    /// How many values are at least this bright.
    fn end_at(&self, least: f32) -> usize {
        self.values.partition_point(|value| *value >= least)
    }
}

impl Plateau {
    /// Its pixels in a plane.
    pub(super) fn mask(&self, plane: &Array2<f32>) -> Array2<bool> {
        plane.mapv(|value| value >= self.darkest && value <= self.brightest)
    }

    /// Whether its pixels differ by more than rounding and compression make them.
    pub(super) fn is_wide(&self) -> bool {
        self.darkest < (1.0 - SPREADS[1].0) * self.brightest
    }

    /// The same, or a wider one that has many more pixels.
    pub(super) fn or_wide(self, wide: Self) -> Self {
        let has_many_more = wide.pixels as f32 >= MANY_MORE * self.pixels as f32;
        if has_many_more { wide } else { self }
    }

    /// Whether it ends like a cut, if so many pixels are evidence of it.
    pub(super) fn is_cut(&self, top: &Top, evidence: usize) -> bool {
        let is_one = self.brightest.total_cmp(&self.darkest).is_eq();
        let is_sure = is_one && (top.are_unlike || (evidence > self.pixels && is_white(self.brightest)));
        let least = if is_sure { LEAST_EQUAL } else { LEAST_PIXELS };
        let is_flat = MOST_OF * self.pixels > top.pixels;
        evidence >= least && top.is_many_steps && self.pixels >= self.cut * self.near && !is_flat
    }
}

/// Whether a light is many of the steps above darkness that a plane's values are multiples of.
fn is_many_steps(plane: ArrayView2<'_, f32>, light: f32) -> bool {
    let mut values: Vec<f32> = Vec::with_capacity(LEAST_STEPS);
    let has_many = plane.iter().any(|value| {
        if *value > 0.0 && !values.contains(value) {
            values.push(*value);
        }
        values.len() >= LEAST_STEPS
    });
    values.push(0.0);
    values.sort_unstable_by(f32::total_cmp);
    let step = values.windows(2).map(|pair| pair[1] - pair[0]).fold(f32::INFINITY, f32::min);
    #[expect(clippy::cast_precision_loss, reason = "some steps")]
    let least = LEAST_STEPS as f32 * step;
    has_many || light >= least
}

/// Whether hardly any two of a plane's pixels that are darker than its white and not black are equal.
fn are_unlike(plane: ArrayView2<'_, f32>, white: f32) -> bool {
    let step = (plane.len() / LOOKED_AT).max(1);
    let darker = |value: &f32| *value > 0.0 && *value < NEXT * white;
    let mut values: Vec<f32> = plane.iter().step_by(step).copied().filter(darker).collect();
    values.sort_unstable_by(f32::total_cmp);
    let equal = values.windows(2).filter(|pair| pair[0].total_cmp(&pair[1]).is_eq()).count();
    values.len() > EQUAL_OF && EQUAL_OF * equal <= values.len()
}

/// The white that all channels share, by its value and by how many of their pixels are exactly as bright, and how many those are in each:
/// where a few pixels are brighter, as hot ones, or where most are white.
pub(super) fn shared_white<'a>(
    channels: impl Iterator<Item = ArrayView2<'a, f32>> + Clone,
    brightest: f32,
) -> Option<(f32, Vec<usize>)> {
    // Below one, powers of two are the light of some wall.
    if !brightest.is_finite() || brightest < 1.0 {
        return None;
    }
    let power = |below: i32| 2.0_f32.powi(exponent_of(brightest) + 1 - below);
    let of_integers = |white: f32| (white >= 256.0).then_some(white - 1.0);
    let candidates = (0..=WHITES).map(power).flat_map(|white| [Some(white), of_integers(white)]).flatten();
    candidates.filter(|white| (1.0..=brightest).contains(white)).find_map(|white| {
        let of_channel = |channel: ArrayView2<'a, f32>| {
            channel.iter().fold([0_usize; 3], |[equal, above, near], value| {
                let is_near = *value < white && *value > NEXT * white;
                [
                    equal + usize::from(value.total_cmp(&white).is_eq()),
                    above + usize::from(*value > white),
                    near + usize::from(is_near),
                ]
            })
        };
        let counts: Vec<_> = channels.clone().map(of_channel).collect();
        let sum = |kind: usize| counts.iter().map(|counts| counts[kind]).sum::<usize>();
        let ([equal, above, near], (_, cut)) = ([sum(0), sum(1), sum(2)], SPREADS[0]);
        let is_white = counts.iter().all(|[equal, ..]| *equal >= LEAST_PIXELS)
            && equal >= LEAST_OF_WHITE.max(PLATEAU_OF * above).max(cut * near);
        is_white.then(|| (white, counts.into_iter().map(|[equal, ..]| equal).collect()))
    })
}

/// The exponent of the largest power of two that is not above a positive number.
fn exponent_of(number: f32) -> i32 {
    #[expect(clippy::cast_possible_truncation, reason = "between -126 and 127")]
    let exponent = number.log2().floor() as i32;
    if 2.0_f32.powi(exponent) > number { exponent - 1 } else { exponent }
}

/// Whether a value is one at which light is cut on purpose: a power of two, or the largest integer of some bits.
fn is_white(value: f32) -> bool {
    let is_power = |value: f32| value > 0.0 && value.log2().fract().abs() < f32::EPSILON;
    is_power(value) || (value >= 255.0 && is_power(value + 1.0))
}

/// A value that no more than `count` values are above, to a 2000th of it; zero where fewer are positive.
fn least_of_top(plane: ArrayView2<'_, f32>, count: usize) -> f32 {
    // The order of positive floats is that of their bits; twelve of them are a 2000th.
    const BITS: u32 = 12;
    let mut counts = vec![0_u32; 1 << (31 - BITS)];
    for value in plane.iter().filter(|value| **value > 0.0) {
        counts[(value.to_bits() >> BITS) as usize] += 1;
    }
    let mut above = 0;
    for (bin, in_bin) in counts.iter().enumerate().rev() {
        above += *in_bin as usize;
        if above >= count {
            #[expect(clippy::cast_possible_truncation, reason = "an index of 19 bits")]
            return f32::from_bits((bin as u32) << BITS);
        }
    }
    0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 128;

    /// A lamp that is cut off at `white`, over an uneven ground.
    fn lamp(white: f32) -> Array2<f32> {
        Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
            let distance = (y as f32 - 50.0).hypot(x as f32 - 70.0);
            (0.1 + 0.001 * ((y * 7 + x * 3) % 11) as f32 + 400.0 * (-distance / 3.0).exp()).min(white)
        })
    }

    fn found(plane: &Array2<f32>) -> Option<Plateau> {
        Top::of(plane.view()).plateau()
    }

    #[test]
    fn a_hot_pixel_hides_no_plateau() {
        let plane = lamp(1.0);
        let alone = found(&plane).unwrap();
        assert!(alone.brightest == 1.0 && alone.darkest == 1.0 && alone.pixels > 500, "{alone:?}");
        for (hot, value) in [(1, 1.003), (1, 1.05), (2, 17.0)] {
            let mut plane = plane.clone();
            (0..hot).for_each(|at| plane[[3 + at, 9]] = value);
            assert_eq!(found(&plane), Some(alone), "{hot} of {value}");
        }
        let mut many = plane.clone();
        (0..80).for_each(|at| many[[at, 9]] = 1.5 + 0.05 * at as f32);
        assert_eq!(found(&many), None, "of something brighter");
    }

    #[test]
    fn a_white_that_is_spread_or_shaded_is_one() {
        for spread in [3e-4, 1e-3, 4e-3, 0.012, 0.035] {
            let mut plane = lamp(1.0);
            plane.indexed_iter_mut().filter(|(_, value)| **value == 1.0).for_each(|((y, x), value)| {
                *value = 1.0 - spread * (((y * 31 + x * 17) % 97) as f32 / 96.0);
            });
            let found = found(&plane).expect("a plateau");
            assert!(found.brightest == 1.0 && found.darkest >= 0.96, "{spread}: {found:?}");
            let saturated = plane.iter().filter(|value| **value >= 1.0 - spread).count();
            assert!(
                (saturated..saturated + saturated / 8).contains(&found.pixels),
                "{spread}: {found:?}, {saturated}"
            );
        }
    }

    #[test]
    fn a_lamp_that_is_not_cut_off_has_none() {
        let bell = |width: f32| {
            Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
                let squares = (y as f32 - 50.0).powi(2) + (x as f32 - 70.0).powi(2);
                0.1 + 7.0 * (-squares / width.powi(2)).exp()
            })
        };
        for width in [3.0, 10.0, 30.0, 100.0] {
            assert_eq!(found(&bell(width)), None, "{width}");
        }
        assert_eq!(found(&lamp(1e3)), None);
    }

    /// Three of 16 pixels that would be needed where light is quantised: no two are equal by chance where it is not.
    #[test]
    fn equal_pixels_among_unlike_ones_are_cut_off() {
        let plane = |pixels: usize, steps: Option<f32>| {
            Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
                let light = 0.1 + 0.3 * ((y * SIDE + x) as f64 * 0.618_033_988_75).fract() as f32;
                let light = steps.map_or(light, |steps| (light * steps).round() / steps);
                if y == 50 && (70..70 + pixels).contains(&x) { 3.3 } else { light }
            })
        };
        assert_eq!(found(&plane(3, None)).map(|found| (found.brightest, found.pixels)), Some((3.3, 3)));
        assert_eq!(found(&plane(2, None)), None);
        assert_eq!(found(&plane(3, Some(1023.0))), None);
        assert!(found(&plane(16, Some(1023.0))).is_some());
    }

    /// As of lamps in several places of a picture whose shading was taken out.
    #[test]
    fn plateaus_that_differ_by_shading_are_one() {
        let mut plane = lamp(1.0);
        let lamps = [(10, 10, 1.02), (100, 20, 1.012), (90, 100, 1.0)];
        for (top, left, gain) in lamps {
            (0..12 * 12).for_each(|at| plane[[top + at / 12, left + at % 12]] = gain);
        }
        let found = found(&plane).expect("a plateau");
        assert!(found.brightest == 1.02 && found.darkest <= 1.0 && found.pixels > 800, "{found:?}");
    }

    #[test]
    fn what_another_channel_ends_at_is_a_white_here_too() {
        let other = found(&lamp(1.0)).unwrap();
        let flat =
            Array2::from_shape_fn((SIDE, SIDE), |(y, x)| if y < 90 { 1.0 } else { 0.3 + 0.001 * x as f32 });
        assert_eq!(found(&flat), None, "most of it");
        assert_eq!(Top::of(flat.view()).plateau_as(&other).map(|found| found.pixels), Some(90 * SIDE));
        assert_eq!(Top::of(lamp(0.9).view()).plateau_as(&other), None);
        assert_eq!(Top::of(lamp(1e3).view()).plateau_as(&other), None);
    }

    #[test]
    fn a_white_of_all_channels_is_told_by_its_value() {
        let whites = |plane: &Array2<f32>| {
            shared_white(std::iter::repeat_n(plane.view(), 3), plane.iter().copied().fold(0.0, f32::max))
        };
        let mut plane = lamp(4.0);
        (0..12).for_each(|at| plane[[3, 9 + 2 * at]] = 4.2 + 0.1 * at as f32);
        assert_eq!(found(&plane), None);
        assert!(
            whites(&plane)
                .is_some_and(|(white, pixels)| white == 4.0 && pixels.len() == 3 && pixels[0] > 100)
        );
        assert_eq!(whites(&lamp(4.1)), None, "no white");
        let integers = lamp(4.0).map(|value| (value * 1023.75).round().min(4095.0));
        assert_eq!(whites(&integers).map(|(white, _)| white), Some(4095.0));
        for plane in
            [Array2::zeros((9, 9)), Array2::from_elem((9, 9), -1.0), Array2::from_elem((40, 40), 0.7)]
        {
            assert_eq!(whites(&plane), None);
        }
    }

    /// Of 8 bits, in dim light: the scene ends after twelve steps, which many pixels reach.
    #[test]
    fn few_steps_above_darkness_there_is_no_white() {
        let dim = |steps: f32, white: f32| lamp(white).map(|value| (value * steps).round() / steps);
        assert_eq!(found(&dim(60.0, 0.2)), None);
        assert!(found(&dim(60.0, 1.0)).is_some());
    }

    #[test]
    fn planes_without_light_and_of_one_pixel_have_none() {
        for plane in [
            Array2::zeros((0, 0)),
            Array2::zeros((9, 9)),
            Array2::ones((1, 1)),
            Array2::from_elem((9, 9), -1.0),
        ] {
            assert_eq!(found(&plane), None, "{plane}");
        }
    }
}
