//! How far a scene may be off: noise through the regularised inverse, and flare that was taken away.

use ndarray::Array2;

use super::frame::{Blur, Frame};
use super::prior::Edges;
use super::smooth::local_mean;

/// Edge weights that the gain of noise is computed for, as squares of multiples of 1/8: the gain changes by less than a tenth
/// from one to the next.
const KNOTS: usize = 9;

/// Standard deviation of the bell that edge weights are averaged over: noise of a pixel is spread over its neighbours.
const EDGE_PX: f32 = 1.0;

/// The floor of |H|², as in the preconditioner.
const LEAST_POWER: f32 = 1e-4;

/// The deviation of the noise of a regularised inverse over that of the capture, by the weight of edges.
///
/// # Equation
/// `g(e)² = mean |H|²/(|H|² + λ·e·L + ε)²` over all frequencies, L the Laplacian's transfer function.
pub(super) struct NoiseGain([f32; KNOTS]);

impl NoiseGain {
    pub(super) fn new(blur: &Blur<'_>, smoothness: f32) -> Self {
        Self(std::array::from_fn(|knot| {
            let weight = smoothness * weight_of(knot);
            let gain =
                |power: f32, laplacian: f32| power / (power + weight * laplacian + LEAST_POWER).powi(2);
            #[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
            let variance = blur.mean(gain) as f32;
            variance.sqrt()
        }))
    }

    /// The gain at a weight from 0 to 1.
    fn at(&self, weight: f32) -> f32 {
        #[expect(clippy::cast_precision_loss, reason = "a handful of knots")]
        let place = (KNOTS - 1) as f32 * weight.clamp(0.0, 1.0).sqrt();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a handful of knots")]
        let knot = (place as usize).min(KNOTS - 2);
        #[expect(clippy::cast_precision_loss, reason = "a handful of knots")]
        let part = place - knot as f32;
        self.0[knot] + (self.0[knot + 1] - self.0[knot]) * part
    }

    /// The gain in each pixel of the frame.
    pub(super) fn plane(&self, edges: &Edges, frame: &Frame) -> Array2<f32> {
        let Some(edges) = edges.plane() else { return Array2::from_elem(frame.size(), self.at(1.0)) };
        let mut gains = local_mean(&frame.cut(edges).as_standard_layout().into_owned(), EDGE_PX);
        gains.par_mapv_inplace(|weight| self.at(weight));
        gains
    }
}

#[expect(clippy::cast_precision_loss, reason = "a handful of knots")]
fn weight_of(knot: usize) -> f32 {
    (knot as f32 / (KNOTS - 1) as f32).powi(2)
}
