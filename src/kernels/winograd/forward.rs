//! Inputs and transformed weights to outputs, one strip of tiles at a time.
//!
//! # Layout
//! Transformed weights are `[panel][point 6×6][input][output of the panel]`, a panel being as many outputs as
//! a register tile has columns, so that a product reads them in one run. Between the steps values lie as
//! `[point][tile row][column][channel]`, then `[point][tile][channel]`; rows of buffers are a cache line
//! longer than needed, because strides of a power of two make the six streams of a transform fall on the
//! same cache sets.
//!
//! # Sizes
//! A strip is [`strip_tiles`] tiles. At 32 channels 24 tiles keep each product's operands in the first-level
//! cache; at 128 the transformed weights (2.4 MB) no longer fit the second level, and 54 tiles (nine register
//! tiles of six rows) reuse each of them often enough. Images narrower than a strip put several rows of tiles
//! into one.

use rayon::prelude::*;

use super::transform::{self, G};
use super::{POINTS, TILE};
use crate::kernels::finish::{Finish, Finisher, with_finisher};
use crate::kernels::gemm::{
    MOST_ROWS, Operand, multiply_add, panel_vectors, store_tile, with_register_tile, zero_tile,
};
use crate::kernels::scratch::{AlignedBuffer, lend, whole_lines};
use crate::kernels::simd::{Isa, Kernel, Simd, load_strided, store_strided};

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

/// Tells whether this method applies: channels fill whole vectors on both sides.
pub(crate) fn applies(isa: Isa, inputs: usize, outputs: usize) -> bool {
    inputs.is_multiple_of(isa.lanes()) && outputs.is_multiple_of(isa.lanes())
}

/// How many tiles make a strip.
fn strip_tiles(channels: usize) -> usize {
    match channels {
        0..=48 => 24,
        49..=96 => 36,
        _ => 54,
    }
}

/// How many rows of tiles of an image `width` wide one task should be given.
pub(crate) fn rows_per_task(weights: &Weights, width: usize) -> usize {
    (strip_tiles(weights.inputs.max(weights.outputs)) / width.div_ceil(TILE)).max(1)
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
        let mut packed = AlignedBuffer::zeros(POINTS * POINTS * inputs * outputs);
        let panels = packed.as_mut_slice().par_chunks_mut(POINTS * POINTS * inputs * panel);
        panels.enumerate().for_each(|(p, to)| {
            let weight = |lane: usize, input: usize| weight(p * panel + lane, input);
            isa.run(PackPanel { to, inputs, panel, weight });
        });
        let mut bias_buffer = AlignedBuffer::zeros(outputs);
        bias_buffer.as_mut_slice().iter_mut().enumerate().for_each(|(o, b)| *b = bias(o));
        Self { isa, inputs, outputs, vectors, packed, bias: bias_buffer }
    }
}

/// Transforms the weights of one panel.
struct PackPanel<'a, W> {
    to: &'a mut [f32],
    inputs: usize,
    panel: usize,
    weight: W,
}

/// Outputs transformed together; divides every panel.
const PACKED_TOGETHER: usize = 4;

impl<W: Fn(usize, usize) -> [f32; 9]> Kernel for PackPanel<'_, W> {
    type Output = ();

    // In f64, so that the transform adds no error to the weights but their rounding to f32.
    #[inline(always)]
    fn run<S: Simd>(self, _simd: S) {
        for lane in (0..self.panel).step_by(PACKED_TOGETHER) {
            for input in 0..self.inputs {
                let mut g = [[0.0f64; PACKED_TOGETHER]; 9];
                for together in 0..PACKED_TOGETHER {
                    let weight = (self.weight)(lane + together, input);
                    g.iter_mut().zip(weight).for_each(|(g, tap)| g[together] = f64::from(tap));
                }
                let transformed = weight_transform(&g);
                for (point, values) in transformed.iter().enumerate() {
                    let at = (point * self.inputs + input) * self.panel + lane;
                    #[expect(clippy::cast_possible_truncation, reason = "rounds to the kernels' precision")]
                    (0..PACKED_TOGETHER).for_each(|t| self.to[at + t] = values[t] as f32);
                }
            }
        }
    }
}

/// Computes G·g·Gᵀ for several weights at once.
#[inline(always)]
fn weight_transform(g: &[[f64; PACKED_TOGETHER]; 9]) -> [[f64; PACKED_TOGETHER]; POINTS * POINTS] {
    let mut columns = [[[0.0; PACKED_TOGETHER]; 3]; POINTS];
    for (row, of_g) in columns.iter_mut().zip(G) {
        for (x, sum) in row.iter_mut().enumerate() {
            for (y, factor) in of_g.into_iter().enumerate() {
                (0..PACKED_TOGETHER).for_each(|t| sum[t] += factor * g[y * 3 + x][t]);
            }
        }
    }
    let mut result = [[0.0; PACKED_TOGETHER]; POINTS * POINTS];
    for (point, sum) in result.iter_mut().enumerate() {
        for (x, factor) in G[point % POINTS].into_iter().enumerate() {
            (0..PACKED_TOGETHER).for_each(|t| sum[t] += factor * columns[point / POINTS][x][t]);
        }
    }
    result
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
        let tiles_across = width.div_ceil(TILE);
        let most = (strip_tiles(weights.inputs.max(weights.outputs)) / rows.len()).clamp(1, tiles_across);
        // Strips of equal length: a short one at the end would waste most of a register tile.
        let length = tiles_across.div_ceil(tiles_across.div_ceil(most));
        let sizes = Sizes::new(weights, rows.len(), length);
        let mut lent = lend(sizes.total());
        let mut scratch = lent.scratch();
        let mut buffers = Buffers {
            vertical: scratch.take(POINTS * sizes.vertical),
            inputs: scratch.take(POINTS * sizes.inputs),
            products: scratch.take(POINTS * sizes.products),
            sums: scratch.take(POINTS * sizes.sums),
            zeros: scratch.take(sizes.zeros),
        };
        buffers.zeros.fill(0.0);
        for first in (0..tiles_across).step_by(length) {
            let tiles = length.min(tiles_across - first);
            let strip = Strip { weights, width, order, first, tiles, rows: rows.len(), sizes };
            // SAFETY: the buffers have the sizes that `Sizes` gives for strips of up to `length` tiles.
            unsafe { strip.compute(simd, rows, &mut buffers) };
        }
    }
}

/// Distances between the six parts of each buffer, in floats.
#[derive(Clone, Copy)]
struct Sizes {
    vertical_row: usize,
    vertical: usize,
    inputs: usize,
    products: usize,
    sums_row: usize,
    sums: usize,
    zeros: usize,
}

impl Sizes {
    fn new(weights: &Weights, rows: usize, tiles: usize) -> Self {
        const SKEW: usize = 16;
        let columns = tiles * TILE + POINTS - TILE;
        let vertical_row = whole_lines(columns * weights.inputs) + SKEW;
        let sums_row = whole_lines(tiles * TILE * weights.outputs) + SKEW;
        let padded_tiles = rows * tiles + MOST_ROWS;
        Self {
            vertical_row,
            vertical: rows * vertical_row,
            inputs: whole_lines(padded_tiles * weights.inputs) + SKEW,
            products: whole_lines(padded_tiles * weights.outputs) + SKEW,
            sums_row,
            sums: rows * sums_row,
            zeros: whole_lines(columns * weights.inputs),
        }
    }

    fn total(&self) -> usize {
        POINTS * (self.vertical + self.inputs + self.products + self.sums) + self.zeros
    }
}

/// What lies between the steps; each but `zeros` in six parts.
struct Buffers<'a> {
    vertical: &'a mut [f32],
    inputs: &'a mut [f32],
    products: &'a mut [f32],
    sums: &'a mut [f32],
    zeros: &'a mut [f32],
}

/// One strip of tiles.
#[derive(Clone, Copy)]
struct Strip<'a> {
    weights: &'a Weights,
    width: usize,
    order: Order,
    /// The first tile's number within its row.
    first: usize,
    /// Tiles per row.
    tiles: usize,
    /// Rows of tiles.
    rows: usize,
    sizes: Sizes,
}

impl Strip<'_> {
    /// Computes the outputs of the strip.
    ///
    /// # Safety
    /// The buffers have the sizes of `self.sizes`, made for at least as many tiles and rows.
    #[inline(always)]
    unsafe fn compute<S: Simd>(self, simd: S, rows: &mut [TileRow<'_>], buffers: &mut Buffers<'_>) {
        // SAFETY: the caller's promise covers each step.
        unsafe {
            for (q, row) in rows.iter().enumerate() {
                self.transform_columns(simd, q, row, buffers);
            }
            let vectors = self.weights.vectors;
            for point_row in 0..POINTS {
                self.transform_rows(simd, point_row, buffers);
                with_register_tile!(S, vectors, multiply(simd, &self, point_row, buffers));
                self.invert_rows(simd, point_row, buffers);
            }
            for (q, row) in rows.iter_mut().enumerate() {
                let output = &mut *row.output;
                with_finisher!(row.finish, f => self.invert_columns(simd, q, f, output, buffers));
            }
        }
    }

    /// Step 1, vertical: Bᵀ over six input rows, for every column that the strip's tiles see.
    #[inline(always)]
    unsafe fn transform_columns<S: Simd>(
        self,
        simd: S,
        q: usize,
        row: &TileRow<'_>,
        buffers: &mut Buffers<'_>,
    ) {
        let channels = self.weights.inputs;
        let columns = self.tiles * TILE + POINTS - TILE;
        // Column 0 of the buffer is image column 4·first − 1.
        let before = usize::from(self.first == 0);
        let until = columns.min(self.width + 1 - self.first * TILE);
        let len = (until - before) * channels;
        let start = (self.first * TILE + before - 1) * channels;
        let rows = row.inputs.map(|row| row.map_or(&buffers.zeros[..len], |row| &row[start..start + len]));
        let sizes = self.sizes;
        for point in 0..POINTS {
            let at = point * sizes.vertical + q * sizes.vertical_row;
            buffers.vertical[at..at + before * channels].fill(0.0);
            buffers.vertical[at + until * channels..at + columns * channels].fill(0.0);
        }
        let to = q * sizes.vertical_row + before * channels;
        for at in (0..len).step_by(S::LANES) {
            // SAFETY: `len` is a multiple of the vector (the channels are), each row slice is `len` long, and
            // the buffer's row holds `columns · channels` floats from `q · vertical_row`.
            unsafe {
                let mut d = [simd.splat(0.0); POINTS];
                for (vector, row) in d.iter_mut().zip(&rows) {
                    *vector = simd.load(row, at);
                }
                let v = transform::input(simd, d);
                store_strided(simd, buffers.vertical, to + at, sizes.vertical, &v);
            }
        }
    }

    /// Step 2, horizontal: Bᵀ over six columns, giving the left factors of one row of points.
    #[inline(always)]
    unsafe fn transform_rows<S: Simd>(self, simd: S, point_row: usize, buffers: &mut Buffers<'_>) {
        let channels = self.weights.inputs;
        for q in 0..self.rows {
            let from = point_row * self.sizes.vertical + q * self.sizes.vertical_row;
            for tile in 0..self.tiles {
                let (from, to) = (from + tile * TILE * channels, (q * self.tiles + tile) * channels);
                for c in (0..channels).step_by(S::LANES) {
                    // SAFETY: the tile's six columns lie within the row filled by step 1, and its channels
                    // within the `rows · tiles` tiles that `inputs` has room for.
                    unsafe {
                        let d = load_strided(simd, buffers.vertical, from + c, channels);
                        let v = transform::input(simd, d);
                        store_strided(simd, buffers.inputs, to + c, self.sizes.inputs, &v);
                    }
                }
            }
        }
    }

    /// Step 4, horizontal: Aᵀ over the products of one row of points, six to four columns.
    #[inline(always)]
    unsafe fn invert_rows<S: Simd>(self, simd: S, point_row: usize, buffers: &mut Buffers<'_>) {
        let channels = self.weights.outputs;
        for q in 0..self.rows {
            let to = point_row * self.sizes.sums + q * self.sizes.sums_row;
            for tile in 0..self.tiles {
                let (from, to) = ((q * self.tiles + tile) * channels, to + tile * TILE * channels);
                for c in (0..channels).step_by(S::LANES) {
                    // SAFETY: step 3 wrote `rows · tiles` tiles; the row of sums has room for four columns
                    // of each.
                    unsafe {
                        let m = load_strided(simd, buffers.products, from + c, self.sizes.products);
                        let y = transform::output(simd, m);
                        store_strided(simd, buffers.sums, to + c, channels, &y);
                    }
                }
            }
        }
    }

    /// Step 5, vertical: Aᵀ over the six rows of sums, then bias and [`Finish`], to where the output lies.
    #[inline(always)]
    #[expect(
        clippy::too_many_arguments,
        reason = "one inner loop's state; a struct would be taken apart at once"
    )]
    unsafe fn invert_columns<S: Simd>(
        self,
        simd: S,
        q: usize,
        finisher: impl Finisher<S>,
        output: &mut [f32],
        buffers: &Buffers<'_>,
    ) {
        let place = Placement::new(self.order, self.width, self.weights.outputs);
        let rows = output.len() / (self.width * self.weights.outputs);
        let columns = (self.tiles * TILE).min(self.width - self.first * TILE);
        let sums = &buffers.sums[q * self.sizes.sums_row..];
        let bias = self.weights.bias.as_slice();
        for group in 0..place.groups {
            let to = place.group(group) + self.first * TILE * place.column;
            for x in 0..columns {
                for c in (0..place.channels).step_by(S::LANES) {
                    let channel = group * place.channels + c;
                    let from = x * self.weights.outputs + channel;
                    let at = to + x * place.column + c;
                    // SAFETY: the sums hold `columns · outputs` floats per point; `at + y · row` is the place
                    // of an output of this image's row `y < rows`, channels filling whole vectors, and the
                    // finisher's tensor is laid out like the output.
                    unsafe {
                        let s = load_strided(simd, sums, from, self.sizes.sums);
                        let b = simd.load(bias, channel);
                        let y = transform::output(simd, s);
                        for (k, value) in y.iter().enumerate() {
                            if k < rows {
                                let at = at + k * place.row;
                                let sum = simd.add(*value, b);
                                simd.store(output, at, finisher.vector(simd, sum, at));
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Step 3: the six products of one row of points, `[tile, input] · [input, output]` each.
#[inline(always)]
unsafe fn multiply<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    strip: &Strip<'_>,
    point_row: usize,
    buffers: &mut Buffers<'_>,
) {
    let (inputs, outputs) = (strip.weights.inputs, strip.weights.outputs);
    let panel = COLUMNS * S::LANES;
    for point in 0..POINTS {
        let left_at = point * strip.sizes.inputs;
        for p in 0..outputs / panel {
            let right_at = (p * POINTS * POINTS + point_row * POINTS + point) * inputs * panel;
            let b = Operand { data: strip.weights.packed.as_slice(), at: right_at, row: 0, step: panel };
            for tile in (0..strip.rows * strip.tiles).step_by(ROWS) {
                let at = left_at + tile * inputs;
                let a = Operand { data: buffers.inputs, at, row: inputs, step: 1 };
                // SAFETY: both buffers have room for `MOST_ROWS` tiles more than the strip has (what is read
                // and written there is never used); the weights hold 36 points for each of the panels.
                unsafe {
                    let sums = multiply_add::<S, ROWS, COLUMNS>(simd, zero_tile(simd), inputs, a, b);
                    let to = point * strip.sizes.products + tile * outputs + p * panel;
                    store_tile(simd, &sums, buffers.products, to, outputs);
                }
            }
        }
    }
}

/// Where an output of row `y`, column `x`, group `g` and channel `c` lies in its tile row's slice:
/// `group(g) + y·row + x·column + c`.
struct Placement {
    groups: usize,
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
                Self { groups: 1, channels: outputs, column: outputs, row, shuffled_row: row }
            }
            Order::Shuffled => {
                let channels = outputs / 4;
                let shuffled_row = 2 * width * channels;
                Self { groups: 4, channels, column: 2 * channels, row: 2 * shuffled_row, shuffled_row }
            }
        }
    }

    fn group(&self, group: usize) -> usize {
        (group / 2) * self.shuffled_row + (group % 2) * self.channels
    }
}
