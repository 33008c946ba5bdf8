//! Follows the schedule: feeds input rows, lets each step compute what it can, hands out the result's rows.

use std::ops::Range;

use rayon::prelude::*;

use super::plan::{Rows as Schedule, slot_space};
use super::{Operation, Plan, Tensor};
use crate::kernels::convolution::{BLOCK_ROWS, RowBlock};
use crate::kernels::dynamic_filter::FilterBlock;
use crate::kernels::finish::Finish;
use crate::kernels::rows::Rows;
use crate::kernels::scratch::{AlignedBuffer, Scratch, Target};

/// Writes one input row, given its number: `width · channels` floats.
pub type Source<'a> = &'a (dyn Fn(usize, &mut [f32]) + Sync);

impl Plan<'_> {
    /// Runs the network: `sources` fill the rows of each input in turn, `sink` is given each row of the last
    /// tensor, from the first to the last.
    ///
    /// # Errors
    /// Whatever `proceed`, asked before each portion of rows with the number of input rows done, returns.
    ///
    /// # Panics
    /// When there is not one source for each input of the network.
    pub fn run<E: Send>(
        &self,
        sources: &[Source<'_>],
        sink: impl FnMut(usize, &[f32]) + Send,
        proceed: impl FnMut(usize) -> Result<(), E> + Send,
    ) -> Result<(), E> {
        // On a thread of the pool, which shares each step's work without being woken for it.
        rayon::scope(|_| self.run_here(sources, sink, proceed))
    }

    fn run_here<E>(
        &self,
        sources: &[Source<'_>],
        mut sink: impl FnMut(usize, &[f32]),
        mut proceed: impl FnMut(usize) -> Result<(), E>,
    ) -> Result<(), E> {
        let network = self.network;
        assert_eq!(sources.len(), network.inputs.len(), "sources for the network's inputs");
        let mut arena = AlignedBuffer::zeros(self.arena_len());
        let mut slots = self.lay_out(&mut arena);
        let mut schedule = Schedule::new(self);
        while let Some(portion) = schedule.next_portion() {
            proceed(portion.start)?;
            for (input, source) in network.inputs.iter().zip(sources) {
                let row_len = self.row_len(*input);
                for y in portion.clone() {
                    let (unit, row) = self.place(*input, y);
                    let slot = &mut slots[self.memory.places[input.0][unit]];
                    source(y, &mut slot[row * row_len..][..row_len]);
                }
                schedule.computed[input.0] = portion.end;
            }
            for (s, step) in network.steps.iter().enumerate() {
                let done = schedule.computed[step.output.0];
                let rows = schedule.advance(s);
                let computed = done..schedule.computed[step.output.0];
                // Out of the list while they are written, so that the others can be read.
                let units = self.place(step.output, done).0..self.units(step.output, computed.end);
                let places = &self.memory.places[step.output.0][units];
                let mut outputs: Vec<_> =
                    places.iter().map(|&place| std::mem::take(&mut slots[place])).collect();
                self.compute(s, rows, &mut outputs, &slots);
                for (&place, output) in places.iter().zip(outputs) {
                    slots[place] = output;
                }
                if s + 1 == network.steps.len() {
                    let result = self.view(step.output, &slots);
                    computed.for_each(|y| sink(y, result.nearest_row(y.cast_signed())));
                }
            }
        }
        Ok(())
    }

    /// Cuts the arena into slots.
    fn lay_out<'a>(&self, arena: &'a mut AlignedBuffer) -> Vec<&'a mut [f32]> {
        let mut scratch = Scratch::of(arena);
        let mut slot = |&len: &usize| &mut scratch.take(slot_space(len))[..len];
        self.memory.slots.iter().map(&mut slot).collect()
    }

    /// The rows of a tensor that are held at the moment.
    fn view<'a>(&'a self, tensor: Tensor, slots: &'a [&'a mut [f32]]) -> Rows<'a> {
        let size = (self.height_of(tensor), self.row_len(tensor));
        let shift = self.place(tensor, 0).1;
        Rows::scattered(slots, &self.memory.places[tensor.0], (self.unit_rows[tensor.0], shift), size)
    }

    /// Computes some rows of a step, in blocks, to the slots that hold them.
    fn compute(&self, step: usize, rows: Range<usize>, outputs: &mut [&mut [f32]], slots: &[&mut [f32]]) {
        let step = &self.network.steps[step];
        let row_len = self.row_len(step.output);
        let shift = self.place(step.output, 0).1;
        let view = |tensor: Tensor| self.view(tensor, slots);
        match &step.operation {
            Operation::Convolution { convolution, input, slope, add } => {
                let factor = convolution.factor();
                let finish = |first: usize, len: usize| {
                    let Some(add) = add else { return Finish::Leak(*slope) };
                    let (unit, row) = self.place(*add, first * factor);
                    let slot = &*slots[self.memory.places[add.0][unit]];
                    Finish::LeakThenAdd(*slope, &slot[row * row_len..][..len])
                };
                let block = |Block { first, rows, output }| {
                    let len = rows * factor * row_len;
                    let output = Target::Written(output);
                    RowBlock { input: view(*input), first, output, finish: finish(first, len) }
                };
                let blocks = blocks(rows, outputs, (factor, row_len), shift);
                convolution.compute(blocks.into_iter().map(block).collect(), self.width_of(*input));
            }
            Operation::DynamicFilter { filter, condition, features } => {
                let (condition, features) = (view(*condition), view(*features));
                let block = |Block { first, output, .. }| FilterBlock { condition, features, first, output };
                let blocks = blocks(rows, outputs, (1, row_len), shift);
                filter.compute(blocks.into_iter().map(block).collect());
            }
            Operation::Pixelwise { function, inputs } => {
                let views: Vec<Rows<'_>> = inputs.iter().map(|&input| view(input)).collect();
                let channels = |t: &Tensor| self.network.tensors[t.0].channels;
                let channels: Vec<usize> = inputs.iter().map(channels).collect();
                blocks(rows, outputs, (1, row_len), shift).into_par_iter().for_each(|block| {
                    for (y, row) in block.output.chunks_exact_mut(row_len).enumerate() {
                        let y = (block.first + y).cast_signed();
                        let rows: Vec<&[f32]> = views.iter().map(|view| view.nearest_row(y)).collect();
                        function.apply(&rows, &channels, row);
                    }
                });
            }
        }
    }
}

/// Some rows of a step with the part of a slot that they go to.
struct Block<'a> {
    first: usize,
    rows: usize,
    output: &'a mut [f32],
}

/// Cuts rows into blocks, each with its part of the slots that hold them. There the tensor's first row stands at
/// `shift`; each row that is computed becomes `factor` rows of `row_len` floats.
fn blocks<'a>(
    rows: Range<usize>,
    slots: &'a mut [&mut [f32]],
    (factor, row_len): (usize, usize),
    shift: usize,
) -> Vec<Block<'a>> {
    let mut blocks = Vec::new();
    let mut first = rows.start;
    // Blocks begin at multiples of their rows in a slot, which may hold blocks of an earlier portion.
    let per_slot = slots.first().map_or(1, |slot| slot.len() / (factor * row_len));
    let mut at = (first + shift / factor) % per_slot;
    for slot in slots {
        let mut rest = &mut slot[at * factor * row_len..];
        while !rest.is_empty() && first < rows.end {
            let count = (BLOCK_ROWS - at % BLOCK_ROWS).min(rows.end - first);
            let (output, others) = rest.split_at_mut(count * factor * row_len);
            blocks.push(Block { first, rows: count, output });
            (first, at, rest) = (first + count, at + count, others);
        }
        at = 0;
    }
    blocks
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
            let expected = run(&Plan::with_portion(&network, height, width, height), &input);
            assert_eq!(expected.len(), shape.len());
            for portion in [8, 16, 40] {
                let plan = Plan::with_portion(&network, height, width, portion);
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
