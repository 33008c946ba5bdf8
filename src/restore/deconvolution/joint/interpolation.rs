//! Tells from the finest detail of a capture whether its pixels were measured or interpolated from others, or whether it is the scene's.
//!
//! A pixel beside a saturated one that was measured is known like any other; one that was interpolated from it holds a part
//! of what was clipped. Noise of pixels that were measured is white, and that of one colour tells nothing of another's;
//! interpolation takes it out of the finest detail, and demosaicing copies the detail of one colour to the others.

use std::array;

use super::noise_level::median;
use super::places::{Place, places_of};
use crate::core::image::{CHANNELS, LinearImage};

/// Pixels without which nothing is told.
const LEAST_PIXELS: usize = 400;

/// The variance of the finest detail over that of the next band, between which noise counts as white. Of views with the noise of a sensor
/// most have 0.6 to 1.1, and those of leaves, glints, text and stone 0.4 to 0.9, in which the scene has detail as fine; interpolated
/// bilinearly, all have less than 0.03, and demosaiced by gradients 0.2 to 0.5, but streets at night and text up to 1.3.
pub(super) const WHITE: [f32; 2] = [0.35, 1.4];

/// How far from a half the share of like signs of two colours' finest detail may be: of 41 views with noise 40 have 0.49 to 0.56 in all
/// pairs; demosaiced by gradients all of 44 have 0.68 to 0.86 in one pair at least. Bilinear interpolation leaves a half, but no white noise.
const UNLIKE: f32 = 0.1;

/// The share of like signs of all pairs of colours from which on what is finest is the scene's own detail and no noise, demosaiced or not.
/// Of foliage and bright halls in little noise all pairs have 0.84 to 0.92.
const SHARED: f32 = 0.8;

/// The same from which on some of it is the scene's, where the pairs share it evenly: of 54 captures of leaves, walls and print whose detail
/// is as fine as their pixels 27 have it in all pairs, and of 30 that are demosaiced along edges none.
const PARTLY_SHARED: f32 = 0.6;

/// How far the shares of like signs of the pairs of colours may lie apart where pixels were measured and share the scene's detail:
/// demosaicing copies that of green to red and to blue, which share less. Six captures of print and twigs have 0.003 to 0.05; of 16
/// that are demosaiced by gradients those whose finest detail passes for white have 0.09 and 0.15.
const EVEN: f32 = 0.06;

/// What the finest detail of a capture is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Finest {
    /// Whether pixels seem to have been interpolated.
    pub(super) is_interpolated: bool,
    /// Whether all colours share it: it is the scene's, and stronger than noise.
    pub(super) is_shared: bool,
    /// Whether it was measured, and is noise, or detail that all colours share evenly.
    pub(super) is_measured: bool,
    /// Whether pixels beside saturated ones may hold a part of what was clipped: whether they seem to have been interpolated, and not by
    /// detail alone that the pairs of colours share evenly. To disbelieve those that were measured costs 4 to 10 dB of print on overexposed
    /// paper; to believe those that were not costs 0.9 dB of 16 demosaiced captures.
    pub(super) is_guarded: bool,
}

impl Finest {
    /// Of a capture whose pixels are saturated from this light on. If in doubt, as where detail hides the noise, they were interpolated.
    pub(super) fn of(image: &LinearImage, alpha: f32, saturated_from: [f32; CHANNELS]) -> Self {
        Self::of_places(&places_of(image, alpha, saturated_from))
    }

    /// The same of the capture of these pixels.
    pub(super) fn of_places(places: &[Place]) -> Self {
        let calm = calmer_half(places);
        if calm.len() < LEAST_PIXELS {
            return Self { is_interpolated: true, is_shared: false, is_measured: false, is_guarded: true };
        }
        let is_white = |channel: usize| {
            let variance = |of: &dyn Fn(&Place) -> f32| {
                let mut moduli: Vec<f32> = calm.iter().map(|place| of(place).abs()).collect();
                median(&mut moduli).map_or(0.0, |m| m * m)
            };
            let (finest, fine) =
                (variance(&|place| place.finest()[channel]), variance(&|place| place.fine()[channel]));
            finest > WHITE[0] * fine && finest < WHITE[1] * fine
        };
        let alike: [f32; CHANNELS] = array::from_fn(|a| {
            let b = (a + 1) % CHANNELS;
            let alike = calm.iter().filter(|place| place.finest()[a] * place.finest()[b] > 0.0).count();
            alike as f32 / calm.len() as f32
        });
        let are_apart = alike.iter().all(|share| (share - 0.5).abs() <= UNLIKE);
        let is_white = (0..CHANNELS).all(is_white);
        let is_shared = alike.iter().all(|share| *share >= SHARED);
        let is_interpolated = !(are_apart && is_white);
        let [least, most] = [f32::min, f32::max].map(|of| alike.into_iter().fold(alike[0], of));
        let is_even = most - least <= EVEN;
        let is_partly_shared = alike.iter().all(|share| *share >= PARTLY_SHARED);
        let is_measured = !is_interpolated || is_shared || is_even && is_partly_shared;
        let is_guarded = is_interpolated && !(is_even && (is_white || is_shared));
        Self { is_interpolated, is_shared, is_measured, is_guarded }
    }
}

/// The half of the places with the least coarse detail, each colour's relative to its median: there noise shows.
fn calmer_half(places: &[Place]) -> Vec<&Place> {
    let medians: [f32; CHANNELS] = array::from_fn(|channel| {
        let mut moduli: Vec<f32> = places.iter().map(|place| place.coarse()[channel].abs()).collect();
        median(&mut moduli).unwrap_or(0.0).max(f32::MIN_POSITIVE)
    });
    let liveliness = |place: &Place| -> f32 {
        place.coarse().iter().zip(&medians).map(|(detail, m)| detail.abs() / m).sum()
    };
    let mut places: Vec<&Place> = places.iter().collect();
    let half = places.len() / 2;
    if half > 0 {
        places.select_nth_unstable_by(half, |a: &&Place, b: &&Place| liveliness(a).total_cmp(&liveliness(b)));
        places.truncate(half);
    }
    places
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, Array3, Zip};
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::capture::bayer::{BayerPattern, demosaic_scene};
    use crate::core::rng;

    const ALPHA: f32 = 0.25;

    /// Slow gradients with 2 % of noise.
    fn capture() -> Array3<f32> {
        let mut rng = rng::stream(5, "interpolation");
        Array3::from_shape_fn((CHANNELS, 160, 200), |(channel, y, x)| {
            let light = 0.4 + 0.3 * (x as f32 / 40.0 + channel as f32).sin() * (y as f32 / 30.0).cos();
            let normal: f32 = StandardNormal.sample(&mut rng);
            light + 0.02 * (light + ALPHA) * normal
        })
    }

    fn finest(planes: Array3<f32>) -> Finest {
        Finest::of(&LinearImage::from_planes(planes).unwrap(), ALPHA, [15.9; CHANNELS])
    }

    fn seems_interpolated(planes: Array3<f32>) -> bool {
        finest(planes).is_interpolated
    }

    #[test]
    fn measured_pixels_are_told_from_demosaiced_and_smoothed_ones() {
        let measured = capture();
        let pattern = BayerPattern::Rggb;
        let mosaic = Array2::from_shape_fn((160, 200), |(y, x)| measured[[pattern.channel(y, x), y, x]]);
        let smoothed = Array3::from_shape_fn((CHANNELS, 159, 200), |(channel, y, x)| {
            0.5 * (measured[[channel, y, x]] + measured[[channel, y + 1, x]])
        });
        assert_eq!(
            finest(measured),
            Finest { is_interpolated: false, is_shared: false, is_measured: true, is_guarded: false }
        );
        assert!(!finest(demosaic_scene(mosaic.view(), pattern).unwrap()).is_shared);
        assert!(seems_interpolated(demosaic_scene(mosaic.view(), pattern).unwrap()));
        assert!(seems_interpolated(smoothed));
    }

    /// Grain of 10 %, of all colours, and the noise of each.
    #[test]
    fn detail_that_all_colours_share_is_told_from_noise() {
        let mut rng = rng::stream(6, "grain");
        let grain = Array2::from_shape_simple_fn((160, 200), || {
            let normal: f32 = StandardNormal.sample(&mut rng);
            1.0 + 0.1 * normal
        });
        let mut grained = capture();
        grained.outer_iter_mut().for_each(|mut plane| plane *= &grain);
        assert!(finest(grained.clone()).is_shared);
        assert!(!finest(grained.clone()).is_guarded, "what was measured is known beside saturated pixels");
        let weak =
            Zip::from(&grained).and(&capture()).map_collect(|grained, smooth| 0.3 * grained + 0.7 * smooth);
        let Finest { is_interpolated, is_shared, is_guarded, .. } = finest(weak);
        assert!(is_interpolated && !is_shared && !is_guarded, "detail is evenly shared");
        let pattern = BayerPattern::Rggb;
        let mosaic = Array2::from_shape_fn((160, 200), |(y, x)| grained[[pattern.channel(y, x), y, x]]);
        assert!(finest(demosaic_scene(mosaic.view(), pattern).unwrap()).is_guarded);
    }

    #[test]
    fn without_noise_or_pixels_nothing_is_trusted() {
        assert!(seems_interpolated(Array3::from_elem((CHANNELS, 64, 64), 0.5)));
        assert!(seems_interpolated(Array3::zeros((CHANNELS, 3, 3))));
        assert!(seems_interpolated(Array3::from_elem((CHANNELS, 64, 64), 20.0)));
    }
}
