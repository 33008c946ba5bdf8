//! Tells where a capture is saturated gently: where the scene comes up to the light that saturates slowly, as in snow, skies and white walls.

use ndarray::{Array2, ArrayView2, Zip};

use super::cells::cells;
use crate::core::image::row_of;

/// How far from saturated pixels those lie that tell how a scene comes up to saturation, in pixels along rows and columns: next to them
/// there is a part of them.
const BESIDE_PX: [usize; 2] = [2, 3];

/// The light beside saturated pixels, as a share of what saturates, from which on some of the scene, and all of it, comes up gently. Of 84
/// overexposed frames (192 × 192, through six panels), 21 lost 5.1 dB on average by a network's corrections, snow up to 14; these lose 0.5
/// now, and of what the others gain 0.12 dB are lost, 1.1 at most.
const GENTLE: [f32; 2] = [0.75, 0.85];

/// Light of saturated pixels, in multiples of what saturates, from which on some of what is around them is a lamp's, and all of it: it has
/// flare that a network may take.
const LAMP: [f32; 2] = [1.5, 2.0];

/// The share of the edges of saturated areas in each cell and its neighbours that are gentle, of a capture and the scene that a
/// deconvolution makes of it; zero where there are no edges.
///
/// A lamp is far above what saturates and ends at once: around it a deconvolution leaves haze, which a network rightly takes. What
/// saturates gently is little brighter than that, and has little haze: a network that takes it paints snow grey.
pub(super) fn gentle_edges(
    capture: ArrayView2<'_, f32>,
    scene: ArrayView2<'_, f32>,
    saturated_from: f32,
) -> Array2<f32> {
    let (height, width) = capture.dim();
    let sums = running_sums(capture, saturated_from);
    // How many saturated pixels there are in a square around a pixel.
    let count = |y: usize, x: usize, reach: usize| {
        let [top, left] = [y, x].map(|at| at.saturating_sub(reach));
        let [bottom, right] = [(y + reach + 1).min(height), (x + reach + 1).min(width)];
        sums[[bottom, right]] + sums[[top, left]] - sums[[top, right]] - sums[[bottom, left]]
    };
    let is_edge = |y: usize, x: usize| count(y, x, BESIDE_PX[1]) > 0 && count(y, x, BESIDE_PX[0] - 1) == 0;
    let is_saturated = |y: usize, x: usize| capture[[y, x]] >= saturated_from;
    let gentle = |light: f32| within(light / saturated_from, GENTLE);
    let edges = mean((height, width), is_edge, |y, x| gentle(scene[[y, x]]));
    let inside = mean((height, width), is_saturated, |y, x| scene[[y, x]] / saturated_from);
    Zip::from(&edges).and(&inside).map_collect(|edges, inside| edges * (1.0 - within(*inside, LAMP)))
}

/// The mean of what those pixels have that are meant, over cells and their neighbours; zero where there are none.
fn mean(
    size: (usize, usize),
    is_meant: impl Fn(usize, usize) -> bool + Sync,
    value: impl Fn(usize, usize) -> f32 + Sync,
) -> Array2<f32> {
    let sum = |value: &(dyn Fn(usize, usize) -> f32 + Sync)| {
        cells(size, |y, out| {
            let write = |(x, out): (usize, &mut f32)| *out = if is_meant(y, x) { value(y, x) } else { 0.0 };
            out.iter_mut().enumerate().for_each(write);
        })
    };
    sum(&value) / sum(&|_, _| 1.0).mapv(|count| count.max(1.0))
}

/// How far a value is from the first to the second.
fn within(value: f32, [none, all]: [f32; 2]) -> f32 {
    ((value - none) / (all - none)).clamp(0.0, 1.0)
}

/// How many saturated pixels lie above and to the left of each corner of pixels.
fn running_sums(capture: ArrayView2<'_, f32>, saturated_from: f32) -> Array2<u32> {
    let (height, width) = capture.dim();
    let mut sums = Array2::zeros((height + 1, width + 1));
    for y in 0..height {
        let mut of_row = 0;
        for (x, value) in row_of(capture, y).iter().enumerate() {
            of_row += u32::from(*value >= saturated_from);
            sums[[y + 1, x + 1]] = sums[[y, x + 1]] + of_row;
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 96;

    /// The share at the edge of a saturated half, of light that goes on to the other half as told.
    fn share(light: impl Fn(usize) -> f32) -> f32 {
        let scene = Array2::from_shape_fn((SIDE, SIDE), |(_, x)| light(x));
        let shares = gentle_edges(scene.mapv(|light| light.min(4.0)).view(), scene.view(), 4.0);
        assert_eq!(shares.dim(), (6, 6));
        assert!(shares.column(0).iter().all(|share| *share == 0.0), "no edge is near: {shares}");
        shares[[3, 2]]
    }

    /// From the light `inside` of a saturated half to that beside it, which falls slowly.
    fn step(inside: f32, beside: f32) -> f32 {
        share(|x| if x < SIDE / 2 { inside } else { beside - 0.01 * (x - SIDE / 2) as f32 })
    }

    #[test]
    fn snow_comes_up_gently_and_neither_a_window_nor_a_lamp_does() {
        assert_eq!(step(5.0, 3.9), 1.0);
        assert_eq!(step(5.0, 2.0), 0.0);
        assert_eq!(step(8.1, 3.9), 0.0, "of a lamp what is beside it is flare");
        for between in [step(5.0, 3.2), step(7.0, 3.9)] {
            assert!((0.3..0.6).contains(&between), "{between}");
        }
    }

    #[test]
    fn what_is_next_to_saturated_pixels_is_not_asked() {
        // A window whose edge is blurred over two pixels.
        let window = |x: usize| match x {
            0..48 => 5.0,
            48 => 3.9,
            _ => 1.0,
        };
        assert_eq!(share(window), 0.0);
    }

    #[test]
    fn without_edges_there_are_no_gentle_ones() {
        for size in [(1, 1), (1, 5), (40, 17)] {
            let light = Array2::from_elem(size, 0.9);
            for saturated_from in [1.0, 0.9] {
                let shares = gentle_edges(light.view(), light.view(), saturated_from);
                assert!(shares.iter().all(|share| *share == 0.0), "{size:?} {saturated_from}: {shares}");
            }
        }
    }
}
