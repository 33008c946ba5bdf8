//! Follows the schedule: feeds input rows, lets each step compute what it can, hands out the result's rows.
//!
//! # Order of work
//! A portion's work stands in one list of tasks, step after step, each a few rows. Threads take them in this order and
//! wait for what a task depends on, not for all of the step before: where one thread is late the others go on with the
//! next step's first rows. Two steps are under way at most, so that the rows that a step has read for the last time
//! can be overwritten two steps later: [`Plan`] gives memory out accordingly.

use std::ops::Range;

use rayon::prelude::*;

use super::plan::{Rows as Schedule, slot_space};
use super::tasks::run_in_order;
use super::{Operation, Plan, Tensor};
use crate::kernels::convolution::{BLOCK_ROWS, RowBlock};
use crate::kernels::dynamic_filter::FilterBlock;
use crate::kernels::epilogue::Epilogue;
use crate::kernels::rows::Rows;
use crate::kernels::scratch::{AlignedBuffer, Target};
use crate::kernels::slots::{Slots, Turn};

/// Writes one input row, given its number: `width · channels` floats.
pub type Source<'a> = &'a (dyn Fn(usize, &mut [f32]) + Sync);

/// Memory for all slots of a plan, to be used for one run after another.
#[derive(Default)]
pub struct Arena(AlignedBuffer);

impl Plan<'_> {
    /// Runs the network in an arena: `sources` fill the rows of each input in turn, `sink` is given each row of the last
    /// tensor, from the first to the last.
    ///
    /// # Errors
    /// Whatever `proceed`, asked before each portion of rows with the number of input rows done, returns.
    ///
    /// # Panics
    /// When there is not one source for each input of the network.
    pub fn run<E: Send>(
        &self,
        arena: &mut Arena,
        sources: &[Source<'_>],
        sink: impl FnMut(usize, &[f32]) + Send,
        proceed: impl FnMut(usize) -> Result<(), E> + Send,
    ) -> Result<(), E> {
        // On a thread of the pool, which shares the work without being woken for it.
        rayon::scope(|_| self.run_here(arena, sources, sink, proceed))
    }

    fn run_here<E>(
        &self,
        Arena(arena): &mut Arena,
        sources: &[Source<'_>],
        mut sink: impl FnMut(usize, &[f32]),
        mut proceed: impl FnMut(usize) -> Result<(), E>,
    ) -> Result<(), E> {
        let network = self.network;
        assert_eq!(sources.len(), network.inputs.len(), "sources for the network's inputs");
        arena.grow(self.arena_len());
        let mut slots = Slots::new(arena.as_mut_slice(), &self.memory.slots, slot_space);
        let mut schedule = Schedule::new(self);
        let result = network.steps.last().map(|step| step.output);
        while let Some(portion) = schedule.next_portion() {
            proceed(portion.start)?;
            for (&input, source) in network.inputs.iter().zip(sources) {
                let row_len = self.row_len(input);
                portion.clone().into_par_iter().for_each(|y| {
                    let (unit, row) = self.place(input, y);
                    let slot = self.memory.places[input.0][unit];
                    // SAFETY: no task is under way, and each row has a place of its own.
                    source(y, unsafe { slots.write(slot, row * row_len..(row + 1) * row_len) });
                });
                schedule.computed[input.0] = portion.end;
            }
            let done = result.map_or(0, |result| schedule.computed[result.0]);
            let tasks = self.tasks(&mut schedule);
            // SAFETY: the tasks are those of the plan.
            unsafe { self.run_tasks(&tasks, &mut slots) };
            if let Some(result) = result {
                // SAFETY: no task is under way.
                let rows = unsafe { self.view(result, &slots) };
                (done..schedule.computed[result.0]).for_each(|y| sink(y, rows.nearest_row(y.cast_signed())));
            }
        }
        Ok(())
    }

    /// Computes all tasks, each after those that it needs.
    ///
    /// # Safety
    /// The tasks need whatever uses the floats that they write, and whatever writes those that they read: they are as
    /// [`Plan::tasks`] lists them.
    unsafe fn run_tasks(&self, tasks: &[Task], slots: &mut Slots<'_>) {
        let needs: Vec<usize> = tasks.iter().map(|task| task.needs).collect();
        run_in_order(&needs, |number| {
            let task = &tasks[number];
            let _turn = slots.turn(task.turn(number));
            // SAFETY: `run_in_order` has everything finished that the task needs.
            unsafe { self.compute(task, slots) }
        });
        slots.all_finished();
    }

    /// Lists the tasks of a portion, whose input rows the schedule counts as computed.
    fn tasks(&self, schedule: &mut Schedule<'_>) -> Vec<Task> {
        let mut tasks: Vec<Task> = Vec::new();
        // Where the tasks of the step before begin, and those of this one.
        let (mut before, mut current) = (0, 0);
        let mut written = None;
        for (s, step) in self.network.steps.iter().enumerate() {
            let rows = schedule.advance(s);
            let factor = match &step.operation {
                Operation::Convolution { convolution, .. } => convolution.factor(),
                Operation::DynamicFilter { .. } | Operation::Pixelwise { .. } => 1,
            };
            let mut blocks = self.blocks(step.output, rows, factor);
            let together = match &step.operation {
                Operation::Convolution { convolution, input, .. } => {
                    convolution.blocks_per_task(blocks.len(), self.width_of(*input))
                }
                Operation::DynamicFilter { .. } | Operation::Pixelwise { .. } => 1,
            };
            while !blocks.is_empty() {
                let others = blocks.split_off(together.min(blocks.len()));
                let end = blocks.last().map_or(0, |block| block.first + block.rows);
                let needed = match written {
                    Some(tensor) if step.operation.inputs().any(|input| input == tensor) => {
                        step.operation.rows_needed(tensor, end)
                    }
                    _ => 0,
                };
                let is_needed = |task: &&Task| task.first_output < needed;
                let needs = before + tasks[before..current].iter().take_while(is_needed).count();
                let first_output = blocks[0].first * factor;
                tasks.push(Task { step: s, first_output, blocks, needs });
                blocks = others;
            }
            (before, current) = (current, tasks.len());
            written = Some(step.output);
        }
        tasks
    }

    /// Cuts rows of a tensor (before shuffling by `factor`) into blocks, each within a slot.
    fn blocks(&self, tensor: Tensor, rows: Range<usize>, factor: usize) -> Vec<Block> {
        let row_len = self.row_len(tensor);
        let mut blocks = Vec::new();
        let mut first = rows.start;
        while first < rows.end {
            let (unit, row) = self.place(tensor, first * factor);
            // Blocks begin at multiples of their rows in a slot, which may hold blocks of an earlier portion.
            let row = row / factor;
            let count = (BLOCK_ROWS - row % BLOCK_ROWS).min(rows.end - first);
            let floats = row * factor * row_len..(row + count) * factor * row_len;
            blocks.push(Block { first, rows: count, slot: self.memory.places[tensor.0][unit], floats });
            first += count;
        }
        blocks
    }

    /// The rows of a tensor that are held at the moment.
    ///
    /// # Safety
    /// While the view and what it returns live, nobody writes the rows that are asked for.
    unsafe fn view<'a>(&'a self, tensor: Tensor, slots: &'a Slots<'a>) -> Rows<'a> {
        let size = (self.height_of(tensor), self.row_len(tensor));
        let shift = self.place(tensor, 0).1;
        // SAFETY: passed on to the caller.
        unsafe {
            Rows::scattered(slots, &self.memory.places[tensor.0], (self.unit_rows[tensor.0], shift), size)
        }
    }

    /// Computes the rows of a task.
    ///
    /// # Safety
    /// All tasks with a number below [`Task::needs`] are finished, and each task is computed once.
    ///
    /// Then what it reads has been written, and nobody writes it: a slot that was given back goes to another tensor two
    /// steps later, whose tasks need all those of this step. And nobody else touches what it writes: the rows of a block
    /// belong to one task, those who read them wait for it, and those who read what lay there before are finished.
    unsafe fn compute(&self, task: &Task, slots: &Slots<'_>) {
        let step = &self.network.steps[task.step];
        let row_len = self.row_len(step.output);
        // SAFETY: nobody writes what the task reads, as the caller promises.
        let view = |tensor: Tensor| unsafe { self.view(tensor, slots) };
        // SAFETY: nobody else touches what the task writes; each of its blocks is asked for once.
        let output = |block: &Block| unsafe { slots.write(block.slot, block.floats.clone()) };
        match &step.operation {
            Operation::Convolution { convolution, input, slope, add } => {
                let block = |block: &Block| {
                    let epilogue = match add {
                        None => Epilogue::Leak(*slope),
                        Some(add) => {
                            let (unit, row) = self.place(*add, block.first * convolution.factor());
                            let slot = self.memory.places[add.0][unit];
                            let floats = row * row_len..row * row_len + block.floats.len();
                            // SAFETY: as for the views.
                            Epilogue::LeakThenAdd(*slope, unsafe { slots.read(slot, floats) })
                        }
                    };
                    let output = Target::Written(output(block));
                    RowBlock { input: view(*input), first: block.first, rows: block.rows, output, epilogue }
                };
                convolution.compute_blocks(task.blocks.iter().map(block).collect(), self.width_of(*input));
            }
            Operation::DynamicFilter { filter, condition, features } => {
                let (condition, features) = (view(*condition), view(*features));
                for block in &task.blocks {
                    let (first, output) = (block.first, output(block));
                    filter.compute_block(FilterBlock { condition, features, first, output });
                }
            }
            Operation::Pixelwise { function, inputs } => {
                let views: Vec<Rows<'_>> = inputs.iter().map(|&input| view(input)).collect();
                let channels = |t: &Tensor| self.network.tensors[t.0].channels;
                let channels: Vec<usize> = inputs.iter().map(channels).collect();
                for block in &task.blocks {
                    for (y, row) in output(block).chunks_exact_mut(row_len).enumerate() {
                        let y = (block.first + y).cast_signed();
                        let rows: Vec<&[f32]> = views.iter().map(|view| view.nearest_row(y)).collect();
                        function.apply(&rows, &channels, row);
                    }
                }
            }
        }
    }
}

/// A few rows of a step: what one thread computes at a time.
struct Task {
    step: usize,
    /// The first row written, after shuffling.
    first_output: usize,
    blocks: Vec<Block>,
    /// The task begins once all tasks with a smaller number than this are finished.
    needs: usize,
}

impl Task {
    /// What those who watch over the slots are told of the task with this number.
    fn turn(&self, task: usize) -> Turn {
        let first = self.blocks.first().map_or(0, |block| block.first);
        let end = self.blocks.last().map_or(0, |block| block.first + block.rows);
        Turn { task, needs: self.needs, step: self.step, first, end }
    }
}

/// Some rows of a step with the part of a slot that they go to.
struct Block {
    first: usize,
    rows: usize,
    slot: usize,
    floats: Range<usize>,
}

#[cfg(test)]
mod tests {
    use super::super::Graph;
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
    fn network() -> Graph {
        let mut layers = Layers { values: Values::new(1) };
        let stride_two = Geometry { inputs: CHANNELS, outputs: 2 * CHANNELS, side: 3, stride: 2 };
        let same = |c| Geometry::three_by_three(c, c);
        let mut network = Graph::default();
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
        run_in(&mut Arena::default(), plan, input)
    }

    fn run_in(arena: &mut Arena, plan: &Plan<'_>, input: &[f32]) -> Vec<f32> {
        let row_len = plan.width * 3;
        let mut output = Vec::new();
        let source = |y: usize, row: &mut [f32]| row.copy_from_slice(&input[y * row_len..][..row_len]);
        let sink = |y: usize, row: &[f32]| {
            assert_eq!(output.len(), y * row_len, "rows come in order");
            output.extend_from_slice(row);
        };
        plan.run(arena, &[&source], sink, |_| Ok::<(), ()>(())).unwrap();
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
    fn the_result_does_not_depend_on_the_threads() {
        let network = network();
        let (height, width) = (70, 38);
        let input = Values::new(2).take(height * width * 3);
        let plan = Plan::with_portion(&network, height, width, 16);
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run(&plan, &input))
        };
        let expected = with(1);
        for threads in [2, 3, 8] {
            assert_eq!(with(threads), expected, "{threads} threads");
        }
    }

    /// Runs a network's first portion with tasks that `change` was given, on one thread, where no two of them meet.
    #[cfg(debug_assertions)]
    fn run_changed(change: impl Fn(&mut Task)) -> std::thread::Result<()> {
        let network = network();
        let plan = Plan::with_portion(&network, 70, 38, 16);
        let mut schedule = Schedule::new(&plan);
        schedule.computed[network.inputs[0].0] = schedule.next_portion().unwrap().end;
        let mut tasks = plan.tasks(&mut schedule);
        tasks.iter_mut().for_each(change);
        let run = || {
            let mut memory = vec![0.0; plan.arena_len()];
            let mut slots = Slots::new(&mut memory, &plan.memory.slots, slot_space);
            // SAFETY: one thread computes one task after the other.
            unsafe { plan.run_tasks(&tasks, &mut slots) }
        };
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| alone.install(run)))
    }

    /// The check needs no luck: that tasks could meet is enough.
    #[cfg(debug_assertions)]
    #[test]
    fn a_schedule_that_lets_tasks_meet_at_the_same_rows_is_caught() {
        assert!(run_changed(|_| ()).is_ok());
        for step in 1..4 {
            let caught = run_changed(|task| {
                if task.step == step {
                    task.needs = 0;
                }
            });
            let said = *caught.unwrap_err().downcast::<String>().unwrap();
            assert!(said.contains("slot ") && said.contains(&format!("step {step}, rows ")), "{said}");
        }
    }

    #[test]
    fn the_result_does_not_depend_on_what_the_arena_held() {
        let network = network();
        let mut arena = Arena::default();
        for (height, width) in [(26, 22), (70, 38), (26, 22)] {
            let input = Values::new(2).take(height * width * 3);
            let plan = Plan::with_portion(&network, height, width, 16);
            let expected = run(&plan, &input);
            arena.0.grow(plan.arena_len());
            arena.0.as_mut_slice().fill(f32::NAN);
            assert_eq!(run_in(&mut arena, &plan, &input), expected, "{height} × {width}");
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
