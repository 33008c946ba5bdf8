//! Reads a plane at places between its pixels.

use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView2, Axis};

/// How values between pixels are told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sampling {
    /// Those of the nearest pixel.
    Nearest,
    /// By cubic convolution (Keys, IEEE Transactions on Acoustics, Speech, and Signal Processing 29, 1981).
    Cubic,
}

/// A plane of which each pixel (row, column) is the value at `from(row, column)` of another; beyond the border those at the border.
pub(super) fn resampled(
    plane: ArrayView2<'_, f32>,
    from: impl Fn(f64, f64) -> [f64; 2] + Sync,
    sampling: Sampling,
) -> Array2<f32> {
    let mut moved = Array2::zeros(plane.dim());
    moved.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(y, mut row)| {
        for (x, value) in row.iter_mut().enumerate() {
            let place = from(y as f64, x as f64);
            *value = match sampling {
                Sampling::Nearest => nearest(plane, place),
                Sampling::Cubic => cubic(plane, place),
            };
        }
    });
    moved
}

fn nearest(plane: ArrayView2<'_, f32>, [y, x]: [f64; 2]) -> f32 {
    plane[[at(y.round(), plane.nrows()), at(x.round(), plane.ncols())]]
}

fn cubic(plane: ArrayView2<'_, f32>, [y, x]: [f64; 2]) -> f32 {
    let (top, left) = (y.floor(), x.floor());
    let rows = OFFSETS.map(|offset| at(top + offset, plane.nrows()));
    let columns = OFFSETS.map(|offset| at(left + offset, plane.ncols()));
    let [down, along] = [y - top, x - left].map(weights);
    let mut sum = 0.0;
    for (row, down) in rows.into_iter().zip(down) {
        let of_row: f32 =
            columns.into_iter().zip(along).map(|(column, along)| along * plane[[row, column]]).sum();
        sum += down * of_row;
    }
    sum
}

/// Pixels around a place, from the one before it.
const OFFSETS: [f64; 4] = [-1.0, 0.0, 1.0, 2.0];

/// What the pixels at [`OFFSETS`] count for the place `t` behind one.
fn weights(t: f64) -> [f32; 4] {
    let (square, cube) = (t * t, t * t * t);
    #[expect(clippy::cast_possible_truncation, reason = "weights of 32-bit values")]
    [
        -0.5 * cube + square - 0.5 * t,
        1.5 * cube - 2.5 * square + 1.0,
        -1.5 * cube + 2.0 * square + 0.5 * t,
        0.5 * cube - 0.5 * square,
    ]
    .map(|weight| weight as f32)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to indices")]
fn at(place: f64, count: usize) -> usize {
    place.clamp(0.0, (count - 1) as f64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quadratic_is_read_between_pixels_exactly_and_a_map_by_its_pixels() {
        let value = |y: f64, x: f64| 0.3 + 0.02 * y - 0.01 * x + 0.003 * (y * y) - 0.002 * (x * y);
        let plane = Array2::from_shape_fn((12, 14), |(y, x)| value(y as f64, x as f64) as f32);
        let moved = resampled(plane.view(), |y, x| [y + 0.3, x - 0.6], Sampling::Cubic);
        for ((y, x), moved) in
            moved.indexed_iter().filter(|((y, x), _)| (2..9).contains(y) && (3..12).contains(x))
        {
            assert!((f64::from(*moved) - value(y as f64 + 0.3, x as f64 - 0.6)).abs() < 1e-5, "{y} {x}");
        }
        let nearest = resampled(plane.view(), |y, x| [y + 0.3, x - 0.6], Sampling::Nearest);
        assert_eq!(nearest[[4, 7]], plane[[4, 6]]);
        assert_eq!(nearest[[4, 0]], plane[[4, 0]], "beyond the border");
    }
}
