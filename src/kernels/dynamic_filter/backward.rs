//! The gradients of the dynamic filter, computing its filters once more, tile by tile.
//!
//! # Equation
//! With `p = bias(c, t) + Σᵢ weight(c, t, i) · condition(i)`, `f` the feature that tap t of channel c sees and
//! `d` the gradient of the output: the feature's gradient gets `d · PReLU(p)`; `g = d · f · PReLU′(p)` is the
//! gradient of p, from which the condition gets `Σ g · weight`, the weights `Σ g · condition`, the biases
//! `Σ g`; the slope gets `Σ d · f · min(p, 0)`.
//!
//! # Method
//! For each tile of a row's pixels and each tap: a product gives p, one pass over it the features' gradient
//! and g, two more products the gradients of conditions and weights. Rows are worked on in units that depend
//! on the shape alone; each unit has its own sums, and its own features' gradient with the rows and columns
//! around it that its taps reach. Those are folded back onto the image at the end, in a fixed order, the
//! parts outside of the image onto its nearest pixels: the transpose of replication.

use std::ops::Range;

use rayon::prelude::*;

use super::forward::{DynamicFilter, PixelTile, TileInputs, TileView, filter_sums};
use super::tile_pixels;
use crate::kernels::gemm::{
    MOST_ROWS, MOST_WEIGHT_ROWS, Operand, load_tile, multiply_add, store_tile, with_register_tile,
    with_weight_tile,
};
use crate::kernels::rows::Rows;
use crate::kernels::scratch::{AlignedBuffer, by_chunks, lend, whole_lines, zeros};
use crate::kernels::shape::Shape;
use crate::kernels::simd::{Kernel, Simd};
use crate::kernels::sums;

/// Units that the rows of a batch are cut into, if there are fewer images; also the most sets of sums.
const UNITS: usize = 8;

/// The gradients that a dynamic filter hands back.
#[derive(Debug)]
pub struct DynamicFilterGradients {
    /// Of the conditions.
    pub condition: Vec<f32>,
    /// Of the features.
    pub features: Vec<f32>,
    /// Of the weights, `[channels·size², channels, 1, 1]`.
    pub weight: Vec<f32>,
    /// Of the biases, `[channels·size²]`.
    pub bias: Vec<f32>,
    /// Of the PReLU's slope.
    pub slope: f32,
}

impl DynamicFilter {
    /// Takes the gradient of the output back to everything that it was computed from.
    ///
    /// # Shapes
    /// `condition`, `features` and `gradient` have shape `shape`.
    ///
    /// # Panics
    /// When a slice's length is not that of the shape, or the weights were packed for products in bfloat16.
    pub fn backward(
        &self,
        condition: &[f32],
        features: &[f32],
        shape: Shape,
        gradient: &[f32],
    ) -> DynamicFilterGradients {
        assert_eq!(self.isa.per_lane(), 1, "gradients are made of products of 32-bit floats");
        assert_eq!(shape.channels, self.channels, "channels of {shape:?}");
        let lengths = (condition.len(), features.len(), gradient.len());
        assert_eq!(lengths, (shape.len(), shape.len(), shape.len()), "floats of {shape:?}");
        assert!(!shape.is_empty(), "{shape:?} has no pixels to take a gradient from");
        let transposed = self.transposed_weights();
        let per_image = UNITS.div_ceil(shape.images);
        let unit_rows = shape.height.div_ceil(per_image);
        let mut condition_gradient = zeros(shape.len());
        let mut units = Vec::new();
        for (n, image) in condition_gradient.chunks_mut(shape.image_len()).enumerate() {
            let image_range = n * shape.image_len()..(n + 1) * shape.image_len();
            for (u, to) in image.chunks_mut(unit_rows * shape.row_len()).enumerate() {
                let first = u * unit_rows;
                units.push(Unit {
                    condition: Rows::whole(&condition[image_range.clone()], shape.height),
                    features: Rows::whole(&features[image_range.clone()], shape.height),
                    gradient: Rows::whole(&gradient[image_range.clone()], shape.height),
                    image: n,
                    rows: first..first + to.len() / shape.row_len(),
                    condition_gradient: to,
                    features_gradient: AlignedBuffer::default(),
                });
            }
        }
        let together = units.len().div_ceil(UNITS);
        let work = |units: &mut [Unit<'_>]| {
            let mut sums = Sums::new(self);
            for unit in units {
                self.isa.run(UnitBackward { filter: self, transposed: &transposed, unit, sums: &mut sums });
            }
            sums
        };
        let sums: Vec<Sums> = units.par_chunks_mut(together).map(work).collect();
        let features = self.fold(&units, shape);
        drop(units);
        let (weight, bias, slope) = self.unpack(&sums);
        DynamicFilterGradients { condition: condition_gradient, features, weight, bias, slope }
    }

    /// The weights packed `[tap][panel of inputs][channel][input of the panel]`.
    fn transposed_weights(&self) -> AlignedBuffer {
        let panel = self.vectors * self.isa.lanes();
        let mut transposed = AlignedBuffer::zeros(self.size * self.size * self.padded * self.channels);
        let tap_len = self.padded * self.channels;
        let taps = transposed.as_mut_slice().par_chunks_mut(tap_len).enumerate();
        taps.for_each(|(tap, to)| {
            for c in 0..self.channels {
                let weights = self.weights(tap, c - c % panel);
                let from = weights.data[weights.at + c % panel..].iter().step_by(weights.step);
                for (i, weight) in from.take(self.channels).enumerate() {
                    to[(i / panel * self.channels + c) * panel + i % panel] = *weight;
                }
            }
        });
        transposed
    }

    /// Adds the units' features' gradients, what lies outside of the image to its nearest pixels.
    fn fold(&self, units: &[Unit<'_>], shape: Shape) -> Vec<f32> {
        let half = self.size / 2;
        let layout = Margin::new(self, shape.width);
        let (folded, _) = by_chunks(shape.len(), shape.row_len(), |row, to| {
            let (image, y) = (row / shape.height, row % shape.height);
            for unit in units.iter().filter(|unit| unit.image == image) {
                for local in 0..unit.rows.len() + 2 * half {
                    let nearest = (unit.rows.start + local).saturating_sub(half).min(shape.height - 1);
                    if nearest == y {
                        let from = &unit.features_gradient.as_slice()[local * layout.row_len..];
                        self.fold_row(from, to, shape.width);
                    }
                }
            }
        });
        folded
    }

    fn fold_row(&self, from: &[f32], to: &mut [f32], width: usize) {
        let half = self.size / 2;
        for (x, from) in from.chunks_exact(self.padded).take(width + 2 * half).enumerate() {
            let nearest = x.saturating_sub(half).min(width - 1);
            let to = &mut to[nearest * self.channels..][..self.channels];
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        }
    }

    /// Adds the sets of sums in order and brings them into PyTorch's layout.
    fn unpack(&self, sums: &[Sums]) -> (Vec<f32>, Vec<f32>, f32) {
        let taps = self.size * self.size;
        let channels = self.channels;
        let rows = Sums::weight_rows(self);
        let parts = |of: fn(&Sums) -> &[f32]| sums.iter().map(of).collect::<Vec<_>>();
        let weights = sums::add_up(&parts(|s| s.weight.as_slice()), taps * rows * self.padded);
        let biases = sums::add_up(&parts(|s| s.bias.as_slice()), taps * self.padded);
        let slopes = sums::add_up(&parts(|s| &s.slope), self.padded);
        let weight = |at: usize| {
            let (output, i) = (at / channels, at % channels);
            weights[(output % taps * rows + i) * self.padded + output / taps]
        };
        let bias = |output: usize| biases[output % taps * self.padded + output / taps];
        (
            (0..taps * channels * channels).into_par_iter().map(weight).collect(),
            (0..taps * channels).map(bias).collect(),
            slopes.iter().sum(),
        )
    }
}

/// Some rows of one image, with what is computed for them.
struct Unit<'a> {
    condition: Rows<'a>,
    features: Rows<'a>,
    gradient: Rows<'a>,
    image: usize,
    rows: Range<usize>,
    condition_gradient: &'a mut [f32],
    /// With the margins that taps reach, laid out by [`Margin`].
    features_gradient: AlignedBuffer,
}

/// The layout of a unit's features' gradient: half a filter more on every side, and room for register tiles
/// that reach over the right end.
struct Margin {
    row_len: usize,
}

impl Margin {
    fn new(filter: &DynamicFilter, width: usize) -> Self {
        Self { row_len: whole_lines((width + filter.size - 1 + MOST_ROWS) * filter.padded) }
    }
}

/// Gradients of parameters, summed over some units.
struct Sums {
    /// `[tap][input, filled up][channel, filled up]`.
    weight: AlignedBuffer,
    /// `[tap][channel, filled up]`.
    bias: AlignedBuffer,
    /// `[channel, filled up]`.
    slope: Vec<f32>,
}

impl Sums {
    fn weight_rows(filter: &DynamicFilter) -> usize {
        filter.channels.next_multiple_of(MOST_WEIGHT_ROWS)
    }

    fn new(filter: &DynamicFilter) -> Self {
        let taps = filter.size * filter.size;
        Self {
            weight: AlignedBuffer::zeros(taps * Self::weight_rows(filter) * filter.padded),
            bias: AlignedBuffer::zeros(taps * filter.padded),
            slope: vec![0.0; filter.padded],
        }
    }
}

/// One unit's work.
struct UnitBackward<'a, 'b> {
    filter: &'a DynamicFilter,
    transposed: &'a AlignedBuffer,
    unit: &'a mut Unit<'b>,
    sums: &'a mut Sums,
}

impl Kernel for UnitBackward<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { filter, transposed, unit, sums } = self;
        let (channels, padded) = (filter.channels, filter.padded);
        let width = unit.features.row_len() / channels;
        let margin = Margin::new(filter, width);
        let margin_rows = unit.rows.len() + filter.size - 1;
        unit.features_gradient = AlignedBuffer::zeros(margin_rows * margin.row_len);
        let pixels = tile_pixels(channels);
        let tile_len = whole_lines((pixels + MOST_ROWS) * padded);
        let mut lent = lend(TileInputs::scratch_len(filter) + 3 * tile_len);
        let mut scratch = lent.scratch();
        let output_gradient = scratch.take(tile_len);
        let filter_gradient = scratch.take(tile_len);
        let condition_gradient = scratch.take(tile_len);
        let mut inputs = TileInputs::new(filter, &mut scratch);
        for (r, row) in unit.rows.clone().enumerate() {
            let gradient = unit.gradient.nearest_row(row.cast_signed());
            for first in (0..width).step_by(pixels) {
                let tile = PixelTile { row, first, pixels: pixels.min(width - first) };
                let range = first * channels..(first + tile.pixels) * channels;
                widen(&gradient[range.clone()], channels, output_gradient, padded);
                condition_gradient.fill(0.0);
                let view = inputs.view(simd, filter, (unit.condition, unit.features), tile);
                for tap in 0..filter.size * filter.size {
                    let (dy, dx) = (tap / filter.size, tap % filter.size);
                    let at = (r + dy) * margin.row_len + (first + dx) * padded;
                    let pass = Pass { filter, view: &view, tap, pixels: tile.pixels, at };
                    // SAFETY: tiles have room for whole register tiles; the margin's rows for `width +
                    // size − 1 + MOST_ROWS` pixels; the sums are laid out as each step says.
                    unsafe {
                        let features_gradient = unit.features_gradient.as_mut_slice();
                        let vectors = filter.vectors;
                        with_register_tile!(
                            S,
                            vectors,
                            through_filters(
                                simd,
                                &pass,
                                output_gradient,
                                (features_gradient, &mut *filter_gradient),
                                sums
                            )
                        );
                        with_register_tile!(
                            S,
                            vectors,
                            to_conditions(simd, &pass, filter_gradient, transposed, condition_gradient)
                        );
                        with_weight_tile!(S, padded, to_weights(simd, &pass, filter_gradient, sums));
                    }
                }
                let to = &mut unit.condition_gradient[r * width * channels..][range];
                for (to, from) in to.chunks_exact_mut(channels).zip(condition_gradient.chunks_exact(padded)) {
                    to.copy_from_slice(&from[..channels]);
                }
            }
        }
    }
}

/// Copies pixels to a wider distance, zeros in the gaps and behind.
#[inline(always)]
fn widen(from: &[f32], channels: usize, to: &mut [f32], padded: usize) {
    let pixels = from.len() / channels;
    to[pixels * padded..].fill(0.0);
    for (to, from) in to.chunks_exact_mut(padded).zip(from.chunks_exact(channels)) {
        to[..channels].copy_from_slice(from);
        to[channels..].fill(0.0);
    }
}

/// One tap of one tile.
struct Pass<'a, 'b> {
    filter: &'a DynamicFilter,
    view: &'a TileView<'b>,
    tap: usize,
    pixels: usize,
    /// Where the features that the tap sees begin in the unit's gradient of features.
    at: usize,
}

/// Computes the tap's filters, adds to the features' gradient, and gives the gradient of the filters before
/// their PReLU, whose sums go to bias and slope.
///
/// # Safety
/// The view, both tiles of gradients and, from `pass.at`, the features' gradient hold `pass.pixels` rounded up to `ROWS`
/// pixels, of `padded` channels where vectors are read or written; sums are laid out as [`Sums`] says; panels are `COLUMNS`
/// vectors wide. The output's gradient is zero past the tile's end.
#[inline(always)]
unsafe fn through_filters<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    pass: &Pass<'_, '_>,
    output_gradient: &[f32],
    to: (&mut [f32], &mut [f32]),
    sums: &mut Sums,
) {
    let (filter, view) = (pass.filter, pass.view);
    let (features_gradient, filter_gradient) = to;
    let (slope, zero) = (simd.splat(filter.slope), simd.splat(0.0));
    let (features, features_at) = view.shifted_features(filter, pass.tap);
    for channel in (0..filter.padded).step_by(COLUMNS * S::LANES) {
        for first in (0..pass.pixels).step_by(ROWS) {
            // SAFETY: as the caller promises; pixels past the tile's end have no output gradient, so that
            // they add zeros.
            unsafe {
                let filters =
                    filter_sums::<S, ROWS, COLUMNS>(simd, filter, view, (pass.tap, channel, first), 1);
                let mut bias = [zero; COLUMNS];
                let mut slopes = [zero; COLUMNS];
                for (i, row) in filters.iter().enumerate() {
                    let pixel = first + i;
                    for (j, sum) in row.iter().enumerate() {
                        let c = channel + j * S::LANES;
                        let d = simd.load(output_gradient, pixel * filter.padded + c);
                        let feature = simd.load(features, features_at + pixel * view.feature_pixel + c);
                        let at = pass.at + pixel * filter.padded + c;
                        let before = simd.load(features_gradient, at);
                        let value = simd.leak(*sum, *sum, slope);
                        simd.store(features_gradient, at, simd.mul_add(d, value, before));
                        let product = simd.mul(d, feature);
                        let gradient = simd.leak(*sum, product, slope);
                        simd.store(filter_gradient, pixel * filter.padded + c, gradient);
                        bias[j] = simd.add(bias[j], gradient);
                        let negative = simd.sub(*sum, simd.leak(*sum, *sum, zero));
                        slopes[j] = simd.mul_add(product, negative, slopes[j]);
                    }
                }
                for j in 0..COLUMNS {
                    let c = channel + j * S::LANES;
                    let at = pass.tap * filter.padded + c;
                    let before = simd.load(sums.bias.as_slice(), at);
                    simd.store(sums.bias.as_mut_slice(), at, simd.add(before, bias[j]));
                    let before = simd.load(&sums.slope, c);
                    simd.store(&mut sums.slope, c, simd.add(before, slopes[j]));
                }
            }
        }
    }
}

/// Adds the filters' gradient times the weights to the conditions' gradient.
///
/// # Safety
/// Both tiles of gradients hold `pass.pixels` rounded up to `ROWS` pixels of `padded` channels, `transposed` whole panels of
/// `COLUMNS` vectors for each tap.
#[inline(always)]
unsafe fn to_conditions<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    pass: &Pass<'_, '_>,
    filter_gradient: &[f32],
    transposed: &AlignedBuffer,
    condition_gradient: &mut [f32],
) {
    let (channels, padded) = (pass.filter.channels, pass.filter.padded);
    let panel = COLUMNS * S::LANES;
    for input in (0..padded).step_by(panel) {
        for first in (0..pass.pixels).step_by(ROWS) {
            let a = Operand { data: filter_gradient, at: first * padded, row: padded, step: 1 };
            let at = (pass.tap * padded + input) * channels;
            let b = Operand { data: transposed.as_slice(), at, row: 0, step: panel };
            let to = first * padded + input;
            // SAFETY: tiles have room for whole register tiles, the weights whole panels.
            unsafe {
                let tile = load_tile::<S, ROWS, COLUMNS>(simd, condition_gradient, to, padded);
                let tile = multiply_add::<S, ROWS, COLUMNS>(simd, tile, channels, a, b);
                store_tile(simd, &tile, condition_gradient, to, padded);
            }
        }
    }
}

/// Adds the conditions times the filters' gradient to the weights' gradient.
///
/// # Safety
/// The view holds `pass.pixels` conditions and may be read `ROWS` floats past the last, the gradient as many pixels of
/// `padded` channels; sums are laid out as [`Sums`] says.
#[inline(always)]
unsafe fn to_weights<S: Simd, const ROWS: usize, const COLUMNS: usize>(
    simd: S,
    pass: &Pass<'_, '_>,
    filter_gradient: &[f32],
    sums: &mut Sums,
) {
    let (channels, padded) = (pass.filter.channels, pass.filter.padded);
    let weight_rows = Sums::weight_rows(pass.filter);
    for output in (0..padded).step_by(COLUMNS * S::LANES) {
        for input in (0..channels).step_by(ROWS) {
            let at = pass.view.condition_at + input;
            let a = Operand { data: pass.view.condition, at, row: 1, step: channels };
            let b = Operand { data: filter_gradient, at: output, row: 0, step: padded };
            let to = (pass.tap * weight_rows + input) * padded + output;
            // SAFETY: rows of the sums are filled up to whole register tiles; for channels that are not, the
            // conditions lie in a copy with room behind.
            unsafe {
                let tile = load_tile::<S, ROWS, COLUMNS>(simd, sums.weight.as_slice(), to, padded);
                let tile = multiply_add::<S, ROWS, COLUMNS>(simd, tile, pass.pixels, a, b);
                store_tile(simd, &tile, sums.weight.as_mut_slice(), to, padded);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::Isa;
    use crate::kernels::testing::{Values, check_gradients, dot, naive, on_every_isa};

    #[test]
    fn gradients_agree_with_the_equation() {
        for (size, shape) in [
            (3, Shape::new(1, 1, 1, 1)),
            (5, Shape::new(2, 4, 3, 4)),
            (5, Shape::new(1, 3, 60, 16)),
            (5, Shape::new(1, 4, 5, 32)),
            (7, Shape::new(1, 9, 5, 5)),
            (3, Shape::new(3, 3, 4, 20)),
        ] {
            let channels = shape.channels;
            let taps = size * size;
            let mut values = Values::new(6);
            let tensors = vec![
                values.take(shape.len()),
                values.take(shape.len()),
                values.take_scaled(taps * channels * channels, channels),
                values.take(taps * channels),
                vec![0.3],
            ];
            let gradient = values.take(shape.len());
            let found = on_every_isa(|| {
                let filter =
                    DynamicFilter::new(Isa::current(), size, &tensors[2], &tensors[3], tensors[4][0]);
                let g = filter.backward(&tensors[0], &tensors[1], shape, &gradient);
                vec![g.condition, g.features, g.weight, g.bias, vec![g.slope]]
            });
            let loss = |t: &[Vec<f32>]| {
                let head = naive::FilterHead { size, weight: &t[2], bias: &t[3], slope: t[4][0] };
                dot(&head.apply(&t[0], &t[1], shape), &gradient)
            };
            check_gradients(tensors, &found, loss);
        }
    }
}
