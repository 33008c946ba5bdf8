//! Inputs and transformed weights to outputs, one batch of tiles at a time.
//!
//! # Layout
//! Transformed weights are `[panel][point 6×6][input][output of the panel]`, a panel being as many outputs as
//! a register tile has columns, so that a product reads them in one run. Transformed inputs and products lie
//! as `[point][tile][channel]`; the 36 parts are a cache line longer than needed, because strides of a power
//! of two make the streams of a transform fall on the same cache sets.
//!
//! # Sizes
//! Both transforms of a tile stay in registers and the top of the stack, one vector of channels at a time.
//! What lies between them takes `36 · tiles · channels` floats: 24 tiles at 32 channels 110 KB, twice, which
//! the second-level cache holds beside the weights. At 128 channels the weights (2.4 MB) exceed that cache,
//! and 48 tiles reuse each of them often enough. Batches count tiles along all rows of a task, so that narrow
//! images fill them too.
//!
//! # Channels that do not fill vectors
//! Transformed inputs and products hold whole vectors of channels for each tile, filled up with zeros: only
//! what is read from the inputs and written to the outputs is cut off. The products' depth is the number of
//! inputs that there are.

use rayon::prelude::*;

use super::transform;
use super::{POINTS, TILE};
use crate::kernels::finish::{Finish, Finisher, with_finisher};
use crate::kernels::gemm::{
    MOST_ROWS, Operand, multiply_add, panel_vectors, store_tile, with_register_tile, zero_tile,
};
use crate::kernels::scratch::{AlignedBuffer, lend, whole_lines};
use crate::kernels::simd::{Extent as _, Isa, Kernel, Simd, for_each_vector, load_strided, store_strided};

/// Weights of a 3 × 3 convolution after G·G ᵀ, in the order in which the products read them.
pub(crate) struct Weights {
    pub(crate) isa: Isa,
    pub(crate) inputs: usize,
    pub(crate) outputs: usize,
    /// Vectors per panel.
    vectors: usize,
    packed: AlignedBuffer,
    bias: AlignedBuffer,
}

impl Weights {
    /// Inputs of a tile in the working memory: whole vectors.
    fn padded_inputs(&self) -> usize {
        self.inputs.next_multiple_of(self.isa.lanes())
    }

    /// Outputs of a tile in the working memory: whole panels.
    fn padded_outputs(&self) -> usize {
        self.outputs.next_multiple_of(self.vectors * self.isa.lanes())
    }
}

/// Tells whether this method is the fastest: a transform costs as much for a vector with few channels as for a
/// full one, so that fewer than half a vector on either side are left to the direct sums.
pub(crate) fn applies(isa: Isa, inputs: usize, outputs: usize) -> bool {
    inputs.min(outputs) * 2 >= isa.lanes()
}

/// How many tiles a batch has at most.
fn most_tiles(channels: usize) -> usize {
    match channels {
        0..=96 => 24,
        _ => 48,
    }
}

/// How many tiles make a batch of a task of `tiles`: equal shares, but whole register tiles.
fn tiles_per_batch(weights: &Weights, tiles: usize) -> usize {
    let most = most_tiles(weights.inputs.max(weights.outputs));
    tiles.div_ceil(tiles.div_ceil(most)).next_multiple_of(MOST_ROWS)
}

/// How many rows of tiles of an image `width` wide one task should be given.
pub(crate) fn rows_per_task(weights: &Weights, width: usize) -> usize {
    (most_tiles(weights.inputs.max(weights.outputs)) / width.div_ceil(TILE)).max(1)
}

impl Weights {
    /// Transforms the 3 × 3 weights that `weight(output, input)` gives, row by row.
    pub(crate) fn pack(
        isa: Isa,
        (inputs, outputs): (usize, usize),
        weight: impl Fn(usize, usize) -> [f32; 9] + Sync,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        let vectors = panel_vectors(isa.lanes(), outputs);
        let panel = vectors * isa.lanes();
        let padded = outputs.next_multiple_of(panel);
        let mut packed = AlignedBuffer::zeros(POINTS * POINTS * inputs * padded);
        let shares = packed.as_mut_slice().par_chunks_mut(PACKED_ROWS * POINTS * inputs * panel);
        shares.enumerate().for_each(|(share, to)| {
            let (p, first) = (share * PACKED_ROWS / POINTS, share * PACKED_ROWS % POINTS);
            // Lanes past the last output repeat it: what they compute is not stored.
            let weight = |lane: usize, input: usize| weight((p * panel + lane).min(outputs - 1), input);
            isa.run(PackPanel { to, inputs, panel, first, weight });
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
        if self.panel.is_multiple_of(16) { self.pack::<16>() } else { self.pack::<4>() }
    }
}

impl<W: Fn(usize, usize) -> [f32; 9]> PackPanel<'_, W> {
    /// Computes G·g·Gᵀ for `TOGETHER` outputs at once.
    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "the loop transposes: an output becomes a lane of each tap"
    )]
    fn pack<const TOGETHER: usize>(self) {
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
                        let at = ((row * POINTS + point) * self.inputs + input) * self.panel + lane;
                        let to = &mut self.to[at..at + TOGETHER];
                        #[expect(
                            clippy::cast_possible_truncation,
                            reason = "rounds to the kernels' precision"
                        )]
                        to.iter_mut().zip(values).for_each(|(to, value)| *to = *value as f32);
                    }
                }
            }
        }
    }
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
    pub(crate) finish: Finish<'a>,
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
        let batch = tiles_per_batch(weights, tiles);
        let sizes = Sizes::new(weights, batch, width);
        let mut lent = lend(sizes.total());
        let mut scratch = lent.scratch();
        let mut buffers = Buffers {
            inputs: scratch.take(POINTS * POINTS * sizes.inputs),
            products: scratch.take(POINTS * POINTS * sizes.products),
            patch: scratch.take(sizes.patch),
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

/// Distances between the 36 parts of the first two buffers, and the lengths of the others, in floats.
#[derive(Clone, Copy)]
struct Sizes {
    inputs: usize,
    products: usize,
    patch: usize,
    zeros: usize,
}

impl Sizes {
    fn new(weights: &Weights, tiles: usize, width: usize) -> Self {
        const SKEW: usize = 16;
        let padded_tiles = tiles + MOST_ROWS;
        Self {
            inputs: whole_lines(padded_tiles * weights.padded_inputs()) + SKEW,
            products: whole_lines(padded_tiles * weights.padded_outputs()) + SKEW,
            patch: whole_lines(POINTS * POINTS * weights.inputs),
            zeros: whole_lines(width * weights.inputs),
        }
    }

    fn total(&self) -> usize {
        POINTS * POINTS * (self.inputs + self.products) + self.patch + self.zeros
    }
}

/// What lies between the steps.
struct Buffers<'a> {
    /// Transformed inputs, `[point][tile][input]`.
    inputs: &'a mut [f32],
    /// Their products with the weights, `[point][tile][output]`.
    products: &'a mut [f32],
    /// The inputs of a tile at the image's border, `[row][column][input]`.
    patch: &'a mut [f32],
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

/// Where a tile of a batch lies.
#[derive(Clone, Copy)]
struct Position {
    /// Its number within the batch.
    tile: usize,
    /// The row of tiles.
    row: usize,
    /// Its number within the row.
    across: usize,
}

impl Batch<'_> {
    /// Computes the outputs of the batch.
    ///
    /// # Safety
    /// The buffers have the sizes of `self.sizes`, made for at least as many tiles.
    #[inline(always)]
    unsafe fn compute<S: Simd>(self, simd: S, rows: &mut [TileRow<'_>], buffers: &mut Buffers<'_>) {
        // SAFETY: the caller's promise covers each step.
        unsafe {
            for tile in 0..self.count {
                let place = self.position(tile);
                self.transform_inputs(simd, &rows[place.row], place, buffers);
            }
            with_register_tile!(S, self.weights.vectors, multiply(simd, &self, buffers));
            for tile in 0..self.count {
                let place = self.position(tile);
                let TileRow { output, finish, .. } = &mut rows[place.row];
                let products = &*buffers.products;
                with_finisher!(*finish, f => self.invert(simd, f, place, products, output));
            }
        }
    }

    #[inline(always)]
    fn position(self, tile: usize) -> Position {
        Position { tile, row: (self.first + tile) / self.across, across: (self.first + tile) % self.across }
    }

    /// Bᵀ·d·B of one tile, all channels.
    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "the loop transposes: a column becomes an entry of each row"
    )]
    unsafe fn transform_inputs<S: Simd>(
        self,
        simd: S,
        row: &TileRow<'_>,
        Position { tile, across, .. }: Position,
        buffers: &mut Buffers<'_>,
    ) {
        let (channels, padded) = (self.weights.inputs, self.weights.padded_inputs());
        let Buffers { inputs, patch, zeros, .. } = buffers;
        let rows = row.inputs.map(|row| row.unwrap_or(zeros));
        // The tile's six columns begin one before its outputs.
        let inside = across > 0 && across * TILE + POINTS - 1 <= self.width;
        let (rows, start) = if inside {
            (rows, (across * TILE - 1) * channels)
        } else {
            self.fill_patch(&rows, across, patch);
            let row_len = POINTS * channels;
            (std::array::from_fn(|y| &patch[y * row_len..][..row_len]), 0)
        };
        for_each_vector!(S, channels, (c, extent) => {
            // SAFETY: six columns from `start` lie within each row; the buffer holds 36 parts with room for
            // the whole vectors of all tiles of the batch.
            unsafe {
                let mut d = [[simd.splat(0.0); POINTS]; POINTS];
                for x in 0..POINTS {
                    let mut column = [simd.splat(0.0); POINTS];
                    for (vector, row) in column.iter_mut().zip(&rows) {
                        *vector = extent.load(simd, row, start + x * channels + c);
                    }
                    let column = transform::input(simd, column);
                    for y in 0..POINTS {
                        d[y][x] = column[y];
                    }
                }
                for (y, row) in d.into_iter().enumerate() {
                    let v = transform::input(simd, row);
                    let to = y * POINTS * self.sizes.inputs + tile * padded + c;
                    store_strided(simd, inputs, to, self.sizes.inputs, &v);
                }
            }
        });
    }

    /// Copies the inputs of a tile at the border, with zeros where the image has none.
    fn fill_patch(self, rows: &[&[f32]; POINTS], across: usize, patch: &mut [f32]) {
        let channels = self.weights.inputs;
        let before = usize::from(across == 0);
        let start = across * TILE + before - 1;
        let columns = (POINTS - before).min(self.width - start);
        patch.fill(0.0);
        for (row, patch) in rows.iter().zip(patch.chunks_exact_mut(POINTS * channels)) {
            let from = &row[start * channels..][..columns * channels];
            patch[before * channels..][..from.len()].copy_from_slice(from);
        }
    }

    /// Aᵀ·m·A of one tile, then bias and [`Finish`], to where the output lies.
    #[inline(always)]
    #[expect(
        clippy::needless_range_loop,
        reason = "the loop transposes: a column becomes an entry of each row"
    )]
    #[expect(
        clippy::too_many_arguments,
        reason = "one inner loop's state; a struct would be taken apart at once"
    )]
    unsafe fn invert<S: Simd>(
        self,
        simd: S,
        finisher: impl Finisher<S>,
        Position { tile, across, .. }: Position,
        products: &[f32],
        output: &mut [f32],
    ) {
        let Self { place, weights, .. } = self;
        let rows = output.len() / (self.width * weights.outputs);
        let columns = self.width - across * TILE;
        let bias = weights.bias.as_slice();
        for_each_vector!(S, weights.outputs, (channel, extent) => {
            let at = place.group(channel / place.channels)
                + across * TILE * place.column
                + channel % place.channels;
            // SAFETY: `products` holds 36 parts of at least as many tiles as the batch has; row `k < rows` and
            // column `x < columns` of the tile are in the output, with the extent's channels from this one on,
            // and the finisher's tensor is laid out like the output.
            unsafe {
                let b = simd.load(bias, channel);
                let mut m = [[simd.splat(0.0); POINTS]; TILE];
                for x in 0..POINTS {
                    let from = x * self.sizes.products + tile * weights.padded_outputs() + channel;
                    let column = load_strided(simd, products, from, POINTS * self.sizes.products);
                    let column = transform::output(simd, column);
                    for k in 0..TILE {
                        m[k][x] = column[k];
                    }
                }
                for (k, row) in m.into_iter().enumerate() {
                    if k < rows {
                        for (x, value) in transform::output(simd, row).into_iter().enumerate() {
                            if x < columns {
                                let at = at + k * place.row + x * place.column;
                                let sum = simd.add(value, b);
                                extent.store(simd, output, at, finisher.vector(simd, extent, sum, at));
                            }
                        }
                    }
                }
            }
        });
    }
}

/// The 36 products `[tile, input] · [input, output]`.
#[inline(always)]
unsafe fn multiply<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    batch: &Batch<'_>,
    buffers: &mut Buffers<'_>,
) {
    let inputs = batch.weights.inputs;
    let (padded, outputs) = (batch.weights.padded_inputs(), batch.weights.padded_outputs());
    let panel = COLUMNS * S::LANES;
    for point in 0..POINTS * POINTS {
        for p in 0..outputs / panel {
            let right_at = (p * POINTS * POINTS + point) * inputs * panel;
            let b = Operand { data: batch.weights.packed.as_slice(), at: right_at, row: 0, step: panel };
            let filled = point * batch.sizes.inputs + batch.count * padded;
            let missing = batch.count.next_multiple_of(ROWS) - batch.count;
            // Stale rows would give right results too, but stale numbers end as subnormals, which are slow.
            buffers.inputs[filled..filled + missing * padded].fill(0.0);
            for tile in (0..batch.count).step_by(ROWS) {
                let at = point * batch.sizes.inputs + tile * padded;
                let a = Operand { data: buffers.inputs, at, row: padded, step: 1 };
                // SAFETY: both buffers have room for `MOST_ROWS` tiles more than the batch has (what is read
                // and written there is never used); the weights hold 36 points for each of the panels.
                unsafe {
                    let sums = multiply_add::<S, ROWS, COLUMNS>(simd, zero_tile(simd), inputs, a, b);
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
