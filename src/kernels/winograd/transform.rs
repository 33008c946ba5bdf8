//! The matrices of F(4, 3) with the points 0, ±h, ±r, ∞, where h = 1/√2 and r = √2, as straight-line code.
//!
//! For a finite point p with N(p) = ∏_{q≠p} (p − q): row p of G is `[1, p, p²] / N(p)`, row p of Bᵀ holds the
//! coefficients of ∏_{q≠p} (x − q), and column p of Aᵀ is `[1, p, p², p³]`. With h² = 1/2 and r² = 2,
//! N(0) = 1, N(±h) = 2h²(h² − 2) = −3/2 and N(±r) = 2r²(r² − 1/2) = 6.

use std::f32::consts::{FRAC_1_SQRT_2, SQRT_2};

use super::{POINTS, TILE};
use crate::kernels::simd::Simd;

/// G, row by row: what the weights are multiplied by.
#[cfg(test)]
const G: [[f64; 3]; POINTS] = {
    const H: f64 = std::f64::consts::FRAC_1_SQRT_2;
    const R: f64 = std::f64::consts::SQRT_2;
    [
        [1.0, 0.0, 0.0],
        [-2.0 / 3.0, -H * 2.0 / 3.0, -1.0 / 3.0],
        [-2.0 / 3.0, H * 2.0 / 3.0, -1.0 / 3.0],
        [1.0 / 6.0, R / 6.0, 1.0 / 3.0],
        [1.0 / 6.0, -R / 6.0, 1.0 / 3.0],
        [0.0, 0.0, 1.0],
    ]
};

/// Multiplies six inputs by Bᵀ.
///
/// # Equation
/// `x⁴ − 5/2 x² + 1`; `x⁴ ± h x³ − 2x² ∓ 2h x`; `x⁴ ± r x³ − x²/2 ∓ r/2 x`; `x⁵ − 5/2 x³ + x`.
#[inline(always)]
pub(crate) fn input<S: Simd>(simd: S, d: [S::Vector; POINTS]) -> [S::Vector; POINTS] {
    let (half, two, five_halves) = (simd.splat(0.5), simd.splat(2.0), simd.splat(2.5));
    let (h, r) = (simd.splat(FRAC_1_SQRT_2), simd.splat(SQRT_2));
    let even_h = simd.sub_mul(d[4], two, d[2]);
    let odd_h = simd.mul(h, simd.sub_mul(d[3], two, d[1]));
    let even_r = simd.sub_mul(d[4], half, d[2]);
    let odd_r = simd.mul(r, simd.sub_mul(d[3], half, d[1]));
    [
        simd.add(d[0], simd.sub_mul(d[4], five_halves, d[2])),
        simd.add(even_h, odd_h),
        simd.sub(even_h, odd_h),
        simd.add(even_r, odd_r),
        simd.sub(even_r, odd_r),
        simd.add(d[1], simd.sub_mul(d[5], five_halves, d[3])),
    ]
}

/// Multiplies six products by Aᵀ.
#[inline(always)]
pub(crate) fn output<S: Simd>(simd: S, m: [S::Vector; POINTS]) -> [S::Vector; TILE] {
    let (half, two) = (simd.splat(0.5), simd.splat(2.0));
    let (h, r) = (simd.splat(FRAC_1_SQRT_2), simd.splat(SQRT_2));
    let (h_cubed, r_cubed) = (simd.splat(FRAC_1_SQRT_2 * 0.5), simd.splat(SQRT_2 * 2.0));
    let (even_h, odd_h) = (simd.add(m[1], m[2]), simd.sub(m[1], m[2]));
    let (even_r, odd_r) = (simd.add(m[3], m[4]), simd.sub(m[3], m[4]));
    [
        simd.add(simd.add(m[0], even_h), even_r),
        simd.mul_add(r, odd_r, simd.mul(h, odd_h)),
        simd.mul_add(two, even_r, simd.mul(half, even_h)),
        simd.mul_add(r_cubed, odd_r, simd.mul_add(h_cubed, odd_h, m[5])),
    ]
}

/// Multiplies the gradients of four outputs by A: the transpose of [`output`].
#[inline(always)]
pub(crate) fn output_gradient<S: Simd>(simd: S, y: [S::Vector; TILE]) -> [S::Vector; POINTS] {
    let (half, two) = (simd.splat(0.5), simd.splat(2.0));
    let (h, r) = (simd.splat(FRAC_1_SQRT_2), simd.splat(SQRT_2));
    let even_h = simd.mul_add(half, y[2], y[0]);
    let odd_h = simd.mul(h, simd.mul_add(half, y[3], y[1]));
    let even_r = simd.mul_add(two, y[2], y[0]);
    let odd_r = simd.mul(r, simd.mul_add(two, y[3], y[1]));
    [
        y[0],
        simd.add(even_h, odd_h),
        simd.sub(even_h, odd_h),
        simd.add(even_r, odd_r),
        simd.sub(even_r, odd_r),
        y[3],
    ]
}

/// Multiplies the gradients of six transformed weights by Gᵀ.
#[inline(always)]
pub(crate) fn weight_gradient<S: Simd>(simd: S, u: [S::Vector; POINTS]) -> [S::Vector; 3] {
    let (third, two_thirds, sixth) = (simd.splat(1.0 / 3.0), simd.splat(2.0 / 3.0), simd.splat(1.0 / 6.0));
    let (h, r) = (simd.splat(FRAC_1_SQRT_2 * 2.0 / 3.0), simd.splat(SQRT_2 / 6.0));
    let (even_h, odd_h) = (simd.add(u[1], u[2]), simd.sub(u[2], u[1]));
    let (even_r, odd_r) = (simd.add(u[3], u[4]), simd.sub(u[3], u[4]));
    [
        simd.mul_add(sixth, even_r, simd.sub_mul(u[0], two_thirds, even_h)),
        simd.mul_add(r, odd_r, simd.mul(h, odd_h)),
        simd.mul_add(third, simd.sub(even_r, even_h), u[5]),
    ]
}

/// Multiplies three weights by G, several at once and in f64, so that it adds no error but the rounding of its
/// results to f32.
#[inline(always)]
pub(crate) fn weight<const N: usize>(g: [[f64; N]; 3]) -> [[f64; N]; POINTS] {
    const H: f64 = std::f64::consts::FRAC_1_SQRT_2 * 2.0 / 3.0;
    const R: f64 = std::f64::consts::SQRT_2 / 6.0;
    let mut u = [[0.0; N]; POINTS];
    for t in 0..N {
        let (even_h, odd_h) = (g[0][t] * (-2.0 / 3.0) - g[2][t] * (1.0 / 3.0), g[1][t] * H);
        let (even_r, odd_r) = (g[0][t] * (1.0 / 6.0) + g[2][t] * (1.0 / 3.0), g[1][t] * R);
        u[0][t] = g[0][t];
        u[1][t] = even_h - odd_h;
        u[2][t] = even_h + odd_h;
        u[3][t] = even_r + odd_r;
        u[4][t] = even_r - odd_r;
        u[5][t] = g[2][t];
    }
    u
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::simd::Portable;

    /// Σ over the three taps for four outputs, by the transforms alone.
    fn filter(d: [f32; 6], g: [f64; 3]) -> [f32; 4] {
        let v = input(Portable, d.map(|x| [x; 4]));
        let u = G.map(|row| row.iter().zip(g).map(|(a, b)| a * b).sum::<f64>() as f32);
        let m = std::array::from_fn(|p| v[p].map(|x| x * u[p]));
        output(Portable, m).map(|x| x[0])
    }

    #[test]
    fn filters_six_inputs_to_four_outputs() {
        let d = [0.5, -1.25, 2.0, 0.75, -0.5, 3.0];
        let g = [0.3, -0.7, 1.1];
        for (i, found) in filter(d, g).into_iter().enumerate() {
            let expected: f64 = (0..3).map(|k| f64::from(d[i + k]) * g[k]).sum();
            // The matrices' largest entries are 2.8, six terms of them: some 20 roundings of 6e-8.
            assert!((f64::from(found) - expected).abs() < 2e-6, "{i}: {found} {expected}");
        }
    }

    #[test]
    fn the_weights_are_multiplied_by_g() {
        let g = [[0.3, -0.1], [-0.7, 0.4], [1.1, 0.9]];
        let u = [0.4f32, -1.2, 0.8, 2.5, -0.3, 0.6];
        let back = weight_gradient(Portable, u.map(|u| [u; 4]));
        for (row, found) in G.iter().zip(weight(g)) {
            for (lane, found) in found.into_iter().enumerate() {
                let expected: f64 = row.iter().zip(g).map(|(a, g)| a * g[lane]).sum();
                assert!((found - expected).abs() < 1e-15, "{found} {expected}");
            }
        }
        for (tap, found) in back.into_iter().enumerate() {
            let expected: f64 = G.iter().zip(u).map(|(row, u)| row[tap] * f64::from(u)).sum();
            assert!((f64::from(found[0]) - expected).abs() < 1e-6, "{found:?} {expected}");
        }
    }

    #[test]
    fn the_output_gradient_is_the_transpose() {
        for row in 0..TILE {
            let unit = std::array::from_fn(|i| [if i == row { 1.0f32 } else { 0.0 }; 4]);
            let column = output_gradient(Portable, unit);
            for (p, entry) in column.iter().enumerate() {
                let m = std::array::from_fn(|i| [if i == p { 1.0f32 } else { 0.0 }; 4]);
                assert!((output(Portable, m)[row][0] - entry[0]).abs() < 1e-6);
            }
        }
    }
}
