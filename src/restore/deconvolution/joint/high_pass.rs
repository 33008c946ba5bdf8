//! Weighs what a capture has beside a model of it, without the smooth part that any scene has.

use ndarray::{Array2, ArrayView2, Zip};

use super::frame::Blur;
use super::smooth::smooth;

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
    /// M: 1 where the capture is believed, 0 elsewhere.
    known: Array2<f32>,
    /// G(M).
    share: Array2<f32>,
    /// w: M over the brightness.
    pub(super) weights: Array2<f32>,
    /// The standard deviation of the bell, in pixels.
    width_px: f32,
}

impl HighPass {
    /// A high pass over the pixels that are `known` (1, others 0), each relative to its brightness.
    pub(super) fn new(known: Array2<f32>, brightness: ArrayView2<'_, f32>, width_px: f32) -> Self {
        let mut share = known.clone();
        smooth(&mut share, width_px);
        share.mapv_inplace(|share| share + LEAST_SHARE);
        let weights = Zip::from(&known).and(brightness).par_map_collect(|known, n| known / n);
        Self { known, share, weights, width_px }
    }

    /// Weighs pixels by the local root mean square of what is left of them, `left` = `w·h(r)`, besides: where the scene is
    /// busy, the capture tells less.
    ///
    /// # Equation
    /// `w ← w / √(G(left²)/G(M) + ε)`, G of `width_px` pixels and ε a small part of the mean of left²: then what is left is near
    /// 1 everywhere. Done again with what is left then, errors of the first weights vanish.
    pub(super) fn weigh(&mut self, left: &Array2<f32>, width_px: f32) {
        let mut power = left.mapv(|left| left * left);
        let mut share = self.known.clone();
        let sum = |plane: &Array2<f32>| plane.iter().map(|value| f64::from(*value)).sum::<f64>();
        let least = LEAST_POWER * narrow(sum(&power) / sum(&share).max(1.0));
        smooth(&mut power, width_px);
        smooth(&mut share, width_px);
        Zip::from(&mut self.weights).and(&power).and(&share).par_for_each(|w, power, share| {
            *w /= (power / (share + LEAST_SHARE) + least).sqrt().max(f32::MIN_POSITIVE);
        });
    }

    /// `w·h(r)`.
    pub(super) fn passed(&self, r: &Array2<f32>) -> Array2<f32> {
        let mut passed = r.clone();
        self.pass(&mut passed);
        passed
    }

    /// `w·h(r)`, in place.
    pub(super) fn pass(&self, r: &mut Array2<f32>) {
        let mut smoothed = &*r * &self.known;
        smooth(&mut smoothed, self.width_px);
        Zip::from(r).and(&smoothed).and(&self.share).and(&self.weights).par_for_each(|r, low, share, w| {
            *r = w * (*r - low / share);
        });
    }

    /// `Aᵀ hᵀ(w·r)`.
    pub(super) fn back(&self, blur: &Blur<'_>, r: &Array2<f32>, out: &mut Array2<f32>) {
        let weighted = r * &self.weights;
        let mut smoothed = &weighted / &self.share;
        smooth(&mut smoothed, self.width_px);
        let passed = weighted - smoothed;
        blur.transpose(&(passed * &self.known), out);
    }
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}
