//! Gradients of a stride-2 convolution's outputs to those of its inputs: the transposed convolution.
//!
//! Input pixel (y, x) was read by output (o, p) through weight (k, l) where `2·o = y + 1 − k` and
//! `2·p = x + 1 − l`. So even rows got there through the middle row of the weights only, odd ones through
//! the outer two, and columns alike: four classes of pixels, each a dense product of its own. All pixels of
//! a class in one row make the rows of register tiles, two pixels apart in memory.

use rayon::prelude::*;

use super::forward::{Geometry, Target, copy_columns, finish_tile};
use crate::kernels::epilogue::Leak;
use crate::kernels::gemm::{MOST_ROWS, Operand, multiply_add, panel_vectors, with_register_tile, zero_tile};
use crate::kernels::rows::Rows;
use crate::kernels::scratch::{AlignedBuffer, lend, whole_lines};
use crate::kernels::simd::{Isa, Kernel, Simd};

/// Weights packed `[tap][panel of inputs][output][input of the panel]`.
pub(crate) struct Weights {
    geometry: Geometry,
    vectors: usize,
    packed: AlignedBuffer,
}

impl Weights {
    /// Packs PyTorch's `[outputs, inputs, 3, 3]` weights of a stride-2 convolution.
    pub(crate) fn pack(isa: Isa, geometry: Geometry, weight: &[f32]) -> Self {
        let Geometry { inputs, outputs, side, stride } = geometry;
        assert!(side == 3 && stride == 2, "transposed convolution of side {side}, stride {stride}");
        let vectors = panel_vectors(isa.lanes(), inputs);
        let panel = vectors * isa.lanes();
        let padded = inputs.next_multiple_of(panel);
        let mut packed = AlignedBuffer::zeros(9 * padded * outputs);
        packed.as_mut_slice().par_chunks_mut(panel * outputs).enumerate().for_each(|(place, to)| {
            let (tap, first) = (place / (padded / panel), place % (padded / panel) * panel);
            for (output, to) in to.chunks_exact_mut(panel).enumerate() {
                let from = weight[(output * inputs + first) * 9 + tap..].iter().step_by(9);
                to[..panel.min(inputs - first)].iter_mut().zip(from).for_each(|(to, from)| *to = *from);
            }
        });
        Self { geometry, vectors, packed }
    }
}

/// Some rows of the inputs' gradient of one image.
pub(crate) struct InputRows<'a> {
    pub(crate) weights: &'a Weights,
    /// The outputs' gradient.
    pub(crate) output_gradient: Rows<'a>,
    /// Columns of the input.
    pub(crate) width: usize,
    /// The number of the first input row.
    pub(crate) first: usize,
    /// The inputs' gradient.
    pub(crate) to: &'a mut [f32],
}

impl Kernel for InputRows<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { weights, output_gradient, width, first, to } = self;
        let Geometry { inputs, outputs, .. } = weights.geometry;
        let edge_row = whole_lines((MOST_ROWS + 1) * outputs);
        let mut lent = lend(3 * edge_row);
        let mut scratch = lent.scratch();
        let edge = scratch.take(3 * edge_row);
        for row in 0..to.len() / (width * inputs) {
            // Row k of the weights and the row of output gradients that it is multiplied with.
            let rows: [Option<&[f32]>; 3] = std::array::from_fn(|k| {
                let twice = (first + row + 1).cast_signed() - k.cast_signed();
                if twice % 2 == 0 { output_gradient.row(twice / 2) } else { None }
            });
            let at = row * width * inputs;
            let mut line = Line { weights, rows, width, edge, edge_row, to, at };
            for parity in 0..2.min(width) {
                // SAFETY: `rows` are whole rows of output gradients, `to` holds one input row from `at`,
                // the edge buffer three runs of the most pixels that a register tile sees.
                unsafe { with_register_tile!(S, weights.vectors, input_line(simd, parity, &mut line)) };
            }
        }
    }
}

/// One row of the inputs' gradient and what it is computed from.
struct Line<'a, 'b> {
    weights: &'a Weights,
    rows: [Option<&'a [f32]>; 3],
    width: usize,
    edge: &'b mut [f32],
    edge_row: usize,
    to: &'b mut [f32],
    at: usize,
}

/// Computes the pixels of one row whose columns have the given parity.
///
/// # Safety
/// The line's rows hold whole pixels of the outputs' gradient; `to` holds one input row from `at`; the edge buffer has three
/// runs of `edge_row` floats, enough for `MOST_ROWS + 1` pixels. Panels of the weights are `COLUMNS` vectors wide.
#[inline(always)]
unsafe fn input_line<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    parity: usize,
    line: &mut Line<'_, '_>,
) {
    let panels = line.weights.geometry.inputs.div_ceil(COLUMNS * S::LANES);
    let pixels = (line.width - parity).div_ceil(2);
    for panel in 0..panels {
        let mut first = 0;
        while first < pixels {
            let run = Run { parity, panel, first, count: pixels - first };
            // SAFETY: passed on to the caller.
            unsafe {
                if run.count.next_multiple_of(FEW) < ROWS {
                    input_tile::<S, FEW, COLUMNS>(simd, run, line);
                    first += FEW;
                } else {
                    input_tile::<S, ROWS, COLUMNS>(simd, run, line);
                    first += ROWS;
                }
            }
        }
    }
}

/// Pixels of the register tiles that end a row, where a whole one would be mostly empty.
const FEW: usize = 4;

/// Pixels of one parity, counted without the others, and a panel of their channels.
#[derive(Clone, Copy)]
struct Run {
    parity: usize,
    panel: usize,
    first: usize,
    count: usize,
}

/// Computes the first `ROWS` pixels of a run, or as many as it has.
///
/// # Safety
/// As for [`input_line`]; the run lies within the line.
#[inline(always)]
unsafe fn input_tile<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    run: Run,
    line: &mut Line<'_, '_>,
) {
    let Run { parity, panel: p, first, count } = run;
    let weights = line.weights;
    let Geometry { inputs, outputs, .. } = weights.geometry;
    let panel = COLUMNS * S::LANES;
    let panels = inputs.div_ceil(panel);
    let columns = weights.geometry.output_extent(line.width);
    // Column l of the weights and how far right of a pixel's number the output that it is multiplied with is.
    let taps: &[(usize, usize)] = if parity == 0 { &[(1, 0)] } else { &[(0, 1), (2, 0)] };
    let inside = first + ROWS < columns;
    if !inside {
        for (k, row) in line.rows.iter().enumerate() {
            if let Some(row) = row {
                let to = &mut line.edge[k * line.edge_row..][..(ROWS + 1) * outputs];
                copy_columns(row, first.cast_signed(), outputs, to);
            }
        }
    }
    let mut tile = zero_tile::<S, ROWS, COLUMNS>(simd);
    for (k, row) in line.rows.iter().enumerate() {
        let Some(row) = row else { continue };
        for (l, right) in taps {
            let (data, start) = if inside { (*row, first) } else { (&*line.edge, 0) };
            let at = (start + right) * outputs + if inside { 0 } else { k * line.edge_row };
            let a = Operand { data, at, row: outputs, step: 1 };
            let at = ((k * 3 + l) * panels + p) * outputs * panel;
            let b = Operand { data: weights.packed.as_slice(), at, row: 0, step: panel };
            // SAFETY: inside, pixels `first … first + ROWS` exist; otherwise the copy holds `ROWS + 1`.
            tile = unsafe { multiply_add::<S, ROWS, COLUMNS>(simd, tile, outputs, a, b) };
        }
    }
    let target = Target {
        at: line.at + (2 * first + parity) * inputs + p * panel,
        pixels: ROWS.min(count),
        pixel: 2 * inputs,
        channels: panel.min(inputs - p * panel),
    };
    // SAFETY: the wanted pixels of this parity lie within the row, their channels too.
    unsafe { finish_tile(simd, &tile, Leak(1.0), line.to, target) };
}
