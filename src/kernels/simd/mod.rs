//! Vectors of floats and the instruction sets that carry them.
//!
//! A kernel is written once, generic over [`Simd`], and compiled once for each instruction set: [`Isa::run`]
//! enters it through a function that has the features enabled, so that everything inlined below it may use
//! them. The tokens ([`Avx512`] …) are zero-sized and can only be had after the CPU was asked: holding one is
//! the proof that its instructions exist. (The idea is that of the crates pulp and rten-simd.)

mod factor;
mod portable;
#[cfg(target_arch = "x86_64")]
mod x86;

use std::sync::OnceLock;

pub(crate) use factor::put_factor;
pub(crate) use portable::Portable;
#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Avx2, Avx512, Avx512Bf16};

/// The environment variable that forces an instruction set, one of [`NAMES`]; empty, it counts as not set.
const FORCE_VARIABLE: &str = "UDC_SIMD";

/// The sets that there are kernels for, on one CPU or another.
const NAMES: [&str; 3] = ["avx512", "avx2", "portable"];

/// Operations on vectors of [`Simd::LANES`] floats; the implementor proves that the CPU has them.
pub(crate) trait Simd: Copy + Send + Sync + 'static {
    /// Floats per vector.
    const LANES: usize;
    /// Numbers that a lane holds of a factor of [`Simd::dot`]: one float, or two in bfloat16.
    const PER_LANE: usize = 1;
    /// One vector.
    type Vector: Copy;

    /// Fills a vector with one value.
    fn splat(self, value: f32) -> Self::Vector;

    /// Reads the vector that begins at `from[at]`.
    ///
    /// # Safety
    /// `at + LANES <= from.len()`.
    unsafe fn load(self, from: &[f32], at: usize) -> Self::Vector;

    /// Writes a vector to where `to[at]` begins.
    ///
    /// # Safety
    /// `at + LANES <= to.len()`.
    unsafe fn store(self, to: &mut [f32], at: usize, value: Self::Vector);

    /// Reads the `count` floats that begin at `from[at]` into a vector's first lanes, zeros into the others.
    ///
    /// # Safety
    /// `count <= LANES` and `at + count <= from.len()`.
    unsafe fn load_part(self, from: &[f32], at: usize, count: usize) -> Self::Vector;

    /// Writes a vector's first `count` lanes to where `to[at]` begins.
    ///
    /// # Safety
    /// `count <= LANES` and `at + count <= to.len()`.
    unsafe fn store_part(self, to: &mut [f32], at: usize, count: usize, value: Self::Vector);

    /// Adds.
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;

    /// Subtracts.
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;

    /// Multiplies.
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;

    /// Divides.
    fn div(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;

    /// Computes `a·b + c`, rounded once where the CPU can.
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;

    /// Adds to `c` what the numbers in each lane of `a` and `b` give multiplied one by one.
    #[inline(always)]
    fn dot(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector {
        self.mul_add(a, b, c)
    }

    /// Rounds the numbers of two vectors, one after the other, to those of a factor of [`Simd::dot`]; where a lane holds
    /// one number, the first vector is the factor.
    #[inline(always)]
    fn pack(self, first: Self::Vector, _second: Self::Vector) -> Self::Vector {
        first
    }

    /// Computes `c − a·b`, rounded once where the CPU can.
    fn sub_mul(self, c: Self::Vector, a: Self::Vector, b: Self::Vector) -> Self::Vector;

    /// Takes `value` where `sign > 0` and `slope · value` elsewhere: with `sign = value` a leaky rectifier
    /// of any slope, with another `sign` its derivative.
    fn leak(self, sign: Self::Vector, value: Self::Vector, slope: Self::Vector) -> Self::Vector;

    /// Adds the lanes, in a tree.
    fn sum(self, a: Self::Vector) -> f32;

    /// Writes the transpose of a block of 16 × 16 floats, whose rows stand so many floats apart: `to[j][i] = from[i][j]`.
    ///
    /// # Safety
    /// Sixteen rows of sixteen floats lie within either slice.
    #[inline(always)]
    unsafe fn transpose(self, from: &[f32], from_stride: usize, to: &mut [f32], to_stride: usize) {
        for i in 0..16 {
            for j in 0..16 {
                // SAFETY: passed on to the caller.
                unsafe {
                    *to.get_unchecked_mut(j * to_stride + i) = *from.get_unchecked(i * from_stride + j);
                };
            }
        }
    }
}

/// How much of a vector there is in memory: all channels of a group, or what is left of them.
pub(crate) trait Extent: Copy {
    /// Reads the lanes that there are, zeros for the others.
    ///
    /// # Safety
    /// So many floats begin at `from[at]`.
    unsafe fn load<S: Simd>(self, simd: S, from: &[f32], at: usize) -> S::Vector;

    /// Writes the lanes that there are.
    ///
    /// # Safety
    /// There is room for so many floats at `to[at]`.
    unsafe fn store<S: Simd>(self, simd: S, to: &mut [f32], at: usize, value: S::Vector);
}

/// All lanes.
#[derive(Clone, Copy)]
pub(crate) struct Whole;

/// The first lanes, at most as many as there are.
#[derive(Clone, Copy)]
pub(crate) struct First(pub(crate) usize);

impl Extent for Whole {
    #[inline(always)]
    unsafe fn load<S: Simd>(self, simd: S, from: &[f32], at: usize) -> S::Vector {
        // SAFETY: passed on to the caller.
        unsafe { simd.load(from, at) }
    }

    #[inline(always)]
    unsafe fn store<S: Simd>(self, simd: S, to: &mut [f32], at: usize, value: S::Vector) {
        // SAFETY: passed on to the caller.
        unsafe { simd.store(to, at, value) };
    }
}

impl Extent for First {
    #[inline(always)]
    unsafe fn load<S: Simd>(self, simd: S, from: &[f32], at: usize) -> S::Vector {
        // SAFETY: passed on to the caller.
        unsafe { simd.load_part(from, at, self.0) }
    }

    #[inline(always)]
    unsafe fn store<S: Simd>(self, simd: S, to: &mut [f32], at: usize, value: S::Vector) {
        // SAFETY: passed on to the caller.
        unsafe { simd.store_part(to, at, self.0, value) };
    }
}

/// Runs a body for each vector of `len` floats, the last of which may be a part of one, with its place and its
/// [`Extent`]: `for_each_vector!(S, len, (at, extent) => body)`.
///
/// The body is compiled for either extent: masks would slow whole vectors down by up to a fifth.
macro_rules! for_each_vector {
    ($simd:ident, $len:expr, ($at:ident, $extent:ident) => $body:expr) => {{
        let len = $len;
        let whole = len - len % $simd::LANES;
        for $at in (0..whole).step_by($simd::LANES) {
            let $extent = crate::kernels::simd::Whole;
            $body
        }
        if whole < len {
            let ($at, $extent) = (whole, crate::kernels::simd::First(len - whole));
            $body
        }
    }};
}
pub(crate) use for_each_vector;

/// Asks for the cache line of `from[at]`, so that it is near when it is read or written; changes nothing but speed.
#[inline(always)]
pub(crate) fn prefetch(from: &[f32], at: usize) {
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    x86::prefetch(from.as_ptr().wrapping_add(at));
    #[cfg(not(all(target_arch = "x86_64", not(miri))))]
    let _ = (from, at);
}

/// Reads `N` vectors whose starts lie `stride` apart.
///
/// # Safety
/// All of them lie within `from`.
// A loop and not `array::from_fn`: a closure is a function of its own, compiled without the features of
// the instruction set unless it happens to be inlined.
#[inline(always)]
pub(crate) unsafe fn load_strided<S: Simd, const N: usize>(
    simd: S,
    from: &[f32],
    at: usize,
    stride: usize,
) -> [S::Vector; N] {
    let mut vectors = [simd.splat(0.0); N];
    for (i, vector) in vectors.iter_mut().enumerate() {
        // SAFETY: passed on to the caller.
        *vector = unsafe { simd.load(from, at + i * stride) };
    }
    vectors
}

/// Writes vectors whose starts lie `stride` apart.
///
/// # Safety
/// All of them lie within `to`.
#[inline(always)]
pub(crate) unsafe fn store_strided<S: Simd>(
    simd: S,
    to: &mut [f32],
    at: usize,
    stride: usize,
    vectors: &[S::Vector],
) {
    for (i, vector) in vectors.iter().enumerate() {
        // SAFETY: passed on to the caller.
        unsafe { simd.store(to, at + i * stride, *vector) };
    }
}

/// A computation that can be compiled for every instruction set.
///
/// Implementations mark `run` and all that it calls `#[inline(always)]`: a function that stays out of line
/// would be compiled without the features. For the same reason vectors never pass through closures.
pub(crate) trait Kernel {
    /// What it returns.
    type Output;
    /// Computes with the vectors of `simd`.
    fn run<S: Simd>(self, simd: S) -> Self::Output;
}

/// The instruction set that kernels are compiled for and run with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isa(Path);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Path {
    #[cfg(target_arch = "x86_64")]
    Avx512Bf16(Avx512Bf16),
    #[cfg(target_arch = "x86_64")]
    Avx512(Avx512),
    #[cfg(target_arch = "x86_64")]
    Avx2(Avx2),
    Portable(Portable),
}

impl Isa {
    /// Finds the best set that this CPU has, or the one that `UDC_SIMD` names; asked once per process.
    ///
    /// # Panics
    /// When `UDC_SIMD` names no set that this CPU has, which [`Isa::forced`] tells without a panic.
    pub fn current() -> Self {
        #[cfg(test)]
        if let Some(forced) = crate::kernels::testing::isa_of_thread() {
            return forced;
        }
        static CURRENT: OnceLock<Isa> = OnceLock::new();
        *CURRENT.get_or_init(|| match Self::forced() {
            Ok(forced) => forced.unwrap_or_else(|| Self::available()[0]),
            Err(reason) => panic!("{reason}"),
        })
    }

    /// Reads `UDC_SIMD`: nothing when unset, an error text when it names no set that this CPU has.
    ///
    /// # Errors
    /// A sentence that lists what can be asked for.
    pub fn forced() -> Result<Option<Self>, String> {
        let Some(name) = std::env::var_os(FORCE_VARIABLE) else { return Ok(None) };
        Self::choose(&name.to_string_lossy(), &Self::available())
    }

    /// The one of `available` that is named; nothing when the name is empty.
    fn choose(name: &str, available: &[Self]) -> Result<Option<Self>, String> {
        if name.is_empty() {
            return Ok(None);
        }
        if let Some(found) = available.iter().find(|isa| isa.name() == name) {
            return Ok(Some(*found));
        }
        let names: Vec<_> = available.iter().map(Self::name).collect();
        Err(if NAMES.contains(&name) {
            let has = names.join(" and ");
            format!("{FORCE_VARIABLE} is {name}, which this CPU does not have; it has {has}")
        } else {
            let names = NAMES.join(", ");
            format!(
                "{FORCE_VARIABLE} must be one of {names}, found {name:?}; unset it to use what the CPU has"
            )
        })
    }

    /// Lists the sets that this CPU has, the best first.
    pub fn available() -> Vec<Self> {
        let mut found = Vec::new();
        #[cfg(target_arch = "x86_64")]
        {
            found.extend(Avx512::detect().map(|token| Self(Path::Avx512(token))));
            found.extend(Avx2::detect().map(|token| Self(Path::Avx2(token))));
        }
        found.push(Self(Path::Portable(Portable)));
        found
    }

    /// Finds a set by its name, if this CPU has it.
    pub fn named(name: &str) -> Option<Self> {
        Self::available().into_iter().find(|isa| isa.name() == name)
    }

    /// This set, but with products of numbers in bfloat16 (8 bits of precision) that are added up in 32 bits, where this
    /// CPU has instructions for them. Operations that gain nothing by it go on as before.
    pub fn with_bf16_products(self) -> Option<Self> {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512(_) => Avx512Bf16::detect().map(|token| Self(Path::Avx512Bf16(token))),
            _ => None,
        }
    }

    /// This set, with products of 32-bit floats.
    fn with_f32_products(self) -> Self {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512Bf16(token) => Self(Path::Avx512(token.without())),
            _ => self,
        }
    }

    /// This set, without products that sums over as many numbers do not fill lanes for.
    pub(crate) fn for_sums_over(self, numbers: usize) -> Self {
        let fills = numbers.is_multiple_of(self.lanes() * self.per_lane());
        if fills { self } else { self.with_f32_products() }
    }

    /// The name: that which `UDC_SIMD` accepts, and the kind of products.
    pub fn name(&self) -> &'static str {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512Bf16(_) => "avx512, bfloat16 products",
            #[cfg(target_arch = "x86_64")]
            Path::Avx512(_) => "avx512",
            #[cfg(target_arch = "x86_64")]
            Path::Avx2(_) => "avx2",
            Path::Portable(_) => "portable",
        }
    }

    /// Floats per vector.
    pub(crate) fn lanes(self) -> usize {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512Bf16(_) => Avx512Bf16::LANES,
            #[cfg(target_arch = "x86_64")]
            Path::Avx512(_) => Avx512::LANES,
            #[cfg(target_arch = "x86_64")]
            Path::Avx2(_) => Avx2::LANES,
            Path::Portable(_) => Portable::LANES,
        }
    }

    /// Numbers per lane of a product's factor.
    pub(crate) fn per_lane(self) -> usize {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512Bf16(_) => Avx512Bf16::PER_LANE,
            _ => 1,
        }
    }

    /// Runs a kernel compiled for this set, whose products are of 32-bit floats.
    #[inline]
    pub(crate) fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512Bf16(token) => token.without().enter(kernel),
            #[cfg(target_arch = "x86_64")]
            Path::Avx512(token) => token.enter(kernel),
            #[cfg(target_arch = "x86_64")]
            Path::Avx2(token) => token.enter(kernel),
            Path::Portable(token) => kernel.run(token),
        }
    }

    /// Runs a kernel compiled for this set and its kind of products.
    #[inline]
    pub(crate) fn run_products<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            #[cfg(target_arch = "x86_64")]
            Path::Avx512Bf16(token) => token.enter(kernel),
            #[cfg(target_arch = "x86_64")]
            Path::Avx512(token) => token.enter(kernel),
            #[cfg(target_arch = "x86_64")]
            Path::Avx2(token) => token.enter(kernel),
            Path::Portable(token) => kernel.run(token),
        }
    }
}

#[cfg(test)]
mod tests;
