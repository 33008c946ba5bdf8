//! Follows the schedule: feeds input rows, lets each step compute what it can, hands out the result's rows.

use std::ops::Range;

use rayon::prelude::*;

use super::plan::{Rows as Schedule, WINDOW_UNIT};
use super::{Operation, Plan, Tensor};
use crate::kernels::convolution::{BLOCK_ROWS, RowBlock};
use crate::kernels::dynamic_filter::FilterBlock;
use crate::kernels::finish::Finish;
use crate::kernels::rows::Rows;
use crate::kernels::scratch::{AlignedBuffer, Scratch};

/// Writes one input row, given its number: `width · channels` floats.
pub type Source<'a> = &'a dyn Fn(usize, &mut [f32]);

impl Plan<'_> {
    /// Runs the network: `sources` fill the rows of each input in turn, `sink` is given each row of the last
    /// tensor, from the first to the last.
    ///
    /// # Errors
    /// Whatever `proceed`, asked before each portion of rows with the number of input rows done, returns.
    ///
    /// # Panics
    /// When there is not one source for each input of the network.
    pub fn run<E>(
        &self,
        sources: &[Source<'_>],
        mut sink: impl FnMut(usize, &[f32]),
        mut proceed: impl FnMut(usize) -> Result<(), E>,
    ) -> Result<(), E> {
        let network = self.network;
        assert_eq!(sources.len(), network.inputs.len(), "sources for the network's inputs");
        let mut arena = AlignedBuffer::zeros(self.arena_len());
        let mut windows = self.lay_out(&mut arena);
        let mut schedule = Schedule::new(self);
        while let Some(portion) = schedule.next_portion() {
            proceed(portion.start)?;
            for (input, source) in network.inputs.iter().zip(sources) {
                let row_len = self.row_len(*input);
                let window = &mut *windows[input.0];
                for y in portion.clone() {
                    source(y, &mut window[y % self.windows[input.0] * row_len..][..row_len]);
                }
                schedule.computed[input.0] = portion.end;
            }
            for (s, step) in network.steps.iter().enumerate() {
                let rows = schedule.advance(s);
                let is_last = s + 1 == network.steps.len();
                // Out of the list while it is written, so that the others can be read.
                let output = std::mem::take(&mut windows[step.output.0]);
                self.compute(s, rows.clone(), output, &windows);
                if is_last {
                    self.hand_out(step.output, rows, output, &mut sink);
                }
                windows[step.output.0] = output;
            }
        }
        Ok(())
    }

    /// Cuts the arena into the windows of all tensors.
    fn lay_out<'a>(&self, arena: &'a mut AlignedBuffer) -> Vec<&'a mut [f32]> {
        let mut scratch = Scratch::of(arena);
        let mut window = |t| &mut scratch.take(self.window_space(Tensor(t)))[..self.window_len(Tensor(t))];
        (0..self.windows.len()).map(&mut window).collect()
    }

    /// Computes some rows of a step, in blocks.
    fn compute(&self, step: usize, rows: Range<usize>, output: &mut [f32], windows: &[&mut [f32]]) {
        let step = &self.network.steps[step];
        let row_len = self.row_len(step.output);
        let view = |t: Tensor| Rows::window(windows[t.0], self.windows[t.0], self.height_of(t));
        match &step.operation {
            Operation::Convolution { convolution, input, slope, add } => {
                let factor = convolution.factor();
                let blocks = blocks(rows, output, BLOCK_ROWS * factor * row_len);
                let finish = |first: usize, len: usize| {
                    let Some(add) = add else { return Finish::Leak(*slope) };
                    let start = first * factor % self.windows[add.0] * row_len;
                    Finish::LeakThenAdd(*slope, &windows[add.0][start..start + len])
                };
                let block = |Block { first, rows, output }| {
                    let len = rows * factor * row_len;
                    RowBlock {
                        input: view(*input),
                        first,
                        output: &mut { output }[..len],
                        finish: finish(first, len),
                    }
                };
                convolution.compute(blocks.into_iter().map(block).collect(), self.width_of(*input));
            }
            Operation::DynamicFilter { filter, condition, features } => {
                let (condition, features) = (view(*condition), view(*features));
                let block = |Block { first, rows, output }| FilterBlock {
                    condition,
                    features,
                    first,
                    output: &mut { output }[..rows * row_len],
                };
                let blocks = blocks(rows, output, BLOCK_ROWS * row_len);
                filter.compute(blocks.into_iter().map(block).collect());
            }
            Operation::Pixelwise { function, inputs } => {
                let views: Vec<Rows<'_>> = inputs.iter().map(|&input| view(input)).collect();
                let channels = |t: &Tensor| self.network.tensors[t.0].channels;
                let channels: Vec<usize> = inputs.iter().map(channels).collect();
                blocks(rows, output, BLOCK_ROWS * row_len).into_par_iter().for_each(|block| {
                    for (y, row) in block.output.chunks_exact_mut(row_len).take(block.rows).enumerate() {
                        let y = (block.first + y).cast_signed();
                        let rows: Vec<&[f32]> = views.iter().map(|view| view.nearest_row(y)).collect();
                        function.apply(&rows, &channels, row);
                    }
                });
            }
        }
    }

    /// Gives the sink the rows that the last step has just computed.
    fn hand_out(
        &self,
        tensor: Tensor,
        rows: Range<usize>,
        window: &[f32],
        sink: &mut impl FnMut(usize, &[f32]),
    ) {
        let row_len = self.row_len(tensor);
        for y in rows {
            sink(y, &window[y % self.windows[tensor.0] * row_len..][..row_len]);
        }
    }
}

/// Some rows of a step with the part of the window that they go to.
struct Block<'a> {
    first: usize,
    rows: usize,
    output: &'a mut [f32],
}

/// Cuts rows into blocks, each with its part of the window, which rolls over at its end.
fn blocks(rows: Range<usize>, window: &mut [f32], block_len: usize) -> Vec<Block<'_>> {
    let mut parts: Vec<Option<&mut [f32]>> = window.chunks_mut(block_len).map(Some).collect();
    let count = parts.len();
    debug_assert_eq!(WINDOW_UNIT % BLOCK_ROWS, 0, "windows hold whole blocks");
    let block = |first: usize| {
        let output = parts[first / BLOCK_ROWS % count].take();
        let output = output.expect("a portion never exceeds its window");
        Block { first, rows: BLOCK_ROWS.min(rows.end - first), output }
    };
    rows.clone().step_by(BLOCK_ROWS).map(block).collect()
}

#[cfg(test)]
mod tests {
    use super::super::Network;
    use super::*;
    use crate::kernels::testing::Values;
    use crate::kernels::{Convolution, DynamicFilter, Geometry, Isa, Shape};

    const CHANNELS: usize = 16;

    struct Layers {
        values: Values,
    }

    impl Layers {
        fn convolution(&mut self, geometry: Geometry) -> Convolution {
            let weight = self.values.take_scaled(geometry.weight_len(), 9 * geometry.inputs);
            Convolution::new(geometry, &weight, &self.values.take(geometry.outputs))
        }

        fn up(&mut self) -> Convolution {
            let weight = self.values.take_scaled(8 * CHANNELS * CHANNELS * 9, 9 * CHANNELS);
            Convolution::up(Isa::current(), 2 * CHANNELS, &weight, &self.values.take(4 * CHANNELS))
        }

        fn filter(&mut self) -> DynamicFilter {
            let weight = self.values.take_scaled(25 * CHANNELS * CHANNELS, CHANNELS);
            DynamicFilter::new(Isa::current(), 5, &weight, &self.values.take(25 * CHANNELS), 0.3)
        }
    }

    /// A small U-Net with everything in it: residual block, stride, up-convolution with skip, filter, large
    /// convolution, modulation by two halves of a concatenation.
    fn network() -> Network {
        let mut layers = Layers { values: Values::new(1) };
        let stride_two = Geometry { inputs: CHANNELS, outputs: 2 * CHANNELS, side: 3, stride: 2 };
        let same = |c| Geometry::three_by_three(c, c);
        let mut network = Network::default();
        let image = network.input(3);
        let fine = layers.convolution(Geometry::three_by_three(3, CHANNELS));
        let fine = network.convolution(image, fine, 0.2, None);
        let (first, second) = (layers.convolution(same(CHANNELS)), layers.convolution(same(CHANNELS)));
        let refined = network.res_block(fine, first, second, 0.2);
        let filtered = network.dynamic_filter(fine, refined, layers.filter());
        let coarse = network.convolution(refined, layers.convolution(stride_two), 0.2, None);
        let (first, second) =
            (layers.convolution(same(2 * CHANNELS)), layers.convolution(same(2 * CHANNELS)));
        let coarse = network.res_block(coarse, first, second, 0.2);
        let fine = network.convolution(coarse, layers.up(), 0.2, Some(filtered));
        let joined = network.concatenate(fine, image);
        let large = Geometry { inputs: CHANNELS + 3, outputs: CHANNELS, side: 9, stride: 1 };
        let scale = network.convolution(joined, layers.convolution(large), 0.2, None);
        let fine = network.modulate(fine, scale, refined, 0.0);
        let fine = network.add(fine, refined);
        let last = layers.convolution(Geometry::three_by_three(CHANNELS, 3));
        network.convolution(fine, last, 0.2, Some(image));
        network
    }

    fn run(plan: &Plan<'_>, input: &[f32]) -> Vec<f32> {
        let row_len = plan.width * 3;
        let mut output = Vec::new();
        let source = |y: usize, row: &mut [f32]| row.copy_from_slice(&input[y * row_len..][..row_len]);
        let sink = |y: usize, row: &[f32]| {
            assert_eq!(output.len(), y * row_len, "rows come in order");
            output.extend_from_slice(row);
        };
        plan.run(&[&source], sink, |_| Ok::<(), ()>(())).unwrap();
        output
    }

    #[test]
    fn the_result_does_not_depend_on_the_portions() {
        let network = network();
        for (height, width) in [(2, 2), (6, 10), (90, 24), (134, 6)] {
            let shape = Shape::new(1, height, width, 3);
            let input = Values::new(2).take(shape.len());
            let mut whole = Plan::new(&network, height, width, 1);
            whole.portion = height;
            whole.windows = (0..network.tensors.len())
                .map(|t| whole.height_of(Tensor(t)).next_multiple_of(WINDOW_UNIT))
                .collect();
            let expected = run(&whole, &input);
            assert_eq!(expected.len(), shape.len());
            for portion in [8, 16, 40] {
                let mut plan = Plan::new(&network, height, width, 1);
                plan.portion = portion;
                plan.windows = plan.windows();
                assert_eq!(run(&plan, &input), expected, "{height} × {width}, portions of {portion}");
            }
        }
    }

    #[test]
    fn memory_does_not_grow_with_the_height() {
        let network = network();
        let bytes = |height| Plan::new(&network, height, 512, 2).bytes();
        assert_eq!(bytes(512), bytes(4096));
        assert!(bytes(512) < 512 * 512 * CHANNELS * 4 * 2, "{}", bytes(512));
    }
}
