//! Conditions and features to filtered features, a few rows per task.

use rayon::prelude::*;

use super::tile_pixels;
use crate::kernels::convolution::BLOCK_ROWS;
use crate::kernels::gemm::{
    MOST_ROWS, Operand, Tile, multiply_add, panel_vectors, unrolled, with_register_tile,
};
use crate::kernels::prefetch::Prefetcher;
use crate::kernels::rows::Rows;
use crate::kernels::scratch::{AlignedBuffer, Scratch, lend, whole_lines};
use crate::kernels::shape::Shape;
use crate::kernels::simd::{Isa, Kernel, Simd, put_factor};

/// The filters' weights, packed, ready to be applied any number of times.
pub struct DynamicFilter {
    pub(super) isa: Isa,
    pub(super) channels: usize,
    /// Channels filled up to whole panels.
    pub(super) padded: usize,
    pub(super) size: usize,
    pub(super) slope: f32,
    pub(super) vectors: usize,
    /// Taps whose filters one register tile holds.
    taps_together: usize,
    /// `[group of taps][panel][input][tap of the group][channel of the panel]`; in bfloat16 two inputs share a place.
    pub(super) packed: AlignedBuffer,
    pub(super) bias: AlignedBuffer,
}

impl DynamicFilter {
    /// Packs PyTorch's weights `[channels·size², channels, 1, 1]` and bias `[channels·size²]`, output
    /// `c·size² + dy·size + dx`, and the slope of the filters' PReLU.
    ///
    /// # Panics
    /// When the size is even or above 15, or the lengths do not fit.
    pub fn new(isa: Isa, size: usize, weight: &[f32], bias: &[f32], slope: f32) -> Self {
        assert!(size % 2 == 1 && size <= MOST_TAPS, "filters of {size} × {size}");
        let taps = size * size;
        let channels = bias.len() / taps;
        assert!(channels > 0 && channels * taps == bias.len(), "{} biases for size {size}", bias.len());
        assert_eq!(weight.len(), taps * channels * channels, "weights for {channels} channels, size {size}");
        let isa = isa.for_sums_over(channels);
        let vectors = panel_vectors(isa.lanes(), channels);
        let panel = vectors * isa.lanes();
        let padded = channels.next_multiple_of(panel);
        let (per_lane, depth) = (isa.per_lane(), channels / isa.per_lane());
        // Panels of two vectors leave room for a second tap: outputs are read and written half as often.
        let taps_together = if (isa.lanes(), vectors) == (16, 2) { 2 } else { 1 };
        let mut packed = AlignedBuffer::zeros(taps * padded * depth);
        let mut bias_buffer = AlignedBuffer::zeros(taps * padded);
        let groups = packed.as_mut_slice().par_chunks_mut(taps_together * padded * depth);
        groups.zip(bias_buffer.as_mut_slice().par_chunks_mut(taps_together * padded)).enumerate().for_each(
            |(group, (to, to_bias))| {
                let count = to_bias.len() / padded;
                for (c, t) in (0..channels).flat_map(|c| (0..count).map(move |t| (c, t))) {
                    let output = c * taps + group * taps_together + t;
                    to_bias[t * padded + c] = bias[output];
                    let from = &weight[output * channels..][..channels];
                    let first = (c / panel * depth * count + t) * panel + c % panel;
                    let steps = to[first..].iter_mut().step_by(count * panel);
                    for (step, from) in steps.zip(from.chunks(per_lane)) {
                        for (index, number) in from.iter().enumerate() {
                            put_factor(step, per_lane, index, *number);
                        }
                    }
                }
            },
        );
        Self { isa, channels, padded, size, slope, vectors, taps_together, packed, bias: bias_buffer }
    }

    /// How many taps the group that begins with `tap` has.
    fn group_len(&self, tap: usize) -> usize {
        self.taps_together.min(self.size * self.size - tap)
    }

    /// The weights of a tap for the channels of a panel from `channel` on: a row for each input.
    pub(super) fn weights(&self, tap: usize, channel: usize) -> Operand<'_> {
        let panel = self.vectors * self.isa.lanes();
        let first = tap - tap % self.taps_together;
        let count = self.group_len(first);
        let at = (first * self.padded + channel * count) * self.depth() + (tap - first) * panel;
        Operand { data: self.packed.as_slice(), at, row: 0, step: count * panel }
    }

    /// Floats that a pixel's conditions take as a factor of products.
    pub(super) fn depth(&self) -> usize {
        self.channels / self.isa.per_lane()
    }

    /// Rows and columns of the filters.
    pub(crate) fn size(&self) -> usize {
        self.size
    }

    /// Channels of conditions, features and output.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Filters a batch of images.
    ///
    /// # Shapes
    /// `condition`, `features` and `output` have shape `shape`.
    ///
    /// # Panics
    /// When a slice's length is not that of the shape.
    pub fn forward(&self, condition: &[f32], features: &[f32], shape: Shape, output: &mut [f32]) {
        let lengths = (condition.len(), features.len(), output.len());
        assert_eq!(shape.channels, self.channels, "channels of {shape:?}");
        assert_eq!(lengths, (shape.len(), shape.len(), shape.len()), "floats of {shape:?}");
        if shape.is_empty() {
            return;
        }
        let block_len = BLOCK_ROWS * shape.row_len();
        let mut blocks = Vec::new();
        for (n, image) in output.chunks_mut(shape.image_len()).enumerate() {
            let range = n * shape.image_len()..(n + 1) * shape.image_len();
            let condition = Rows::whole(&condition[range.clone()], shape.height);
            let features = Rows::whole(&features[range], shape.height);
            for (b, output) in image.chunks_mut(block_len).enumerate() {
                blocks.push(FilterBlock { condition, features, first: b * BLOCK_ROWS, output });
            }
        }
        blocks.into_par_iter().for_each(|block| self.compute_block(block));
    }

    /// Computes a block of output rows, on this thread.
    pub(crate) fn compute_block(&self, block: FilterBlock<'_>) {
        self.isa.run_products(FilterRows { filter: self, block });
    }
}

/// Some output rows of one image.
pub(crate) struct FilterBlock<'a> {
    pub(crate) condition: Rows<'a>,
    pub(crate) features: Rows<'a>,
    /// The number of the first row.
    pub(crate) first: usize,
    pub(crate) output: &'a mut [f32],
}

impl FilterBlock<'_> {
    /// What a tile of `pixels` from (row of the block, column) on reads for the first time, and what it writes; nothing
    /// past the last row.
    #[inline(always)]
    fn fresh_runs(&self, filter: &DynamicFilter, (row, first): (usize, usize), pixels: usize) -> [&[f32]; 3] {
        let row_len = self.condition.row_len();
        let Some(output) = self.output.get(row * row_len..(row + 1) * row_len) else { return [&[]; 3] };
        let (y, below) = ((self.first + row).cast_signed(), (filter.size / 2).cast_signed());
        let range = first * filter.channels..((first + pixels) * filter.channels).min(row_len);
        [self.condition.nearest_row(y), self.features.nearest_row(y + below), output]
            .map(|row| &row[range.clone()])
    }
}

/// A block with the filter that is applied to it.
struct FilterRows<'a> {
    filter: &'a DynamicFilter,
    block: FilterBlock<'a>,
}

impl Kernel for FilterRows<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { filter, block } = self;
        let row_len = block.condition.row_len();
        let width = row_len / filter.channels;
        let pixels = tile_pixels(filter.channels);
        let outputs_len = whole_lines((pixels + MOST_ROWS) * filter.padded);
        let mut lent = lend(TileInputs::scratch_len(filter) + outputs_len);
        let mut scratch = lent.scratch();
        let outputs = scratch.take(outputs_len);
        let mut inputs = TileInputs::new(filter, &mut scratch);
        let groups = (filter.size * filter.size).div_ceil(filter.taps_together);
        for row in 0..block.output.len() / row_len {
            for first in (0..width).step_by(pixels) {
                let next = if first + pixels < width { (row, first + pixels) } else { (row + 1, 0) };
                let mut ahead = Prefetcher::new(block.fresh_runs(filter, next, pixels), groups);
                let tile = PixelTile { row: block.first + row, first, pixels: pixels.min(width - first) };
                let view = inputs.view(simd, filter, (block.condition, block.features), tile);
                outputs.fill(0.0);
                for tap in (0..filter.size * filter.size).step_by(filter.taps_together) {
                    let vectors = filter.vectors;
                    ahead.fetch();
                    // SAFETY: the view has room for whole register tiles, the outputs too; groups of two taps have
                    // panels of two vectors.
                    unsafe {
                        if S::LANES == 16 && filter.group_len(tap) == 2 {
                            add_taps::<S, 6, 4, 2>(simd, filter, tap, tile.pixels, &view, outputs);
                        } else {
                            with_register_tile!(
                                S,
                                vectors,
                                add_tap(simd, filter, tap, tile.pixels, &view, outputs)
                            );
                        }
                    }
                }
                let at = row * row_len + first * filter.channels;
                let to = &mut block.output[at..][..tile.pixels * filter.channels];
                let from = outputs.chunks_exact(filter.padded);
                for (to, from) in to.chunks_exact_mut(filter.channels).zip(from) {
                    to.copy_from_slice(&from[..filter.channels]);
                }
            }
        }
    }
}

/// Adds what one tap contributes to the outputs of a tile.
///
/// # Safety
/// As for [`add_taps`] with one tap.
#[inline(always)]
#[expect(
    clippy::too_many_arguments,
    reason = "one inner loop's state; a struct would be taken apart at once"
)]
unsafe fn add_tap<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    filter: &DynamicFilter,
    tap: usize,
    pixels: usize,
    view: &TileView<'_>,
    outputs: &mut [f32],
) {
    // SAFETY: passed on to the caller.
    unsafe { add_taps::<S, ROWS, COLUMNS, 1>(simd, filter, tap, pixels, view, outputs) };
}

/// Adds what `TAPS` taps that follow each other contribute to the outputs of a tile: register tiles of `ROWS` pixels and
/// as many channels of each tap as make `COLUMNS` vectors.
///
/// # Safety
/// View and outputs hold `pixels` rounded up to `ROWS` pixels, of `padded` channels where vectors are read or written.
/// The taps are a group, and `COLUMNS / TAPS` vectors a panel.
#[inline(always)]
#[expect(
    clippy::too_many_arguments,
    reason = "one inner loop's state; a struct would be taken apart at once"
)]
unsafe fn add_taps<S: Simd, const ROWS: usize, const COLUMNS: usize, const TAPS: usize>(
    simd: S,
    filter: &DynamicFilter,
    tap: usize,
    pixels: usize,
    view: &TileView<'_>,
    outputs: &mut [f32],
) {
    let vectors = COLUMNS / TAPS;
    let slope = simd.splat(filter.slope);
    let mut features = [(&[][..], 0); TAPS];
    for (t, features) in features.iter_mut().enumerate() {
        *features = view.shifted_features(filter, tap + t);
    }
    for channel in (0..filter.padded).step_by(vectors * S::LANES) {
        for first in (0..pixels).step_by(ROWS) {
            // SAFETY: as the caller promises.
            unsafe {
                let sums = filter_sums::<S, ROWS, COLUMNS>(simd, filter, view, (tap, channel, first), TAPS);
                unrolled!(12, ROWS, i => unrolled!(4, COLUMNS / TAPS, j => {
                    let c = channel + j * S::LANES;
                    let at = (first + i) * filter.padded + c;
                    let mut output = simd.load(outputs, at);
                    unrolled!(4, TAPS, t => {
                        let sum = sums[i][t * (COLUMNS / TAPS) + j];
                        let (features, features_at) = features[t];
                        let seen = features_at + (first + i) * view.feature_pixel + c;
                        let feature = simd.load(features, seen);
                        output = simd.mul_add(simd.leak(sum, sum, slope), feature, output);
                    });
                    simd.store(outputs, at, output);
                }));
            }
        }
    }
}

/// Computes filters before their PReLU: those of some taps for a register tile of pixels and channels.
///
/// # Safety
/// `place` is (first tap, first channel of a panel, first pixel), and the view holds `ROWS` pixels from there. `taps` is 1,
/// or the taps are a group; `COLUMNS / taps` vectors are a panel.
#[inline(always)]
pub(super) unsafe fn filter_sums<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    filter: &DynamicFilter,
    view: &TileView<'_>,
    place: (usize, usize, usize),
    taps: usize,
) -> Tile<S, ROWS, COLUMNS> {
    let (tap, channel, pixel) = place;
    let depth = filter.channels / S::PER_LANE;
    let at = view.condition_at + pixel * depth;
    let a = Operand { data: view.condition, at, row: depth, step: 1 };
    // SAFETY: bias and weights hold whole panels; the caller promises the conditions.
    unsafe {
        let mut bias = [simd.splat(0.0); COLUMNS];
        for (j, bias) in bias.iter_mut().enumerate() {
            let (t, vector) = (j / (COLUMNS / taps), j % (COLUMNS / taps));
            let at = (tap + t) * filter.padded + channel + vector * S::LANES;
            *bias = simd.load(filter.bias.as_slice(), at);
        }
        let weights = filter.weights(tap, channel);
        multiply_add::<S, ROWS, COLUMNS>(simd, [bias; ROWS], depth, a, weights)
    }
}

/// Some neighbouring pixels of a row.
#[derive(Clone, Copy)]
pub(super) struct PixelTile {
    pub(super) row: usize,
    pub(super) first: usize,
    pub(super) pixels: usize,
}

/// Where a tile's conditions and features can be read: in the image, or in a copy that continues it.
pub(super) struct TileView<'a> {
    /// As a factor of products.
    pub(super) condition: &'a [f32],
    pub(super) condition_at: usize,
    /// The features' rows, one for each row of the filter.
    features: [&'a [f32]; MOST_TAPS],
    features_at: usize,
    /// Distance between pixels of the features.
    pub(super) feature_pixel: usize,
}

/// The largest filter size.
const MOST_TAPS: usize = 15;

impl<'a> TileView<'a> {
    /// The features that one tap sees: the slice and where the tile's first pixel lies in it.
    #[inline(always)]
    pub(super) fn shifted_features(&self, filter: &DynamicFilter, tap: usize) -> (&'a [f32], usize) {
        let (dy, dx) = (tap / filter.size, tap % filter.size);
        (self.features[dy], self.features_at + dx * self.feature_pixel)
    }
}

/// Room for the copies that tiles at the image's borders need.
pub(super) struct TileInputs<'a> {
    condition: &'a mut [f32],
    features: &'a mut [f32],
    feature_row: usize,
}

impl<'a> TileInputs<'a> {
    fn lengths(filter: &DynamicFilter) -> (usize, usize) {
        let pixels = tile_pixels(filter.channels) + MOST_ROWS;
        (whole_lines(pixels * filter.channels), whole_lines((pixels + filter.size - 1) * filter.padded))
    }

    /// Floats of working memory needed.
    pub(super) fn scratch_len(filter: &DynamicFilter) -> usize {
        let (condition, feature_row) = Self::lengths(filter);
        condition + filter.size * feature_row
    }

    pub(super) fn new(filter: &DynamicFilter, scratch: &mut Scratch<'a>) -> Self {
        let (condition, feature_row) = Self::lengths(filter);
        let features = scratch.take(filter.size * feature_row);
        Self { condition: scratch.take(condition), features, feature_row }
    }

    /// Makes a tile's inputs readable for whole register tiles.
    #[inline(always)]
    pub(super) fn view<'b, S: Simd>(
        &'b mut self,
        simd: S,
        filter: &DynamicFilter,
        (condition, features): (Rows<'b>, Rows<'b>),
        tile: PixelTile,
    ) -> TileView<'b> {
        let (channels, half) = (filter.channels, filter.size / 2);
        let width = features.row_len() / channels;
        let whole = tile.pixels.next_multiple_of(MOST_ROWS);
        let feature_row =
            |dy: usize| features.nearest_row((tile.row + dy).cast_signed() - half.cast_signed());
        let is_inside = tile.first >= half && tile.first + whole + half <= width && filter.padded == channels;
        let condition = condition.nearest_row(tile.row.cast_signed());
        let (condition, condition_at) = if is_inside && S::PER_LANE == 1 {
            (condition, tile.first * channels)
        } else {
            let from = &condition[tile.first * channels..][..tile.pixels * channels];
            pack_numbers(simd, from, &mut self.condition[..whole * filter.depth()]);
            (&*self.condition, 0)
        };
        let mut rows = [&[][..]; MOST_TAPS];
        if is_inside {
            (0..filter.size).for_each(|dy| rows[dy] = feature_row(dy));
            return TileView {
                condition,
                condition_at,
                features: rows,
                features_at: (tile.first - half) * channels,
                feature_pixel: channels,
            };
        }
        for dy in 0..filter.size {
            let row = feature_row(dy);
            let to = &mut self.features[dy * self.feature_row..][..(whole + 2 * half) * filter.padded];
            for (x, to) in to.chunks_exact_mut(filter.padded).enumerate() {
                let column = (tile.first + x).saturating_sub(half).min(width - 1);
                to[..channels].copy_from_slice(&row[column * channels..][..channels]);
                to[channels..].fill(0.0);
            }
        }
        for (to, from) in rows.iter_mut().zip(self.features.chunks_exact(self.feature_row)) {
            *to = from;
        }
        TileView { condition, condition_at, features: rows, features_at: 0, feature_pixel: filter.padded }
    }
}

/// Copies numbers as a factor of products, and zeros behind them.
#[inline(always)]
fn pack_numbers<S: Simd>(simd: S, from: &[f32], to: &mut [f32]) {
    let len = from.len() / S::PER_LANE;
    if S::PER_LANE == 1 {
        to[..len].copy_from_slice(from);
    } else {
        assert!(len.is_multiple_of(S::LANES) && len <= to.len(), "{len} floats of whole vectors");
        for at in (0..len).step_by(S::LANES) {
            // SAFETY: `from` is two vectors long for each one of `to`, and the last one begins before `len`.
            unsafe {
                let first = simd.load(from, 2 * at);
                let second = simd.load(from, 2 * at + S::LANES);
                simd.store(to, at, simd.pack(first, second));
            }
        }
    }
    to[len..].fill(0.0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::testing::{Values, assert_close, naive};

    /// Compares with the sum written down, for conditions and weights that `prepare` has changed.
    fn check(isa: Isa, size: usize, shape: Shape, prepare: impl Fn(&mut f32)) {
        let (channels, taps) = (shape.channels, size * size);
        let mut values = Values::new(5);
        let mut weight = values.take_scaled(taps * channels * channels, channels);
        let bias = values.take(taps * channels);
        let (mut condition, features) = (values.take(shape.len()), values.take(shape.len()));
        weight.iter_mut().chain(&mut condition).for_each(prepare);
        let filter = DynamicFilter::new(isa, size, &weight, &bias, -0.3);
        let mut output = vec![f32::NAN; shape.len()];
        filter.forward(&condition, &features, shape, &mut output);
        let head = naive::FilterHead { size, weight: &weight, bias: &bias, slope: -0.3 };
        let expected = head.apply(&condition, &features, shape);
        assert_close(&output, &expected, 3e-6, &format!("{} size {size} {shape:?}", isa.name()));
    }

    /// Conditions and weights of 8 bits: nothing is rounded, and what is left is the order of the sums.
    #[test]
    fn products_in_bfloat16_of_numbers_that_it_has_are_exact() {
        for isa in Isa::available().into_iter().filter_map(Isa::with_bf16_products) {
            for (size, channels) in [(5, 32), (3, 64), (3, 128), (3, 48)] {
                for (height, width) in [(1, 1), (3, 2), (2, 130)] {
                    let shape = Shape::new(1, height, width, channels);
                    check(isa, size, shape, |value| *value = (*value * 32.0).round() / 32.0);
                }
            }
        }
    }

    #[test]
    fn agrees_with_the_equation_for_every_size() {
        for isa in Isa::available() {
            for (size, channels) in
                [(3, 1), (5, 4), (5, 5), (7, 8), (5, 16), (9, 20), (5, 32), (3, 64), (3, 128)]
            {
                for (height, width) in [(1, 1), (3, 2), (5, 61), (6, 110)] {
                    if height * width * channels <= 20_000 {
                        check(isa, size, Shape::new(2, height, width, channels), |_| ());
                    }
                }
            }
        }
    }
}
