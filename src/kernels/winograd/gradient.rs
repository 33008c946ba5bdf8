//! The gradient of the weights: the steps of the forward transform turned around.
//!
//! # Equation
//! With `Y = Aᵀ [ U ⊙ V ] A`, `U = G g Gᵀ` and `V = Bᵀ d B`, the gradient is `∂g = Gᵀ [ Σ V ⊙ (A ∂Y Aᵀ) ] G`
//! over all tiles: at each of the 36 points a product `[input, tile] · [tile, output]`.
//!
//! # Order of work
//! One task adds up the six points of one row, for a group of tile rows; so the sums it updates
//! (`6 · inputs · outputs`) stay in the second-level cache and need no locks. The number of groups depends on
//! the shape alone, and groups are added in order: the result does not depend on the threads.
//!
//! # Channels that do not fill vectors
//! The vertical steps run along whole rows. From the horizontal ones on each tile has whole vectors of
//! channels, filled up with zeros, and so have the sums.

use rayon::prelude::*;

use super::transform;
use super::{POINTS, TILE};
use crate::kernels::gemm::{Operand, load_tile, multiply_add, store_tile, with_weight_tile};
use crate::kernels::rows::Rows;
use crate::kernels::scratch::{AlignedBuffer, LINE, lend, whole_lines};
use crate::kernels::shape::Shape;
use crate::kernels::simd::{Extent, Isa, Kernel, Simd, for_each_vector, load_strided, store_strided};

/// Tiles per product: the depth over which a register tile of sums is kept.
const DEPTH: usize = 64;

/// Tiles that are worth a group of sums of their own.
const TILES_PER_GROUP: usize = 512;

/// The most groups: six times as many tasks.
const MOST_GROUPS: usize = 8;

/// The most floats of all groups' sums.
const MOST_SUMS: usize = 1 << 22;

/// Computes the gradient of weights `[outputs, inputs, 3, 3]`.
///
/// # Shapes
/// `input` has `shape`; `gradient`, of the outputs, has the same with `outputs` channels.
pub(crate) fn weight_gradient(
    isa: Isa,
    input: &[f32],
    shape: Shape,
    gradient: &[f32],
    outputs: usize,
) -> Vec<f32> {
    let rows = tile_rows(input, shape, gradient, outputs);
    let channels = Channels::new(isa, shape.channels, outputs);
    let Channels { inputs, padded_inputs, padded_outputs, .. } = channels;
    let point_len = padded_inputs * padded_outputs;
    let tiles = rows.len() * shape.width.div_ceil(TILE);
    let groups = groups(tiles, point_len);
    let per_group = rows.len().div_ceil(groups);
    let mut sums = AlignedBuffer::zeros(groups * POINTS * POINTS * point_len);
    sums.as_mut_slice().par_chunks_mut(POINTS * point_len).enumerate().for_each(|(task, sums)| {
        let (group, point_row) = (task / POINTS, task % POINTS);
        let start = (group * per_group).min(rows.len());
        let rows = &rows[start..(start + per_group).min(rows.len())];
        isa.run(PointRow { point_row, rows, width: shape.width, channels, sums });
    });
    let mut by_input = vec![0.0; inputs * 9 * padded_outputs];
    by_input.par_chunks_mut(INVERTED_INPUTS * 9 * padded_outputs).enumerate().for_each(|(block, to)| {
        isa.run(InvertWeights { sums: sums.as_slice(), channels, first: block * INVERTED_INPUTS, to });
    });
    let (mut weights, taps) = (vec![0.0; outputs * inputs * 9], inputs * 9);
    weights.par_chunks_mut(LINE * taps).enumerate().for_each(|(block, to)| {
        for (tap, from) in by_input.chunks_exact(padded_outputs).enumerate() {
            let from = &from[block * LINE..][..to.len() / taps];
            from.iter().enumerate().for_each(|(output, value)| to[output * taps + tap] = *value);
        }
    });
    weights
}

/// How many groups of sums there are for so many tiles, each sum of a point taking `point_len` floats.
pub(crate) fn groups(tiles: usize, point_len: usize) -> usize {
    let affordable = (MOST_SUMS / (POINTS * POINTS * point_len)).max(1);
    (tiles / TILES_PER_GROUP).clamp(1, MOST_GROUPS).min(affordable)
}

/// Channels on either side, and how many of them a tile has in the working memory.
#[derive(Clone, Copy)]
struct Channels {
    inputs: usize,
    outputs: usize,
    padded_inputs: usize,
    padded_outputs: usize,
}

impl Channels {
    fn new(isa: Isa, inputs: usize, outputs: usize) -> Self {
        let padded = |channels: usize| channels.next_multiple_of(isa.lanes());
        Self { inputs, outputs, padded_inputs: padded(inputs), padded_outputs: padded(outputs) }
    }
}

/// What one row of tiles saw and the gradients of what it computed; rows outside of the image are missing.
struct TileRow<'a> {
    inputs: [Option<&'a [f32]>; POINTS],
    gradients: [Option<&'a [f32]>; TILE],
}

fn tile_rows<'a>(input: &'a [f32], shape: Shape, gradient: &'a [f32], outputs: usize) -> Vec<TileRow<'a>> {
    let out = shape.with_channels(outputs);
    let images = input.chunks_exact(shape.image_len()).zip(gradient.chunks_exact(out.image_len()));
    let mut rows = Vec::new();
    for (input, gradient) in images {
        let (input, gradient) = (Rows::whole(input, shape.height), Rows::whole(gradient, shape.height));
        for top in (0..shape.height.cast_signed()).step_by(TILE) {
            rows.push(TileRow {
                inputs: std::array::from_fn(|k| input.row(top - 1 + k.cast_signed())),
                gradients: std::array::from_fn(|k| gradient.row(top + k.cast_signed())),
            });
        }
    }
    rows
}

/// Adds up the six points of one row over some rows of tiles.
struct PointRow<'a> {
    point_row: usize,
    rows: &'a [TileRow<'a>],
    width: usize,
    channels: Channels,
    /// `[point][input][output]`.
    sums: &'a mut [f32],
}

impl Kernel for PointRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        const SKEW: usize = 16;
        let Self { point_row, rows, width, channels, sums } = self;
        let Channels { inputs, outputs, padded_inputs, padded_outputs } = channels;
        let tiles_across = width.div_ceil(TILE);
        let across = DEPTH.min(tiles_across);
        let together = (DEPTH / tiles_across).max(1);
        let input_part = whole_lines((across * together + 1) * padded_inputs) + SKEW;
        let gradient_part = whole_lines(across * together * padded_outputs) + SKEW;
        let line_len = whole_lines((across * TILE + POINTS) * inputs.max(outputs));
        let mut lent = lend(POINTS * (input_part + gradient_part) + 2 * line_len);
        let mut scratch = lent.scratch();
        let left = scratch.take(POINTS * input_part);
        let right = scratch.take(POINTS * gradient_part);
        let line = scratch.take(line_len);
        let zeros = scratch.take(line_len);
        zeros.fill(0.0);
        for rows in rows.chunks(together) {
            for first in (0..tiles_across).step_by(across) {
                let tiles = across.min(tiles_across - first);
                let segment = Segment { point_row, first, tiles, width };
                for (q, row) in rows.iter().enumerate() {
                    // SAFETY: `line` holds all columns of `across` tiles, each of the six parts of `left` and
                    // `right` the channels of `across · together` tiles.
                    unsafe {
                        segment.inputs(simd, row, inputs, line, zeros);
                        let first = q * tiles * padded_inputs;
                        let to = Destination { first, tile: padded_inputs, point: input_part };
                        input_points(simd, tiles, inputs, line, left, to);
                        segment.gradients(simd, row, outputs, line, zeros);
                        let first = q * tiles * padded_outputs;
                        let to = Destination { first, tile: padded_outputs, point: gradient_part };
                        gradient_points(simd, tiles, outputs, line, right, to);
                    }
                }
                for point in 0..POINTS {
                    let product = Product {
                        depth: rows.len() * tiles,
                        channels,
                        left: &left[point * input_part..],
                        right: &right[point * gradient_part..],
                    };
                    let point_len = padded_inputs * padded_outputs;
                    let sums = &mut sums[point * point_len..][..point_len];
                    // SAFETY: both operands hold `depth` tiles, the sums one point.
                    unsafe { with_weight_tile!(S, padded_outputs, accumulate(simd, &product, sums)) };
                }
            }
        }
    }
}

/// Neighbouring tiles of a row of tiles.
#[derive(Clone, Copy)]
struct Segment {
    point_row: usize,
    first: usize,
    tiles: usize,
    width: usize,
}

impl Segment {
    /// Vertical step for the inputs: one row of Bᵀ over six rows, for each column that the tiles see.
    ///
    /// # Safety
    /// Rows of inputs are `width` pixels of `channels`; `line` and `zeros` hold the columns of the segment's tiles and two more.
    #[inline(always)]
    #[expect(
        clippy::too_many_arguments,
        reason = "one inner loop's state; a struct would be taken apart at once"
    )]
    unsafe fn inputs<S: Simd>(
        self,
        simd: S,
        row: &TileRow<'_>,
        channels: usize,
        line: &mut [f32],
        zeros: &[f32],
    ) {
        let columns = self.tiles * TILE + POINTS - TILE;
        let before = usize::from(self.first == 0);
        let until = columns.min(self.width + 1 - self.first * TILE);
        let len = (until - before) * channels;
        let start = (self.first * TILE + before - 1) * channels;
        let rows = row.inputs.map(|row| row.map_or(&zeros[..len], |row| &row[start..start + len]));
        line[..before * channels].fill(0.0);
        line[until * channels..columns * channels].fill(0.0);
        let line = &mut line[before * channels..];
        // SAFETY: the rows are `len` long, and the line holds all columns.
        unsafe {
            match self.point_row {
                0 => input_point::<S, 0>(simd, &rows, len, line),
                1 => input_point::<S, 1>(simd, &rows, len, line),
                2 => input_point::<S, 2>(simd, &rows, len, line),
                3 => input_point::<S, 3>(simd, &rows, len, line),
                4 => input_point::<S, 4>(simd, &rows, len, line),
                _ => input_point::<S, 5>(simd, &rows, len, line),
            }
        }
    }

    /// Vertical step for the gradients: one row of A over four rows.
    ///
    /// # Safety
    /// Rows of gradients are `width` pixels of `channels`; `line` and `zeros` hold the columns of the segment's tiles.
    #[inline(always)]
    #[expect(
        clippy::too_many_arguments,
        reason = "one inner loop's state; a struct would be taken apart at once"
    )]
    unsafe fn gradients<S: Simd>(
        self,
        simd: S,
        row: &TileRow<'_>,
        channels: usize,
        line: &mut [f32],
        zeros: &[f32],
    ) {
        let columns = self.tiles * TILE;
        let until = columns.min(self.width - self.first * TILE);
        let (start, len) = (self.first * TILE * channels, until * channels);
        let rows = row.gradients.map(|row| row.map_or(&zeros[..len], |row| &row[start..start + len]));
        line[len..columns * channels].fill(0.0);
        // SAFETY: as for the inputs.
        unsafe {
            match self.point_row {
                0 => gradient_point::<S, 0>(simd, &rows, len, line),
                1 => gradient_point::<S, 1>(simd, &rows, len, line),
                2 => gradient_point::<S, 2>(simd, &rows, len, line),
                3 => gradient_point::<S, 3>(simd, &rows, len, line),
                4 => gradient_point::<S, 4>(simd, &rows, len, line),
                _ => gradient_point::<S, 5>(simd, &rows, len, line),
            }
        }
    }
}

/// Point `POINT` of Bᵀ over six rows; the compiler leaves out what the other points would need.
///
/// # Safety
/// The rows and `to` hold `len` floats.
#[inline(always)]
unsafe fn input_point<S: Simd, const POINT: usize>(
    simd: S,
    rows: &[&[f32]; POINTS],
    len: usize,
    to: &mut [f32],
) {
    for_each_vector!(S, len, (at, extent) => {
        // SAFETY: the caller promises rows and room of `len` floats.
        unsafe {
            let mut d = [simd.splat(0.0); POINTS];
            for (vector, row) in d.iter_mut().zip(rows) {
                *vector = extent.load(simd, row, at);
            }
            extent.store(simd, to, at, transform::input(simd, d)[POINT]);
        }
    });
}

/// Point `POINT` of A over four rows.
///
/// # Safety
/// The rows and `to` hold `len` floats.
#[inline(always)]
unsafe fn gradient_point<S: Simd, const POINT: usize>(
    simd: S,
    rows: &[&[f32]; TILE],
    len: usize,
    to: &mut [f32],
) {
    for_each_vector!(S, len, (at, extent) => {
        // SAFETY: the caller promises rows and room of `len` floats.
        unsafe {
            let mut y = [simd.splat(0.0); TILE];
            for (vector, row) in y.iter_mut().zip(rows) {
                *vector = extent.load(simd, row, at);
            }
            extent.store(simd, to, at, transform::output_gradient(simd, y)[POINT]);
        }
    });
}

/// Where a row of transformed tiles goes.
#[derive(Clone, Copy)]
struct Destination {
    /// The place of its first tile.
    first: usize,
    /// Distance between tiles.
    tile: usize,
    /// Distance between points.
    point: usize,
}

/// Reads up to a vector of channels of `N` neighbouring columns.
///
/// # Safety
/// All of them lie within `line`.
#[inline(always)]
unsafe fn load_columns<S: Simd, const N: usize>(
    simd: S,
    extent: impl Extent,
    line: &[f32],
    at: usize,
    channels: usize,
) -> [S::Vector; N] {
    let mut columns = [simd.splat(0.0); N];
    for (x, column) in columns.iter_mut().enumerate() {
        // SAFETY: passed on to the caller.
        *column = unsafe { extent.load(simd, line, at + x * channels) };
    }
    columns
}

/// Horizontal step for the inputs.
///
/// # Safety
/// `line` holds `4 · tiles + 2` columns of `channels`, `points` whole vectors of every tile's channels, where `to` says.
#[inline(always)]
#[expect(
    clippy::too_many_arguments,
    reason = "one inner loop's state; a struct would be taken apart at once"
)]
unsafe fn input_points<S: Simd>(
    simd: S,
    tiles: usize,
    channels: usize,
    line: &[f32],
    points: &mut [f32],
    to: Destination,
) {
    for tile in 0..tiles {
        for_each_vector!(S, channels, (c, extent) => {
            // SAFETY: the line holds `4 · tiles + 2` columns, each part of `points` the tiles' whole vectors.
            unsafe {
                let d = load_columns(simd, extent, line, tile * TILE * channels + c, channels);
                let v = transform::input(simd, d);
                store_strided(simd, points, to.first + tile * to.tile + c, to.point, &v);
            }
        });
    }
}

/// Horizontal step for the gradients.
///
/// # Safety
/// `line` holds `4 · tiles` columns of `channels`, `points` whole vectors of every tile's channels, where `to` says.
#[inline(always)]
#[expect(
    clippy::too_many_arguments,
    reason = "one inner loop's state; a struct would be taken apart at once"
)]
unsafe fn gradient_points<S: Simd>(
    simd: S,
    tiles: usize,
    channels: usize,
    line: &[f32],
    points: &mut [f32],
    to: Destination,
) {
    for tile in 0..tiles {
        for_each_vector!(S, channels, (c, extent) => {
            // SAFETY: the line holds `4 · tiles` columns, each part of `points` the tiles' whole vectors.
            unsafe {
                let y = load_columns(simd, extent, line, tile * TILE * channels + c, channels);
                let v = transform::output_gradient(simd, y);
                store_strided(simd, points, to.first + tile * to.tile + c, to.point, &v);
            }
        });
    }
}

/// The operands of one point's product, `[tile, input]` and `[tile, output]`.
struct Product<'a> {
    depth: usize,
    channels: Channels,
    left: &'a [f32],
    right: &'a [f32],
}

/// Adds `leftᵀ · right` to the sums `[input, output]`.
///
/// # Safety
/// Both operands hold `depth` tiles of padded channels, the sums one point; `COLUMNS` vectors divide the padded outputs.
#[inline(always)]
unsafe fn accumulate<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    product: &Product<'_>,
    sums: &mut [f32],
) {
    let Product { depth, channels, left, right } = *product;
    let Channels { inputs, padded_inputs, padded_outputs, .. } = channels;
    for output in (0..padded_outputs).step_by(COLUMNS * S::LANES) {
        // Register tiles without any input are left out.
        for input in (0..inputs).step_by(ROWS) {
            let a = Operand { data: left, at: input, row: 1, step: padded_inputs };
            let b = Operand { data: right, at: output, row: 0, step: padded_outputs };
            let at = input * padded_outputs + output;
            // SAFETY: register tiles divide the channels in the working memory.
            unsafe {
                let tile = load_tile::<S, ROWS, COLUMNS>(simd, sums, at, padded_outputs);
                let tile = multiply_add::<S, ROWS, COLUMNS>(simd, tile, depth, a, b);
                store_tile(simd, &tile, sums, at, padded_outputs);
            }
        }
    }
}

/// Inputs whose weights one task takes back.
const INVERTED_INPUTS: usize = 4;

/// Takes the groups' sums of a few inputs back to weights: Gᵀ·U·G.
struct InvertWeights<'a> {
    /// `[group][point 6×6][input][output]`.
    sums: &'a [f32],
    channels: Channels,
    /// The first input.
    first: usize,
    /// `[input][tap][output]`.
    to: &'a mut [f32],
}

impl Kernel for InvertWeights<'_> {
    type Output = ();

    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "the loop transposes: a column becomes an entry of each row"
    )]
    fn run<S: Simd>(self, simd: S) {
        let Self { sums, channels, first, to } = self;
        let outputs = channels.padded_outputs;
        let point_len = channels.padded_inputs * outputs;
        for (input, to) in to.chunks_exact_mut(9 * outputs).enumerate() {
            for output in (0..outputs).step_by(S::LANES) {
                let at = (first + input) * outputs + output;
                // SAFETY: each group holds 36 parts of `point_len` floats, `to` nine of `outputs`, and outputs
                // fill whole vectors.
                unsafe {
                    let mut columns = [[simd.splat(0.0); POINTS]; 3];
                    for x in 0..POINTS {
                        let mut column = [simd.splat(0.0); POINTS];
                        for group in 0..sums.len() / (POINTS * POINTS * point_len) {
                            let from = (group * POINTS * POINTS + x) * point_len + at;
                            let part: [S::Vector; POINTS] =
                                load_strided(simd, sums, from, POINTS * point_len);
                            for (sum, part) in column.iter_mut().zip(part) {
                                *sum = simd.add(*sum, part);
                            }
                        }
                        let column = transform::weight_gradient(simd, column);
                        for k in 0..3 {
                            columns[k][x] = column[k];
                        }
                    }
                    for (k, row) in columns.into_iter().enumerate() {
                        let taps = transform::weight_gradient(simd, row);
                        store_strided(simd, to, k * 3 * outputs + output, outputs, &taps);
                    }
                }
            }
        }
    }
}
