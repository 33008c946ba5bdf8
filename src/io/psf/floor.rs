//! Finds a background that was left in an energy map that is to be a PSF.

use ndarray::{ArrayView2, s};

/// What every pixel of the edge has, as a share of the whole if all pixels had it, that is not worth a word: of simulated
/// PSFs of 50 to 401 pixels it is at most 0.004.
pub(super) const FLOOR_TOLERANCE: f64 = 0.01;

/// The side of blocks along the edge, in pixels, and the same of the darkest block's mean: where noise was cut at zero, dark pixels hide
/// a background. Of simulated PSFs it is at most 0.003, of one with a third of its light in a wide haze 0.02.
const FLOOR_BLOCK: usize = 8;
const BLOCK_TOLERANCE: f64 = 0.03;

/// A smaller side may be cut so close to the core that its edge is bright.
const LEAST_SIDE_WITH_FLOOR: usize = 31;

/// What each pixel has if all have no more than the darkest of the edge, or than the darkest block there where that is plainly light, as a
/// share of all light; zero for a plane that is small or dark, and one for an even one.
pub(super) fn floor_of(plane: ArrayView2<'_, f32>) -> f64 {
    let (height, width) = plane.dim();
    if height.min(width) < LEAST_SIDE_WITH_FLOOR {
        return 0.0;
    }
    let edges = [plane.row(0), plane.row(height - 1), plane.column(0), plane.column(width - 1)];
    let darkest = edges.iter().flatten().fold(f32::INFINITY, |least, value| least.min(*value));
    let sum: f64 = plane.iter().map(|value| f64::from(*value)).sum();
    let share = |light: f64| light * plane.len() as f64 / sum;
    let [darkest, block] = [share(f64::from(darkest)), share(darkest_block(plane))];
    let floor = if darkest <= FLOOR_TOLERANCE && block > BLOCK_TOLERANCE { block } else { darkest };
    if sum > 0.0 { floor.clamp(0.0, 1.0) } else { 0.0 }
}

/// The least mean of the blocks along a plane's edge.
fn darkest_block(plane: ArrayView2<'_, f32>) -> f64 {
    let (height, width) = plane.dim();
    let (last, right) = (height - FLOOR_BLOCK, width - FLOOR_BLOCK);
    let beside = (0..=last).step_by(FLOOR_BLOCK).flat_map(|y| [(y, 0), (y, right)]);
    let above = (0..=right).step_by(FLOOR_BLOCK).flat_map(|x| [(0, x), (last, x)]);
    let mean = |(y, x): (usize, usize)| {
        let block = plane.slice(s![y..y + FLOOR_BLOCK, x..x + FLOOR_BLOCK]);
        block.iter().map(|value| f64::from(*value)).sum::<f64>() / block.len() as f64
    };
    beside.chain(above).map(mean).fold(f64::INFINITY, f64::min)
}
