//! Keeps saturated pixels from being darker than the light that is found around them, and lamps from going out.

use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView2, Axis};

use super::peaks::brightest_near;
use crate::core::error::Result;
use crate::core::image::{CHANNELS, Image, LinearImage, ToneMappedImage, row_of};
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;

/// How far around a pixel its neighbourhood reaches along rows and columns.
const REACH_PX: usize = 4;

/// The share of its neighbourhood that a saturated pixel is not darker than. Views of panoramas with panes and lamps gain 0.02 to
/// 0.15 dB by it, painted ones lose 0.05 through one panel and gain 0.07 through another; one of these loses 0.3.
const OUTSHONE: f64 = 0.35;

/// How far around a lamp's pixel the light of each colour may be told.
const BESIDE_PX: usize = 1;

/// Raises saturated pixels of a network's image to what a share of their neighbourhood in the deconvolved image is darker than, and those
/// of lamps, which are `peaks` of the light that is found, to the brightest that is beside them, up to what saturates.
///
/// A network that cannot tell where a lamp ends takes something between it and the dark for each of its pixels, though within a
/// pane all that is around shines. So lamps of a pixel or two went out, and others were left grey or of one colour, though their flare tells
/// their light: of eight nights through four panels, 23 % of the white pixels of lamps were dark and 49 % coloured, of the same
/// demosaiced 85 % and 35 %, where now none is of either; the means of all pixels are 0.4 and 0.8 dB better.
///
/// # Errors
/// Never: values of images are finite.
pub(super) fn shining(
    restored: ToneMappedImage,
    deconvolved: &ToneMappedImage,
    (capture, peaks): (&LinearImage, Option<&Array2<bool>>),
    (saturation, curve): ([f32; CHANNELS], ToneCurve),
) -> Result<ToneMappedImage> {
    let mut planes = restored.into_planes();
    for (channel, mut plane) in planes.outer_iter_mut().enumerate() {
        let (deconvolved, capture) = (deconvolved.channel(channel), capture.channel(channel));
        let from = saturated_from(saturation[channel]);
        let white = curve.compress(saturation[channel]);
        let rows = plane.axis_iter_mut(Axis(0)).into_par_iter().enumerate();
        rows.for_each_init(Vec::new, |around, (y, mut row)| {
            for (x, (restored, captured)) in row.iter_mut().zip(capture.row(y)).enumerate() {
                if *captured >= from {
                    *restored = restored.max(least(deconvolved, (y, x), *restored, around));
                    if peaks.is_some_and(|peaks| peaks[[y, x]]) {
                        *restored = restored.max(brightest_near(deconvolved, (y, x), BESIDE_PX).min(white));
                    }
                }
            }
        });
    }
    Image::from_planes(planes)
}

/// What the share of a pixel's neighbourhood is darker than, if that is above `found`, or less than that.
fn least(plane: ArrayView2<'_, f32>, (y, x): (usize, usize), found: f32, around: &mut Vec<f32>) -> f32 {
    let (height, width) = plane.dim();
    let rows = y.saturating_sub(REACH_PX)..(y + REACH_PX + 1).min(height);
    let columns = x.saturating_sub(REACH_PX)..(x + REACH_PX + 1).min(width);
    let pixels = rows.len() * columns.len();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of some pixels")]
    let darker = (OUTSHONE * (pixels - 1) as f64).round() as usize;
    around.clear();
    for y in rows {
        around.extend_from_slice(&row_of(plane, y)[columns.clone()]);
    }
    // All that is not brighter comes first.
    let brighter = around.iter().filter(|value| **value > found).count();
    if darker < pixels - brighter {
        return found;
    }
    *around.select_nth_unstable_by(darker, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    const CURVE: ToneCurve = ToneCurve { alpha: 0.25, x_max: 16.0 };
    const SIDE: usize = 32;
    const LAMP: std::ops::Range<usize> = 10..20;

    fn image<D: crate::core::image::Domain>(value: impl Fn(usize, usize) -> f32) -> Image<D> {
        Image::from_planes(Array3::from_shape_fn((CHANNELS, SIDE, SIDE), |(_, y, x)| value(y, x))).unwrap()
    }

    /// A pane of ten pixels a side whose glare saturates two more, of which a network takes 0.5 everywhere.
    fn restored(deconvolved: impl Fn(usize, usize) -> f32) -> ToneMappedImage {
        let near = |at: usize| (LAMP.start - 2..LAMP.end + 2).contains(&at);
        let capture = image(|y, x| if near(y) && near(x) { 4.0 } else { 0.3 });
        shining(image(|_, _| 0.5), &image(deconvolved), (&capture, None), ([4.0; CHANNELS], CURVE)).unwrap()
    }

    fn is_pane(y: usize, x: usize) -> bool {
        LAMP.contains(&y) && LAMP.contains(&x)
    }

    #[test]
    fn a_pane_shines_and_its_glare_does_not() {
        let found = restored(|y, x| if is_pane(y, x) { 1.0 } else { 0.2 });
        let found = found.channel(1);
        assert_eq!(found[[15, 15]], 1.0);
        // 0.65 of what is around an edge's pixel has to shine, and 5 of 9 rows do.
        assert_eq!((found[[10, 15]], found[[12, 15]]), (0.5, 1.0));
        assert!(found.indexed_iter().all(|((y, x), value)| *value == 0.5 || is_pane(y, x)));
    }

    #[test]
    fn a_hole_is_filled_and_what_is_not_saturated_stays() {
        let found = restored(|y, x| if (y, x) == (15, 15) { 0.0 } else { 0.9 });
        let found = found.channel(0);
        assert_eq!((found[[15, 15]], found[[8, 8]], found[[7, 7]], found[[0, 0]]), (0.9, 0.9, 0.5, 0.5));
    }

    /// Each colour is as bright as what is told beside it, and no brighter than what saturates it.
    #[test]
    fn lamps_do_not_go_out() {
        let capture = image(|y, x| if y.abs_diff(9) < 3 && x.abs_diff(9) < 3 { 4.0 } else { 0.3 });
        let peaks = Array2::from_shape_fn((SIDE, SIDE), |place| place == (9, 9) || place == (20, 20));
        let deconvolved = image(|y, x| match (y, x) {
            (9, 10) => 0.98,
            (10, 8) => 0.6,
            _ => 0.1,
        });
        let restored = image(|_, _| 0.2);
        let known = ([4.0, 4.0, 16.0], CURVE);
        let found = shining(restored, &deconvolved, (&capture, Some(&peaks)), known).unwrap();
        let white = CURVE.compress(4.0);
        assert_eq!((found.channel(0)[[9, 9]], found.channel(1)[[9, 9]]), (white, white));
        // Blue is not saturated by 4, and no pixel is at the other peak.
        assert_eq!((found.channel(2)[[9, 9]], found.channel(0)[[20, 20]]), (0.2, 0.2));
        assert!(found.channel(0).indexed_iter().all(|(place, value)| *value == 0.2 || place == (9, 9)));
    }

    /// As sorting all of the neighbourhood has it.
    #[test]
    fn the_least_is_the_share_of_the_sorted_neighbourhood() {
        let plane = Array2::from_shape_fn((12, 15), |(y, x)| ((y * 31 + x * 17) % 29) as f32);
        for at in [(0, 0), (5, 7), (11, 3), (6, 14)] {
            let mut sorted: Vec<f32> = plane
                .indexed_iter()
                .filter(|((y, x), _)| y.abs_diff(at.0) <= REACH_PX && x.abs_diff(at.1) <= REACH_PX)
                .map(|(_, value)| *value)
                .collect();
            sorted.sort_by(f32::total_cmp);
            let expected = sorted[((sorted.len() - 1) as f64 * OUTSHONE).round() as usize];
            for found in [-1.0, 5.0, 8.0, 40.0] {
                let least = least(plane.view(), at, found, &mut Vec::new());
                assert_eq!(least.max(found), expected.max(found), "{at:?} {found}");
            }
        }
    }
}
