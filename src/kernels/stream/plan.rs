//! The schedule of rows: what each step can compute when, and where in memory its rows lie.

use std::collections::HashMap;
use std::ops::Range;

use super::{Network, Operation, Step, Tensor};
use crate::kernels::convolution::BLOCK_ROWS;
use crate::kernels::scratch::whole_lines;

/// Rows that a slot holds: those of a shuffled block, so that every block lies in one piece.
pub(super) const UNIT: usize = 2 * BLOCK_ROWS;

/// Input rows per portion for up to two threads: two rows of tiles at a quarter of the resolution.
const PORTION: usize = 32;

/// Input pixels per portion at least: portions of narrow images are higher, so that batches are filled.
const PORTION_PIXELS: usize = 1 << 14;

/// Sides of the input per side of a step from which on it waits for two portions: weights of coarse steps
/// exceed the second-level cache and are read from afar each time.
const COARSE: usize = 4;

/// Floats between slots: five cache lines.
const SKEW: usize = 80;

/// The order of work and the memory of all tensors for one size of image.
pub struct Plan<'a> {
    pub(super) network: &'a Network,
    pub(super) height: usize,
    pub(super) width: usize,
    /// Input rows taken at a time.
    pub(super) portion: usize,
    pub(super) memory: Memory,
}

/// Where rows lie: slots of [`UNIT`] rows, each given to one tensor after another.
#[derive(Default)]
pub(super) struct Memory {
    /// Floats of each slot.
    pub(super) slots: Vec<usize>,
    /// For each tensor the slot of every unit of its rows.
    pub(super) places: Vec<Vec<usize>>,
    /// Slots that nobody needs, by their length; the one used last is given out first, as it may lie in a cache.
    free: HashMap<usize, Vec<usize>>,
    /// Units of each tensor that were given back.
    given_back: Vec<usize>,
}

impl Memory {
    /// Gives slots of `len` floats to a tensor until it has as many units.
    fn extend(&mut self, tensor: Tensor, units: usize, len: usize) {
        while self.places[tensor.0].len() < units {
            let slot = self.free.get_mut(&len).and_then(Vec::pop).unwrap_or_else(|| {
                self.slots.push(len);
                self.slots.len() - 1
            });
            self.places[tensor.0].push(slot);
        }
    }

    /// Takes a tensor's units above `first` back.
    fn give_back(&mut self, tensor: Tensor, first: usize, len: usize) {
        let from = std::mem::replace(&mut self.given_back[tensor.0], first);
        self.free.entry(len).or_default().extend(&self.places[tensor.0][from..first]);
    }
}

impl<'a> Plan<'a> {
    /// Plans a run on images of `height` × `width`, multiples of [`Network::reduction`], with `threads`.
    ///
    /// # Panics
    /// When a side is no multiple of [`Network::reduction`].
    pub fn new(network: &'a Network, height: usize, width: usize, threads: usize) -> Self {
        let rows = (PORTION * threads.max(2) / 2).max(PORTION_PIXELS / width.max(1));
        Self::with_portion(network, height, width, rows)
    }

    /// Plans a run that takes at least `rows` input rows at a time, where the image has so many.
    pub(super) fn with_portion(network: &'a Network, height: usize, width: usize, rows: usize) -> Self {
        let reduction = network.reduction();
        assert!(
            height > 0 && width > 0 && height.is_multiple_of(reduction) && width.is_multiple_of(reduction),
            "{height} × {width} for a network that reduces sides by {reduction}"
        );
        let portion = rows.min(height).next_multiple_of(BLOCK_ROWS * reduction);
        let mut plan = Self { network, height, width, portion, memory: Memory::default() };
        plan.memory = plan.give_out();
        plan
    }

    /// Bytes that all slots take.
    pub fn bytes(&self) -> usize {
        self.arena_len() * size_of::<f32>()
    }

    /// Floats that all slots take, one after another.
    pub(super) fn arena_len(&self) -> usize {
        self.memory.slots.iter().map(|&len| slot_space(len)).sum()
    }

    /// Floats of a slot of a tensor's rows.
    pub(super) fn slot_len(&self, tensor: Tensor) -> usize {
        UNIT * self.row_len(tensor)
    }

    /// Rows of a tensor.
    pub(super) fn height_of(&self, tensor: Tensor) -> usize {
        self.height / self.network.tensors[tensor.0].reduction
    }

    /// Columns of a tensor.
    pub(super) fn width_of(&self, tensor: Tensor) -> usize {
        self.width / self.network.tensors[tensor.0].reduction
    }

    /// Floats per row of a tensor.
    pub(super) fn row_len(&self, tensor: Tensor) -> usize {
        self.width_of(tensor) * self.network.tensors[tensor.0].channels
    }

    /// Plays the schedule with row numbers only: rows get memory when they are computed and lose it after the
    /// last step that reads them.
    fn give_out(&self) -> Memory {
        let tensors = self.network.tensors.len();
        let mut memory =
            Memory { places: vec![Vec::new(); tensors], given_back: vec![0; tensors], ..Memory::default() };
        let mut rows = Rows::new(self);
        while let Some(portion) = rows.next_portion() {
            for input in &self.network.inputs {
                rows.computed[input.0] = portion.end;
                memory.extend(*input, portion.end.div_ceil(UNIT), self.slot_len(*input));
            }
            for (s, step) in self.network.steps.iter().enumerate() {
                rows.advance(s);
                let units = rows.computed[step.output.0].div_ceil(UNIT);
                memory.extend(step.output, units, self.slot_len(step.output));
                // What nobody reads is the result, handed out at once.
                for tensor in step.operation.inputs().chain([step.output]) {
                    let oldest = rows.oldest_read(tensor).unwrap_or(rows.computed[tensor.0]);
                    memory.give_back(tensor, oldest / UNIT, self.slot_len(tensor));
                }
            }
        }
        memory
    }
}

/// Floats from one slot to the next: the next begins on a cache line, and never at the same place of a page,
/// so that streams through several slots fall on different cache sets.
pub(super) fn slot_space(len: usize) -> usize {
    whole_lines(len) + SKEW
}

/// How many rows of each tensor have been computed.
pub(super) struct Rows<'a> {
    plan: &'a Plan<'a>,
    pub(super) computed: Vec<usize>,
    /// The steps that read each tensor.
    readers: Vec<Vec<usize>>,
    /// Rows that each step has computed, before shuffling.
    done: Vec<usize>,
    /// Input rows fed.
    fed: usize,
    /// Portions begun.
    portions: usize,
}

impl<'a> Rows<'a> {
    pub(super) fn new(plan: &'a Plan<'a>) -> Self {
        let network = plan.network;
        let mut readers = vec![Vec::new(); network.tensors.len()];
        for (s, step) in network.steps.iter().enumerate() {
            step.operation.inputs().for_each(|tensor| readers[tensor.0].push(s));
        }
        Self {
            plan,
            readers,
            computed: vec![0; network.tensors.len()],
            done: vec![0; network.steps.len()],
            fed: 0,
            portions: 0,
        }
    }

    /// The input rows to feed next, none once all are; nothing when the last step has computed its last row.
    pub(super) fn next_portion(&mut self) -> Option<Range<usize>> {
        let last = self.plan.network.steps.last()?.output;
        let start = self.fed;
        self.fed = (start + self.plan.portion).min(self.plan.height);
        self.portions += 1;
        (self.computed[last.0] < self.plan.height_of(last)).then_some(start..self.fed)
    }

    /// The rows that a step computes now, before shuffling: what its inputs allow, but no more than a portion,
    /// so that the last steps do not catch up all at once when the input ends. Counts them as computed.
    pub(super) fn advance(&mut self, step: usize) -> Range<usize> {
        let Step { operation, output } = &self.plan.network.steps[step];
        let height = self.plan.height_of(*output);
        // Rows that depend on `below` rows beneath them; none do at the image's end.
        let ready = |tensor: Tensor, below: usize| {
            let computed = self.computed[tensor.0];
            if computed == self.plan.height_of(tensor) { computed } else { computed.saturating_sub(below) }
        };
        let (rows, height, factor) = match operation {
            Operation::Convolution { convolution, input, add, .. } => {
                let (geometry, factor) = (convolution.geometry(), convolution.factor());
                let below = geometry.padding() * usize::from(geometry.stride == 1);
                let rows = ready(*input, below) / geometry.stride;
                let added = add.map_or(usize::MAX, |add| self.computed[add.0] / factor);
                (rows.min(added), height / factor, factor)
            }
            Operation::DynamicFilter { filter, condition, features } => {
                (self.computed[condition.0].min(ready(*features, filter.size() / 2)), height, 1)
            }
            Operation::Pixelwise { inputs, .. } => {
                let computed = inputs.iter().map(|input| self.computed[input.0]);
                (computed.min().unwrap_or(0), height, 1)
            }
        };
        let period = if self.plan.height / height < COARSE { 1 } else { 2 };
        let is_due = self.portions.is_multiple_of(period) || self.fed == self.plan.height;
        let most = if is_due { period * self.plan.portion * height / self.plan.height } else { 0 };
        let rows = rows.min(self.done[step] + most);
        let rows = if rows >= height { height } else { rows / BLOCK_ROWS * BLOCK_ROWS };
        let start = std::mem::replace(&mut self.done[step], rows);
        self.computed[output.0] = rows * factor;
        start..rows
    }

    /// The oldest row of a tensor that a step still has to read, if any step reads it.
    fn oldest_read(&self, tensor: Tensor) -> Option<usize> {
        let mut oldest = usize::MAX;
        for &s in &self.readers[tensor.0] {
            let done = self.done[s];
            match &self.plan.network.steps[s].operation {
                Operation::Convolution { convolution, input, add, .. } => {
                    let geometry = convolution.geometry();
                    if *input == tensor {
                        oldest = oldest.min((done * geometry.stride).saturating_sub(geometry.padding()));
                    }
                    if *add == Some(tensor) {
                        oldest = oldest.min(done * convolution.factor());
                    }
                }
                Operation::DynamicFilter { filter, condition, features } => {
                    if *condition == tensor {
                        oldest = oldest.min(done);
                    }
                    if *features == tensor {
                        oldest = oldest.min(done.saturating_sub(filter.size() / 2));
                    }
                }
                Operation::Pixelwise { inputs, .. } => {
                    if inputs.contains(&tensor) {
                        oldest = oldest.min(done);
                    }
                }
            }
        }
        (oldest < usize::MAX).then_some(oldest)
    }
}
