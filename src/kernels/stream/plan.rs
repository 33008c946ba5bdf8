//! The schedule of rows: what each step can compute when, and where in memory its rows lie.

use std::ops::Range;

use super::{Graph, Operation, Step, Tensor};
use crate::kernels::Geometry;
use crate::kernels::convolution::BLOCK_ROWS;
use crate::kernels::scratch::whole_lines;

/// Rows that a slot of most tensors holds: those of a block, so that every block lies in one piece.
const UNIT: usize = BLOCK_ROWS;

/// Rows that a slot holds of tensors that are shuffled, or added to shuffled ones.
const SHUFFLED_UNIT: usize = 2 * BLOCK_ROWS;

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
    pub(super) network: &'a Graph,
    pub(super) height: usize,
    pub(super) width: usize,
    /// Input rows taken at a time.
    pub(super) portion: usize,
    /// By how many rows each tensor lags behind the input's.
    pub(super) lags: Vec<usize>,
    /// Rows of each tensor's units.
    pub(super) unit_rows: Vec<usize>,
    pub(super) memory: Memory,
}

/// Where rows lie: slots of a few rows (a unit), each given to one tensor after another.
///
/// Row `y` of a tensor lies in its unit `(y + lag) / rows` at `(y + lag) % rows`, `rows` being those of a unit, so that
/// what a portion adds fills whole blocks.
#[derive(Default)]
pub(super) struct Memory {
    /// Floats of each slot.
    pub(super) slots: Vec<usize>,
    /// For each tensor the slot of every unit of its rows.
    pub(super) places: Vec<Vec<usize>>,
    /// Slots that nobody needs, in a list for each length; the one used last is given out first, as it may lie in a cache.
    free: Vec<(usize, Vec<usize>)>,
    /// Slots that the step before gave back, each with its length. The next step must not write them: it may begin
    /// before that one ends.
    in_use: Vec<(usize, usize)>,
    /// Units of each tensor that were given back.
    given_back: Vec<usize>,
}

impl Memory {
    /// Gives slots of `len` floats to a tensor until it has as many units.
    fn extend(&mut self, tensor: Tensor, units: usize, len: usize) {
        while self.places[tensor.0].len() < units {
            let slot = self.free_of(len).pop().unwrap_or_else(|| {
                self.slots.push(len);
                self.slots.len() - 1
            });
            self.places[tensor.0].push(slot);
        }
    }

    /// Takes a tensor's units above `first` back.
    fn give_back(&mut self, tensor: Tensor, first: usize, len: usize) {
        let from = std::mem::replace(&mut self.given_back[tensor.0], first);
        self.in_use.extend(self.places[tensor.0][from..first].iter().map(|&slot| (len, slot)));
    }

    /// Makes available what was given back so far.
    fn release(&mut self) {
        for (len, slot) in std::mem::take(&mut self.in_use) {
            self.free_of(len).push(slot);
        }
    }

    /// The slots of `len` floats that nobody needs. There are a handful of lengths.
    fn free_of(&mut self, len: usize) -> &mut Vec<usize> {
        let known = self.free.iter().position(|(of, _)| *of == len);
        let at = known.unwrap_or_else(|| {
            self.free.push((len, Vec::new()));
            self.free.len() - 1
        });
        &mut self.free[at].1
    }
}

impl<'a> Plan<'a> {
    /// Plans a run on images of `height` × `width`, multiples of [`Graph::reduction`], with `threads`.
    ///
    /// # Panics
    /// When a side is no multiple of [`Graph::reduction`].
    pub fn new(network: &'a Graph, height: usize, width: usize, threads: usize) -> Self {
        let rows = (PORTION * threads.max(2) / 2).max(PORTION_PIXELS / width.max(1));
        Self::with_portion(network, height, width, rows)
    }

    /// Plans a run that takes at least `rows` input rows at a time, where the image has so many.
    pub(super) fn with_portion(network: &'a Graph, height: usize, width: usize, rows: usize) -> Self {
        let reduction = network.reduction();
        assert!(
            height > 0 && width > 0 && height.is_multiple_of(reduction) && width.is_multiple_of(reduction),
            "{height} × {width} for a network that reduces sides by {reduction}"
        );
        let portion = rows.min(height).next_multiple_of(BLOCK_ROWS * reduction);
        let (lags, unit_rows) = (lags(network), unit_rows(network));
        let mut plan = Self { network, height, width, portion, lags, unit_rows, memory: Memory::default() };
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
        self.unit_rows[tensor.0] * self.row_len(tensor)
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

    /// The unit in which a tensor's row lies, and its number there.
    pub(super) fn place(&self, tensor: Tensor, row: usize) -> (usize, usize) {
        let rows = self.unit_rows[tensor.0];
        let shifted = row + self.lags[tensor.0] % rows;
        (shifted / rows, shifted % rows)
    }

    /// Units that hold a tensor's first rows.
    pub(super) fn units(&self, tensor: Tensor, rows: usize) -> usize {
        let of_unit = self.unit_rows[tensor.0];
        (rows + self.lags[tensor.0] % of_unit).div_ceil(of_unit)
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
                memory.extend(*input, self.units(*input, portion.end), self.slot_len(*input));
            }
            for (s, step) in self.network.steps.iter().enumerate() {
                rows.advance(s);
                let units = self.units(step.output, rows.computed[step.output.0]);
                memory.extend(step.output, units, self.slot_len(step.output));
                memory.release();
                // What nobody reads is the result, handed out at once.
                for tensor in step.operation.inputs().chain([step.output]) {
                    let oldest = rows.oldest_read(tensor).unwrap_or(rows.computed[tensor.0]);
                    memory.give_back(tensor, self.place(tensor, oldest).0, self.slot_len(tensor));
                }
            }
            memory.release();
        }
        memory
    }
}

/// Rows of each tensor's units.
fn unit_rows(network: &Graph) -> Vec<usize> {
    let mut rows = vec![UNIT; network.tensors.len()];
    for Step { operation, output } in &network.steps {
        if let Operation::Convolution { convolution, add, .. } = operation
            && convolution.factor() > 1
        {
            rows[output.0] = SHUFFLED_UNIT;
            if let Some(add) = add {
                rows[add.0] = SHUFFLED_UNIT;
            }
        }
    }
    rows
}

/// By how many rows each tensor lags behind the input's rows at its resolution while the input lasts.
///
/// A step computes whole blocks of [`BLOCK_ROWS`] rows, but they need not begin at multiples of it: where a portion
/// leaves a tensor, its next block begins. So a 3 × 3 convolution lags one row behind its input, not a block. What is
/// added to a convolution's result has to be cut into the same blocks, so tensors that are added lag by multiples of
/// a block.
fn lags(network: &Graph) -> Vec<usize> {
    let mut lags = vec![0; network.tensors.len()];
    let is_added = |tensor: Tensor| {
        network.steps.iter().any(
            |step| matches!(&step.operation, Operation::Convolution { add: Some(add), .. } if *add == tensor),
        )
    };
    for Step { operation, output } in &network.steps {
        lags[output.0] = match operation {
            Operation::Convolution { convolution, input, add, .. } => {
                let (geometry, factor) = (convolution.geometry(), convolution.factor());
                let least = (lags[input.0] + rows_below(geometry)).div_ceil(geometry.stride);
                let Some(add) = add else {
                    let block = if is_added(*output) { BLOCK_ROWS } else { 1 };
                    lags[output.0] = least.next_multiple_of(block) * factor;
                    continue;
                };
                let added = lags[add.0];
                let block = BLOCK_ROWS * factor;
                let least = (least * factor).max(added);
                added + (least - added).next_multiple_of(block)
            }
            Operation::DynamicFilter { filter, condition, features } => {
                lags[condition.0].max(lags[features.0] + filter.size() / 2)
            }
            Operation::Pixelwise { inputs, .. } => inputs.iter().map(|x| lags[x.0]).max().unwrap_or(0),
        };
        if is_added(*output) {
            lags[output.0] = lags[output.0].next_multiple_of(BLOCK_ROWS);
        }
    }
    lags
}

/// Rows that the last output of `n` whole strides of input rows needs beneath them: those of half a side, less the
/// stride's own, which lie beneath its middle one.
fn rows_below(geometry: Geometry) -> usize {
    (geometry.padding() + 1).saturating_sub(geometry.stride)
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
                let rows = ready(*input, rows_below(geometry)) / geometry.stride;
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
        let lag = self.plan.lags[output.0] / factor;
        let whole_blocks = ((rows + lag) / BLOCK_ROWS * BLOCK_ROWS).saturating_sub(lag);
        let rows = if rows >= height { height } else { whole_blocks };
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::Convolution;

    fn three_by_three(inputs: usize, outputs: usize, stride: usize) -> Convolution {
        let geometry = Geometry { inputs, outputs, side: 3, stride };
        Convolution::new(geometry, &vec![0.0; geometry.weight_len()], &vec![0.0; outputs])
    }

    #[test]
    fn convolutions_lag_by_rows_and_what_is_added_by_blocks() {
        let mut network = Graph::default();
        let image = network.input(4);
        let mut chain = image;
        for lag in 1..=3 {
            chain = network.convolution(chain, three_by_three(4, 4, 1), 0.2, None);
            assert_eq!(lags(&network)[chain.0], lag);
        }
        let half = network.convolution(chain, three_by_three(4, 4, 2), 0.2, None);
        assert_eq!(lags(&network)[half.0], 2, "three rows are one and a half");
        let block = network.res_block(half, three_by_three(4, 4, 1), three_by_three(4, 4, 1), 0.2);
        let lags = lags(&network);
        assert_eq!((lags[half.0], lags[block.0]), (4, 8), "what is added is cut into the same blocks");
    }

    /// Each of these convolutions needs two rows of its input again, and has one unit of it at most.
    #[test]
    fn a_chain_holds_no_more_than_what_is_read_again_and_a_portion() {
        let mut network = Graph::default();
        let mut chain = network.input(4);
        for _ in 0..40 {
            chain = network.convolution(chain, three_by_three(4, 4, 1), 0.2, None);
        }
        let plan = Plan::with_portion(&network, 4096, 512, 32);
        let row = plan.row_len(chain) * size_of::<f32>();
        let (held, portions) = (41 * 2 * UNIT * row, 3 * 32 * row);
        assert!(plan.bytes() < (held + portions) * 11 / 10, "{} of {}", plan.bytes(), held + portions);
    }
}
