//! The Fourier transform of lines side by side, each in a lane.

use super::butterfly::{Complex, times, transform};
use super::{COMPLEX, WIDE};
use crate::kernels::simd::{Isa, Kernel, Simd};

/// The numbers that are transformed in registers.
const RADICES: [usize; 6] = [9, 8, 5, 4, 3, 2];

/// A plan for lines of one length, a product of 2, 3 and 5.
///
/// # Method
/// Stockham's: each pass takes numbers a radix-th of the line apart and leaves them so that after the last they stand in order,
/// from one buffer to another. (C. Van Loan, "Computational Frameworks for the Fast Fourier Transform", 1992.) Passes of up to 81
/// numbers by steps within the first cache take a quarter longer for 960 places, and twice as long for 2880.
pub struct LinePlan {
    length: usize,
    passes: Vec<Pass>,
}

struct Pass {
    radix: usize,
    /// Lines of the passes before that stand between each other.
    stride: usize,
    /// `exp(−2πi·p·j/m)` for the p below m/radix and j from 1 to radix − 1, m the length that is left: real and imaginary parts.
    /// Empty in the last pass, where all are 1.
    twiddles: Vec<f32>,
}

/// Which way a transform goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// `F[k] = Σ f[n]·exp(−2πi·n·k/N)`.
    Forward,
    /// `f[n] = Σ F[k]·exp(2πi·n·k/N)`: not divided by N.
    Inverse,
}

impl LinePlan {
    /// Plans for lines of a length.
    ///
    /// # Panics
    /// For other lengths than [`is_smooth`](super::is_smooth) tells.
    pub fn new(length: usize) -> Self {
        assert!(super::is_smooth(length), "{length} is no product of 2, 3 and 5");
        let (mut passes, mut left, mut stride) = (Vec::new(), length, 1);
        while left > 1 {
            let radix = *RADICES.iter().find(|radix| left.is_multiple_of(**radix)).expect("it is smooth");
            let rows = left / radix;
            let twiddles = match rows {
                1 => Vec::new(),
                _ => (0..rows).flat_map(|p| (1..radix).flat_map(move |j| root(p * j, left))).collect(),
            };
            passes.push(Pass { radix, stride, twiddles });
            (left, stride) = (rows, stride * radix);
        }
        Self { length, passes }
    }

    /// Places of a line.
    pub fn length(&self) -> usize {
        self.length
    }

    /// Whether what is transformed ends in the other buffer.
    pub fn moves(&self) -> bool {
        !self.passes.len().is_multiple_of(2)
    }

    /// Transforms `lines`, `[place][part][lane]`, to one of the two buffers, which comes first in what is returned; the other one is
    /// written over too.
    ///
    /// # Panics
    /// When either is not of [`COMPLEX`] floats for each place.
    pub fn transform<'b>(
        &self,
        direction: Direction,
        lines: &'b mut [f32],
        room: &'b mut [f32],
    ) -> [&'b mut [f32]; 2] {
        let floats = self.length * COMPLEX;
        assert_eq!([lines.len(), room.len()], [floats; 2], "lines of {} places", self.length);
        // The parts change places for the way back: conj(F(conj f)) = swap(F(swap f)).
        let parts = match direction {
            Direction::Forward => [0, WIDE],
            Direction::Inverse => [WIDE, 0],
        };
        let (isa, mut buffers) = (Isa::current(), [lines, room]);
        for pass in &self.passes {
            let [from, to] = &mut buffers;
            isa.run(Step { pass, length: self.length, parts, from, to });
            buffers.swap(0, 1);
        }
        buffers
    }
}

/// `exp(−2πi·k/n)`.
#[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "lengths are far below 2⁵³")]
pub(super) fn root(k: usize, n: usize) -> [f32; 2] {
    let angle = -std::f64::consts::TAU * (k % n) as f64 / n as f64;
    [angle.cos() as f32, angle.sin() as f32]
}

/// A pass over all lines.
struct Step<'a> {
    pass: &'a Pass,
    length: usize,
    /// Where the real and the imaginary parts of a place begin.
    parts: [usize; 2],
    from: &'a [f32],
    to: &'a mut [f32],
}

impl Kernel for Step<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        match self.pass.radix {
            2 => self.take::<S, 2>(simd),
            3 => self.take::<S, 3>(simd),
            4 => self.take::<S, 4>(simd),
            5 => self.take::<S, 5>(simd),
            8 => self.take::<S, 8>(simd),
            9 => self.take::<S, 9>(simd),
            radix => unreachable!("no pass of radix {radix}"),
        }
    }
}

impl Step<'_> {
    #[inline(always)]
    fn take<S: Simd, const R: usize>(mut self, simd: S) {
        let Pass { stride, twiddles, .. } = self.pass;
        let floats = self.length * COMPLEX;
        assert!(self.from.len() == floats && self.to.len() == floats, "buffers are of the length");
        let rows = self.length / R / stride;
        assert!(rows * stride * R == self.length, "as planned");
        if rows == 1 {
            // SAFETY: there is one row, and buffers are of the length, as was checked above.
            return unsafe { self.take_row::<S, R, false>(simd, 0, [[simd.splat(0.0); 2]; R]) };
        }
        for (p, twiddles) in twiddles.chunks_exact((R - 1) * 2).enumerate().take(rows) {
            let mut factors = [[simd.splat(0.0); 2]; R];
            for j in 1..R {
                factors[j] = [simd.splat(twiddles[2 * j - 2]), simd.splat(twiddles[2 * j - 1])];
            }
            // SAFETY: `take` ends after as many rows as there are, and buffers are of the length, as was checked above.
            unsafe { self.take_row::<S, R, true>(simd, p, factors) };
        }
    }

    /// Transforms the numbers of row p of all lines, and multiplies them by factors if they are `TURNED`.
    ///
    /// # Safety
    /// The pass has more than p rows, and buffers have [`COMPLEX`] floats for each place.
    #[inline(always)]
    unsafe fn take_row<S: Simd, const R: usize, const TURNED: bool>(
        &mut self,
        simd: S,
        p: usize,
        factors: [Complex<S>; R],
    ) {
        let (stride, apart, parts) = (self.pass.stride, self.length / R, self.parts);
        for q in 0..stride {
            for lane in (0..WIDE).step_by(S::LANES) {
                let read = ((p * stride + q) * COMPLEX + lane, apart * COMPLEX);
                let written = ((p * stride * R + q) * COMPLEX + lane, stride * COMPLEX);
                // SAFETY: as p·stride + q is below `apart`, the places that are read are below R·apart, and those that are written below
                // rows·stride·R: both are the length. A part of a place has a multiple of a vector's lanes.
                unsafe {
                    let a = read_places(simd, self.from, read, parts);
                    let mut b = transform::<S, R>(simd, a);
                    if TURNED {
                        for j in 1..R {
                            b[j] = times(simd, b[j], factors[j]);
                        }
                    }
                    write_places(simd, self.to, written, parts, b);
                }
            }
        }
    }
}

/// Reads the parts of places that are so many floats apart.
///
/// # Safety
/// All of them lie within `from`.
#[inline(always)]
unsafe fn read_places<S: Simd, const R: usize>(
    simd: S,
    from: &[f32],
    (first, apart): (usize, usize),
    [real, imaginary]: [usize; 2],
) -> [Complex<S>; R] {
    let mut places = [[simd.splat(0.0); 2]; R];
    for (j, place) in places.iter_mut().enumerate() {
        let at = first + j * apart;
        // SAFETY: passed on to the caller.
        *place = unsafe { [simd.load(from, at + real), simd.load(from, at + imaginary)] };
    }
    places
}

/// Writes the parts of places that are so many floats apart.
///
/// # Safety
/// All of them lie within `to`.
#[inline(always)]
unsafe fn write_places<S: Simd, const R: usize>(
    simd: S,
    to: &mut [f32],
    (first, apart): (usize, usize),
    [real, imaginary]: [usize; 2],
    places: [Complex<S>; R],
) {
    for (j, place) in places.iter().enumerate() {
        let at = first + j * apart;
        // SAFETY: passed on to the caller.
        unsafe {
            simd.store(to, at + real, place[0]);
            simd.store(to, at + imaginary, place[1]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::testing::on_every_isa;

    /// Against sums of 64 bits, in every lane.
    #[test]
    fn transforms_are_those_of_the_definition_both_ways() {
        for length in [1, 2, 3, 4, 5, 6, 8, 9, 10, 16, 30, 40, 72, 81, 90, 96, 120, 480, 729, 960, 2592] {
            let plan = LinePlan::new(length);
            let value = |n: usize, i: usize| ((n * 31 + i * 17) % 23) as f32 / 23.0 - 0.4;
            let given: Vec<f32> = (0..length * COMPLEX).map(|at| value(at / COMPLEX, at % COMPLEX)).collect();
            for (direction, sign) in [(Direction::Forward, -1.0), (Direction::Inverse, 1.0)] {
                let transformed = || {
                    let (mut lines, mut room) = (given.clone(), vec![7.0; given.len()]);
                    plan.transform(direction, &mut lines, &mut room)[0].to_vec()
                };
                for (isa, lines) in on_every_isa(transformed) {
                    for (k, found) in lines.chunks_exact(COMPLEX).enumerate() {
                        for lane in [0, 3, WIDE - 1] {
                            let (mut re, mut im) = (0.0, 0.0);
                            for n in 0..length {
                                let angle =
                                    sign * std::f64::consts::TAU * (n * k % length) as f64 / length as f64;
                                let (x, y) = (f64::from(value(n, lane)), f64::from(value(n, WIDE + lane)));
                                re += x * angle.cos() - y * angle.sin();
                                im += x * angle.sin() + y * angle.cos();
                            }
                            let error =
                                (re - f64::from(found[lane])).hypot(im - f64::from(found[WIDE + lane]));
                            let least = 2e-6 * (length as f64).sqrt();
                            assert!(error < least, "{} {length} {direction:?} {k}: {error}", isa.name());
                        }
                    }
                }
            }
        }
    }
}
