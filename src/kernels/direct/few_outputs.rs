//! 3 × 3 convolutions to one to four outputs, where a vector of outputs would be mostly empty.
//!
//! # Method
//! Vectors run along the input channels instead: each output of each of [`PIXELS`] neighbouring pixels has a
//! vector of partial sums, whose lanes are added at the end. The three pixels that an output sees in one
//! input row are one run of `3 · inputs` floats, read in vectors; the weights lie `[row][vector][output]`.
//!
//! # Error
//! A lane adds `9 · inputs / LANES` products, a tree the lanes: below that of the sum in order.

use super::forward::{Geometry, copy_columns};
use crate::kernels::epilogue::Epilogue;
use crate::kernels::rows::Rows;
use crate::kernels::scratch::{AlignedBuffer, LINE, lend, whole_lines};
use crate::kernels::simd::{Isa, Kernel, Simd, load_strided, prefetch};

/// Pixels computed together: with three outputs twelve sums, enough to hide the latency of 4 cycles at 2 a
/// cycle, and they fit the sixteen registers of AVX2.
const PIXELS: usize = 4;

/// How many pixels ahead inputs are asked for: one sum needs little time, and rows come from memory.
const AHEAD: usize = 8 * PIXELS;

/// The most outputs that this method takes.
const MOST_OUTPUTS: usize = 4;

/// Weights in the order in which they are read.
pub(crate) struct Weights {
    pub(crate) isa: Isa,
    pub(crate) geometry: Geometry,
    packed: AlignedBuffer,
    bias: Vec<f32>,
}

/// Tells whether this method applies.
pub(crate) fn applies(isa: Isa, geometry: Geometry) -> bool {
    let Geometry { inputs, outputs, side, stride } = geometry;
    let is_part_of_a_vector = outputs < isa.lanes() && outputs <= MOST_OUTPUTS;
    (side, stride) == (3, 1) && is_part_of_a_vector && inputs.is_multiple_of(isa.lanes())
}

impl Weights {
    /// Packs the weights that `weight(output, input, row · 3 + column)` gives.
    pub(crate) fn pack(
        isa: Isa,
        geometry: Geometry,
        weight: impl Fn(usize, usize, usize) -> f32,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        let Geometry { inputs, outputs, .. } = geometry;
        let lanes = isa.lanes();
        let mut packed = AlignedBuffer::zeros(geometry.weight_len());
        for (at, to) in packed.as_mut_slice().iter_mut().enumerate() {
            let (lane, output, vector) = (at % lanes, at / lanes % outputs, at / lanes / outputs);
            let place = vector * lanes + lane;
            *to = weight(output, place % inputs, place / inputs);
        }
        Self { isa, geometry, packed, bias: (0..outputs).map(bias).collect() }
    }
}

/// Some output rows of one image: the work of one task.
pub(crate) struct OutputRows<'a> {
    pub(crate) weights: &'a Weights,
    pub(crate) input: Rows<'a>,
    /// The number of the first output row.
    pub(crate) first: usize,
    /// The output rows.
    pub(crate) output: &'a mut [f32],
    pub(crate) epilogue: Epilogue<'a>,
}

impl Kernel for OutputRows<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        match self.weights.geometry.outputs {
            1 => self.compute::<S, 1>(simd),
            2 => self.compute::<S, 2>(simd),
            3 => self.compute::<S, 3>(simd),
            _ => self.compute::<S, MOST_OUTPUTS>(simd),
        }
    }
}

impl OutputRows<'_> {
    #[inline(always)]
    fn compute<S: Simd, const OUTPUTS: usize>(self, simd: S) {
        let Self { weights, input, first, output, epilogue } = self;
        let inputs = weights.geometry.inputs;
        let width = input.row_len() / inputs;
        let edge_row = whole_lines((PIXELS + 2) * inputs);
        let mut lent = lend(3 * edge_row);
        let edge = lent.scratch().take(3 * edge_row);
        for (y, pixels) in output.chunks_exact_mut(width * OUTPUTS).enumerate() {
            let top = (first + y).cast_signed() - 1;
            let rows: [Option<&[f32]>; 3] = std::array::from_fn(|k| input.row(top + k.cast_signed()));
            for (block, pixels) in pixels.chunks_mut(PIXELS * OUTPUTS).enumerate() {
                let x = block * PIXELS;
                let inside = x > 0 && x + PIXELS < width;
                // The rows above were read for the line before.
                if let Some(row) = rows[2] {
                    let ahead = (x + AHEAD) * inputs;
                    (ahead..ahead + PIXELS * inputs).step_by(LINE).for_each(|at| prefetch(row, at));
                }
                let sums = if inside {
                    let runs = rows.map(|row| row.map(|row| &row[(x - 1) * inputs..]));
                    // SAFETY: the pixels from x − 1 to x + PIXELS lie within the rows.
                    unsafe { sums::<S, OUTPUTS>(simd, weights, runs) }
                } else {
                    for (row, to) in rows.iter().zip(edge.chunks_exact_mut(edge_row)) {
                        if let Some(row) = row {
                            let to = &mut to[..(PIXELS + 2) * inputs];
                            copy_columns(row, x.cast_signed() - 1, inputs, to);
                        }
                    }
                    let run = |k: usize| rows[k].map(|_| &edge[k * edge_row..][..edge_row]);
                    let runs = [run(0), run(1), run(2)];
                    // SAFETY: each run holds the PIXELS + 2 pixels that were copied.
                    unsafe { sums::<S, OUTPUTS>(simd, weights, runs) }
                };
                let at = (y * width + x) * OUTPUTS;
                for (i, pixel) in pixels.chunks_exact_mut(OUTPUTS).enumerate() {
                    for (o, value) in pixel.iter_mut().enumerate() {
                        *value = epilogue.scalar(sums[i][o] + weights.bias[o], at + i * OUTPUTS + o);
                    }
                }
            }
        }
    }
}

/// The sums of [`PIXELS`] neighbouring outputs, whose inputs begin with the runs.
///
/// # Safety
/// Each run holds `PIXELS + 2` pixels.
#[inline(always)]
unsafe fn sums<S: Simd, const OUTPUTS: usize>(
    simd: S,
    weights: &Weights,
    runs: [Option<&[f32]>; 3],
) -> [[f32; OUTPUTS]; PIXELS] {
    let inputs = weights.geometry.inputs;
    let mut vectors = [[simd.splat(0.0); OUTPUTS]; PIXELS];
    for (k, run) in runs.into_iter().enumerate() {
        let Some(run) = run else { continue };
        for at in (0..3 * inputs).step_by(S::LANES) {
            // SAFETY: pixel i reads 3·inputs floats from i·inputs, i < PIXELS; there are OUTPUTS vectors of
            // weights for each vector of the run.
            unsafe {
                let from = (k * 3 * inputs + at) * OUTPUTS;
                let w: [S::Vector; OUTPUTS] = load_strided(simd, weights.packed.as_slice(), from, S::LANES);
                for (i, sums) in vectors.iter_mut().enumerate() {
                    let x = simd.load(run, i * inputs + at);
                    for (sum, w) in sums.iter_mut().zip(&w) {
                        *sum = simd.mul_add(x, *w, *sum);
                    }
                }
            }
        }
    }
    let mut result = [[0.0; OUTPUTS]; PIXELS];
    for (sums, vectors) in result.iter_mut().zip(vectors) {
        for (sum, vector) in sums.iter_mut().zip(vectors) {
            *sum = simd.sum(vector);
        }
    }
    result
}
