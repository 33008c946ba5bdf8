//! Inputs and transformed weights to outputs, one batch of tiles at a time.
//!
//! # Method
//! The rows of tiles are transformed down the columns first, all columns of a batch, then one row of points after
//! the other: across the tiles, times the weights, back across. What a row of points left is transformed down the
//! columns last. Tiles side by side share the first transform of the two columns that they share, and of the 36
//! parts of inputs and products only six exist at a time.
//!
//! # Layout
//! Transformed inputs and products lie as `[point][tile][channel]`; their parts are a cache line longer than
//! needed, because strides of a power of two make the streams of a transform fall on the same cache sets.
//!
//! # Sizes
//! For 36 tiles of 32 channels a row of points takes 28 KB of inputs and as much of products, which the first-level
//! cache mostly holds, and the whole columns 113 KB each way. More tiles would reuse the weights of 128 channels
//! (2.4 MB, more than the second-level cache) more often, but gain nothing: the products hide the reading. Batches
//! count tiles along all rows of a task, so that narrow images fill them too.
//!
//! # Memory
//! Both ends of a batch wait for rows that no near cache holds. They are asked for during the products ([`Prefetcher`]), which
//! makes the network 3 % faster, and 8 % when others use the memory too.
//!
//! # Channels that do not fill vectors
//! Transformed inputs and products hold whole vectors of channels for each tile, filled up with zeros: only
//! what is read from the inputs and written to the outputs is cut off. The products' depth is the number of
//! inputs that there are.

use super::weights::Weights;
use super::{POINTS, TILE, transform};
use crate::kernels::epilogue::{CompiledEpilogue, Epilogue, with_epilogue};
use crate::kernels::gemm::{MOST_ROWS, Operand, multiply_add, store_tile, with_register_tile, zero_tile};
use crate::kernels::prefetch::Prefetcher;
use crate::kernels::scratch::{lend, whole_lines};
use crate::kernels::simd::{Extent as _, Kernel, Simd, for_each_vector, load_strided, store_strided};

/// How many tiles a batch has at most.
const MOST_TILES: usize = 36;

/// How many tiles make a batch of a task of `tiles`: equal shares, but whole register tiles.
fn tiles_per_batch(tiles: usize) -> usize {
    tiles.div_ceil(tiles.div_ceil(MOST_TILES)).next_multiple_of(MOST_ROWS)
}

/// How many rows of tiles of an image `width` wide one task should be given.
pub(crate) fn rows_per_task(width: usize) -> usize {
    (MOST_TILES / width.div_ceil(TILE)).max(1)
}

/// How outputs lie in memory.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Order {
    /// As computed.
    Plain,
    /// Four groups of channels, in the order (0,0), (0,1), (1,0), (1,1), become 2 × 2 pixels.
    Shuffled,
}

/// Inputs and output of one row of tiles.
pub(crate) struct TileRow<'a> {
    /// The input rows from one above the tiles to one below, missing where there is none.
    pub(crate) inputs: [Option<&'a [f32]>; POINTS],
    /// One to four output rows.
    pub(crate) output: &'a mut [f32],
    /// What is done to the sums.
    pub(crate) epilogue: Epilogue<'a>,
}

/// A few rows of tiles of one image: the work of one task.
pub(crate) struct TileRows<'a, 'b> {
    pub(crate) weights: &'a Weights,
    /// Columns of the image, before shuffling.
    pub(crate) width: usize,
    pub(crate) order: Order,
    pub(crate) rows: &'a mut [TileRow<'b>],
}

impl Kernel for TileRows<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { weights, width, order, rows } = self;
        let across = width.div_ceil(TILE);
        let tiles = across * rows.len();
        let batch = tiles_per_batch(tiles);
        let sizes = Sizes::new(weights, batch, rows.len(), width);
        let mut lent = lend(sizes.total());
        let mut scratch = lent.scratch();
        let mut buffers = Buffers {
            columns: scratch.take(POINTS * sizes.columns),
            inputs: scratch.take(POINTS * sizes.inputs),
            products: scratch.take(POINTS * sizes.products),
            sums: scratch.take(POINTS * sizes.sums),
            zeros: scratch.take(sizes.zeros),
        };
        buffers.zeros.fill(0.0);
        let place = Placement::new(order, width, weights.outputs);
        for first in (0..tiles).step_by(batch) {
            let count = batch.min(tiles - first);
            let batch = Batch { weights, width, across, first, count, sizes, place };
            // SAFETY: the buffers have the sizes that `Sizes` gives for batches of up to `batch` tiles.
            unsafe { batch.compute(simd, rows, &mut buffers) };
        }
    }
}

/// Distances between the six parts of the buffers, and the length of the last, in floats.
#[derive(Clone, Copy)]
struct Sizes {
    columns: usize,
    inputs: usize,
    products: usize,
    sums: usize,
    zeros: usize,
}

impl Sizes {
    fn new(weights: &Weights, tiles: usize, rows: usize, width: usize) -> Self {
        const SKEW: usize = 16;
        let padded_tiles = tiles + MOST_ROWS;
        Self {
            columns: whole_lines((TILE * tiles + 2 * rows) * weights.padded_inputs()) + SKEW,
            inputs: whole_lines(padded_tiles * weights.input_floats()) + SKEW,
            products: whole_lines(padded_tiles * weights.padded_outputs()) + SKEW,
            sums: whole_lines(TILE * tiles * weights.padded_outputs()) + SKEW,
            zeros: whole_lines(width * weights.inputs),
        }
    }

    fn total(&self) -> usize {
        POINTS * (self.columns + self.inputs + self.products + self.sums) + self.zeros
    }
}

/// What lies between the steps.
struct Buffers<'a> {
    /// Bᵀ·d of whole rows, `[point row][column][input]`.
    columns: &'a mut [f32],
    /// One row of points of Bᵀ·d·B, `[point column][tile][input]`.
    inputs: &'a mut [f32],
    /// Its products m with the weights, `[point column][tile][output]`.
    products: &'a mut [f32],
    /// m·A, `[point row][tile][column][output]`.
    sums: &'a mut [f32],
    /// A row of zeros.
    zeros: &'a mut [f32],
}

/// Some tiles, counted along the rows of a task.
#[derive(Clone, Copy)]
struct Batch<'a> {
    weights: &'a Weights,
    width: usize,
    /// Tiles per row.
    across: usize,
    first: usize,
    count: usize,
    sizes: Sizes,
    place: Placement,
}

/// The tiles of a batch that lie in one row.
#[derive(Clone, Copy)]
struct Run {
    /// The row of tiles.
    row: usize,
    /// The first tile's number within the row.
    across: usize,
    /// The first tile's number within the batch.
    tile: usize,
    /// How many tiles there are.
    count: usize,
    /// Where its first column lies in [`Buffers::columns`]: each run has two columns beside those of its tiles.
    column: usize,
}

impl Batch<'_> {
    /// Computes the outputs of the batch.
    ///
    /// # Safety
    /// The buffers have the sizes of `self.sizes`, made for at least as many tiles and rows.
    #[inline(always)]
    unsafe fn compute<S: Simd>(self, simd: S, rows: &mut [TileRow<'_>], buffers: &mut Buffers<'_>) {
        // SAFETY: the caller's promise covers each step.
        unsafe {
            for run in self.runs() {
                self.transform_columns(simd, &rows[run.row], run, buffers);
            }
            for point_row in 0..POINTS {
                for run in self.runs() {
                    self.transform_rows(simd, point_row, run, buffers);
                }
                let ahead = self.ahead(point_row, rows);
                with_register_tile!(
                    S,
                    self.weights.vectors,
                    multiply(simd, &self, point_row, buffers, ahead)
                );
                self.invert_rows(simd, point_row, buffers);
            }
            for run in self.runs() {
                let TileRow { output, epilogue, .. } = &mut rows[run.row];
                let sums = &*buffers.sums;
                with_epilogue!(*epilogue, f => self.invert_columns(simd, f, run, sums, output));
            }
        }
    }

    /// What is asked for during the products of a row of points, of the first run of tiles: the inputs' row of the
    /// next batch, the output's row or, where they are shuffled, two, and what is read to finish them.
    #[inline(always)]
    fn ahead<'a>(self, point_row: usize, rows: &'a [TileRow<'_>]) -> [&'a [f32]; 5] {
        let Self { place, weights, width, .. } = self;
        let mut ahead = [&[][..]; 5];
        let columns = |run: Run| (run.across * TILE, ((run.across + run.count) * TILE).min(width));
        let end = self.first + self.count;
        let next = self.count.min(self.across * rows.len() - end);
        if next > 0
            && let Some(run) = (Self { first: end, count: next, ..self }).runs().next()
            && let Some(row) = rows[run.row].inputs[point_row]
        {
            let (left, right) = columns(run);
            ahead[0] = &row[left * weights.inputs..right * weights.inputs];
        }
        if let Some(run) = self.runs().next() {
            let (left, right) = columns(run);
            let TileRow { output, epilogue, .. } = &rows[run.row];
            for (half, group) in (0..weights.outputs / place.channels).step_by(2).enumerate() {
                let from = point_row * place.row + place.group(group);
                let range = from + left * place.column..from + right * place.column;
                if range.end <= output.len() {
                    ahead[1 + half] = &output[range.clone()];
                    ahead[3 + half] = epilogue.tensor().map_or(&[], |tensor| &tensor[range]);
                }
            }
        }
        ahead
    }

    /// The runs of the batch, in order.
    fn runs(self) -> impl Iterator<Item = Run> {
        let last = self.first + self.count - 1;
        (self.first / self.across..=last / self.across).enumerate().map(move |(index, row)| {
            let first = self.first.max(row * self.across);
            let end = (last + 1).min((row + 1) * self.across);
            let tile = first - self.first;
            let column = TILE * tile + 2 * index;
            Run { row, across: first - row * self.across, tile, count: end - first, column }
        })
    }

    /// Bᵀ·d of the columns of a run, from one before its tiles to one behind them.
    ///
    /// # Safety
    /// As for [`Batch::compute`]; the run is one of the batch's, and `row` its row of tiles, whose inputs are `width` pixels long.
    #[inline(always)]
    unsafe fn transform_columns<S: Simd>(
        self,
        simd: S,
        row: &TileRow<'_>,
        run: Run,
        buffers: &mut Buffers<'_>,
    ) {
        let (channels, padded) = (self.weights.inputs, self.weights.padded_inputs());
        let Buffers { columns, zeros, .. } = buffers;
        let rows = row.inputs.map(|row| row.unwrap_or(zeros));
        let missing = usize::from(run.across == 0);
        let start = run.across * TILE + missing - 1;
        let count = (run.across * TILE + run.count * TILE + 1).min(self.width) - start;
        for part in columns.chunks_exact_mut(self.sizes.columns) {
            let part = &mut part[run.column * padded..][..(run.count * TILE + 2) * padded];
            part[..missing * padded].fill(0.0);
            part[(missing + count) * padded..].fill(0.0);
        }
        for x in 0..count {
            let (from, to) = ((start + x) * channels, (run.column + missing + x) * padded);
            for_each_vector!(S, channels, (c, extent) => {
                // SAFETY: column `start + x` lies within each row; the buffer has six parts with room for whole vectors
                // of the columns of the batch's runs.
                unsafe {
                    let mut d = [simd.splat(0.0); POINTS];
                    for (vector, row) in d.iter_mut().zip(&rows) {
                        *vector = extent.load(simd, row, from + c);
                    }
                    let v = transform::input(simd, d);
                    store_strided(simd, columns, to + c, self.sizes.columns, &v);
                }
            });
        }
    }

    /// One row of points of Bᵀ·d·B for the tiles of a run.
    ///
    /// # Safety
    /// As for [`Batch::compute`]; the run is one of the batch's, its columns are transformed, and `point_row < POINTS`.
    #[inline(always)]
    unsafe fn transform_rows<S: Simd>(self, simd: S, point_row: usize, run: Run, buffers: &mut Buffers<'_>) {
        let channels = self.weights.padded_inputs();
        for tile in 0..run.count {
            let from = point_row * self.sizes.columns + (run.column + tile * TILE) * channels;
            let to = (run.tile + tile) * self.weights.input_floats();
            for c in (0..channels).step_by(S::LANES * S::PER_LANE) {
                // SAFETY: a run has two columns more than its tiles have, and each of the six parts of the buffer
                // room for the batch's tiles; where lanes hold two numbers, channels fill them.
                unsafe {
                    let d = load_strided(simd, buffers.columns, from + c, channels);
                    let mut v = transform::input(simd, d);
                    if S::PER_LANE == 2 {
                        let d = load_strided(simd, buffers.columns, from + c + S::LANES, channels);
                        for (first, second) in v.iter_mut().zip(transform::input(simd, d)) {
                            *first = simd.pack(*first, second);
                        }
                    }
                    store_strided(simd, buffers.inputs, to + c / S::PER_LANE, self.sizes.inputs, &v);
                }
            }
        }
    }

    /// One row of points of m·A for all tiles.
    ///
    /// # Safety
    /// As for [`Batch::compute`], with `point_row < POINTS`.
    #[inline(always)]
    unsafe fn invert_rows<S: Simd>(self, simd: S, point_row: usize, buffers: &mut Buffers<'_>) {
        let channels = self.weights.padded_outputs();
        for tile in 0..self.count {
            let to = point_row * self.sizes.sums + tile * TILE * channels;
            for c in (0..channels).step_by(S::LANES) {
                // SAFETY: both buffers have six parts with room for the batch's tiles.
                unsafe {
                    let m = load_strided(simd, buffers.products, tile * channels + c, self.sizes.products);
                    let y = transform::output(simd, m);
                    store_strided(simd, buffers.sums, to + c, channels, &y);
                }
            }
        }
    }

    /// Aᵀ·(m·A) of the tiles of a run, then bias and [`Epilogue`], to where the output lies.
    ///
    /// # Safety
    /// As for [`Batch::compute`]; the run is one of the batch's, `output` holds the rows of its row of tiles, and so does the
    /// epilogue's tensor.
    #[inline(always)]
    #[expect(
        clippy::too_many_arguments,
        reason = "one inner loop's state; a struct would be taken apart at once"
    )]
    unsafe fn invert_columns<S: Simd>(
        self,
        simd: S,
        epilogue: impl CompiledEpilogue<S>,
        run: Run,
        sums: &[f32],
        output: &mut [f32],
    ) {
        let Self { place, weights, .. } = self;
        let rows = output.len() / (self.width * weights.outputs);
        let first = run.across * TILE;
        let columns = (run.count * TILE).min(self.width - first);
        let bias = weights.bias.as_slice();
        for x in 0..columns {
            let from = (run.tile * TILE + x) * weights.padded_outputs();
            for group in 0..weights.outputs / place.channels {
                let to = place.group(group) + (first + x) * place.column;
                let channel = group * place.channels;
                for_each_vector!(S, place.channels, (c, extent) => {
                    // SAFETY: `sums` has six parts with room for the batch's tiles; row `k < rows` and column `x` are
                    // in the output, with the extent's channels from this one on, and the epilogue's tensor is laid
                    // out like the output.
                    unsafe {
                        let b = simd.load(bias, channel + c);
                        let m = load_strided(simd, sums, from + channel + c, self.sizes.sums);
                        for (k, value) in transform::output(simd, m).into_iter().enumerate() {
                            if k < rows {
                                let at = to + c + k * place.row;
                                let sum = simd.add(value, b);
                                extent.store(simd, output, at, epilogue.vector(simd, extent, sum, at));
                            }
                        }
                    }
                });
            }
        }
    }
}

/// The six products `[tile, input] · [input, output]` of one row of points.
///
/// # Safety
/// As for [`Batch::compute`], with `point_row < POINTS`; panels of the weights are `COLUMNS` vectors wide.
#[inline(always)]
unsafe fn multiply<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    batch: &Batch<'_>,
    point_row: usize,
    buffers: &mut Buffers<'_>,
    ahead: [&[f32]; 5],
) {
    let depth = batch.weights.inputs / S::PER_LANE;
    let (row, outputs) = (batch.weights.input_floats(), batch.weights.padded_outputs());
    let panel = COLUMNS * S::LANES;
    let mut ahead = Prefetcher::new(ahead, POINTS * (outputs / panel) * batch.count.div_ceil(ROWS));
    for point in 0..POINTS {
        let filled = point * batch.sizes.inputs + batch.count * row;
        let missing = batch.count.next_multiple_of(ROWS) - batch.count;
        // Stale rows would give right results too, but stale numbers end as subnormals, which are slow.
        buffers.inputs[filled..filled + missing * row].fill(0.0);
        for p in 0..outputs / panel {
            let right_at = ((p * POINTS + point_row) * POINTS + point) * depth * panel;
            let b = Operand { data: batch.weights.packed.as_slice(), at: right_at, row: 0, step: panel };
            for tile in (0..batch.count).step_by(ROWS) {
                ahead.fetch();
                let at = point * batch.sizes.inputs + tile * row;
                let a = Operand { data: buffers.inputs, at, row, step: 1 };
                // SAFETY: both buffers have room for `MOST_ROWS` tiles more than the batch has (what is read
                // and written there is never used); the weights hold 36 points for each of the panels.
                unsafe {
                    let sums = multiply_add::<S, ROWS, COLUMNS>(simd, zero_tile(simd), depth, a, b);
                    let to = point * batch.sizes.products + tile * outputs + p * panel;
                    store_tile(simd, &sums, buffers.products, to, outputs);
                }
            }
        }
    }
}

/// Where an output of row `y`, column `x`, group `g` and channel `c` lies in its tile row's slice:
/// `group(g) + y·row + x·column + c`.
#[derive(Clone, Copy)]
struct Placement {
    channels: usize,
    column: usize,
    row: usize,
    shuffled_row: usize,
}

impl Placement {
    fn new(order: Order, width: usize, outputs: usize) -> Self {
        match order {
            Order::Plain => {
                let row = width * outputs;
                Self { channels: outputs, column: outputs, row, shuffled_row: row }
            }
            Order::Shuffled => {
                let channels = outputs / 4;
                let shuffled_row = 2 * width * channels;
                Self { channels, column: 2 * channels, row: 2 * shuffled_row, shuffled_row }
            }
        }
    }

    fn group(&self, group: usize) -> usize {
        (group / 2) * self.shuffled_row + (group % 2) * self.channels
    }
}
