//! Turns and scales a channel of a PSF, many times over.

use ndarray::{Array2, ArrayView2, s};
use rayon::prelude::*;

use super::Pose2;
use crate::codes::CubicSpline;

/// The largest side of a PSF that is looked at; further orders cost more than they tell.
pub(super) const LARGEST_PX: usize = 513;

/// A channel of a PSF that can be turned and scaled about its centre.
pub(super) struct Movable {
    spline: CubicSpline,
    size: [usize; 2],
    /// The pose of the channel that others are relative to.
    origin: Pose2,
}

impl Movable {
    /// Fits a spline through the middle of a channel, `[height, width]`.
    pub(super) fn new(channel: ArrayView2<'_, f32>) -> Self {
        let part = |length: usize| {
            let kept = length.min(LARGEST_PX);
            let first = length / 2 - kept / 2;
            first..first + kept
        };
        let (height, width) = channel.dim();
        let middle = channel.slice(s![part(height), part(width)]);
        Self { spline: CubicSpline::fit(middle), size: middle.dim().into(), origin: [0.0; 2] }
    }

    /// Makes poses relative to this one.
    pub(super) fn begin_at(&mut self, origin: Pose2) {
        self.origin = origin;
    }

    /// Height and width of the channel.
    pub(super) fn size(&self) -> [usize; 2] {
        self.size
    }

    /// The channel in a pose: non-negative, of unit sum.
    ///
    /// # Equation
    /// A pixel takes its light from the place turned back, at 1/(1 + s) of the distance, as
    /// [`MeasurementErrors`](crate::codes::MeasurementErrors) does.
    pub(super) fn at(&self, pose: Pose2) -> Array2<f32> {
        let (turn_deg, times) = (self.origin[0] + pose[0], (1.0 + self.origin[1]) * (1.0 + pose[1]));
        let (sin, cos) = turn_deg.to_radians().sin_cos();
        let (sin, cos) = (sin / times, cos / times);
        let [centre_y, centre_x] = self.size.map(|side| (side / 2) as f64);
        let mut moved = Array2::zeros(self.size);
        let width = self.size[1];
        let rows = moved.outer_iter_mut().into_par_iter().enumerate();
        rows.for_each_init(
            || vec![0.0; width],
            |values, (y, mut row)| {
                let (dy, dx) = (y as f64 - centre_y, -centre_x);
                let from = [centre_y + dy * cos + dx * sin, centre_x + dx * cos - dy * sin];
                self.spline.sample_line(from, [sin, cos], values);
                row.iter_mut().zip(values).for_each(|(moved, value)| *moved = narrow(value.max(0.0)));
            },
        );
        let sum: f64 = moved.iter().map(|value| f64::from(*value)).sum();
        let factor = narrow(1.0 / sum.max(f64::MIN_POSITIVE));
        moved.mapv_into(|value| value * factor)
    }

    /// The derivative of the channel by one part of the pose, by central differences of `step`.
    pub(super) fn slope(&self, pose: Pose2, part: usize, step: f64) -> Array2<f32> {
        let (mut before, mut after) = (pose, pose);
        before[part] -= step;
        after[part] += step;
        let scale = narrow(0.5 / step);
        (self.at(after) - self.at(before)).mapv_into(|difference| difference * scale)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "PSF values are f32")]
fn narrow(value: f64) -> f32 {
    value as f32
}
