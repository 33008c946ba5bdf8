//! Finds the light at which a capture saturates, where nobody says it, and the tone curve that suits its units.

use ndarray::{Array3, ArrayView2};
use rayon::prelude::*;

use super::plateau::{Plateau, Top, shared_white};
use super::shaded::shaded_whites;
use crate::core::capture::{CaptureInfo, is_level};
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;

/// What light is in multiples of α where it saturates, at least and at most, in the captures that networks are trained on.
const LEVELS: [f32; 2] = [4.0, 2000.0];

/// A capture whose brightest light is less than this part of α is in smaller units than networks know.
const DARKEST: f32 = 1.0 / 3.0;

/// So may be one whose brightest light is less than this multiple of α,
const DIM: f32 = 8.0;

/// if the α that suits it is less than this part of α.
const DARK: f32 = 1.0 / 8.0;

/// A capture is brighter than those that networks know if the α that suits it is more than this multiple of α. Of fifteen captures whose
/// median is 0.1 to 0.65, in light six times as bright, eleven lose by an α that stays, up to 6 dB, and none gains.
const BRIGHT: f32 = 2.0;

/// Where the dark is noise, α is this multiple of its deviation at least, but no larger part of white: what a sensor does not see is
/// no reason to flatten what it does.
const OVER_NOISE: f32 = 24.0;
const MOST_DARKNESS: f32 = 0.02;

/// Pixels of which the median is taken, at most.
const MOST_SAMPLES: usize = 1 << 20;

/// The α that suits a capture in multiples of α from which on its light is in larger units than usual, and does not only shine.
const LARGE: f32 = 10.0;

/// How much brighter than a capture its restored scene may be, at least, where nothing says what saturates.
const HEADROOM: f32 = 4.0;

/// α of a scene exposed like the brighter ones of those, over the median of its green light: 20 captures in counts are restored as at
/// 2.5 times as much, within 0.1 dB, and one of a lamp over an even pattern, whose φ is nearly linear then, better.
const ALPHA_OVER_MEDIAN: f32 = 0.8;

/// The curve itself where a capture is of light as networks know it; for one in other units, counts of a sensor or light of which
/// white is 1 and most is dark, for example, one whose α is as large beside its light as theirs.
pub(super) fn suited_curve(curve: ToneCurve, image: &LinearImage) -> ToneCurve {
    curve_for(curve, image, image.max())
}

/// The same of a capture of which it is told that it saturates at the curve's x_max, which tells its units: one that is dark in those of
/// networks keeps the curve. (A dark studio, 25.3 dB by the α of its median, has 33.7.)
pub(super) fn curve_of_told(curve: ToneCurve, image: &LinearImage) -> ToneCurve {
    curve_for(curve, image, curve.x_max)
}

/// The curve that suits an image of which light may be as bright as this.
fn curve_for(curve: ToneCurve, image: &LinearImage, brightest: f32) -> ToneCurve {
    let [least, most] = LEVELS;
    let white = image.max().min(curve.x_max);
    if white <= 0.0 {
        return curve;
    }
    let green = image.channel(1);
    let mut sampled: Vec<f32> = green.iter().step_by(green.len() / MOST_SAMPLES + 1).copied().collect();
    let middle = sampled.len() / 2;
    let (_, median, _) = sampled.select_nth_unstable_by(middle, f32::total_cmp);
    let alpha = ALPHA_OVER_MEDIAN * *median;
    let darker = sampled.len() * 3 / 4;
    let darker = *sampled.select_nth_unstable_by(darker, f32::total_cmp).1;
    let is_in_large_units = curve.x_max > most * curve.alpha;
    if !is_in_large_units && alpha <= BRIGHT * curve.alpha && brightest.min(curve.x_max) >= DIM * curve.alpha
    {
        return curve;
    }
    let in_the_dark = (MOST_DARKNESS * white).min(OVER_NOISE * noise_in_the_dark(green, darker));
    let alpha = alpha.max(in_the_dark).clamp(white / most, white / least);
    let is_in_small_units = white < DARKEST * curve.alpha || alpha < DARK * curve.alpha;
    let is_bright = alpha > BRIGHT * curve.alpha;
    if is_in_large_units || is_bright || is_in_small_units { ToneCurve { alpha, ..curve } } else { curve }
}

/// The standard deviation of the noise of light up to this, at most: of neighbours' differences, or half a step of a converter.
fn noise_in_the_dark(plane: ArrayView2<'_, f32>, most: f32) -> f32 {
    /// The median of the modulus of the difference of two normal variables.
    const OF_DIFFERENCE: f32 = 0.954;
    let mut differences: Vec<f32> = plane
        .rows()
        .into_iter()
        .flat_map(|row| row.into_iter().zip(row.into_iter().skip(1)))
        .filter(|(a, b)| **a <= most && **b <= most)
        .map(|(a, b)| (a - b).abs())
        .collect();
    let middle = differences.len() / 2;
    if differences.is_empty() {
        return 0.0;
    }
    let median = *differences.select_nth_unstable_by(middle, f32::total_cmp).1;
    if median > 0.0 {
        return median / OF_DIFFERENCE;
    }
    // Most of it is one value, and the least light is a step.
    let step = plane.iter().copied().filter(|value| *value > 0.0).fold(f32::INFINITY, f32::min);
    if step.is_finite() { 0.5 * step } else { 0.0 }
}

/// Where light may saturate that nobody has told of, in a capture that shows nothing of it: as far above α as in the published
/// model, in whatever units.
fn unknown_level(curve: ToneCurve, image: &LinearImage) -> f32 {
    let brightest = image.max();
    let within = ToneCurve { x_max: curve.x_max.min(brightest), ..curve };
    let units = suited_curve(within, image).alpha / curve.alpha;
    let level = if (1.0..LARGE).contains(&units) { curve.x_max } else { curve.x_max * units };
    if brightest < saturated_from(level) { level } else { HEADROOM * brightest }
}

/// The white level of each channel that its brightest pixels show, if they end like a cut, and how many pixels do. Where all
/// channels end at one value, their pixels count together.
pub(super) fn cut_levels(image: &LinearImage) -> [Option<(f32, usize)>; CHANNELS] {
    let channels = (0..CHANNELS).map(|channel| image.channel(channel));
    if let Some((white, counts)) = shared_white(channels, image.max()) {
        return std::array::from_fn(|channel| Some((white, counts[channel])));
    }
    let mut tops: [Option<Top>; CHANNELS] = [const { None }; CHANNELS];
    tops.par_iter_mut().enumerate().for_each(|(channel, top)| *top = Some(Top::of(image.channel(channel))));
    let tops = tops.map(|top| top.expect("each was filled"));
    let narrow = tops.each_ref().map(Top::narrowest);
    let together = narrow.iter().flatten().map(|plateau| plateau.pixels).sum();
    let is_one_value = narrow[0].is_some_and(|first| {
        narrow.iter().all(|plateau| {
            plateau.is_some_and(|plateau| plateau.brightest.total_cmp(&first.brightest).is_eq())
        })
    });
    let found: [Option<Plateau>; CHANNELS] = std::array::from_fn(|channel| {
        let top = &tops[channel];
        let shared = narrow[channel].filter(|plateau| is_one_value && plateau.is_cut(top, together));
        shared.into_iter().chain(top.plateau()).reduce(Plateau::or_wide)
    });
    let found: [Option<Plateau>; CHANNELS] = std::array::from_fn(|channel| {
        found[channel].or_else(|| found.iter().flatten().find_map(|other| tops[channel].plateau_as(other)))
    });
    // All of a plateau saturates.
    let level = |brightest: f32, darkest: f32| brightest.min(darkest / saturated_from(1.0));
    let shaded = match found.iter().all(|found| found.is_some_and(|found| !found.is_wide())) {
        true => [None; CHANNELS],
        false => shaded_whites(
            std::array::from_fn(|channel| image.channel(channel)),
            tops.each_ref().map(Top::brightest),
        ),
    };
    std::array::from_fn(|channel| {
        let found = found[channel];
        let shaded = shaded[channel]
            .filter(|_| found.is_none_or(|found| found.is_wide()))
            .map(|white| (level(white.level, white.darkest), white.pixels));
        shaded.or_else(|| found.map(|found| (level(found.brightest, found.darkest), found.pixels)))
    })
}

/// Whether the brightest pixels of a linear capture end like a cut about this light, as those do whose shading was taken out after they were
/// clipped: above it, and further above in the corners.
pub fn saturates_about(image: &LinearImage, level: f32) -> bool {
    /// What the gain of a shading adds where the first pixels saturate.
    const ABOUT: std::ops::Range<f32> = 0.95..1.5;
    let found = cut_levels(image);
    found.iter().any(Option::is_some)
        && found.iter().flatten().all(|(found, _)| ABOUT.contains(&(found / level)))
}

/// Finds the white level of each channel of a capture, as [`cut_levels`]. Channels without one saturate above all that they show: at
/// x_max, in units as the curve's.
///
/// The second number is how many pixels were found to be saturated.
pub(super) fn find_levels(image: &LinearImage, curve: ToneCurve) -> ([f32; CHANNELS], usize) {
    let found = cut_levels(image);
    let count = found.iter().flatten().map(|(_, count)| count).sum();
    let unknown = if found.iter().all(Option::is_some) { curve.x_max } else { unknown_level(curve, image) };
    (found.map(|found| found.map_or(unknown, |(level, _)| level)), count)
}

/// As [`find_levels`], of a capture whose file holds no light above `most`, where that is told: the x_max of a tone-mapped one.
pub(super) fn find_levels_below(
    image: &LinearImage,
    curve: ToneCurve,
    most: Option<f32>,
) -> ([f32; CHANNELS], usize) {
    let (levels, count) = find_levels(image, curve);
    (levels.map(|level| most.map_or(level, |most| level.min(most))), count)
}

/// The levels that files tell, or those that the capture shows below them, as where a sensor is full before its converter is; whether
/// it shows any. All channels end at one share of what they are told to, however their white is balanced.
pub(super) fn corrected_levels(image: &LinearImage, told: [f32; CHANNELS]) -> ([f32; CHANNELS], bool) {
    // Far below, flat light is more plausible than a white.
    const LEAST: f32 = 0.8;
    let mut shares: Array3<f32> = image.planes().to_owned();
    for (mut plane, told) in shares.outer_iter_mut().zip(told) {
        plane.mapv_inplace(|light| light / told);
    }
    let found = LinearImage::from_planes(shares).map_or([None; CHANNELS], |shares| cut_levels(&shares));
    let below = |channel: usize| {
        let (share, _) = found[channel]?;
        (LEAST..saturated_from(1.0)).contains(&share).then_some(share * told[channel])
    };
    let below: [Option<f32>; CHANNELS] = std::array::from_fn(below);
    (
        std::array::from_fn(|channel| below[channel].unwrap_or(told[channel])),
        below.iter().any(Option::is_some),
    )
}

/// What the brightest pixels of each channel show to saturate it, where that is below what is told to.
pub(super) fn doubted_levels(image: &LinearImage, told: [f32; CHANNELS]) -> Option<[Option<f32>; CHANNELS]> {
    let found = cut_levels(image);
    let doubted: [Option<f32>; CHANNELS] = std::array::from_fn(|channel| {
        found[channel].map(|(level, _)| level).filter(|level| *level < saturated_from(told[channel]))
    });
    doubted.iter().any(Option::is_some).then_some(doubted)
}

/// The levels that light of the capture reaches: those of the others were not found in it.
pub(super) fn reached_levels(image: &LinearImage, levels: [f32; CHANNELS]) -> [Option<f32>; CHANNELS] {
    std::array::from_fn(|channel| {
        let level = levels[channel];
        image.channel(channel).iter().any(|light| *light >= saturated_from(level)).then_some(level)
    })
}

/// Whether a restored image holds light above what saturates its capture, by more than pixels of a plateau differ.
pub(super) fn is_surpassed(saturation: [f32; CHANNELS], restored: &LinearImage) -> bool {
    let brightest = |channel| restored.channel(channel).iter().copied().fold(0.0, f32::max);
    (0..CHANNELS).any(|channel| saturated_from(brightest(channel)) > saturation[channel])
}

/// What is to be told of a restored image: what is known of its capture, and the levels that were found in it. One that `shines_above`
/// them is clipped nowhere, and files hold no [other levels](is_level) than sensors have.
pub(super) fn info_of(
    info: Option<CaptureInfo>,
    found: Option<[f32; CHANNELS]>,
    shines_above: bool,
) -> Option<CaptureInfo> {
    if shines_above {
        return info.map(|info| CaptureInfo { saturation: None, ..info });
    }
    // A channel that does not saturate has a level far above; white balance is not by more than this.
    const MOST_APART: f32 = 10.0;
    let is_of_all = |levels: &[f32; CHANNELS]| {
        let [least, most] = [f32::min, f32::max].map(|of| levels.iter().copied().fold(levels[0], of));
        most <= MOST_APART * least
    };
    match found.filter(|levels| is_of_all(levels) && levels.iter().all(|level| is_level(*level))) {
        Some(levels) => Some(CaptureInfo { saturation: Some(levels), ..info.unwrap_or_default() }),
        None => info,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng;
    use rand_distr::{Distribution, StandardNormal};

    const USUAL: ToneCurve = ToneCurve { alpha: 0.25, x_max: 500.0 };

    fn scene(limit: f32) -> LinearImage {
        let light = |y: usize, x: usize| {
            0.2 + 90.0 * (-((y as f32 - 30.0).powi(2) + (x as f32 - 20.0).powi(2)) / 80.0).exp()
        };
        LinearImage::from_planes(Array3::from_shape_fn((3, 64, 64), |(_, y, x)| light(y, x).min(limit)))
            .unwrap()
    }

    #[test]
    fn a_lamp_that_is_cut_off_saturates_and_one_that_is_not_does_not() {
        let (levels, count) = find_levels(&scene(16.0), USUAL);
        assert_eq!(levels, [16.0; 3]);
        assert!(count > 3 * 100, "{count}");
        assert_eq!(find_levels(&scene(1e3), USUAL), ([500.0; 3], 0));
        assert_eq!(find_levels_below(&scene(1e3), USUAL, Some(16.0)), ([16.0; 3], 0));
    }

    #[test]
    fn an_image_that_is_brighter_than_usual_is_below_its_own_level() {
        let bright = LinearImage::from_planes(scene(1e3).into_planes() * 10.0).unwrap();
        let (levels, count) = find_levels(&bright, USUAL);
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
    }

    #[test]
    fn a_dark_capture_keeps_its_curve_where_its_level_is_told() {
        let (curve, dark) =
            (ToneCurve::new(0.25, 16.0).unwrap(), scene(1e3).map_values(|value| 6e-3 * value));
        assert!(suited_curve(curve, &dark).alpha < 0.1);
        assert_eq!(curve_of_told(curve, &dark), curve);
        // White is 1: nobody knows how dark that is.
        let of_one = ToneCurve::new(0.25, 1.0).unwrap();
        assert_eq!(curve_of_told(of_one, &dark), suited_curve(of_one, &dark));
    }

    #[test]
    fn a_flat_or_dark_image_is_not_white() {
        let dark = LinearImage::from_planes(Array3::zeros((3, 8, 8))).unwrap();
        assert_eq!(find_levels(&dark, USUAL), ([500.0; 3], 0));
        let wall = LinearImage::from_planes(Array3::from_elem((3, 8, 8), 0.5)).unwrap();
        assert_eq!(find_levels(&wall, USUAL), ([500.0; 3], 0));
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
        assert_eq!(find_levels(&lamp([4.0; 3]), USUAL), ([4.0; 3], 30));
        assert_eq!(find_levels(&lamp([4.0, 3.0, 2.0]), USUAL), ([500.0; 3], 0));
    }

    /// Few pixels, and gains apart: they end at one share of what they are told to.
    #[test]
    fn a_small_lamp_that_ends_below_what_balanced_channels_are_told_to_is_cut_off_there() {
        let told = [4.0, 3.0, 2.0];
        let ending_at = |share: f32| {
            let light = |(c, y, x): (usize, usize, usize)| {
                let is_lamp = (10..12).contains(&y) && (20..25).contains(&x);
                if is_lamp { share * told[c] } else { 0.1 + 0.001 * ((y * 7 + x * 3) % 11) as f32 }
            };
            LinearImage::from_planes(Array3::from_shape_fn((3, 32, 32), light)).unwrap()
        };
        assert_eq!(corrected_levels(&ending_at(0.875), told), (told.map(|level| 0.875 * level), true));
        assert_eq!(corrected_levels(&ending_at(0.5), told), (told, false), "a wall, or a paler lamp");
    }

    /// Light in steps of 1/60 has many pixels at its brightest value, and as many one step below.
    #[test]
    fn coarse_steps_are_not_taken_for_saturation() {
        let light = |(_, y, x): (usize, usize, usize)| {
            let distance = (y as f32 - 30.0).hypot(x as f32 - 20.0);
            ((60.0 * (1.2 - distance / 40.0)).round() / 60.0).max(0.1)
        };
        let coarse = LinearImage::from_planes(Array3::from_shape_fn((3, 64, 64), light)).unwrap();
        assert_eq!(find_levels(&coarse, USUAL), ([500.0; 3], 0));
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

    /// A sensor that is full before its converter is, or a picture whose white is at code 240.
    #[test]
    fn a_white_below_the_one_that_a_file_tells_is_found() {
        for (cut, told, expected) in [
            (0.9, 1.0, ([0.9; 3], true)),
            (0.995, 1.0, ([1.0; 3], false)),
            (0.5, 1.0, ([1.0; 3], false)),
            (16.0, 12.0, ([12.0; 3], false)),
        ] {
            assert_eq!(corrected_levels(&scene(cut), [told; 3]), expected, "{cut} of {told}");
        }
    }

    #[test]
    fn a_level_that_is_told_and_that_nothing_reaches_is_doubted() {
        assert_eq!(doubted_levels(&scene(16.0), [16.17; 3]), Some([Some(16.0); 3]));
        assert_eq!(doubted_levels(&scene(16.0), [16.1; 3]), None);
        assert_eq!(doubted_levels(&scene(16.0), [16.0, 20.0, 16.0]), Some([None, Some(16.0), None]));
        assert_eq!(doubted_levels(&scene(1e3), [500.0; 3]), None, "it shows no white");
    }

    /// Nothing is cut off in any of these units: what may saturate is as far above all of it.
    #[test]
    fn unknown_levels_are_in_the_units_of_the_capture() {
        let image = scene(1e3);
        for unit in [1e-4, 1.0 / 90.0, 4095.0] {
            let (levels, count) = find_levels(&image.map_values(|value| unit * value), USUAL);
            let over_brightest = levels[1] / (unit * image.max());
            assert!(count == 0 && (1.5..50.0).contains(&over_brightest), "{unit}: {levels:?}");
        }
    }

    /// Light of which the brightest is 1, as HDR images are often divided.
    #[test]
    fn a_dark_scene_whose_white_is_one_is_mapped_as_if_it_were_brighter() {
        let image = scene(16.0).map_values(|value| value / 16.0);
        let curve = suited_curve(ToneCurve::new(0.25, 1.0).unwrap(), &image);
        let median = 0.2 / 16.0;
        assert!((curve.alpha / (ALPHA_OVER_MEDIAN * median) - 1.0).abs() < 0.1, "{curve:?}");
        let exposed = image.map_values(|value| (6.0 * value).min(1.0));
        assert_eq!(suited_curve(USUAL, &exposed), USUAL);
    }

    /// A night of 10 bits, in whose dark there is little but noise: what is bright is not flattened.
    #[test]
    fn where_the_dark_is_noise_alpha_is_above_it() {
        let night = |noise: f32| {
            let mut rng = rng::stream(5, "night");
            let planes =
                Array3::from_shape_simple_fn((3, 64, 64), || -> f32 { StandardNormal.sample(&mut rng) });
            let light = |((_, y, x), normal): ((usize, usize, usize), &f32)| {
                let is_lit = (20..30).contains(&y) && (10..40).contains(&x);
                if is_lit { 0.5 + 0.05 * normal } else { (1e-3 + noise * normal).max(0.0) }
            };
            let mut lit = planes.clone();
            planes.indexed_iter().zip(&mut lit).for_each(|(pixel, lit)| *lit = light(pixel));
            LinearImage::from_planes(lit).unwrap()
        };
        let alpha = |image: &LinearImage| suited_curve(ToneCurve::new(0.25, 1.0).unwrap(), image).alpha;
        assert!(
            (alpha(&night(1e-5)) / (ALPHA_OVER_MEDIAN * 1e-3) - 1.0).abs() < 0.1,
            "{}",
            alpha(&night(1e-5))
        );
        assert!((0.01..=0.021).contains(&alpha(&night(1e-3))), "{}", alpha(&night(1e-3)));
        // Most of it zero, the rest steps.
        let steps = night(1e-3).map_values(|value| (value * 1023.0 - 0.8).round().max(0.0) / 1023.0);
        assert!((0.005..=0.021).contains(&alpha(&steps)), "{}", alpha(&steps));
    }

    #[test]
    fn a_channel_that_does_not_saturate_has_no_level_to_tell() {
        let mut planes = scene(1e3).into_planes();
        planes.index_axis_mut(ndarray::Axis(0), 1).mapv_inplace(|light| light.min(16.0));
        let image = LinearImage::from_planes(planes).unwrap();
        let (levels, count) = find_levels(&image, USUAL);
        assert_eq!((levels, count > 0), ([500.0, 16.0, 500.0], true));
        assert_eq!(reached_levels(&image, levels), [None, Some(16.0), None]);
    }

    /// Counts of 8 bits, which do not reach the usual x-max.
    #[test]
    fn bright_units_are_told_by_the_median() {
        let image = scene(1.0).map_values(|value| 255.0 * value);
        let curve = suited_curve(ToneCurve::new(0.25, 255.0).unwrap(), &image);
        assert!((curve.alpha / (ALPHA_OVER_MEDIAN * 0.2 * 255.0) - 1.0).abs() < 0.1, "{curve:?}");
    }

    /// Five times as bright as usual: no other units, but another α.
    #[test]
    fn bright_captures_are_mapped_by_their_median_and_saturate_where_others_do() {
        let image = scene(1e3).map_values(|value| 5.0 * value);
        let curve = suited_curve(USUAL, &image);
        assert!((curve.alpha / (ALPHA_OVER_MEDIAN * 0.2 * 5.0) - 1.0).abs() < 0.1, "{curve:?}");
        assert_eq!(find_levels(&image, USUAL), ([USUAL.x_max; CHANNELS], 0));
        assert_eq!(suited_curve(USUAL, &scene(1e3)), USUAL);
    }

    #[test]
    fn levels_are_told_of_no_image_that_shines_above_them_and_as_far_as_files_hold_them() {
        let told = |found, shines_above| {
            let info = CaptureInfo { saturation: Some([4.0; 3]), ..CaptureInfo::default() };
            info_of(Some(info), found, shines_above).unwrap().saturation
        };
        assert_eq!(told(None, false), Some([4.0; 3]));
        assert_eq!(told(Some([3.0; 3]), false), Some([3.0; 3]));
        assert_eq!((told(None, true), told(Some([3.0; 3]), true)), (None, None));
        assert_eq!(info_of(None, Some([2e-8; 3]), false), None, "nobody reads such a level");
        assert!(is_surpassed([500.0, 80.0, 500.0], &scene(1e3)) && !is_surpassed([100.0; 3], &scene(1e3)));
        assert!(!is_surpassed([16.0; 3], &scene(16.0)));
    }
}
