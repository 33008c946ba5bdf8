//! The discrete Fourier transforms of a few numbers, of many lanes at once.

use crate::kernels::simd::Simd;

/// Complex numbers, one a lane: real and imaginary parts.
pub(super) type Complex<S> = [<S as Simd>::Vector; 2];

/// `exp(−2πi·k/9)` for k from 1 to 4.
const NINTHS: [[f32; 2]; 4] = [
    [0.766_044_44, -0.642_787_6],
    [0.173_648_18, -0.984_807_8],
    [-0.5, -0.866_025_4],
    [-0.939_692_6, -0.342_020_14],
];

#[inline(always)]
pub(super) fn add<S: Simd>(simd: S, a: Complex<S>, b: Complex<S>) -> Complex<S> {
    [simd.add(a[0], b[0]), simd.add(a[1], b[1])]
}

#[inline(always)]
pub(super) fn sub<S: Simd>(simd: S, a: Complex<S>, b: Complex<S>) -> Complex<S> {
    [simd.sub(a[0], b[0]), simd.sub(a[1], b[1])]
}

/// `a + i·b`.
#[inline(always)]
pub(super) fn add_turned<S: Simd>(simd: S, a: Complex<S>, b: Complex<S>) -> Complex<S> {
    [simd.sub(a[0], b[1]), simd.add(a[1], b[0])]
}

/// `a − i·b`.
#[inline(always)]
pub(super) fn sub_turned<S: Simd>(simd: S, a: Complex<S>, b: Complex<S>) -> Complex<S> {
    [simd.add(a[0], b[1]), simd.sub(a[1], b[0])]
}

/// `a·w`.
#[inline(always)]
pub(super) fn times<S: Simd>(simd: S, a: Complex<S>, w: Complex<S>) -> Complex<S> {
    let real = simd.sub_mul(simd.mul(a[0], w[0]), a[1], w[1]);
    [real, simd.mul_add(a[0], w[1], simd.mul(a[1], w[0]))]
}

/// `a·factor` of a real factor.
#[inline(always)]
fn scaled<S: Simd>(simd: S, a: Complex<S>, factor: f32) -> Complex<S> {
    let factor = simd.splat(factor);
    [simd.mul(a[0], factor), simd.mul(a[1], factor)]
}

/// `a + factor·b` of a real factor.
#[inline(always)]
fn add_scaled<S: Simd>(simd: S, a: Complex<S>, factor: f32, b: Complex<S>) -> Complex<S> {
    let factor = simd.splat(factor);
    [simd.mul_add(b[0], factor, a[0]), simd.mul_add(b[1], factor, a[1])]
}

/// `F[k] = Σ a[j]·exp(−2πi·j·k/R)` of R numbers, for R of 2, 3, 4, 5, 8 and 9.
#[inline(always)]
pub(super) fn transform<S: Simd, const R: usize>(simd: S, a: [Complex<S>; R]) -> [Complex<S>; R] {
    let mut out = a;
    match R {
        2 => (out[0], out[1]) = (add(simd, a[0], a[1]), sub(simd, a[0], a[1])),
        3 => [out[0], out[1], out[2]] = three(simd, [a[0], a[1], a[2]]),
        4 => [out[0], out[1], out[2], out[3]] = four(simd, [a[0], a[1], a[2], a[3]]),
        5 => {
            [out[0], out[1], out[2], out[3], out[4]] = five(simd, [a[0], a[1], a[2], a[3], a[4]]);
        }
        8 => {
            let even = four(simd, [a[0], a[2], a[4], a[6]]);
            let odd = four(simd, [a[1], a[3], a[5], a[7]]);
            (out[0], out[4]) = (add(simd, even[0], odd[0]), sub(simd, even[0], odd[0]));
            let half = std::f32::consts::FRAC_1_SQRT_2;
            // (1 − i)/√2 times a number, and (1 + i)/√2.
            let eighth = scaled(simd, sub_turned(simd, odd[1], odd[1]), half);
            let back = scaled(simd, add_turned(simd, odd[3], odd[3]), half);
            (out[1], out[5]) = (add(simd, even[1], eighth), sub(simd, even[1], eighth));
            (out[2], out[6]) = (sub_turned(simd, even[2], odd[2]), add_turned(simd, even[2], odd[2]));
            (out[3], out[7]) = (sub(simd, even[3], back), add(simd, even[3], back));
        }
        9 => {
            let mut rows = [[a[0]; 3]; 3];
            for j in 0..3 {
                rows[j] = three(simd, [a[j], a[j + 3], a[j + 6]]);
            }
            for (j, k) in [(1, 1), (1, 2), (2, 1), (2, 2)] {
                let [cos, sin] = NINTHS[j * k - 1];
                rows[j][k] = times(simd, rows[j][k], [simd.splat(cos), simd.splat(sin)]);
            }
            for k in 0..3 {
                [out[k], out[k + 3], out[k + 6]] = three(simd, [rows[0][k], rows[1][k], rows[2][k]]);
            }
        }
        _ => unreachable!("no transform of {R} numbers"),
    }
    out
}

#[inline(always)]
fn three<S: Simd>(simd: S, a: [Complex<S>; 3]) -> [Complex<S>; 3] {
    const SIN: f32 = 0.866_025_4;
    let (sum, difference) = (add(simd, a[1], a[2]), scaled(simd, sub(simd, a[1], a[2]), SIN));
    let middle = add_scaled(simd, a[0], -0.5, sum);
    [add(simd, a[0], sum), sub_turned(simd, middle, difference), add_turned(simd, middle, difference)]
}

#[inline(always)]
fn four<S: Simd>(simd: S, a: [Complex<S>; 4]) -> [Complex<S>; 4] {
    let even = [add(simd, a[0], a[2]), sub(simd, a[0], a[2])];
    let odd = [add(simd, a[1], a[3]), sub(simd, a[1], a[3])];
    [
        add(simd, even[0], odd[0]),
        sub_turned(simd, even[1], odd[1]),
        sub(simd, even[0], odd[0]),
        add_turned(simd, even[1], odd[1]),
    ]
}

#[inline(always)]
fn five<S: Simd>(simd: S, a: [Complex<S>; 5]) -> [Complex<S>; 5] {
    // Cosines and sines of a fifth and two fifths of a turn.
    const COS: [f32; 2] = [0.309_017, -0.809_017];
    const SIN: [f32; 2] = [0.951_056_5, 0.587_785_25];
    let sums = [add(simd, a[1], a[4]), add(simd, a[2], a[3])];
    let differences = [sub(simd, a[1], a[4]), sub(simd, a[2], a[3])];
    let near = add_scaled(simd, add_scaled(simd, a[0], COS[0], sums[0]), COS[1], sums[1]);
    let far = add_scaled(simd, add_scaled(simd, a[0], COS[1], sums[0]), COS[0], sums[1]);
    let of_near = add_scaled(simd, scaled(simd, differences[0], SIN[0]), SIN[1], differences[1]);
    let of_far = add_scaled(simd, scaled(simd, differences[0], SIN[1]), -SIN[0], differences[1]);
    [
        add(simd, add(simd, a[0], sums[0]), sums[1]),
        sub_turned(simd, near, of_near),
        sub_turned(simd, far, of_far),
        add_turned(simd, far, of_far),
        add_turned(simd, near, of_near),
    ]
}
