//! Vectors of four floats in plain Rust, which compilers turn into SSE2 or NEON.

use super::Simd;

/// The path that every CPU has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Portable;

/// Applies `f` lane by lane.
#[inline(always)]
fn lanes(f: impl Fn(usize) -> f32) -> [f32; 4] {
    std::array::from_fn(f)
}

impl Simd for Portable {
    const LANES: usize = 4;
    type Vector = [f32; 4];

    #[inline(always)]
    fn splat(self, value: f32) -> [f32; 4] {
        [value; 4]
    }

    #[inline(always)]
    unsafe fn load(self, from: &[f32], at: usize) -> [f32; 4] {
        // SAFETY: the caller promises that four floats begin at `at`.
        let part = unsafe { from.get_unchecked(at..at + 4) };
        lanes(|i| part[i])
    }

    #[inline(always)]
    unsafe fn store(self, to: &mut [f32], at: usize, value: [f32; 4]) {
        // SAFETY: the caller promises room for four floats at `at`.
        unsafe { to.get_unchecked_mut(at..at + 4) }.copy_from_slice(&value);
    }

    #[inline(always)]
    unsafe fn load_part(self, from: &[f32], at: usize, count: usize) -> [f32; 4] {
        // SAFETY: the caller promises that `count` floats begin at `at`.
        let part = unsafe { from.get_unchecked(at..at + count) };
        lanes(|i| part.get(i).copied().unwrap_or(0.0))
    }

    #[inline(always)]
    unsafe fn store_part(self, to: &mut [f32], at: usize, count: usize, value: [f32; 4]) {
        // SAFETY: the caller promises room for `count` floats at `at`.
        let part = unsafe { to.get_unchecked_mut(at..at + count) };
        part.iter_mut().zip(value).for_each(|(to, value)| *to = value);
    }

    #[inline(always)]
    fn add(self, a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
        lanes(|i| a[i] + b[i])
    }

    #[inline(always)]
    fn sub(self, a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
        lanes(|i| a[i] - b[i])
    }

    #[inline(always)]
    fn mul(self, a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
        lanes(|i| a[i] * b[i])
    }

    #[inline(always)]
    fn div(self, a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
        lanes(|i| a[i] / b[i])
    }

    // Two roundings: `f32::mul_add` is a library call where the CPU has no such instruction.
    #[inline(always)]
    fn mul_add(self, a: [f32; 4], b: [f32; 4], c: [f32; 4]) -> [f32; 4] {
        lanes(|i| a[i] * b[i] + c[i])
    }

    #[inline(always)]
    fn sub_mul(self, c: [f32; 4], a: [f32; 4], b: [f32; 4]) -> [f32; 4] {
        lanes(|i| c[i] - a[i] * b[i])
    }

    #[inline(always)]
    fn leak(self, sign: [f32; 4], value: [f32; 4], slope: [f32; 4]) -> [f32; 4] {
        lanes(|i| if sign[i] > 0.0 { value[i] } else { slope[i] * value[i] })
    }

    #[inline(always)]
    fn sum(self, a: [f32; 4]) -> f32 {
        (a[0] + a[2]) + (a[1] + a[3])
    }
}
