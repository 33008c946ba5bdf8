//! Sums over rows of planes that are the same on every CPU: in a fixed number of lanes, of 64 bits.

use ndarray::{Array2, Zip};

use super::super::objective::sum_of_rows;
use super::frame::row;
use crate::kernels::vectorised;

/// Numbers that are added side by side.
pub(super) const LANES: usize = 16;

/// Sums of lanes.
pub(super) type Lanes = [f64; LANES];

/// Adds the products of two slices of one length, at most so many lanes long, to the sums.
#[inline(always)]
pub(super) fn add_products(sums: &mut Lanes, a: &[f32], b: &[f32]) {
    for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
        *sum += f64::from(*a) * f64::from(*b);
    }
}

/// The inner product of two slices of one length.
#[inline(always)]
pub(super) fn dot(a: &[f32], b: &[f32]) -> f64 {
    let mut sums = [0.0; LANES];
    let ((a, last_of_a), (b, last_of_b)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        add_products(&mut sums, a, b);
    }
    add_products(&mut sums, last_of_a, last_of_b);
    sums.iter().sum()
}

/// The sum of a slice.
#[inline(always)]
pub(super) fn sum(of: &[f32]) -> f64 {
    let mut sums = [0.0; LANES];
    let (of, last) = of.as_chunks::<LANES>();
    for of in of.iter().map(|of| &of[..]).chain([last]) {
        sums.iter_mut().zip(of).for_each(|(sum, value)| *sum += f64::from(*value));
    }
    sums.iter().sum()
}

vectorised! {
    /// [`dot`].
    fn products<'a>(a: &'a [f32], b: &'a [f32]) -> f64 {
        dot(a, b)
    }
}

/// The inner product of two planes.
pub(super) fn inner(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    sum_of_rows(a.nrows(), |y| products(row(a, y), row(b, y)))
}

/// Adds so many times a plane to another.
pub(super) fn add_scaled(to: &mut Array2<f32>, scale: f32, from: &Array2<f32>) {
    Zip::from(to).and(from).par_for_each(|to, from| *to += scale * from);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inner_products_are_those_of_all_numbers() {
        for width in [1, 15, 16, 37] {
            let plane = |seed: usize| {
                Array2::from_shape_fn((3, width), |(y, x)| ((y * 31 + x * 17 + seed) % 23) as f32 - 11.0)
            };
            let (a, b) = (plane(1), plane(8));
            let expected: f64 = a.iter().zip(&b).map(|(a, b)| f64::from(a * b)).sum();
            assert_eq!(inner(&a, &b), expected);
        }
    }
}
