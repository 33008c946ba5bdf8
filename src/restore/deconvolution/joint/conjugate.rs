//! Lowers the weighted least squares of one channel by conjugate gradients over the light that is free to change.

use ndarray::{Array2, Zip};

use super::super::objective::sum_of_rows;
use super::frame::{Blur, row};
use super::prior::Prior;
use crate::core::error::Result;
use crate::core::progress::Progress;

/// The floor of |H|² in the preconditioner.
const LEAST_POWER: f32 = 1e-4;

/// The least squares of a channel: `Σ W·(y − A x)²` and the prior.
pub(super) struct System<'a> {
    pub(super) blur: &'a Blur<'a>,
    /// W: the inverse of the variance where y is known, up to a factor.
    pub(super) weights: &'a Array2<f32>,
    pub(super) prior: Prior<'a>,
    pub(super) preconditioner: Preconditioner<'a>,
}

/// What resembles the inverse of the normal matrix: `P = D·F⁻¹·1/(|H|² + λ·ē·L + ε)·F·D` for pixels whose neighbours are
/// alike, and numbers for those of lamps.
#[derive(Clone, Copy)]
pub(super) struct Preconditioner<'a> {
    /// D: the local standard deviation, zero at lamps.
    pub(super) brightness: &'a Array2<f32>,
    /// The inverse of the diagonal at lamps, zero elsewhere.
    pub(super) lamps: Option<&'a Array2<f32>>,
}

/// Planes that are written over in each step.
pub(super) struct Room {
    gradient: Array2<f32>,
    direction: Array2<f32>,
    /// A times something, and what the preconditioner makes.
    image: Array2<f32>,
    /// The normal matrix times the direction.
    turned: Array2<f32>,
}

impl Room {
    pub(super) fn new(plane: [usize; 2]) -> Self {
        let [gradient, direction, image, turned] = std::array::from_fn(|_| Array2::zeros(plane));
        Self { gradient, direction, image, turned }
    }

    /// The plane for A x.
    pub(super) fn image(&mut self) -> &mut Array2<f32> {
        &mut self.image
    }
}

impl System<'_> {
    /// Takes `steps` steps from x, of which the room holds A x; light stays above zero.
    ///
    /// # Equation
    /// Conjugate gradients for `AᵀW(y − A x) = λ L x` over the pixels that are not held at zero by their slope, from the slope
    /// at x, preconditioned; then `x ← max(0, x)`.
    pub(super) fn descend(
        &self,
        x: &mut Array2<f32>,
        capture: &Array2<f32>,
        steps: usize,
        (room, progress): (&mut Room, &Progress),
    ) -> Result<()> {
        Zip::from(&mut room.image).and(capture).par_for_each(|image, y| *image = y - *image);
        self.blur.transpose(&room.image, self.weights, &mut room.gradient);
        self.prior.add_slope(x, -1.0, &mut room.gradient);
        let held = Zip::from(&*x).and(&room.gradient).par_map_collect(|x, g| *x <= 0.0 && *g <= 0.0);
        let release = |plane: &mut Array2<f32>| {
            Zip::from(plane).and(&held).par_for_each(|value, held| {
                if *held {
                    *value = 0.0;
                }
            });
        };
        release(&mut room.gradient);
        let mut slope = self.precondition(room, &release);
        room.direction.assign(&room.image);
        for step in 1..=steps {
            progress.check()?;
            let curvature = self.turn(room);
            if !(curvature > 0.0 && slope > 0.0) {
                break;
            }
            let length = narrow(slope / curvature);
            Zip::from(&mut *x).and(&room.direction).par_for_each(|x, d| *x += length * d);
            if step == steps {
                break;
            }
            Zip::from(&mut room.gradient).and(&room.turned).par_for_each(|g, q| *g -= length * q);
            release(&mut room.gradient);
            let next = self.precondition(room, &release);
            let kept = narrow(next / slope);
            Zip::from(&mut room.direction).and(&room.image).par_for_each(|d, z| *d = z + kept * *d);
            slope = next;
        }
        x.par_mapv_inplace(|light| light.max(0.0));
        Ok(())
    }

    /// Writes the normal matrix times the direction to `turned`; returns their inner product.
    fn turn(&self, room: &mut Room) -> f64 {
        self.blur.apply(&room.direction, &mut room.image);
        self.blur.transpose(&room.image, self.weights, &mut room.turned);
        self.prior.add_slope(&room.direction, 1.0, &mut room.turned);
        inner(&room.direction, &room.turned)
    }

    /// Writes P times the gradient to `image`; returns their inner product.
    fn precondition(&self, room: &mut Room, release: &impl Fn(&mut Array2<f32>)) -> f64 {
        let smoothness = self.prior.weight * self.prior.edges.mean();
        let response = |power: f32, laplacian: f32| 1.0 / (power + smoothness * laplacian + LEAST_POWER);
        let Preconditioner { brightness, lamps } = self.preconditioner;
        self.blur.filter(&room.gradient, brightness, response, &mut room.image);
        Zip::from(&mut room.image).and(brightness).par_for_each(|z, d| *z *= d);
        if let Some(lamps) = lamps {
            Zip::from(&mut room.image).and(lamps).and(&room.gradient).par_for_each(|z, p, g| *z += p * g);
        }
        release(&mut room.image);
        inner(&room.gradient, &room.image)
    }
}

/// The inner product, the same whatever the number of threads.
pub(super) fn inner(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    sum_of_rows(a.nrows(), |y| {
        row(a, y).iter().zip(row(b, y)).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
    })
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}
