//! Weighs what a capture has beside a model of it, without the smooth part that any scene has.

use ndarray::{Array2, ArrayView2, Zip};

use super::frame::{Blur, copy_of, row};
use super::smooth::{smooth_into, smoothed};
use super::sums::dot;
use crate::core::fft::{Loan, Pool, copy_row};
use crate::kernels::vectorised;

/// What keeps the share of believed pixels above zero.
const LEAST_SHARE: f32 = 1e-6;

/// The part of the mean power that is left at least: no pixel counts more than seven times as much as most.
const LEAST_POWER: f32 = 0.02;

/// The weighted high pass `w·h`.
///
/// # Equation
/// `h(r) = M·(r − G(M r)/G(M))` over the believed pixels M. One that is not normalised by M would leak the core of a lamp into
/// its surroundings, and find a third of its light.
pub(super) struct HighPass {
    /// 1/G(M).
    inverse_share: Array2<f32>,
    /// w: M over the brightness, which is above zero where the capture is believed, and there alone.
    pub(super) weights: Array2<f32>,
    /// The standard deviation of the bell, in pixels.
    width_px: f32,
    /// Planes that are written over; new ones for each product would come from the system page by page.
    rooms: Pool<Array2<f32>>,
}

impl HighPass {
    /// A high pass over the pixels that are `known` (1, others 0), each relative to its brightness.
    pub(super) fn new(known: Array2<f32>, brightness: ArrayView2<'_, f32>, width_px: f32) -> Self {
        let mut inverse_share = smoothed(known.dim(), width_px, copy_of(&known));
        inverse_share.par_mapv_inplace(|share| 1.0 / (share + LEAST_SHARE));
        let weights = Zip::from(&known).and(brightness).par_map_collect(|known, n| known / n);
        Self { inverse_share, weights, width_px, rooms: Pool::new() }
    }

    /// Lends a plane, of which stale contents are to be overwritten.
    fn lend_room(&self) -> Loan<'_, Array2<f32>> {
        self.rooms.lend(|| Array2::zeros(self.weights.dim()))
    }

    /// Weighs pixels by the local root mean square of what is left of them, `left` = `w·h(r)`, besides: where the scene is
    /// busy, the capture tells less.
    ///
    /// # Equation
    /// `w ← w / √(G(left²)/G(M) + ε)`, G of `width_px` pixels and ε a small part of the mean of left²: then what is left is near
    /// 1 everywhere. Done again with what is left then, errors of the first weights vanish.
    pub(super) fn weigh(&mut self, left: &Array2<f32>, width_px: f32) {
        let power: f64 = left.iter().map(|left| f64::from(left * left)).sum();
        let known = self.weights.iter().filter(|weight| **weight > 0.0).count();
        let least = LEAST_POWER * narrow(power / known.max(1) as f64);
        let squares = |y: usize, out: &mut [f32]| {
            out.iter_mut().zip(row(left, y)).for_each(|(out, left)| *out = left * left);
        };
        let power = smoothed(left.dim(), width_px, squares);
        let weights = &self.weights;
        let share = smoothed(left.dim(), width_px, |y, out| {
            out.iter_mut().zip(row(weights, y)).for_each(|(out, weight)| *out = f32::from(*weight > 0.0));
        });
        Zip::from(&mut self.weights).and(&power).and(&share).par_for_each(|w, power, share| {
            *w /= (power / (share + LEAST_SHARE) + least).sqrt().max(f32::MIN_POSITIVE);
        });
    }

    /// `w·h(r)`.
    pub(super) fn passed(&self, r: &Array2<f32>) -> Array2<f32> {
        let mut passed = Array2::zeros(r.dim());
        self.pass(r, &mut passed);
        passed
    }

    /// Writes `w·h(r)`; returns the sum of its squares.
    pub(super) fn pass(&self, r: &Array2<f32>, out: &mut Array2<f32>) -> f64 {
        let Self { inverse_share, weights, width_px, .. } = self;
        let believe = |y: usize, out: &mut [f32]| believe(out, row(r, y), row(weights, y));
        let leave = |y: usize, low: &mut [f32], out: &mut [f32]| {
            leave(out, row(r, y), low, [row(inverse_share, y), row(weights, y)])
        };
        smooth_into(out.view_mut(), *width_px, believe, leave)
    }

    /// `Aᵀ hᵀ(w·r)`.
    pub(super) fn back(&self, blur: &Blur<'_>, r: &Array2<f32>, out: &mut Array2<f32>) {
        self.back_into(blur, r, (out, copy_row));
    }

    /// As [`back`](Self::back), with what takes rows to their places, as [`Blur::transpose_into`] has it.
    pub(super) fn back_into(
        &self,
        blur: &Blur<'_>,
        r: &Array2<f32>,
        into: (&mut Array2<f32>, impl Fn(usize, &[f32], &mut [f32]) -> f64 + Sync),
    ) -> f64 {
        let mut passed = self.lend_room();
        self.transpose(r, &mut passed);
        blur.transpose_into(&passed, into)
    }

    /// `hᵀ(w·r)`.
    pub(super) fn back_unblurred(&self, r: &Array2<f32>) -> Array2<f32> {
        let mut passed = Array2::zeros(r.dim());
        self.transpose(r, &mut passed);
        passed
    }

    fn transpose(&self, r: &Array2<f32>, passed: &mut Array2<f32>) {
        let Self { inverse_share, weights, width_px, .. } = self;
        let share =
            |y: usize, out: &mut [f32]| of_share(out, row(r, y), row(weights, y), row(inverse_share, y));
        let leave = |y: usize, smoothed: &mut [f32], out: &mut [f32]| {
            leave_transposed(out, smoothed, row(r, y), row(weights, y));
            0.0
        };
        smooth_into(passed.view_mut(), *width_px, share, leave);
    }
}

vectorised! {
    /// Writes `M·r`.
    fn believe<'a>(out: &'a mut [f32], r: &'a [f32], weights: &'a [f32]) -> () {
        out.iter_mut().zip(r).zip(weights).for_each(|((out, r), w)| *out = if *w > 0.0 { *r } else { 0.0 });
    }
}

vectorised! {
    /// Writes a row of `w·(r − low/G(M))`; returns the sum of its squares.
    fn leave<'a>(out: &'a mut [f32], r: &'a [f32], low: &'a [f32], factors: [&'a [f32]; 2]) -> f64 {
        let [inverse_share, weights] = factors;
        for ((((out, r), low), inverse), w) in out.iter_mut().zip(r).zip(low).zip(inverse_share).zip(weights) {
            *out = w * (*r - low * inverse);
        }
        dot(out, out)
    }
}

vectorised! {
    /// Writes `w·r/G(M)`.
    fn of_share<'a>(out: &'a mut [f32], r: &'a [f32], weights: &'a [f32], inverse_share: &'a [f32]) -> () {
        out.iter_mut().zip(r).zip(weights).zip(inverse_share).for_each(|(((out, r), w), inverse)| *out = r * w * inverse);
    }
}

vectorised! {
    /// Writes a row of `M·(w·r − smoothed)`.
    fn leave_transposed<'a>(out: &'a mut [f32], smoothed: &'a [f32], r: &'a [f32], weights: &'a [f32]) -> () {
        for (((out, smoothed), r), w) in out.iter_mut().zip(smoothed).zip(r).zip(weights) {
            *out = if *w > 0.0 { r * w - smoothed } else { 0.0 };
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}
