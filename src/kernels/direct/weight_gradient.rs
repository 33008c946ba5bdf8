//! Gradients of a convolution's outputs to those of its weights, row by row.
//!
//! For each row k of the weights, the gradient is the product of the matrix whose rows are the runs that the
//! outputs of one image row see (`[3 · inputs, width]`, read with overlap, never stored) with those outputs'
//! gradients (`[width, outputs]`), summed over image rows.

use super::forward::{Geometry, copy_columns};
use crate::kernels::gemm::{
    MOST_ROWS, Operand, load_tile, multiply_add, panel_vectors, store_tile, with_register_tile,
};
use crate::kernels::rows::Rows;
use crate::kernels::scratch::{lend, whole_lines};
use crate::kernels::simd::{Isa, Kernel, Simd};

/// The extent of the sums: `[weight row][column · input, filled up][output, filled up]`.
#[derive(Clone, Copy)]
pub(crate) struct SumsLayout {
    geometry: Geometry,
    vectors: usize,
    /// Rows per weight row, a multiple of every register tile's.
    rows: usize,
    /// Outputs filled up to whole panels.
    pub(crate) outputs: usize,
}

impl SumsLayout {
    /// Plans the sums for an instruction set.
    pub(crate) fn new(isa: Isa, geometry: Geometry) -> Self {
        let vectors = panel_vectors(isa.lanes(), geometry.outputs);
        Self {
            geometry,
            vectors,
            rows: (geometry.side * geometry.inputs).next_multiple_of(MOST_ROWS),
            outputs: geometry.outputs.next_multiple_of(vectors * isa.lanes()),
        }
    }

    /// Floats of one set of sums.
    pub(crate) fn len(&self) -> usize {
        self.geometry.side * self.rows * self.outputs
    }

    /// Where the sum of one weight lies.
    pub(crate) fn at(&self, output: usize, input: usize, tap: usize) -> usize {
        let Geometry { inputs, side, .. } = self.geometry;
        (tap / side * self.rows + tap % side * inputs + input) * self.outputs + output
    }
}

/// Adds what one output row of one image contributes.
pub(crate) struct AddOutputRow<'a> {
    pub(crate) layout: SumsLayout,
    pub(crate) input: Rows<'a>,
    /// The number of the output row.
    pub(crate) row: usize,
    /// The gradient of that row.
    pub(crate) gradient: &'a [f32],
    pub(crate) sums: &'a mut [f32],
}

impl Kernel for AddOutputRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { layout, input, row, gradient, sums } = self;
        let Geometry { inputs, outputs, side, stride } = layout.geometry;
        let columns = gradient.len() / outputs;
        // Register tiles may read `MOST_ROWS` floats past the last run.
        let run_len = whole_lines(((columns - 1) * stride + side) * inputs + MOST_ROWS);
        let gradient_len = whole_lines(columns * layout.outputs);
        let mut lent = lend(run_len + gradient_len);
        let mut scratch = lent.scratch();
        let runs = scratch.take(run_len);
        let wide = scratch.take(gradient_len);
        for (to, from) in wide.chunks_exact_mut(layout.outputs).zip(gradient.chunks_exact(outputs)) {
            to[..outputs].copy_from_slice(from);
            to[outputs..].fill(0.0);
        }
        for k in 0..side {
            let y = (row * stride + k).cast_signed() - (side / 2).cast_signed();
            let Some(from) = input.row(y) else { continue };
            let seen = ((columns - 1) * stride + side) * inputs;
            copy_columns(from, -(side / 2).cast_signed(), inputs, &mut runs[..seen]);
            let product = Product { layout, k, columns, runs, wide };
            // SAFETY: `runs` has room for the runs of all columns and `MOST_ROWS` floats more, `wide` for
            // all columns' gradients; the sums have `layout.len()` floats.
            unsafe { with_register_tile!(S, layout.vectors, accumulate(simd, &product, sums)) };
        }
    }
}

/// The operands of one weight row's product.
struct Product<'a> {
    layout: SumsLayout,
    k: usize,
    columns: usize,
    runs: &'a [f32],
    wide: &'a [f32],
}

/// Adds the product to the sums of weight row `k`.
///
/// # Safety
/// `runs` holds what `columns` outputs see and `MOST_ROWS` floats more, `wide` the gradients of as many outputs, filled up to
/// whole panels of `COLUMNS` vectors; the sums have `layout.len()` floats.
#[inline(always)]
unsafe fn accumulate<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    product: &Product<'_>,
    sums: &mut [f32],
) {
    let layout = product.layout;
    let Geometry { inputs, side, stride, .. } = layout.geometry;
    let panel = COLUMNS * S::LANES;
    for p in (0..layout.outputs).step_by(panel) {
        for r in (0..side * inputs).step_by(ROWS) {
            let at = (product.k * layout.rows + r) * layout.outputs + p;
            let a = Operand { data: product.runs, at: r, row: 1, step: stride * inputs };
            let b = Operand { data: product.wide, at: p, row: 0, step: layout.outputs };
            // SAFETY: rows up to `side·inputs + ROWS` exist in the sums (filled up) and may be read from the
            // runs; panels fill the outputs exactly.
            unsafe {
                let tile = load_tile::<S, ROWS, COLUMNS>(simd, sums, at, layout.outputs);
                let tile = multiply_add::<S, ROWS, COLUMNS>(simd, tile, product.columns, a, b);
                store_tile(simd, &tile, sums, at, layout.outputs);
            }
        }
    }
}
