//! Fourier transforms of many lines at once, each in a lane: no step of one line has to wait for another, and none shuffles lanes.
//!
//! Sixteen lines stand side by side, `[place][part][line]`, parts being real and imaginary; blocks of 16 × 16 are transposed where
//! lines come from memory in which they stand one after the other, and where they go back.

mod butterfly;
mod lines;
mod real;
mod response;

pub use lines::{Direction, LinePlan};
pub use real::RealPlan;
pub use response::{Damping, Response};

use super::simd::{Isa, Kernel, Simd};

/// Lines side by side.
pub const WIDE: usize = 16;

/// Floats of the complex numbers of one place.
pub const COMPLEX: usize = 2 * WIDE;

/// Floats of a tile of 16 places of complex lines, `[part][place][line]`.
pub const TILE: usize = COMPLEX * WIDE;

/// Whether a length is a product of 2, 3 and 5.
pub fn is_smooth(length: usize) -> bool {
    let without = |length: usize, prime: usize| {
        std::iter::successors(Some(length), |left| left.is_multiple_of(prime).then(|| left / prime)).last()
    };
    length > 0 && [2, 3, 5].into_iter().try_fold(length, without) == Some(1)
}

/// Writes the transpose of a block of 16 × 16 floats, of which rows stand so many apart: `to[j][i] = from[i][j]`.
///
/// # Panics
/// When a row begins within a slice and ends outside.
pub fn transpose(from: &[f32], from_stride: usize, to: &mut [f32], to_stride: usize) {
    struct Block<'a> {
        from: (&'a [f32], usize),
        to: (&'a mut [f32], usize),
    }

    impl Kernel for Block<'_> {
        type Output = ();

        #[inline(always)]
        fn run<S: Simd>(self, simd: S) {
            // SAFETY: the caller checked that the last rows end within the slices.
            unsafe { simd.transpose(self.from.0, self.from.1, self.to.0, self.to.1) };
        }
    }

    let end = |stride: usize| (WIDE - 1) * stride + WIDE;
    assert!(end(from_stride) <= from.len() && end(to_stride) <= to.len(), "a block has sixteen rows");
    Isa::current().run(Block { from: (from, from_stride), to: (to, to_stride) });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::testing::on_every_isa;

    #[test]
    fn smooth_lengths_are_products_of_two_three_and_five() {
        let smooth: Vec<_> = (0..33).filter(|length| is_smooth(*length)).collect();
        assert_eq!(smooth, [1, 2, 3, 4, 5, 6, 8, 9, 10, 12, 15, 16, 18, 20, 24, 25, 27, 30, 32]);
    }

    #[test]
    fn blocks_are_transposed_and_nothing_beside_them_is_written() {
        let from: Vec<f32> = (0..16 * 19).map(|at| at as f32).collect();
        let transposed = || {
            let mut to = vec![-1.0; 16 * 35 + 3];
            transpose(&from[2..], 19, &mut to[3..], 35);
            to
        };
        for (isa, to) in on_every_isa(transposed) {
            for (at, found) in to.iter().enumerate() {
                let (row, column) = (at.wrapping_sub(3) / 35, at.wrapping_sub(3) % 35);
                let expected =
                    if at >= 3 && row < 16 && column < 16 { from[2 + column * 19 + row] } else { -1.0 };
                assert_eq!(*found, expected, "{} {row} {column}", isa.name());
            }
        }
    }
}
