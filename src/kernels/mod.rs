//! The inner loops of networks and transforms: slices in, slices out; the only module with unsafe code.
//!
//! Tensors are NHWC: `[image, row, column, channel]`, 32-bit float, contiguous, without borders. Parameters
//! come in PyTorch's layouts (`[outputs, inputs, rows, columns]` for convolutions) and gradients leave in the
//! same ones; each operation packs what it needs.
//!
//! # Map
//! - [`Isa`]: which vector instructions run, chosen once; `UDC_SIMD=avx512|avx2|portable` forces a path.
//! - [`Convolution`]: any odd side up to 11, by `winograd` where it is 3, the stride is 1 and channels are not
//!   too few, by the `direct` kernel elsewhere; [`convolution`] also has its gradients.
//! - [`res_block`], [`up_convolution`], [`dynamic_filter`], [`modulation`]: the network's blocks, forward and backward.
//! - [`stream`]: whole networks, a few rows at a time, in memory planned beforehand.
//! - [`fourier`]: Fourier transforms of lines side by side.
//! - `vectorised`: loops of other modules, compiled for the vectors in use.
//! - `ahead`: memory asked for while products are computed.
//!
//! # Why unsafe, and where
//! Three things need it. Vector instructions may run only on a CPU that has them: the zero-sized tokens of
//! `simd` are made after detection and their holders prove it. And the inner loops read slices without
//! bounds checks: they go through `Simd::load`, `Simd::store` and one micro-kernel, all of which check their
//! bounds in builds with debug assertions, as the tests are. Results are not filled with zeros beforehand but
//! block by block, by the tasks that compute them (`scratch::written`). Elsewhere outputs are split into disjoint `&mut`
//! slices before the work is spread; [`stream`] alone has threads write to memory that others read (`slots`), where its
//! plan and the order of its tasks keep them apart: builds with debug assertions watch that they do.
//!
//! What the inner loops rely on is checked where safe code comes in: every public function asserts, in all builds, that
//! slices are as long as their shapes say.
//!
//! # Determinism
//! A pixel's value does not depend on how the work was cut into tasks. Sums over pixels (parameter gradients)
//! are cut into groups that depend on shapes only and added in a fixed order. So results do not depend on
//! the number of threads, bit for bit; they do differ in rounding between instruction sets, of which products in bfloat16
//! are one more.
#![expect(unsafe_code, reason = "vector instructions and unchecked reads of the inner loops")]
#![warn(unsafe_op_in_unsafe_fn, clippy::missing_safety_doc, clippy::undocumented_unsafe_blocks)]

mod allocator;
pub mod benchmark;
pub mod convolution;
mod direct;
pub mod dynamic_filter;
mod epilogue;
pub mod fourier;
mod gemm;
pub mod gradient;
#[cfg(test)]
mod misuse_tests;
pub mod modulation;
pub mod peak;
mod plain;
mod prefetch;
#[cfg(test)]
mod published_shapes_tests;
pub mod res_block;
mod rows;
mod scratch;
mod shape;
mod simd;
mod slots;
pub mod stream;
pub mod sums;
#[cfg(test)]
mod testing;
pub mod up_convolution;
mod winograd;

#[cfg(target_os = "linux")]
pub use allocator::LargePages;
pub use allocator::{keep_freed_memory, share_freed_memory};
pub use convolution::Convolution;
pub use direct::forward::Geometry;
pub use dynamic_filter::DynamicFilter;
pub use epilogue::Epilogue;
pub(crate) use plain::{Body, run, vectorised};
pub(crate) use scratch::zeros;
pub use shape::Shape;
pub use simd::Isa;
