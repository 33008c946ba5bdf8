//! Inputs and packed weights to outputs, a few output rows per task.

use crate::kernels::epilogue::{CompiledEpilogue, Epilogue, with_epilogue};
use crate::kernels::gemm::{
    MOST_ROWS, Operand, Tile, multiply_add, panel_vectors, unrolled, with_register_tile,
};
use crate::kernels::rows::Rows;
use crate::kernels::scratch::{AlignedBuffer, lend, whole_lines};
use crate::kernels::shape::Shape;
use crate::kernels::simd::{Extent as _, First, Isa, Kernel, Simd, Whole, load_strided};

/// The largest side of a convolution: AlexNet's first layer has it.
pub(crate) const MOST_SIDE: usize = 11;

/// The extent of a convolution: zero padding of half the side, rounded down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Geometry {
    /// Channels read.
    pub inputs: usize,
    /// Channels written.
    pub outputs: usize,
    /// Rows and columns of the weights: odd, up to 11.
    pub side: usize,
    /// Pixels from one output to the next.
    pub stride: usize,
}

impl Geometry {
    /// A 3 × 3 convolution of stride 1.
    pub fn three_by_three(inputs: usize, outputs: usize) -> Self {
        Self { inputs, outputs, side: 3, stride: 1 }
    }

    /// Counts the weights.
    pub fn weight_len(&self) -> usize {
        self.outputs * self.inputs * self.side * self.side
    }

    /// Number of output rows (columns) of `extent` input rows (columns).
    pub fn output_extent(&self, extent: usize) -> usize {
        extent.div_ceil(self.stride)
    }

    /// The shape of the outputs for an input of shape `input`.
    pub(crate) fn output_shape(&self, input: Shape) -> Shape {
        let (height, width) = (self.output_extent(input.height), self.output_extent(input.width));
        Shape { images: input.images, height, width, channels: self.outputs }
    }

    /// Asserts that there is a kernel for this extent.
    pub(crate) fn check(&self) {
        let Self { inputs, outputs, side, stride } = *self;
        let is_known = side % 2 == 1 && side <= MOST_SIDE && matches!(stride, 1 | 2 | 4);
        assert!(is_known, "a convolution of side {side}, stride {stride}");
        assert!(inputs > 0 && outputs > 0, "a convolution of {inputs} channels to {outputs}");
    }

    /// Asserts that an input, the gradient of its outputs, and the weights, where they are given, have these sizes.
    pub(crate) fn check_gradient(&self, weight: Option<&[f32]>, shape: Shape, gradient: &[f32]) {
        self.check();
        if let Some(weight) = weight {
            assert_eq!(weight.len(), self.weight_len(), "weights of {self:?}");
        }
        assert_eq!(shape.channels, self.inputs, "channels of {shape:?} and inputs of {self:?}");
        let out = self.output_shape(shape);
        assert_eq!(gradient.len(), out.len(), "floats of a gradient {out:?}");
    }

    /// Rows (columns) of zeros around the input.
    pub(crate) fn padding(&self) -> usize {
        self.side / 2
    }
}

/// Weights in the order in which the register tiles read them, outputs filled up to whole panels.
pub(crate) struct Weights {
    pub(crate) isa: Isa,
    pub(crate) geometry: Geometry,
    /// Vectors per panel.
    vectors: usize,
    packed: AlignedBuffer,
    bias: AlignedBuffer,
}

impl Weights {
    /// Packs the weights that `weight(output, input, row · side + column)` gives.
    pub(crate) fn pack(
        isa: Isa,
        geometry: Geometry,
        weight: impl Fn(usize, usize, usize) -> f32,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        let Geometry { inputs, outputs, side, .. } = geometry;
        let vectors = panel_vectors(isa.lanes(), outputs);
        let panel = vectors * isa.lanes();
        let padded = outputs.next_multiple_of(panel);
        let taps = side * side;
        let mut packed = AlignedBuffer::zeros(padded * taps * inputs);
        let to = packed.as_mut_slice();
        for output in 0..outputs {
            for (tap, input) in (0..taps).flat_map(|tap| (0..inputs).map(move |input| (tap, input))) {
                let at = ((output / panel * taps + tap) * inputs + input) * panel + output % panel;
                to[at] = weight(output, input, tap);
            }
        }
        let mut bias_buffer = AlignedBuffer::zeros(padded);
        bias_buffer.as_mut_slice()[..outputs].iter_mut().enumerate().for_each(|(o, b)| *b = bias(o));
        Self { isa, geometry, vectors, packed, bias: bias_buffer }
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
        let Self { weights, input, first, output, epilogue } = self;
        let Geometry { inputs, side, stride, outputs } = weights.geometry;
        let width = input.row_len() / inputs;
        let row_len = weights.geometry.output_extent(width) * outputs;
        let edge_row = whole_lines(((MOST_ROWS - 1) * stride + side) * inputs);
        let mut lent = lend(side * edge_row);
        let mut scratch = lent.scratch();
        let edge = scratch.take(side * edge_row);
        for row in 0..output.len() / row_len {
            let top = ((first + row) * stride).cast_signed() - (side / 2).cast_signed();
            let mut rows: [Option<&[f32]>; MOST_SIDE] = [None; MOST_SIDE];
            for (k, row) in rows.iter_mut().enumerate().take(side) {
                *row = input.row(top + k.cast_signed());
            }
            let at = row * row_len;
            let mut line = Line { weights, rows, width, edge, edge_row, output, at };
            // SAFETY: `rows` are whole rows of the input, `output` holds one output row from `at`, and the
            // edge buffer `side` runs of the most pixels that a register tile sees.
            unsafe { with_register_tile!(S, weights.vectors, output_line(simd, epilogue, &mut line)) };
        }
    }
}

/// One output row and what it is computed from.
struct Line<'a, 'b> {
    weights: &'a Weights,
    rows: [Option<&'a [f32]>; MOST_SIDE],
    /// Columns of the input.
    width: usize,
    edge: &'b mut [f32],
    edge_row: usize,
    output: &'b mut [f32],
    /// Where the row begins in `output`.
    at: usize,
}

/// Computes one output row, register tile by register tile.
///
/// # Safety
/// The line's rows hold whole pixels of the input, `width` of them; `output`, and the epilogue's tensor, hold one output row
/// from `at`; the edge buffer has `side` runs of `edge_row` floats, enough for the pixels that `ROWS` outputs see. Panels of
/// the weights are `COLUMNS` vectors wide.
#[inline(always)]
unsafe fn output_line<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    epilogue: Epilogue<'_>,
    line: &mut Line<'_, '_>,
) {
    let weights = line.weights;
    let Geometry { inputs, outputs, side, stride } = weights.geometry;
    let width = weights.geometry.output_extent(line.width);
    let panel = COLUMNS * S::LANES;
    let run = side * inputs;
    for p in 0..outputs.div_ceil(panel) {
        for x in (0..width).step_by(ROWS) {
            let inside = x * stride >= side / 2 && (x + ROWS - 1) * stride + side / 2 < line.width;
            if !inside {
                line.copy_edge(x, ROWS);
            }
            // SAFETY: a vector of bias per vector of the panel. Tiles inside the row read runs of `side`
            // pixels from input column `x·stride − side/2`; others read the copy, which has room for all
            // `ROWS` runs. Each panel holds `side` rows of `run` vectors of weights.
            unsafe {
                let bias = load_strided(simd, weights.bias.as_slice(), p * panel, S::LANES);
                let mut tile: Tile<S, ROWS, COLUMNS> = [bias; ROWS];
                for k in 0..side {
                    let Some(row) = line.rows[k] else { continue };
                    let (data, at) = if inside {
                        (row, (x * stride - side / 2) * inputs)
                    } else {
                        (&*line.edge, k * line.edge_row)
                    };
                    let a = Operand { data, at, row: stride * inputs, step: 1 };
                    let at = (p * side + k) * run * panel;
                    let b = Operand { data: weights.packed.as_slice(), at, row: 0, step: panel };
                    tile = multiply_add::<S, ROWS, COLUMNS>(simd, tile, run, a, b);
                }
                let target = Target {
                    at: line.at + x * outputs + p * panel,
                    pixels: ROWS.min(width - x),
                    pixel: outputs,
                    channels: panel.min(outputs - p * panel),
                };
                // Chosen for each tile and not around the loops, which would be compiled three times.
                with_epilogue!(epilogue, f => finish_tile(simd, &tile, f, line.output, target));
            }
        }
    }
}

impl Line<'_, '_> {
    /// Copies the pixels that `tile` outputs from output column `x` see, zeros where there is none.
    #[inline(always)]
    fn copy_edge(&mut self, x: usize, tile: usize) {
        let Geometry { inputs, side, stride, .. } = self.weights.geometry;
        let left = (x * stride).cast_signed() - (side / 2).cast_signed();
        let columns = (tile - 1) * stride + side;
        for (k, row) in self.rows.iter().take(side).enumerate() {
            if let Some(row) = row {
                let to = &mut self.edge[k * self.edge_row..][..columns * inputs];
                copy_columns(row, left, inputs, to);
            }
        }
    }
}

/// Copies a row's pixels from column `left` on, zeros where the row has none.
#[inline(always)]
pub(crate) fn copy_columns(row: &[f32], left: isize, channels: usize, to: &mut [f32]) {
    let columns = to.len() / channels;
    let width = row.len() / channels;
    let from = usize::try_from(-left).unwrap_or(0).min(columns);
    let until = usize::try_from(width.cast_signed() - left).unwrap_or(0).clamp(from, columns);
    to[..from * channels].fill(0.0);
    to[until * channels..].fill(0.0);
    if from < until {
        let start = (left + from.cast_signed()).unsigned_abs() * channels;
        let len = (until - from) * channels;
        to[from * channels..][..len].copy_from_slice(&row[start..start + len]);
    }
}

/// Where a register tile's outputs go.
#[derive(Clone, Copy)]
pub(crate) struct Target {
    /// Place of the first.
    pub(crate) at: usize,
    /// How many pixels (rows of the tile) are wanted.
    pub(crate) pixels: usize,
    /// Distance between them.
    pub(crate) pixel: usize,
    /// How many channels (columns of the tile) are wanted.
    pub(crate) channels: usize,
}

/// Finishes and stores the wanted part of a register tile.
///
/// # Safety
/// The pixels' channels lie within `output` and within the epilogue's tensor.
#[inline(always)]
pub(crate) unsafe fn finish_tile<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    tile: &Tile<S, ROWS, COLUMNS>,
    epilogue: impl CompiledEpilogue<S>,
    output: &mut [f32],
    target: Target,
) {
    unrolled!(12, ROWS, i => if i < target.pixels {
        unrolled!(4, COLUMNS, j => {
            let at = target.at + i * target.pixel + j * S::LANES;
            let left = target.channels.saturating_sub(j * S::LANES);
            // SAFETY: the caller promises that the wanted channels lie within both.
            unsafe {
                if left >= S::LANES {
                    Whole.store(simd, output, at, epilogue.vector(simd, Whole, tile[i][j], at));
                } else if left > 0 {
                    let extent = First(left);
                    extent.store(simd, output, at, epilogue.vector(simd, extent, tile[i][j], at));
                }
            }
        });
    });
}
