//! Finds the light at which a capture saturates, where nobody says it, and the tone curve that suits its units.

use ndarray::ArrayView2;

use crate::core::capture::CaptureInfo;
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;

/// Pixels that have to be equally bright to be taken for saturated, in a channel or, where all channels end at the same value, in
/// all of them: fewer may be the core of a lamp.
const LEAST_PIXELS: usize = 16;

/// The part of the brightest value that counts as just as bright: rounding to half floats.
const SAME: f32 = 0.998;

/// Saturated pixels for each that is nearly as bright: a sensor's white ends like a cut, a lamp's image like a bell.
const CUT: usize = 2;

/// Of so many pixels one may be saturated: an image that is flat for the most part is of something flat.
const MOST_OF: usize = 2;

/// What light is in multiples of α where it saturates, at least and at most, in the captures that networks are trained on.
const LEVELS: [f32; 2] = [4.0, 2000.0];

/// The next value below the brightest of coarsely quantised light, as a part of it: that far down, pixels are nearly as bright.
const NEXT: f32 = 0.9;

/// A capture whose brightest light is less than this part of α is in smaller units than networks know.
const DARKEST: f32 = 1.0 / 3.0;

/// α of a scene exposed like the brighter ones of those, over the median of its green light: 20 captures in counts are restored as at
/// 2.5 times as much, within 0.1 dB, and one of a lamp over an even pattern, whose φ is nearly linear then, better.
const ALPHA_OVER_MEDIAN: f32 = 0.8;

/// The curve itself where a capture is of light as networks know it; for one in much larger units, counts of a sensor for
/// example, or in much smaller ones, one whose α is as large beside its light as theirs.
pub(super) fn suited_curve(curve: ToneCurve, image: &LinearImage) -> ToneCurve {
    let [least, most] = LEVELS;
    let white = match image.max().min(curve.x_max) {
        brightest if brightest > 0.0 && brightest < DARKEST * curve.alpha => brightest,
        _ if curve.x_max > most * curve.alpha => curve.x_max,
        _ => return curve,
    };
    let mut green: Vec<f32> = image.channel(1).iter().copied().collect();
    let middle = green.len() / 2;
    let (_, median, _) = green.select_nth_unstable_by(middle, f32::total_cmp);
    let alpha = (ALPHA_OVER_MEDIAN * *median).clamp(white / most, white / least);
    ToneCurve { alpha, ..curve }
}

/// Finds the white level of each channel of a capture: the value that its brightest pixels share, if that ends like a cut.
/// Channels without such a value saturate above all that they show, and at no less than `usual`. Where all channels end at one
/// value, their pixels count together.
///
/// The second number is how many pixels were found to be saturated.
pub(super) fn find_levels(image: &LinearImage, usual: f32) -> ([f32; CHANNELS], usize) {
    let tops: [Top; CHANNELS] = std::array::from_fn(|channel| Top::of(image.channel(channel)));
    let is_one_value = tops.iter().all(|top| top.brightest.total_cmp(&tops[0].brightest).is_eq());
    let equal = |top: &Top| if is_one_value { tops.iter().map(|top| top.equal).sum() } else { top.equal };
    let found = tops.each_ref().map(|top| top.is_cut(equal(top)).then_some((top.brightest, top.equal)));
    let count = found.iter().flatten().map(|(_, count)| count).sum();
    let levels = std::array::from_fn(|channel| {
        found[channel].map_or_else(
            || {
                let brightest = image.channel(channel).iter().fold(0.0, |most: f32, value| most.max(*value));
                usual.max(brightest / saturated_from(1.0) * (1.0 + f32::EPSILON.sqrt()))
            },
            |(level, _)| level,
        )
    });
    (levels, count)
}

/// The brightest pixels of a channel.
struct Top {
    brightest: f32,
    /// Pixels that are just as bright.
    equal: usize,
    /// Pixels that are nearly as bright, be it as the next value of coarsely quantised light.
    near: usize,
    pixels: usize,
}

impl Top {
    fn of(plane: ArrayView2<'_, f32>) -> Self {
        let brightest = plane.iter().fold(0.0, |most: f32, value| most.max(*value));
        let is_equal = |value: f32| value >= SAME * brightest;
        let next =
            plane.iter().filter(|value| !is_equal(**value)).fold(0.0, |most: f32, value| most.max(*value));
        let within = (2.0 * SAME - 1.0 - 4.0 * (1.0 - SAME)) * brightest;
        let is_near = |value: f32| value >= within || (next >= NEXT * brightest && value >= SAME * next);
        let equal = plane.iter().filter(|value| is_equal(**value)).count();
        let near = plane.iter().filter(|value| !is_equal(**value) && is_near(**value)).count();
        Self { brightest, equal, near, pixels: plane.len() }
    }

    /// Whether they end like a cut, if so many pixels are evidence of it.
    fn is_cut(&self, evidence: usize) -> bool {
        self.brightest > 0.0
            && evidence >= LEAST_PIXELS
            && self.equal >= CUT * self.near
            && MOST_OF * self.equal <= self.pixels
    }
}

/// What is known of a capture, and at which light it was found to saturate.
pub(super) fn with_levels(info: Option<CaptureInfo>, levels: Option<[f32; CHANNELS]>) -> Option<CaptureInfo> {
    // A channel that does not saturate has a level far above; white balance is not by more than this.
    const MOST_APART: f32 = 10.0;
    let is_of_all = |levels: &[f32; CHANNELS]| {
        let [least, most] = [f32::min, f32::max].map(|of| levels.iter().copied().fold(levels[0], of));
        most <= MOST_APART * least
    };
    match levels.filter(is_of_all) {
        Some(levels) => Some(CaptureInfo { saturation: Some(levels), ..info.unwrap_or_default() }),
        None => info,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn scene(limit: f32) -> LinearImage {
        let light = |y: usize, x: usize| {
            0.2 + 90.0 * (-((y as f32 - 30.0).powi(2) + (x as f32 - 20.0).powi(2)) / 80.0).exp()
        };
        LinearImage::from_planes(Array3::from_shape_fn((3, 64, 64), |(_, y, x)| light(y, x).min(limit)))
            .unwrap()
    }

    #[test]
    fn a_lamp_that_is_cut_off_saturates_and_one_that_is_not_does_not() {
        let (levels, count) = find_levels(&scene(16.0), 500.0);
        assert_eq!(levels, [16.0; 3]);
        assert!(count > 3 * 100, "{count}");
        assert_eq!(find_levels(&scene(1e3), 500.0), ([500.0; 3], 0));
    }

    #[test]
    fn an_image_that_is_brighter_than_usual_is_below_its_own_level() {
        let bright = LinearImage::from_planes(scene(1e3).into_planes() * 10.0).unwrap();
        let (levels, count) = find_levels(&bright, 500.0);
        let brightest = bright.as_slice().iter().fold(0.0f32, |a, b| a.max(*b));
        assert!(count == 0 && levels.iter().all(|level| saturated_from(*level) > brightest), "{levels:?}");
    }

    /// What is 2000 times as large is tone-mapped to the same.
    #[test]
    fn counts_are_mapped_as_the_light_that_they_count() {
        let light = ToneCurve::new(0.25, 8.0).unwrap();
        let image = scene(8.0).map_values(|value| 0.6 * value);
        assert_eq!(suited_curve(light, &image), light);
        let counts = image.map_values(|value| 2000.0 * value);
        let curve = suited_curve(ToneCurve::new(0.25, 16_000.0).unwrap(), &counts);
        let median = 0.6 * 0.2;
        assert!((curve.alpha / (2000.0 * ALPHA_OVER_MEDIAN * median) - 1.0).abs() < 0.1, "{curve:?}");
        assert_eq!(curve.x_max, 16_000.0);
        let black = LinearImage::from_planes(Array3::zeros((3, 8, 8))).unwrap();
        assert_eq!(suited_curve(curve, &black).alpha, curve.alpha);
        assert_eq!(suited_curve(ToneCurve { alpha: 0.25, ..curve }, &black).alpha, 8.0);
    }

    #[test]
    fn a_flat_or_dark_image_is_not_white() {
        let dark = LinearImage::from_planes(Array3::zeros((3, 8, 8))).unwrap();
        assert_eq!(find_levels(&dark, 500.0), ([500.0; 3], 0));
        let wall = LinearImage::from_planes(Array3::from_elem((3, 8, 8), 0.5)).unwrap();
        assert_eq!(find_levels(&wall, 500.0), ([500.0; 3], 0));
    }

    /// Ten pixels a channel: few, but all channels end at the same value.
    #[test]
    fn a_small_lamp_that_all_channels_end_at_is_cut_off() {
        let lamp = |end: [f32; 3]| {
            let light = |(c, y, x): (usize, usize, usize)| {
                let is_lamp = (10..12).contains(&y) && (20..25).contains(&x);
                if is_lamp { end[c] } else { 0.1 + 0.001 * ((y * 7 + x * 3) % 11) as f32 }
            };
            LinearImage::from_planes(Array3::from_shape_fn((3, 32, 32), light)).unwrap()
        };
        assert_eq!(find_levels(&lamp([4.0; 3]), 500.0), ([4.0; 3], 30));
        assert_eq!(find_levels(&lamp([4.0, 3.0, 2.0]), 500.0), ([500.0; 3], 0));
    }

    /// Light in steps of 1/60 has many pixels at its brightest value, and as many one step below.
    #[test]
    fn coarse_steps_are_not_taken_for_saturation() {
        let light = |(_, y, x): (usize, usize, usize)| {
            let distance = (y as f32 - 30.0).hypot(x as f32 - 20.0);
            ((60.0 * (1.2 - distance / 40.0)).round() / 60.0).max(0.1)
        };
        let coarse = LinearImage::from_planes(Array3::from_shape_fn((3, 64, 64), light)).unwrap();
        assert_eq!(find_levels(&coarse, 500.0), ([500.0; 3], 0));
    }

    /// What is a thousandth as large is tone-mapped to the same.
    #[test]
    fn light_in_small_units_is_mapped_as_what_it_is() {
        let image = scene(8.0).map_values(|value| 1e-3 * value);
        let curve = suited_curve(ToneCurve::new(0.25, 8e-3).unwrap(), &image);
        let median = 0.2e-3;
        assert!((curve.alpha / (ALPHA_OVER_MEDIAN * median) - 1.0).abs() < 0.1, "{curve:?}");
        let unknown = suited_curve(ToneCurve::new(0.25, 500.0).unwrap(), &image);
        assert_eq!(unknown.alpha, curve.alpha);
    }
}
