//! What is done to a convolution's sums before they are stored: its epilogue, fused with it.

use super::simd::{Extent, Simd};

/// The last step of an output: bias, then one of the [`Epilogue`] variants' arithmetic.
///
/// Tensors are laid out like the output.
#[derive(Clone, Copy, Debug)]
pub enum Epilogue<'a> {
    /// Leaky rectifier; slope 1 leaves the sum as it is.
    Leak(f32),
    /// Leaky rectifier, then a tensor added: a residual or a skip connection.
    LeakThenAdd(f32, &'a [f32]),
    /// Times the derivative of a leaky rectifier, whose output (or input) has the sign of the tensor.
    Gate(f32, &'a [f32]),
}

impl<'a> Epilogue<'a> {
    /// The same for a part of the output, given as the range of its floats.
    pub(crate) fn part(self, range: std::ops::Range<usize>) -> Self {
        match self {
            Self::Leak(slope) => Self::Leak(slope),
            Self::LeakThenAdd(slope, other) => Self::LeakThenAdd(slope, &other[range]),
            Self::Gate(slope, sign) => Self::Gate(slope, &sign[range]),
        }
    }

    /// The tensor that is read.
    pub(crate) fn tensor(&self) -> Option<&'a [f32]> {
        match self {
            Self::Leak(_) => None,
            Self::LeakThenAdd(_, other) | Self::Gate(_, other) => Some(other),
        }
    }

    /// Asserts that the tensor, if there is one, has the output's length.
    pub(crate) fn check_len(&self, len: usize) {
        if let Some(other) = self.tensor() {
            assert_eq!(other.len(), len, "floats of the tensor that finishes an output of {len}");
        }
    }
}

impl Epilogue<'_> {
    /// Finishes the one output at `at`.
    pub(crate) fn scalar(self, sum: f32, at: usize) -> f32 {
        match self {
            Self::Leak(slope) => leak(sum, sum, slope),
            Self::LeakThenAdd(slope, other) => leak(sum, sum, slope) + other[at],
            Self::Gate(slope, sign) => leak(sign[at], sum, slope),
        }
    }
}

/// [`Epilogue`] resolved before the inner loop, so that it is compiled once for each kind.
pub(crate) trait CompiledEpilogue<S: Simd>: Copy {
    /// Finishes the outputs that begin at `at`, as many as `extent` says.
    ///
    /// # Safety
    /// So many floats begin at `at` in the tensor of the variant.
    unsafe fn vector(self, simd: S, extent: impl Extent, sum: S::Vector, at: usize) -> S::Vector;
}

/// See [`Epilogue::Leak`].
#[derive(Clone, Copy)]
pub(crate) struct Leak(pub(crate) f32);

/// See [`Epilogue::LeakThenAdd`].
#[derive(Clone, Copy)]
pub(crate) struct LeakThenAdd<'a>(pub(crate) f32, pub(crate) &'a [f32]);

/// See [`Epilogue::Gate`].
#[derive(Clone, Copy)]
pub(crate) struct Gate<'a>(pub(crate) f32, pub(crate) &'a [f32]);

/// Scales a value unless the sign is positive.
#[inline(always)]
fn leak(sign: f32, value: f32, slope: f32) -> f32 {
    if sign > 0.0 { value } else { slope * value }
}

impl<S: Simd> CompiledEpilogue<S> for Leak {
    #[inline(always)]
    unsafe fn vector(self, simd: S, _extent: impl Extent, sum: S::Vector, _at: usize) -> S::Vector {
        simd.leak(sum, sum, simd.splat(self.0))
    }
}

impl<S: Simd> CompiledEpilogue<S> for LeakThenAdd<'_> {
    #[inline(always)]
    unsafe fn vector(self, simd: S, extent: impl Extent, sum: S::Vector, at: usize) -> S::Vector {
        // SAFETY: passed on to the caller.
        let other = unsafe { extent.load(simd, self.1, at) };
        simd.add(simd.leak(sum, sum, simd.splat(self.0)), other)
    }
}

impl<S: Simd> CompiledEpilogue<S> for Gate<'_> {
    #[inline(always)]
    unsafe fn vector(self, simd: S, extent: impl Extent, sum: S::Vector, at: usize) -> S::Vector {
        // SAFETY: passed on to the caller.
        let sign = unsafe { extent.load(simd, self.1, at) };
        simd.leak(sign, sum, simd.splat(self.0))
    }
}

/// Runs a function generic over compiled epilogues with the one that an [`Epilogue`] stands for.
macro_rules! with_epilogue {
    ($epilogue:expr, $compiled:ident => $body:expr) => {
        match $epilogue {
            crate::kernels::epilogue::Epilogue::Leak(slope) => {
                let $compiled = crate::kernels::epilogue::Leak(slope);
                $body
            }
            crate::kernels::epilogue::Epilogue::LeakThenAdd(slope, other) => {
                let $compiled = crate::kernels::epilogue::LeakThenAdd(slope, other);
                $body
            }
            crate::kernels::epilogue::Epilogue::Gate(slope, sign) => {
                let $compiled = crate::kernels::epilogue::Gate(slope, sign);
                $body
            }
        }
    };
}
pub(crate) use with_epilogue;
