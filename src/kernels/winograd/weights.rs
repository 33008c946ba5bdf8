//! Weights transformed once, in the order in which the products read them.
//!
//! # Layout
//! `[panel][point 6×6][input][output of the panel]`, a panel being as many outputs as a register tile has columns, so
//! that a product reads them in one run. In bfloat16 two inputs share the place of one.

use rayon::prelude::*;

use super::{POINTS, transform};
use crate::kernels::gemm::panel_vectors;
use crate::kernels::scratch::AlignedBuffer;
use crate::kernels::simd::{Isa, Kernel, Simd, put_factor};

/// Tells whether this method is the fastest: a transform costs as much for a vector with few channels as for a
/// full one, so that fewer than half a vector on either side are left to the direct sums, but for few inputs whose
/// transforms serve two vectors of outputs.
pub(crate) fn applies(isa: Isa, inputs: usize, outputs: usize) -> bool {
    inputs.min(outputs) * 2 >= isa.lanes() || outputs >= 2 * isa.lanes()
}

/// Weights of a 3 × 3 convolution after G·G ᵀ, in the order in which the products read them.
pub(crate) struct Weights {
    pub(crate) isa: Isa,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// Vectors per panel.
    pub(super) vectors: usize,
    pub(super) packed: AlignedBuffer,
    pub(super) bias: AlignedBuffer,
}

impl Weights {
    /// Inputs of a tile in the working memory: whole vectors.
    pub(super) fn padded_inputs(&self) -> usize {
        self.inputs.next_multiple_of(self.isa.lanes())
    }

    /// Floats that a tile's transformed inputs take in the working memory.
    pub(super) fn input_floats(&self) -> usize {
        self.padded_inputs() / self.isa.per_lane()
    }

    /// Outputs of a tile in the working memory: whole panels.
    pub(super) fn padded_outputs(&self) -> usize {
        self.outputs.next_multiple_of(self.vectors * self.isa.lanes())
    }

    /// Transforms the 3 × 3 weights that `weight(output, input)` gives, row by row.
    pub(crate) fn pack(
        isa: Isa,
        (inputs, outputs): (usize, usize),
        weight: impl Fn(usize, usize) -> [f32; 9] + Sync,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        let isa = isa.for_sums_over(inputs);
        let vectors = panel_vectors(isa.lanes(), outputs);
        let panel = vectors * isa.lanes();
        let padded = outputs.next_multiple_of(panel);
        let depth = inputs / isa.per_lane();
        let mut packed = AlignedBuffer::zeros(POINTS * POINTS * depth * padded);
        let shares = packed.as_mut_slice().par_chunks_mut(PACKED_ROWS * POINTS * depth * panel);
        shares.enumerate().for_each(|(share, to)| {
            let (p, first) = (share * PACKED_ROWS / POINTS, share * PACKED_ROWS % POINTS);
            // Lanes past the last output repeat it: what they compute is not stored.
            let weight = |lane: usize, input: usize| weight((p * panel + lane).min(outputs - 1), input);
            isa.run_products(PackPanel { to, inputs, panel, first, weight });
        });
        let mut bias_buffer = AlignedBuffer::zeros(padded);
        bias_buffer.as_mut_slice()[..outputs].iter_mut().enumerate().for_each(|(o, b)| *b = bias(o));
        Self { isa, inputs, outputs, vectors, packed, bias: bias_buffer }
    }
}

/// Rows of points that one task packs: a single panel occupies two threads.
const PACKED_ROWS: usize = POINTS / 2;

/// Transforms the weights of one panel to [`PACKED_ROWS`] rows of points.
struct PackPanel<'a, W> {
    /// `[point][input][output of the panel]`.
    to: &'a mut [f32],
    inputs: usize,
    panel: usize,
    /// The first row of points.
    first: usize,
    weight: W,
}

impl<W: Fn(usize, usize) -> [f32; 9]> Kernel for PackPanel<'_, W> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        // Sixteen floats make a whole cache line; the panels of short vectors may be narrower.
        if self.panel.is_multiple_of(16) { self.pack::<S, 16>() } else { self.pack::<S, 4>() }
    }
}

impl<W: Fn(usize, usize) -> [f32; 9]> PackPanel<'_, W> {
    /// Computes G·g·Gᵀ for `TOGETHER` outputs at once.
    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "the loop transposes: an output becomes a lane of each tap"
    )]
    fn pack<S: Simd, const TOGETHER: usize>(self) {
        for lane in (0..self.panel).step_by(TOGETHER) {
            for input in 0..self.inputs {
                let mut g = [[[0.0f64; TOGETHER]; 3]; 3];
                for together in 0..TOGETHER {
                    let weight = (self.weight)(lane + together, input);
                    for (tap, weight) in weight.into_iter().enumerate() {
                        g[tap % 3][tap / 3][together] = f64::from(weight);
                    }
                }
                // Loops and not `map`, whose closure would be compiled without the instruction set.
                let mut columns = [[[0.0f64; TOGETHER]; POINTS]; 3];
                for (column, g) in columns.iter_mut().zip(g) {
                    *column = transform::weight(g);
                }
                for row in 0..PACKED_ROWS {
                    let mut taps = [[0.0f64; TOGETHER]; 3];
                    for (taps, column) in taps.iter_mut().zip(&columns) {
                        *taps = column[self.first + row];
                    }
                    let points = transform::weight(taps);
                    for (point, values) in points.iter().enumerate() {
                        let step = (row * POINTS + point) * (self.inputs / S::PER_LANE) + input / S::PER_LANE;
                        let at = step * self.panel + lane;
                        let to = &mut self.to[at..at + TOGETHER];
                        #[expect(
                            clippy::cast_possible_truncation,
                            reason = "rounds to the kernels' precision"
                        )]
                        for (to, value) in to.iter_mut().zip(values) {
                            put_factor(to, S::PER_LANE, input, *value as f32);
                        }
                    }
                }
            }
        }
    }
}
