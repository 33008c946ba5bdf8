//! Lowers the weighted least squares of one channel by conjugate gradients over the light that is free to change.

use ndarray::{Array2, ArrayView2, Zip};

use super::frame::{Blur, Frame, row};
use super::members::{OfMembers, members};
use super::prior::Prior;
use super::sums::{add_scaled, dot};
use crate::core::error::Result;
use crate::core::fft::Damping;
use crate::core::image::row_of;
use crate::core::progress::Progress;
use crate::kernels::vectorised;

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
    /// The pixels of the frame that stay as they are, if any do.
    pub(super) told: Option<&'a Array2<bool>>,
    pub(super) preconditioner: Preconditioner<'a>,
}

/// What resembles the inverse of the normal matrix.
#[derive(Clone, Copy)]
pub(super) enum Preconditioner<'a> {
    /// `D·F⁻¹·1/(|H|² + λ·ē·L + ε)·F·D` for pixels whose neighbours are alike, and numbers for those of lamps.
    Convolution {
        /// D: the local standard deviation, zero at lamps.
        brightness: &'a Array2<f32>,
        /// The pixels of lamps, of the frame's size, and the inverse of the diagonal there.
        lamps: Option<(&'a Array2<bool>, &'a OfMembers)>,
    },
    /// The same within the frame, without lamps, and numbers around it: light of which the frame sees the flare alone.
    Framed { brightness: &'a Array2<f32>, around: &'a Array2<f32> },
}

/// Planes that are written over in each step.
pub(super) struct Room {
    gradient: Array2<f32>,
    /// The direction of a step; has no room of its own where there is to be no other.
    direction: Array2<f32>,
    /// What the preconditioner makes, and the penalty's matrix times the direction.
    turned: Array2<f32>,
    /// A times something, of the frame's size.
    image: Array2<f32>,
}

impl Room {
    pub(super) fn new(frame: &Frame) -> Self {
        let [gradient, turned] = std::array::from_fn(|_| frame.plane());
        let direction = Array2::default((0, 0));
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
        self.take_slope(x, room);
        let is_told = |place| self.told.is_some_and(|told| told.get(place) == Some(&true));
        let held = Zip::indexed(&mut room.gradient).and(&*x).par_map_collect(|place, g, x| {
            let held = *x <= 0.0 && *g <= 0.0 || is_told(place);
            if held {
                *g = 0.0;
            }
            held
        });
        let mut slope = self.precondition(room, &held);
        if room.direction.is_empty() && steps > 1 {
            room.direction = Array2::zeros(x.dim());
        }
        for step in 1..=steps {
            progress.check()?;
            let Room { gradient, direction, turned, image } = &mut *room;
            if step == 1 {
                std::mem::swap(direction, turned);
            }
            // No other step needs the gradient of the last.
            let product = if step == steps { gradient } else { turned };
            let curvature = self.weigh(direction, (product, image));
            if !(curvature > 0.0 && slope > 0.0) {
                break;
            }
            let length = narrow(slope / curvature);
            if step == steps {
                add_scaled(x, length, &room.direction);
                break;
            }
            self.lower(length, &held, room);
            let next = self.precondition(room, &held);
            let kept = narrow(next / slope);
            Zip::from(&mut *x).and(&mut room.direction).and(&room.turned).par_for_each(|x, d, z| {
                *x += length * *d;
                *d = z + kept * *d;
            });
            slope = next;
        }
        if room.turned.is_empty() {
            std::mem::swap(&mut room.direction, &mut room.turned);
        }
        x.par_mapv_inplace(|light| light.max(0.0));
        Ok(())
    }

    /// Writes half the slope at x, of which the room holds A x, to `gradient`.
    fn take_slope(&self, x: &Array2<f32>, Room { gradient, turned, image, .. }: &mut Room) {
        self.prior.product(x, turned);
        let left = |y: usize, samples: &mut [f32]| {
            leave(samples, [row_of(self.capture, y), row(image, y)], row(self.weights, y));
        };
        let take = |y: usize, slope: &[f32], out: &mut [f32]| {
            self.prior.take_slope(y, [slope, row(turned, y)], out);
            0.0
        };
        self.blur.transpose_rows((self.capture.nrows(), left), (gradient, take));
    }

    /// Writes W A d of a direction to `image` and the penalty's matrix times it to `product`; returns its inner product with the
    /// normal matrix times itself.
    fn weigh(&self, direction: &Array2<f32>, (product, image): (&mut Array2<f32>, &mut Array2<f32>)) -> f64 {
        let of_prior = self.prior.product(direction, product);
        let weigh = |y: usize, image: &[f32], out: &mut [f32]| weigh(out, image, row(self.weights, y));
        of_prior + self.blur.apply_into(direction, (image, weigh))
    }

    /// Takes so many times the normal matrix times the direction from the gradient, after [`Self::weigh`].
    fn lower(&self, length: f32, held: &Array2<bool>, room: &mut Room) {
        let Room { gradient, turned, image, .. } = room;
        let lower = |y: usize, seen: &[f32], gradient: &mut [f32]| {
            lower(gradient, [seen, row(turned, y)], row(held, y), length);
            0.0
        };
        self.blur.transpose_into(image, (gradient, lower));
    }

    /// Writes P times the gradient to `turned`; returns their inner product.
    fn precondition(&self, room: &mut Room, held: &Array2<bool>) -> f64 {
        let Room { gradient, turned, .. } = room;
        let smoothness = self.prior.weight * self.prior.edges.mean();
        let damping = Damping { smoothness, floor: LEAST_POWER };
        let gradient = &*gradient;
        match self.preconditioner {
            Preconditioner::Convolution { brightness, lamps } => {
                let turn = |y: usize, filtered: &[f32], out: &mut [f32]| {
                    let lamps = lamps.filter(|(pixels, _)| y < pixels.nrows());
                    let lamps = lamps.map(|(pixels, inverse)| (row(pixels, y), inverse.row(y)));
                    turn(out, [filtered, row(gradient, y), row(brightness, y)], row(held, y), lamps)
                };
                let weigh = |y: usize, samples: &mut [f32]| {
                    multiply(samples, row(gradient, y), row(brightness, y));
                };
                self.blur.invert_normal_into(weigh, damping, (turned, turn))
            }
            Preconditioner::Framed { brightness, around } => {
                let (height, width) = self.capture.dim();
                let of_frame = |y: usize| if y < height { width } else { 0 };
                let turn = |y: usize, filtered: &[f32], out: &mut [f32]| {
                    let parts = [filtered, row(gradient, y), row(brightness, y), row(around, y)];
                    turn_framed(out, parts, row(held, y), of_frame(y))
                };
                let weigh = |y: usize, samples: &mut [f32]| {
                    let (frame, beyond) = samples.split_at_mut(of_frame(y));
                    multiply(frame, row(gradient, y), row(brightness, y));
                    beyond.fill(0.0);
                };
                self.blur.invert_normal_into(weigh, damping, (turned, turn))
            }
        }
    }
}

vectorised! {
    /// Writes the products of two rows, as many as there is place for.
    fn multiply<'a>(out: &'a mut [f32], a: &'a [f32], b: &'a [f32]) -> () {
        out.iter_mut().zip(a).zip(b).for_each(|((out, a), b)| *out = a * b);
    }
}

vectorised! {
    /// Writes what an image leaves of a capture times the weights, as far as these go.
    fn leave<'a>(out: &'a mut [f32], of: [&'a [f32]; 2], weights: &'a [f32]) -> () {
        let [capture, image] = of;
        for (((out, y), image), w) in out.iter_mut().zip(capture).zip(image).zip(weights) {
            *out = w * (y - image);
        }
    }
}

vectorised! {
    /// Writes a row of W A d; returns its part of the curvature.
    fn weigh<'a>(out: &'a mut [f32], image: &'a [f32], weights: &'a [f32]) -> f64 {
        out.iter_mut().zip(image).zip(weights).for_each(|((out, image), w)| *out = w * image);
        dot(out, image)
    }
}

vectorised! {
    /// Takes so many times both of the products from a row of the gradient.
    fn lower<'a>(gradient: &'a mut [f32], products: [&'a [f32]; 2], held: &'a [bool], length: f32) -> () {
        let [seen, of_prior] = products;
        for (((g, seen), of_prior), held) in gradient.iter_mut().zip(seen).zip(of_prior).zip(held) {
            *g -= if *held { 0.0 } else { length * (seen + of_prior) };
        }
    }
}

vectorised! {
    /// Writes a row of what the preconditioner makes of the gradient, from the `filtered` one; returns its part of their inner product.
    fn turn<'a>(out: &'a mut [f32], from: [&'a [f32]; 3], held: &'a [bool], lamps: Option<(&'a [bool], &'a [f32])>) -> f64 {
        let [filtered, gradient, brightness] = from;
        for (((z, filtered), d), held) in out.iter_mut().zip(filtered).zip(brightness).zip(held) {
            *z = if *held { 0.0 } else { filtered * d };
        }
        // The gradient is zero at pixels that are held.
        if let Some((pixels, inverse)) = lamps {
            members(pixels).zip(inverse).for_each(|(x, p)| out[x] += p * gradient[x]);
        }
        dot(out, gradient)
    }
}

vectorised! {
    /// Writes a row of what the preconditioner makes of the gradient, of which `width` pixels are of the frame: these from the `filtered`
    /// one, and others by their numbers; returns its part of their inner product.
    fn turn_framed<'a>(out: &'a mut [f32], from: [&'a [f32]; 4], held: &'a [bool], width: usize) -> f64 {
        let [filtered, gradient, brightness, around] = from;
        let (frame, beyond) = out.split_at_mut(width);
        let of_frame = frame.iter_mut().zip(filtered).zip(brightness).zip(held);
        of_frame.for_each(|(((z, filtered), d), held)| *z = if *held { 0.0 } else { filtered * d });
        // The gradient is zero at pixels that are held.
        let of_beyond = beyond.iter_mut().zip(&gradient[width..]).zip(&around[width..]);
        of_beyond.for_each(|((z, g), p)| *z = p * g);
        dot(out, gradient)
    }
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
            told: None,
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

    /// Three steps explain a capture in which light from around the frame is seen, and look for that light too.
    #[test]
    fn light_around_a_frame_is_found_with_the_scene() {
        let psf = panel_psf(13);
        let frame = Frame::new([30, 33], [13, 13], Border::Smooth, TransformPrecision::Double);
        let blur = frame.blur(psf.view()).unwrap();
        let truth = Array2::from_shape_fn(frame.plane_size(), |(y, x)| 1.0 + ((y * 7 + x * 3) % 5) as f32);
        let mut capture = Array2::zeros(frame.size());
        blur.apply(&truth, &mut capture);
        let ones = Array2::ones(frame.plane_size());
        let weights = Array2::ones(frame.size());
        let edges = Edges::unknown();
        let system = System {
            blur: &blur,
            capture: capture.view(),
            weights: &weights,
            prior: Prior { weight: 0.0, edges: &edges, inverse_brightness: &ones, lamps: None },
            told: None,
            preconditioner: Preconditioner::Framed { brightness: &ones, around: &ones },
        };
        let left = |x: &Array2<f32>| {
            let mut seen = Array2::zeros(frame.size());
            blur.apply(x, &mut seen);
            (&seen - &capture).mapv(|left| left * left).sum()
        };
        let start = frame.surround(capture.view());
        let (mut x, mut room) = (start.clone(), Room::new(&frame));
        blur.apply(&x, room.image());
        system.descend(&mut x, 3, (&mut room, &Progress::default())).unwrap();
        assert!(left(&x) < 1e-3 * left(&start), "{} of {}", left(&x), left(&start));
        let [height, width] = frame.size();
        let moved = (&x - &start)
            .indexed_iter()
            .any(|((y, x), moved)| (y >= height || x >= width) && moved.abs() > 1e-3);
        assert!(moved);
    }
}
