//! AVX-512, with and without products in bfloat16, and AVX2 with fused multiply-add, through `std::arch`.

use std::arch::x86_64::{
    __m256, __m256i, __m512, __m512bh, _CMP_GT_OQ, _CMP_NGT_UQ, _MM_HINT_T0, _mm_add_ps, _mm_add_ss,
    _mm_cvtss_f32, _mm_movehdup_ps, _mm_movehl_ps, _mm_prefetch, _mm256_add_ps, _mm256_blendv_ps,
    _mm256_castpd_ps, _mm256_castps_pd, _mm256_castps256_ps128, _mm256_cmp_ps, _mm256_div_ps,
    _mm256_extractf128_ps, _mm256_fmadd_ps, _mm256_fnmadd_ps, _mm256_loadu_ps, _mm256_loadu_si256,
    _mm256_maskload_ps, _mm256_maskstore_ps, _mm256_mul_ps, _mm256_permute2f128_ps, _mm256_set1_ps,
    _mm256_setzero_ps, _mm256_storeu_ps, _mm256_sub_ps, _mm256_unpackhi_pd, _mm256_unpackhi_ps,
    _mm256_unpacklo_pd, _mm256_unpacklo_ps, _mm512_add_ps, _mm512_castpd_ps, _mm512_castps_pd,
    _mm512_cmp_ps_mask, _mm512_cvtne2ps_pbh, _mm512_div_ps, _mm512_dpbf16_ps, _mm512_fmadd_ps,
    _mm512_fnmadd_ps, _mm512_loadu_ps, _mm512_mask_mul_ps, _mm512_mask_storeu_ps, _mm512_maskz_loadu_ps,
    _mm512_mul_ps, _mm512_reduce_add_ps, _mm512_set1_ps, _mm512_setzero_ps, _mm512_shuffle_f32x4,
    _mm512_storeu_ps, _mm512_sub_ps, _mm512_unpackhi_pd, _mm512_unpackhi_ps, _mm512_unpacklo_pd,
    _mm512_unpacklo_ps,
};
use std::mem::transmute;

use super::{Kernel, Simd};

/// Asks for a cache line.
#[inline(always)]
pub(super) fn prefetch(line: *const f32) {
    // SAFETY: every x86-64 CPU has the instruction, which is a hint: it may be given any address and reads nothing.
    unsafe { _mm_prefetch::<_MM_HINT_T0>(line.cast()) };
}

/// Proof that the CPU has AVX-512 F, VL, DQ and BW; sixteen floats per vector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Avx512(());

/// Proof that the CPU has AVX-512 BF16 too: products of two numbers per lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Avx512Bf16(());

/// Proof that the CPU has AVX2 and FMA; eight floats per vector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Avx2(());

impl Avx512 {
    /// Asks the CPU.
    pub(crate) fn detect() -> Option<Self> {
        let found = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma");
        found.then_some(Self(()))
    }

    /// Runs a kernel in a function that has the features enabled.
    #[inline]
    pub(crate) fn enter<K: Kernel>(self, kernel: K) -> K::Output {
        #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma")]
        fn entered<K: Kernel>(kernel: K, token: Avx512) -> K::Output {
            kernel.run(token)
        }
        // SAFETY: the token was made by `detect`, which saw every feature named here.
        unsafe { entered(kernel, self) }
    }
}

impl Avx512Bf16 {
    /// Asks the CPU.
    pub(crate) fn detect() -> Option<Self> {
        (Avx512::detect().is_some() && is_x86_feature_detected!("avx512bf16")).then_some(Self(()))
    }

    /// Forgets the products of two numbers per lane.
    pub(crate) fn without(self) -> Avx512 {
        Avx512(())
    }

    /// Runs a kernel in a function that has the features enabled.
    #[inline]
    pub(crate) fn enter<K: Kernel>(self, kernel: K) -> K::Output {
        #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx512bf16,avx2,fma")]
        fn entered<K: Kernel>(kernel: K, token: Avx512Bf16) -> K::Output {
            kernel.run(token)
        }
        // SAFETY: the token was made by `detect`, which saw every feature named here.
        unsafe { entered(kernel, self) }
    }
}

impl Avx2 {
    /// Asks the CPU.
    pub(crate) fn detect() -> Option<Self> {
        (is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")).then_some(Self(()))
    }

    /// Runs a kernel in a function that has the features enabled.
    #[inline]
    pub(crate) fn enter<K: Kernel>(self, kernel: K) -> K::Output {
        #[target_feature(enable = "avx2,fma")]
        fn entered<K: Kernel>(kernel: K, token: Avx2) -> K::Output {
            kernel.run(token)
        }
        // SAFETY: the token was made by `detect`, which saw both features.
        unsafe { entered(kernel, self) }
    }
}

/// Implements the arithmetic that differs by the intrinsics' names only.
///
/// Each call is sound because `self` is a token, and tokens are made after detection only.
macro_rules! arithmetic {
    ($vector:ty, $lanes:literal, $splat:ident, $load:ident, $store:ident, $add:ident, $sub:ident, $mul:ident,
     $div:ident, $mul_add:ident, $sub_mul:ident) => {
        const LANES: usize = $lanes;
        type Vector = $vector;

        #[inline(always)]
        fn splat(self, value: f32) -> $vector {
            // SAFETY: the token proves the instruction.
            unsafe { $splat(value) }
        }

        #[inline(always)]
        unsafe fn load(self, from: &[f32], at: usize) -> $vector {
            // SAFETY: the token proves the instruction; the caller promises that a vector begins at `at`.
            unsafe { $load(from.get_unchecked(at..at + $lanes).as_ptr()) }
        }

        #[inline(always)]
        unsafe fn store(self, to: &mut [f32], at: usize, value: $vector) {
            // SAFETY: the token proves the instruction; the caller promises room for a vector at `at`.
            unsafe { $store(to.get_unchecked_mut(at..at + $lanes).as_mut_ptr(), value) }
        }

        #[inline(always)]
        fn add(self, a: $vector, b: $vector) -> $vector {
            // SAFETY: the token proves the instruction.
            unsafe { $add(a, b) }
        }

        #[inline(always)]
        fn sub(self, a: $vector, b: $vector) -> $vector {
            // SAFETY: the token proves the instruction.
            unsafe { $sub(a, b) }
        }

        #[inline(always)]
        fn mul(self, a: $vector, b: $vector) -> $vector {
            // SAFETY: the token proves the instruction.
            unsafe { $mul(a, b) }
        }

        #[inline(always)]
        fn div(self, a: $vector, b: $vector) -> $vector {
            // SAFETY: the token proves the instruction.
            unsafe { $div(a, b) }
        }

        #[inline(always)]
        fn mul_add(self, a: $vector, b: $vector, c: $vector) -> $vector {
            // SAFETY: the token proves the instruction.
            unsafe { $mul_add(a, b, c) }
        }

        #[inline(always)]
        fn sub_mul(self, c: $vector, a: $vector, b: $vector) -> $vector {
            // SAFETY: the token proves the instruction.
            unsafe { $sub_mul(a, b, c) }
        }
    };
}

/// The mask of the first `count` of sixteen lanes.
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "a mask has sixteen bits")]
fn first_lanes(count: usize) -> u16 {
    debug_assert!(count <= 16, "{count} of 16 lanes");
    ((1u32 << count) - 1) as u16
}

/// The mask of the first `count` of eight lanes.
///
/// # Safety
/// The CPU has AVX2, and `count <= 8`.
#[inline(always)]
unsafe fn first_of_eight(count: usize) -> __m256i {
    const ONES_THEN_ZEROS: [i32; 16] = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 0, 0];
    // SAFETY: the caller promises the instruction, and eight numbers follow place `8 − count`.
    unsafe { _mm256_loadu_si256(ONES_THEN_ZEROS.get_unchecked(8 - count..).as_ptr().cast()) }
}

/// Implements [`Simd`] for a token that proves AVX-512, with what `$products` adds.
macro_rules! avx512 {
    ($token:ty, { $($products:item)* }) => {
        impl Simd for $token {
            $($products)*

            arithmetic!(
                __m512,
                16,
                _mm512_set1_ps,
                _mm512_loadu_ps,
                _mm512_storeu_ps,
                _mm512_add_ps,
                _mm512_sub_ps,
                _mm512_mul_ps,
                _mm512_div_ps,
                _mm512_fmadd_ps,
                _mm512_fnmadd_ps
            );

            #[inline(always)]
            unsafe fn load_part(self, from: &[f32], at: usize, count: usize) -> __m512 {
                // SAFETY: the token proves the instruction; the caller promises that `count` floats begin at `at`, and
                // lanes that the mask leaves out are not read.
                unsafe { _mm512_maskz_loadu_ps(first_lanes(count), from.get_unchecked(at..at + count).as_ptr()) }
            }

            #[inline(always)]
            unsafe fn store_part(self, to: &mut [f32], at: usize, count: usize, value: __m512) {
                // SAFETY: the token proves the instruction; the caller promises room for `count` floats at `at`, and
                // lanes that the mask leaves out are not written.
                unsafe {
                    let to = to.get_unchecked_mut(at..at + count).as_mut_ptr();
                    _mm512_mask_storeu_ps(to, first_lanes(count), value);
                }
            }

            #[inline(always)]
            fn leak(self, sign: __m512, value: __m512, slope: __m512) -> __m512 {
                // SAFETY: the token proves the instructions.
                unsafe {
                    let others = _mm512_cmp_ps_mask::<_CMP_NGT_UQ>(sign, _mm512_setzero_ps());
                    _mm512_mask_mul_ps(value, others, slope, value)
                }
            }

            #[inline(always)]
            fn sum(self, a: __m512) -> f32 {
                // SAFETY: the token proves the instructions.
                unsafe { _mm512_reduce_add_ps(a) }
            }

            #[inline(always)]
            unsafe fn transpose(self, from: &[f32], from_stride: usize, to: &mut [f32], to_stride: usize) {
                // SAFETY: the token proves the instructions; the caller promises the rows.
                unsafe {
                    let rows = super::load_strided(self, from, 0, from_stride);
                    super::store_strided(self, to, 0, to_stride, &transposed(rows));
                }
            }
        }
    };
}

/// The columns of sixteen rows.
///
/// # Safety
/// The CPU has AVX-512 F.
#[inline(always)]
unsafe fn transposed(mut rows: [__m512; 16]) -> [__m512; 16] {
    let mut pairs = rows;
    // SAFETY: the caller promises the instructions.
    unsafe {
        for i in (0..16).step_by(2) {
            pairs[i] = _mm512_unpacklo_ps(rows[i], rows[i + 1]);
            pairs[i + 1] = _mm512_unpackhi_ps(rows[i], rows[i + 1]);
        }
        for i in (0..16).step_by(4) {
            for half in 0..2 {
                let (a, b) = (_mm512_castps_pd(pairs[i + half]), _mm512_castps_pd(pairs[i + half + 2]));
                rows[i + 2 * half] = _mm512_castpd_ps(_mm512_unpacklo_pd(a, b));
                rows[i + 2 * half + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(a, b));
            }
        }
        // Quarters of rows: those of even and of odd columns of quarters, twice.
        for i in 0..4 {
            for half in [0, 8] {
                let (a, b) = (rows[half + i], rows[half + i + 4]);
                pairs[half + i] = _mm512_shuffle_f32x4::<0b10_00_10_00>(a, b);
                pairs[half + i + 4] = _mm512_shuffle_f32x4::<0b11_01_11_01>(a, b);
            }
        }
        for i in 0..8 {
            rows[i] = _mm512_shuffle_f32x4::<0b10_00_10_00>(pairs[i], pairs[i + 8]);
            rows[i + 8] = _mm512_shuffle_f32x4::<0b11_01_11_01>(pairs[i], pairs[i + 8]);
        }
    }
    rows
}

/// The columns of eight rows.
///
/// # Safety
/// The CPU has AVX.
#[inline(always)]
unsafe fn transposed_of_eight(mut rows: [__m256; 8]) -> [__m256; 8] {
    let mut pairs = rows;
    // SAFETY: the caller promises the instructions.
    unsafe {
        for i in (0..8).step_by(2) {
            pairs[i] = _mm256_unpacklo_ps(rows[i], rows[i + 1]);
            pairs[i + 1] = _mm256_unpackhi_ps(rows[i], rows[i + 1]);
        }
        for i in (0..8).step_by(4) {
            for half in 0..2 {
                let (a, b) = (_mm256_castps_pd(pairs[i + half]), _mm256_castps_pd(pairs[i + half + 2]));
                rows[i + 2 * half] = _mm256_castpd_ps(_mm256_unpacklo_pd(a, b));
                rows[i + 2 * half + 1] = _mm256_castpd_ps(_mm256_unpackhi_pd(a, b));
            }
        }
        for i in 0..4 {
            pairs[i] = _mm256_permute2f128_ps::<0x20>(rows[i], rows[i + 4]);
            pairs[i + 4] = _mm256_permute2f128_ps::<0x31>(rows[i], rows[i + 4]);
        }
    }
    pairs
}

avx512!(Avx512, {});
avx512!(Avx512Bf16, {
    const PER_LANE: usize = 2;

    #[inline(always)]
    fn dot(self, a: __m512, b: __m512, c: __m512) -> __m512 {
        // SAFETY: the token proves the instruction. The types have the same size, and any bits are a number of each.
        unsafe {
            let (a, b) = (transmute::<__m512, __m512bh>(a), transmute::<__m512, __m512bh>(b));
            _mm512_dpbf16_ps(c, a, b)
        }
    }

    #[inline(always)]
    fn pack(self, first: __m512, second: __m512) -> __m512 {
        // SAFETY: as above.
        unsafe { transmute::<__m512bh, __m512>(_mm512_cvtne2ps_pbh(second, first)) }
    }
});

impl Simd for Avx2 {
    arithmetic!(
        __m256,
        8,
        _mm256_set1_ps,
        _mm256_loadu_ps,
        _mm256_storeu_ps,
        _mm256_add_ps,
        _mm256_sub_ps,
        _mm256_mul_ps,
        _mm256_div_ps,
        _mm256_fmadd_ps,
        _mm256_fnmadd_ps
    );

    #[inline(always)]
    unsafe fn load_part(self, from: &[f32], at: usize, count: usize) -> __m256 {
        // SAFETY: the token proves the instructions; the caller promises that `count` floats begin at `at`, and
        // lanes that the mask leaves out are not read.
        unsafe { _mm256_maskload_ps(from.get_unchecked(at..at + count).as_ptr(), first_of_eight(count)) }
    }

    #[inline(always)]
    unsafe fn store_part(self, to: &mut [f32], at: usize, count: usize, value: __m256) {
        // SAFETY: the token proves the instructions; the caller promises room for `count` floats at `at`, and
        // lanes that the mask leaves out are not written.
        unsafe {
            let to = to.get_unchecked_mut(at..at + count).as_mut_ptr();
            _mm256_maskstore_ps(to, first_of_eight(count), value);
        }
    }

    #[inline(always)]
    fn leak(self, sign: __m256, value: __m256, slope: __m256) -> __m256 {
        // SAFETY: the token proves the instructions.
        unsafe {
            let positive = _mm256_cmp_ps::<_CMP_GT_OQ>(sign, _mm256_setzero_ps());
            _mm256_blendv_ps(_mm256_mul_ps(slope, value), value, positive)
        }
    }

    #[inline(always)]
    fn sum(self, a: __m256) -> f32 {
        // SAFETY: the token proves the instructions.
        unsafe {
            let a = _mm_add_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps::<1>(a));
            let a = _mm_add_ps(a, _mm_movehl_ps(a, a));
            _mm_cvtss_f32(_mm_add_ss(a, _mm_movehdup_ps(a)))
        }
    }

    #[inline(always)]
    unsafe fn transpose(self, from: &[f32], from_stride: usize, to: &mut [f32], to_stride: usize) {
        for (y, x) in [(0, 0), (0, 8), (8, 0), (8, 8)] {
            // SAFETY: the token proves the instructions; the caller promises the rows, of which these are quarters.
            unsafe {
                let rows = super::load_strided(self, from, y * from_stride + x, from_stride);
                let columns = transposed_of_eight(rows);
                super::store_strided(self, to, x * to_stride + y, to_stride, &columns);
            }
        }
    }
}
