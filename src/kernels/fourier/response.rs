//! The products of spectra with what is made of a transfer function.

use super::butterfly::{Complex, times};
use super::{COMPLEX, WIDE};
use crate::kernels::simd::{Isa, Kernel, Simd};

/// What a spectrum is multiplied by, of a transfer function H and of that of the negative Laplacian, L ≥ 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Response {
    /// H: the convolution.
    Convolution,
    /// H̄: its transpose.
    Correlation,
    /// `H̄/(|H|² + s·L + ε)`: a regularised inverse of the convolution.
    Inverse(Damping),
    /// `1/(|H|² + s·L + ε)`: the inverse of its normal matrix.
    NormalInverse(Damping),
}

/// What keeps an inverse from dividing by zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Damping {
    /// s: the weight of differences.
    pub smoothness: f32,
    /// ε.
    pub floor: f32,
}

impl Response {
    /// The factor at one frequency, `[real, imaginary]`.
    pub fn of(self, [re, im]: [f32; 2], laplacian: f32) -> [f32; 2] {
        let inverse = |Damping { smoothness, floor }: Damping| {
            1.0 / (re * re + im * im + smoothness * laplacian + floor)
        };
        match self {
            Self::Convolution => [re, im],
            Self::Correlation => [re, -im],
            Self::Inverse(damping) => [re * inverse(damping), -im * inverse(damping)],
            Self::NormalInverse(damping) => [inverse(damping), 0.0],
        }
    }

    /// Multiplies sixteen lines of a spectrum side by side, `[place][part][line]`, by the factors of as many of a transfer function;
    /// the Laplacian's is the sum of one part for each place and one for each line.
    ///
    /// # Panics
    /// When there are not as many places of each.
    pub fn multiply(self, lines: &mut [f32], transfer: &[f32], laplacian: (&[f32], &[f32; WIDE])) {
        let floats = laplacian.0.len() * COMPLEX;
        assert_eq!([lines.len(), transfer.len()], [floats; 2], "lines, and numbers for each of their places");
        Isa::current().run(Product { response: self, lines, transfer, laplacian });
    }
}

struct Product<'a> {
    response: Response,
    lines: &'a mut [f32],
    transfer: &'a [f32],
    laplacian: (&'a [f32], &'a [f32; WIDE]),
}

impl Kernel for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { response, lines, transfer, laplacian: (of_places, of_lines) } = self;
        let places = of_places.len();
        assert!(lines.len() == places * COMPLEX && transfer.len() == places * COMPLEX, "as promised");
        for (place, of_place) in of_places.iter().enumerate() {
            for lane in (0..WIDE).step_by(S::LANES) {
                let at = place * COMPLEX + lane;
                // SAFETY: there are as many places, as was checked above, and a multiple of a vector's lanes in a part of one.
                let (x, h, of_lines) = unsafe {
                    let x = [simd.load(lines, at), simd.load(lines, at + WIDE)];
                    let h = [simd.load(transfer, at), simd.load(transfer, at + WIDE)];
                    (x, h, simd.load(of_lines, lane))
                };
                let conjugate: Complex<S> = [h[0], simd.sub(simd.splat(0.0), h[1])];
                let product = match response {
                    Response::Convolution => times(simd, x, h),
                    Response::Correlation => times(simd, x, conjugate),
                    Response::Inverse(damping) | Response::NormalInverse(damping) => {
                        let least = simd.splat(damping.smoothness * of_place + damping.floor);
                        let least = simd.mul_add(of_lines, simd.splat(damping.smoothness), least);
                        let power = simd.mul_add(h[0], h[0], simd.mul_add(h[1], h[1], least));
                        let x = [simd.div(x[0], power), simd.div(x[1], power)];
                        if matches!(response, Response::Inverse(_)) { times(simd, x, conjugate) } else { x }
                    }
                };
                // SAFETY: as above.
                unsafe {
                    simd.store(lines, at, product[0]);
                    simd.store(lines, at + WIDE, product[1]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::testing::on_every_isa;

    #[test]
    fn products_are_those_with_the_factors_of_each_frequency() {
        let value = |at: usize, seed: usize| ((at * 31 + seed * 17) % 23) as f32 / 23.0 - 0.4;
        let places = 5;
        let [lines, transfer]: [Vec<f32>; 2] =
            [1, 2].map(|seed| (0..places * COMPLEX).map(|at| value(at, seed)).collect());
        let of_places: Vec<f32> = (0..places).map(|place| value(place, 3) + 0.5).collect();
        let of_lines: [f32; WIDE] = std::array::from_fn(|line| value(line, 4) + 0.5);
        let damping = Damping { smoothness: 0.3, floor: 0.02 };
        let responses = [
            Response::Convolution,
            Response::Correlation,
            Response::Inverse(damping),
            Response::NormalInverse(damping),
        ];
        for response in responses {
            let multiplied = || {
                let mut lines = lines.clone();
                response.multiply(&mut lines, &transfer, (&of_places, &of_lines));
                lines
            };
            for (isa, found) in on_every_isa(multiplied) {
                for (place, of_place) in of_places.iter().enumerate() {
                    for (line, of_line) in of_lines.iter().enumerate() {
                        let at = place * COMPLEX + line;
                        let h = [transfer[at], transfer[at + WIDE]];
                        let factor = response.of(h, of_place + of_line);
                        let expected = [
                            lines[at] * factor[0] - lines[at + WIDE] * factor[1],
                            lines[at] * factor[1] + lines[at + WIDE] * factor[0],
                        ];
                        for (part, expected) in expected.into_iter().enumerate() {
                            let error = (found[at + part * WIDE] - expected).abs();
                            assert!(
                                error < 1e-5 * expected.abs().max(1.0),
                                "{} {response:?}: {error}",
                                isa.name()
                            );
                        }
                    }
                }
            }
        }
    }
}
