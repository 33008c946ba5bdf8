//! Convolutions of whole tensors or of blocks of rows, whatever the method that computes them.

use rayon::prelude::*;

use super::direct::few_outputs::{self, OutputRows as FewOutputRows};
use super::direct::forward::{self as direct, Geometry, OutputRows};
use super::epilogue::Epilogue;
use super::rows::Rows;
use super::scratch::{Target, written};
use super::shape::Shape;
use super::simd::Isa;
use super::winograd::forward::{Order, TileRow, TileRows, rows_per_task};
use super::winograd::{POINTS, TILE, weights as winograd};

/// Output rows per block: a row of Winograd tiles.
pub(crate) const BLOCK_ROWS: usize = TILE;

/// A convolution with its weights packed, ready to be applied any number of times.
///
/// # Equation
/// `output(y, x, o) = epilogue(bias(o) + Σ weight(o, i, k, l) · input(y·stride + k − p, x·stride + l − p, i))`
/// with zeros outside of the image and `p = side / 2` rounded down.
///
/// # Accuracy
/// About 1.5e-6 of the largest output; with products in bfloat16, 2e-3 for smooth inputs and 1.5e-2 for noise.
pub struct Convolution {
    geometry: Geometry,
    order: Order,
    method: Method,
}

/// Makes blocks of an output known as written or as fresh.
type MakeTarget<'a, T> = fn(&'a mut [T]) -> Target<'a>;

enum Method {
    Winograd(winograd::Weights),
    FewOutputs(few_outputs::Weights),
    Direct(direct::Weights),
}

impl Convolution {
    /// Packs PyTorch's weights `[outputs, inputs, side, side]` and bias `[outputs]`.
    ///
    /// # Panics
    /// When a slice's length is not that of the geometry, or there is no kernel for it.
    pub fn new(geometry: Geometry, weight: &[f32], bias: &[f32]) -> Self {
        Self::for_isa(Isa::current(), geometry, weight, bias)
    }

    /// As [`Convolution::new`], for a given instruction set.
    ///
    /// # Panics
    /// As [`Convolution::new`].
    pub fn for_isa(isa: Isa, geometry: Geometry, weight: &[f32], bias: &[f32]) -> Self {
        let taps = check_parameters(geometry, weight, bias);
        let weight = |o: usize, i: usize, tap: usize| weight[(o * geometry.inputs + i) * taps + tap];
        Self::pack(isa, geometry, Order::Plain, weight, |o| bias[o])
    }

    /// Packs a 3 × 3 convolution to `4·channels` outputs whose results are shuffled to `channels` outputs of
    /// twice the rows and columns, in the order of PyTorch's `PixelShuffle(2)`.
    ///
    /// # Shapes
    /// weight `[4·channels, inputs, 3, 3]`, bias `[4·channels]`; output `[images, 2·height, 2·width, channels]`.
    ///
    /// # Panics
    /// When the number of biases is no multiple of four, or that of weights another than theirs and the inputs' say.
    pub fn up(isa: Isa, inputs: usize, weight: &[f32], bias: &[f32]) -> Self {
        let geometry = Geometry::three_by_three(inputs, bias.len());
        check_parameters(geometry, weight, bias);
        assert!(bias.len().is_multiple_of(4), "{} outputs to shuffle", bias.len());
        let place = |o| shuffled_output(o, bias.len() / 4);
        let weight = |o: usize, i: usize, tap: usize| weight[(place(o) * inputs + i) * 9 + tap];
        Self::pack(isa, geometry, Order::Shuffled, weight, |o| bias[place(o)])
    }

    /// Packs the convolution that takes gradients of outputs to those of inputs: stride 1, weights flipped
    /// and transposed, no bias.
    ///
    /// # Panics
    /// When the stride is not 1, or the number of weights not that of the geometry.
    pub fn transposed(isa: Isa, geometry: Geometry, weight: &[f32]) -> Self {
        let Geometry { inputs, outputs, side, stride } = geometry;
        geometry.check();
        assert_eq!(stride, 1, "stride of a convolution whose transpose is one");
        assert_eq!(weight.len(), geometry.weight_len(), "weights of {geometry:?}");
        let taps = side * side;
        let flipped = |i: usize, o: usize, tap: usize| weight[(o * inputs + i) * taps + taps - 1 - tap];
        let geometry = Geometry { inputs: outputs, outputs: inputs, side, stride };
        Self::pack(isa, geometry, Order::Plain, flipped, |_| 0.0)
    }

    fn pack(
        isa: Isa,
        geometry: Geometry,
        order: Order,
        weight: impl Fn(usize, usize, usize) -> f32 + Sync,
        bias: impl Fn(usize) -> f32,
    ) -> Self {
        let Geometry { inputs, outputs, side, stride } = geometry;
        let whole_groups = order == Order::Plain || (outputs / 4).is_multiple_of(isa.lanes());
        let method = if order == Order::Plain && few_outputs::applies(isa, geometry) {
            Method::FewOutputs(few_outputs::Weights::pack(isa, geometry, weight, bias))
        } else if (side, stride) == (3, 1) && whole_groups && winograd::applies(isa, inputs, outputs) {
            let weight = |o: usize, i: usize| std::array::from_fn(|tap| weight(o, i, tap));
            Method::Winograd(winograd::Weights::pack(isa, (inputs, outputs), weight, bias))
        } else {
            Method::Direct(direct::Weights::pack(isa, geometry, weight, bias))
        };
        Self { geometry, order, method }
    }

    /// The extent that was packed.
    pub fn geometry(&self) -> Geometry {
        self.geometry
    }

    /// The shape of the output for an input of shape `input`.
    pub fn output_shape(&self, input: Shape) -> Shape {
        let (factor, out) = (self.factor(), self.geometry.output_shape(input));
        Shape {
            images: out.images,
            height: out.height * factor,
            width: out.width * factor,
            channels: out.channels / (factor * factor),
        }
    }

    /// Rows and columns of the result per output computed.
    pub(crate) fn factor(&self) -> usize {
        if self.order == Order::Shuffled { 2 } else { 1 }
    }

    /// Applies the convolution to a batch of images.
    ///
    /// # Panics
    /// When a slice's length is not that of its shape.
    pub fn forward(&self, input: &[f32], shape: Shape, epilogue: Epilogue<'_>, output: &mut [f32]) {
        let out = self.output_shape(shape);
        assert_eq!(output.len(), out.len(), "floats of an output {out:?}");
        self.forward_blocks(input, shape, epilogue, (output, Target::Written));
    }

    /// As [`Convolution::forward`], to memory of its own, which is not filled with zeros beforehand.
    ///
    /// # Panics
    /// When a slice's length is not that of its shape.
    pub fn apply(&self, input: &[f32], shape: Shape, epilogue: Epilogue<'_>) -> Vec<f32> {
        let len = self.output_shape(shape).len();
        // SAFETY: `forward_blocks` cuts the whole output into blocks, and computing one gets it ready.
        unsafe { written(len, |output| self.forward_blocks(input, shape, epilogue, (output, Target::Fresh))) }
    }

    /// Cuts an output into blocks of rows, which `target` makes known as such, and computes all of them.
    fn forward_blocks<'a, T>(
        &self,
        input: &'a [f32],
        shape: Shape,
        epilogue: Epilogue<'a>,
        (output, target): (&'a mut [T], MakeTarget<'a, T>),
    ) {
        let out = self.output_shape(shape);
        assert_eq!((shape.channels, input.len()), (self.geometry.inputs, shape.len()), "{shape:?}");
        epilogue.check_len(output.len());
        if out.is_empty() {
            return;
        }
        let block_len = BLOCK_ROWS * self.factor() * out.row_len();
        let mut blocks = Vec::new();
        for (n, image) in output.chunks_mut(out.image_len()).enumerate() {
            let rows = Rows::whole(&input[n * shape.image_len()..][..shape.image_len()], shape.height);
            for (b, output) in image.chunks_mut(block_len).enumerate() {
                let start = n * out.image_len() + b * block_len;
                let epilogue = epilogue.part(start..start + output.len());
                let count = output.len() / (self.factor() * out.row_len());
                let (first, output) = (b * BLOCK_ROWS, target(output));
                blocks.push(RowBlock { input: rows, first, rows: count, output, epilogue });
            }
        }
        self.compute(blocks, shape.width);
    }

    /// Computes blocks of output rows, in parallel.
    fn compute(&self, blocks: Vec<RowBlock<'_>>, width: usize) {
        let together = self.blocks_per_task(blocks.len(), width);
        blocks.into_par_iter().chunks(together).for_each(|blocks| self.compute_blocks(blocks, width));
    }

    /// How many of `blocks` blocks of an input `width` wide make a task: enough to be worth a thread's while, but no more
    /// than its share.
    pub(crate) fn blocks_per_task(&self, blocks: usize, width: usize) -> usize {
        match &self.method {
            Method::Winograd(_) => {
                rows_per_task(width).min(blocks.div_ceil(rayon::current_num_threads())).max(1)
            }
            Method::FewOutputs(_) | Method::Direct(_) => 1,
        }
    }

    /// Computes blocks of output rows, on this thread.
    pub(crate) fn compute_blocks(&self, blocks: Vec<RowBlock<'_>>, width: usize) {
        match &self.method {
            Method::Winograd(weights) => {
                let rows = &mut blocks.into_iter().map(RowBlock::into_tile_row).collect::<Vec<_>>();
                weights.isa.run_products(TileRows { weights, width, order: self.order, rows });
            }
            Method::FewOutputs(weights) => blocks.into_iter().for_each(|block| {
                let RowBlock { input, first, output, epilogue, .. } = block;
                let output = output.ready();
                weights.isa.run(FewOutputRows { weights, input, first, output, epilogue });
            }),
            Method::Direct(weights) => blocks.into_iter().for_each(|block| match self.order {
                Order::Plain => weights.isa.run(block.into_output_rows(weights)),
                Order::Shuffled => shuffle_block(weights, block, width),
            }),
        }
    }
}

/// Some output rows of one image: up to [`BLOCK_ROWS`], times two when shuffled.
pub(crate) struct RowBlock<'a> {
    pub(crate) input: Rows<'a>,
    /// The number of the first row computed (before shuffling).
    pub(crate) first: usize,
    /// The rows computed.
    pub(crate) rows: usize,
    pub(crate) output: Target<'a>,
    pub(crate) epilogue: Epilogue<'a>,
}

impl<'a> RowBlock<'a> {
    fn into_tile_row(self) -> TileRow<'a> {
        let top = self.first.cast_signed() - 1;
        // Rows below those that the outputs depend on may not be there yet.
        let input = |k: usize| if k < self.rows + 2 { self.input.row(top + k.cast_signed()) } else { None };
        let inputs: [_; POINTS] = std::array::from_fn(input);
        TileRow { inputs, output: self.output.ready(), epilogue: self.epilogue }
    }

    fn into_output_rows(self, weights: &'a direct::Weights) -> OutputRows<'a> {
        let Self { input, first, output, epilogue, .. } = self;
        OutputRows { weights, input, first, output: output.ready(), epilogue }
    }
}

/// Computes a block by the direct method and shuffles it: for few channels, where it costs little.
fn shuffle_block(weights: &direct::Weights, block: RowBlock<'_>, width: usize) {
    let RowBlock { input, first, output, epilogue, .. } = block;
    let output = output.ready();
    let mut sums = vec![0.0; output.len()];
    weights.isa.run(OutputRows { weights, input, first, output: &mut sums, epilogue: Epilogue::Leak(1.0) });
    let outputs = weights.geometry.outputs;
    let channels = outputs / 4;
    for (pixel, sums) in sums.chunks_exact(outputs).enumerate() {
        let (y, x) = (pixel / width, pixel % width);
        for (group, sums) in sums.chunks_exact(channels).enumerate() {
            let (y, x) = (2 * y + group / 2, 2 * x + group % 2);
            let at = (y * 2 * width + x) * channels;
            for (c, sum) in sums.iter().enumerate() {
                output[at + c] = epilogue.scalar(*sum, at + c);
            }
        }
    }
}

/// The place in PyTorch's order (channel, then sub-pixel) of an output in ours (sub-pixel, then channel).
pub(crate) fn shuffled_output(output: usize, channels: usize) -> usize {
    output % channels * 4 + output / channels
}

fn check_parameters(geometry: Geometry, weight: &[f32], bias: &[f32]) -> usize {
    geometry.check();
    assert_eq!(weight.len(), geometry.weight_len(), "weights of {geometry:?}");
    assert_eq!(bias.len(), geometry.outputs, "biases of {geometry:?}");
    geometry.side * geometry.side
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::testing::{Values, assert_close, naive};

    /// Rows × columns that leave tiles, batches and register tiles unfilled in every way.
    const EXTENTS: [(usize, usize); 7] = [(1, 1), (1, 7), (4, 4), (5, 3), (9, 13), (6, 50), (17, 8)];

    fn check(isa: Isa, geometry: Geometry, shape: Shape) {
        let mut values = Values::new(7);
        let input = values.take(shape.len());
        let weight = values.take_scaled(geometry.weight_len(), geometry.inputs * geometry.side);
        let bias = values.take(geometry.outputs);
        let convolution = Convolution::for_isa(isa, geometry, &weight, &bias);
        let out = convolution.output_shape(shape);
        let sums = naive::convolution(geometry, &weight, &bias, &input, shape);
        let other = values.take(out.len());
        for (name, epilogue) in [
            ("leak", Epilogue::Leak(0.2)),
            ("steep leak", Epilogue::Leak(-1.5)),
            ("add", Epilogue::LeakThenAdd(1.0, &other)),
            ("gate", Epilogue::Gate(0.3, &other)),
        ] {
            let mut output = vec![f32::NAN; out.len()];
            convolution.forward(&input, shape, epilogue, &mut output);
            let expected = naive::epilogue(epilogue, &sums);
            assert_close(&output, &expected, 4e-6, &format!("{} {geometry:?} {shape:?} {name}", isa.name()));
        }
    }

    #[test]
    fn three_by_three_agrees_with_the_sum_written_down() {
        let channels = [
            (1, 1),
            (3, 32),
            (8, 32),
            (32, 3),
            (16, 1),
            (48, 2),
            (4, 4),
            (5, 8),
            (8, 8),
            (16, 16),
            (16, 48),
            (21, 8),
            (8, 16),
            (19, 70),
            (37, 32),
            (32, 32),
        ];
        for isa in Isa::available() {
            for (inputs, outputs) in channels {
                for (height, width) in EXTENTS {
                    let shape = Shape::new(2, height, width, inputs);
                    check(isa, Geometry::three_by_three(inputs, outputs), shape);
                }
            }
            for (inputs, outputs) in [(64, 64), (64, 128), (128, 128)] {
                check(isa, Geometry::three_by_three(inputs, outputs), Shape::new(1, 9, 6, inputs));
            }
        }
    }

    /// Numbers of 8 bits err by 2e-3, which Winograd's transforms make up to 1.7e-2 of the largest output of noise.
    #[test]
    fn products_in_bfloat16_are_rounded_and_no_more() {
        for isa in Isa::available().into_iter().filter_map(Isa::with_bf16_products) {
            for (inputs, outputs) in [(32, 32), (32, 70), (64, 16), (128, 128)] {
                for (height, width) in EXTENTS {
                    let (geometry, shape) =
                        (Geometry::three_by_three(inputs, outputs), Shape::new(2, height, width, inputs));
                    let mut values = Values::new(17);
                    let input = values.take(shape.len());
                    let weight = values.take_scaled(geometry.weight_len(), 9 * inputs);
                    let bias = values.take(outputs);
                    let convolution = Convolution::for_isa(isa, geometry, &weight, &bias);
                    let output = convolution.apply(&input, shape, Epilogue::Leak(0.2));
                    let sums = naive::convolution(geometry, &weight, &bias, &input, shape);
                    let expected = naive::epilogue(Epilogue::Leak(0.2), &sums);
                    assert_close(&output, &expected, 2e-2, &format!("{} {geometry:?} {shape:?}", isa.name()));
                }
            }
        }
    }

    #[test]
    fn stride_two_and_one_by_one_agree_with_the_sum_written_down() {
        for isa in Isa::available() {
            for (inputs, outputs) in [(1, 2), (4, 8), (16, 32), (32, 64), (20, 70)] {
                for (height, width) in EXTENTS {
                    let shape = Shape::new(2, height, width, inputs);
                    check(isa, Geometry { inputs, outputs, side: 3, stride: 2 }, shape);
                    check(isa, Geometry { inputs, outputs, side: 1, stride: 1 }, shape);
                }
            }
        }
    }

    #[test]
    fn large_convolutions_agree_with_the_sum_written_down() {
        for isa in Isa::available() {
            for (inputs, outputs, side, stride) in [(8, 3, 9, 1), (3, 16, 11, 4), (4, 20, 5, 1), (2, 3, 7, 2)]
            {
                for (height, width) in EXTENTS {
                    check(
                        isa,
                        Geometry { inputs, outputs, side, stride },
                        Shape::new(2, height, width, inputs),
                    );
                }
            }
        }
    }

    #[test]
    fn up_convolution_agrees_with_the_shuffled_sum() {
        for isa in Isa::available() {
            for (inputs, channels) in [(2, 1), (16, 8), (32, 16), (128, 64)] {
                for (height, width) in EXTENTS {
                    let shape = Shape::new(1, height, width, inputs);
                    let mut values = Values::new(3);
                    let input = values.take(shape.len());
                    let weight = values.take_scaled(4 * channels * inputs * 9, 3 * inputs);
                    let bias = values.take(4 * channels);
                    let up = Convolution::up(isa, inputs, &weight, &bias);
                    let skip = values.take(up.output_shape(shape).len());
                    let mut output = vec![f32::NAN; skip.len()];
                    up.forward(&input, shape, Epilogue::LeakThenAdd(0.2, &skip), &mut output);
                    let geometry = Geometry::three_by_three(inputs, 4 * channels);
                    let sums = naive::convolution(geometry, &weight, &bias, &input, shape);
                    let shuffled = naive::pixel_shuffle(&sums, shape.with_channels(4 * channels));
                    let expected = naive::epilogue(Epilogue::LeakThenAdd(0.2, &skip), &shuffled);
                    assert_close(&output, &expected, 4e-6, &format!("{} {inputs} {channels}", isa.name()));
                }
            }
        }
    }

    #[test]
    fn pixels_do_not_depend_on_how_the_work_is_cut() {
        let geometry = Geometry::three_by_three(32, 32);
        let shape = Shape::new(3, 21, 30, 32);
        let mut values = Values::new(11);
        let (input, weight) = (values.take(shape.len()), values.take(geometry.weight_len()));
        let convolution = Convolution::new(geometry, &weight, &values.take(32));
        let run = |threads: usize| {
            let mut output = vec![0.0; shape.len()];
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| convolution.forward(&input, shape, Epilogue::Leak(0.2), &mut output));
            output
        };
        assert_eq!(run(1), run(3));
    }
}
