//! Lowers the weighted least squares of one channel by conjugate gradients over the light that is free to change.

use ndarray::{Array2, ArrayView2, Zip};

use super::super::objective::sum_of_rows;
use super::frame::{Blur, Frame, row};
use super::prior::Prior;
use crate::core::error::Result;
use crate::core::progress::Progress;

/// The floor of |H|² in the preconditioner: four digits of curvature are left to the steps.
const LEAST_POWER: f32 = 1e-4;

/// The least squares of a channel: `Σ W·(y − A x)²` over the frame, and the prior.
pub(super) struct System<'a> {
    pub(super) blur: &'a Blur<'a>,
    /// y, of the frame's size.
    pub(super) capture: ArrayView2<'a, f32>,
    /// W: the inverse of the variance where y is known, up to a factor.
    pub(super) weights: &'a Array2<f32>,
    pub(super) prior: Prior<'a>,
    pub(super) preconditioner: Preconditioner<'a>,
}

/// What resembles the inverse of the normal matrix.
#[derive(Clone, Copy)]
pub(super) enum Preconditioner<'a> {
    /// `D·F⁻¹·1/(|H|² + λ·ē·L + ε)·F·D` for pixels whose neighbours are alike, and numbers for those of lamps.
    Convolution {
        /// D: the local standard deviation, zero at lamps.
        brightness: &'a Array2<f32>,
        /// The inverse of the diagonal at lamps, zero elsewhere, of the frame's size.
        lamps: Option<&'a Array2<f32>>,
    },
    /// The inverse of a diagonal: pixels that are hardly seen hardly change.
    Diagonal(&'a Array2<f32>),
}

/// Planes that are written over in each step.
pub(super) struct Room {
    gradient: Array2<f32>,
    direction: Array2<f32>,
    /// What the preconditioner makes, and the normal matrix times the direction.
    turned: Array2<f32>,
    /// A times something, of the frame's size.
    image: Array2<f32>,
}

impl Room {
    pub(super) fn new(frame: &Frame) -> Self {
        let [gradient, direction, turned] = std::array::from_fn(|_| frame.plane());
        Self { gradient, direction, turned, image: Array2::zeros(frame.size()) }
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
        steps: usize,
        (room, progress): (&mut Room, &Progress),
    ) -> Result<()> {
        Zip::from(&mut room.image)
            .and(self.capture)
            .and(self.weights)
            .par_for_each(|image, y, w| *image = w * (y.max(0.0) - *image));
        self.blur.transpose(&room.image, &mut room.gradient);
        self.prior.take_slope(x, &mut room.gradient);
        let held = Zip::from(&mut room.gradient).and(&*x).par_map_collect(|g, x| {
            let held = *x <= 0.0 && *g <= 0.0;
            if held {
                *g = 0.0;
            }
            held
        });
        let mut slope = self.precondition(room, &held);
        std::mem::swap(&mut room.direction, &mut room.turned);
        for step in 1..=steps {
            progress.check()?;
            self.blur.apply(&room.direction, &mut room.image);
            let curvature = self.curvature(room);
            if !(curvature > 0.0 && slope > 0.0) {
                break;
            }
            let length = narrow(slope / curvature);
            Zip::from(&mut *x).and(&room.direction).par_for_each(|x, d| *x += length * d);
            if step == steps {
                break;
            }
            self.lower(length, &held, room);
            let next = self.precondition(room, &held);
            let kept = narrow(next / slope);
            Zip::from(&mut room.direction).and(&room.turned).par_for_each(|d, z| *d = z + kept * *d);
            slope = next;
        }
        x.par_mapv_inplace(|light| light.max(0.0));
        Ok(())
    }

    /// The direction's inner product with the normal matrix times itself, of its image.
    fn curvature(&self, room: &Room) -> f64 {
        let of_image = sum_of_rows(room.image.nrows(), |y| {
            let terms = row(&room.image, y).iter().zip(row(self.weights, y));
            terms.map(|(image, w)| f64::from(*image).powi(2) * f64::from(*w)).sum()
        });
        of_image + self.prior.energy(&room.direction)
    }

    /// Takes so many times the normal matrix times the direction from the gradient.
    fn lower(&self, length: f32, held: &Array2<bool>, room: &mut Room) {
        Zip::from(&mut room.image).and(self.weights).par_for_each(|image, w| *image *= w);
        self.blur.transpose(&room.image, &mut room.turned);
        self.prior.add_product(&room.direction, 1.0, &mut room.turned);
        Zip::from(&mut room.gradient).and(&room.turned).and(held).par_for_each(|g, q, held| {
            if !*held {
                *g -= length * q;
            }
        });
    }

    /// Writes P times the gradient to `turned`; returns their inner product.
    fn precondition(&self, room: &mut Room, held: &Array2<bool>) -> f64 {
        match self.preconditioner {
            Preconditioner::Convolution { brightness, lamps } => {
                self.filter(brightness, held, room);
                if let Some(lamps) = lamps {
                    let frame = self.blur.frame;
                    // The gradient is zero at pixels that are held.
                    Zip::from(frame.cut_mut(&mut room.turned))
                        .and(lamps)
                        .and(frame.cut(&room.gradient))
                        .par_for_each(|z, p, g| *z += p * g);
                }
            }
            Preconditioner::Diagonal(inverse) => {
                let pixels = Zip::from(&mut room.turned).and(&room.gradient).and(inverse);
                pixels.par_for_each(|z, g, p| *z = p * g);
            }
        }
        inner(&room.gradient, &room.turned)
    }

    fn filter(&self, brightness: &Array2<f32>, held: &Array2<bool>, room: &mut Room) {
        let smoothness = self.prior.weight * self.prior.edges.mean();
        let response = |power: f32, laplacian: f32| 1.0 / (power + smoothness * laplacian + LEAST_POWER);
        self.blur.filter(&room.gradient, brightness, response, &mut room.turned);
        Zip::from(&mut room.turned).and(brightness).and(held).par_for_each(|z, d, held| {
            *z = if *held { 0.0 } else { *z * d };
        });
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

#[cfg(test)]
mod tests {
    use super::super::prior::Edges;
    use super::super::tests::panel_psf;
    use super::*;
    use crate::core::fft::TransformPrecision;
    use crate::restore::deconvolution::Border;

    /// As many steps as a system of 130 unknowns needs and to spare; half of the capture's pixels count double.
    #[test]
    fn solves_a_known_system() {
        let psf = panel_psf(13);
        let frame = Frame::new([10, 13], [13, 13], Border::Zero, TransformPrecision::Double);
        let blur = frame.blur(psf.view()).unwrap();
        let truth = Array2::from_shape_fn((10, 13), |(y, x)| 1.0 + ((y * 7 + x * 3) % 5) as f32);
        let mut capture = frame.plane();
        blur.apply(&truth, &mut capture);
        let ones = Array2::ones((10, 13));
        let weights = Array2::from_shape_fn((10, 13), |(_, x)| 1.0 + (x % 2) as f32);
        let edges = Edges::unknown();
        let system = System {
            blur: &blur,
            capture: capture.view(),
            weights: &weights,
            prior: Prior { weight: 0.0, edges: &edges, inverse_brightness: &ones, lamps: None },
            preconditioner: Preconditioner::Convolution { brightness: &ones, lamps: None },
        };
        let (mut x, mut room) = (capture.clone(), Room::new(&frame));
        for _ in 0..3 {
            blur.apply(&x, room.image());
            system.descend(&mut x, 40, (&mut room, &Progress::default())).unwrap();
        }
        let worst = x.iter().zip(&truth).map(|(x, truth)| (x - truth).abs()).fold(0.0, f32::max);
        assert!(worst < 1e-3, "{worst}");
    }
}
