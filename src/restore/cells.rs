//! Measures images over cells of some pixels a side, and tells what lies between the middles of cells.

use ndarray::parallel::prelude::*;
use ndarray::{Array2, Axis};

/// Side of a cell, in pixels; with its neighbours it has 2,304.
pub(super) const CELL_PX: usize = 16;

/// The sums of what pixels have, of which `write(y, row)` writes rows, over cells and their neighbours.
pub(super) fn cells(
    (height, width): (usize, usize),
    write: impl Fn(usize, &mut [f32]) + Sync,
) -> Array2<f32> {
    let mut own = Array2::<f32>::zeros((height.div_ceil(CELL_PX), width.div_ceil(CELL_PX)));
    let rows = own.axis_iter_mut(Axis(0)).into_par_iter().enumerate();
    rows.for_each_init(
        || vec![0.0; width],
        |values, (row, mut cells)| {
            for y in row * CELL_PX..((row + 1) * CELL_PX).min(height) {
                write(y, values);
                let parts = cells.iter_mut().zip(values.chunks(CELL_PX));
                parts.for_each(|(cell, values)| *cell += values.iter().sum::<f32>());
            }
        },
    );
    Array2::from_shape_fn(own.dim(), |(row, column)| {
        let [rows, columns] = [(row, own.nrows()), (column, own.ncols())]
            .map(|(at, count)| at.saturating_sub(1)..(at + 2).min(count));
        rows.flat_map(|row| columns.clone().map(move |column| (row, column))).map(|at| own[at]).sum()
    })
}

/// The cells whose middles are next to a pixel of one axis, and the share of the second.
pub(super) fn between(at: usize, count: usize) -> (usize, usize, f32) {
    #[expect(clippy::cast_precision_loss, reason = "a place in an image")]
    let place = ((at as f32 + 0.5) / CELL_PX as f32 - 0.5).max(0.0);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
    let first = (place as usize).min(count - 1);
    #[expect(clippy::cast_precision_loss, reason = "an index")]
    let share = place - first as f32;
    (first, (first + 1).min(count - 1), share.min(1.0))
}

pub(super) fn interpolated(
    cells: &Array2<f32>,
    (top, bottom, down): (usize, usize, f32),
    (left, right, along): (usize, usize, f32),
) -> f32 {
    let of_row = |row: usize| cells[[row, left]] * (1.0 - along) + cells[[row, right]] * along;
    of_row(top) * (1.0 - down) + of_row(bottom) * down
}
