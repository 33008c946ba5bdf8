//! Says which pixels of a capture are saturated, and fills them in from a model.

use ndarray::{Array2, ArrayView2, Zip};

/// Rounds of filling in: the change of the last one is below a percent of the first's.
pub(super) const FILL_ROUNDS: usize = 5;

/// Whether any pixel is saturated.
pub(super) fn any(plane: ArrayView2<'_, f32>, level: f32) -> bool {
    plane.iter().any(|&v| v >= level)
}

/// Replaces saturated pixels of `plane` by what a model predicts for them, where that is brighter.
pub(super) fn fill(plane: ArrayView2<'_, f32>, level: f32, predicted: &Array2<f32>) -> Array2<f32> {
    let mut filled = plane.to_owned();
    Zip::from(&mut filled).and(predicted).for_each(|value, &predicted| {
        if *value >= level {
            *value = value.max(predicted);
        }
    });
    filled
}
