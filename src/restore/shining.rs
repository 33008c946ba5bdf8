//! Keeps saturated pixels from being darker than the light that is found around them.

use ndarray::parallel::prelude::*;
use ndarray::{ArrayView2, Axis};

use crate::core::error::Result;
use crate::core::image::{CHANNELS, Image, LinearImage, ToneMappedImage, row_of};
use crate::core::saturation::saturated_from;

/// How far around a pixel its neighbourhood reaches along rows and columns.
const REACH_PX: usize = 4;

/// The share of its neighbourhood that a saturated pixel is not darker than. Views of panoramas with panes and lamps gain 0.02 to
/// 0.15 dB by it, painted ones lose 0.05 through one panel and gain 0.07 through another; one of these loses 0.3.
const OUTSHONE: f64 = 0.35;

/// Raises saturated pixels of a network's image to what a share of their neighbourhood in the deconvolved image is darker than.
///
/// A network that cannot tell where a lamp ends takes something between it and the dark for each of its pixels, though within a
/// pane all that is around shines.
///
/// # Errors
/// Never: values of images are finite.
pub(super) fn shining(
    restored: ToneMappedImage,
    deconvolved: &ToneMappedImage,
    capture: &LinearImage,
    saturation: [f32; CHANNELS],
) -> Result<ToneMappedImage> {
    let mut planes = restored.into_planes();
    for (channel, mut plane) in planes.outer_iter_mut().enumerate() {
        let (deconvolved, capture) = (deconvolved.channel(channel), capture.channel(channel));
        let from = saturated_from(saturation[channel]);
        let rows = plane.axis_iter_mut(Axis(0)).into_par_iter().enumerate();
        rows.for_each_init(Vec::new, |around, (y, mut row)| {
            for (x, (restored, captured)) in row.iter_mut().zip(capture.row(y)).enumerate() {
                if *captured >= from {
                    *restored = restored.max(least(deconvolved, (y, x), *restored, around));
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

    const SIDE: usize = 32;
    const LAMP: std::ops::Range<usize> = 10..20;

    fn image<D: crate::core::image::Domain>(value: impl Fn(usize, usize) -> f32) -> Image<D> {
        Image::from_planes(Array3::from_shape_fn((CHANNELS, SIDE, SIDE), |(_, y, x)| value(y, x))).unwrap()
    }

    /// A pane of ten pixels a side whose glare saturates two more, of which a network takes 0.5 everywhere.
    fn restored(deconvolved: impl Fn(usize, usize) -> f32) -> ToneMappedImage {
        let near = |at: usize| (LAMP.start - 2..LAMP.end + 2).contains(&at);
        let capture = image(|y, x| if near(y) && near(x) { 4.0 } else { 0.3 });
        shining(image(|_, _| 0.5), &image(deconvolved), &capture, [4.0; CHANNELS]).unwrap()
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

    /// As sorting all of the neighbourhood has it.
    #[test]
    fn the_least_is_the_share_of_the_sorted_neighbourhood() {
        let plane = ndarray::Array2::from_shape_fn((12, 15), |(y, x)| ((y * 31 + x * 17) % 29) as f32);
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
