//! Runs a whole network a few rows at a time.
//!
//! # Method
//! A network without loops can be computed top to bottom: once its input has a few more rows, each step in
//! turn computes the output rows that its inputs allow. So no tensor is ever whole; each keeps just the rows
//! that a later step still needs: a handful where the next step is the only reader, and some 120 for the
//! skip connection of the finest resolution, which waits for the path through the coarsest. Nothing is
//! computed twice and nothing depends on where one portion of rows ends: the result is that of the whole
//! image, bit for bit.
//!
//! # Memory
//! [`Plan`] plays the schedule through with row numbers only and gives each few rows of a tensor a slot from
//! when they are computed to when they were last read. From the next step but one on, another tensor may have it,
//! the slot that was given back last before the others, so that most of what a step writes and reads still lies in a
//! cache. What all slots take is known before the run and grows with the image's width, not with its height. It is kept
//! for the next image ([`Arena`]), which then needs no fresh pages of the system.

#[cfg(test)]
mod network_tests;
mod pixelwise;
mod plan;
mod run;
mod tasks;

pub use plan::Plan;
pub use run::{Arena, Source};

use super::convolution::Convolution;
use super::dynamic_filter::DynamicFilter;
use pixelwise::Pixelwise;

/// A tensor of a network under construction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tensor(usize);

/// The steps of a network, in an order in which each finds its inputs computed.
#[derive(Default)]
pub struct Graph {
    tensors: Vec<TensorSpec>,
    steps: Vec<Step>,
    inputs: Vec<Tensor>,
}

/// What is known of a tensor before the image's size.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TensorSpec {
    channels: usize,
    /// Sides of the network's input per side of this tensor.
    reduction: usize,
}

struct Step {
    operation: Operation,
    output: Tensor,
}

enum Operation {
    Convolution { convolution: Convolution, input: Tensor, slope: f32, add: Option<Tensor> },
    DynamicFilter { filter: DynamicFilter, condition: Tensor, features: Tensor },
    Pixelwise { function: Pixelwise, inputs: Vec<Tensor> },
}

impl Operation {
    /// The tensors that it reads.
    fn inputs(&self) -> impl Iterator<Item = Tensor> {
        let (several, one, other): (&[Tensor], _, _) = match self {
            Self::Convolution { input, add, .. } => (&[], Some(*input), *add),
            Self::DynamicFilter { condition, features, .. } => (&[], Some(*condition), Some(*features)),
            Self::Pixelwise { inputs, .. } => (inputs, None, None),
        };
        several.iter().copied().chain(one).chain(other)
    }

    /// One past the last row of a tensor that the rows before `end` (before shuffling) depend on.
    fn rows_needed(&self, tensor: Tensor, end: usize) -> usize {
        match self {
            Self::Convolution { convolution, input, add, .. } => {
                let geometry = convolution.geometry();
                let of_input = (end - 1) * geometry.stride + geometry.padding() + 1;
                let of_added = end * convolution.factor();
                let (is_input, is_added) = (*input == tensor, *add == Some(tensor));
                (of_input * usize::from(is_input)).max(of_added * usize::from(is_added))
            }
            Self::DynamicFilter { filter, features, .. } if *features == tensor => end + filter.size() / 2,
            Self::DynamicFilter { .. } | Self::Pixelwise { .. } => end,
        }
    }
}

impl Graph {
    /// Declares an input of as many channels.
    ///
    /// # Panics
    /// When there are none.
    pub fn input(&mut self, channels: usize) -> Tensor {
        assert!(channels > 0, "an input of {channels} channels");
        let input = self.tensor(TensorSpec { channels, reduction: 1 });
        self.inputs.push(input);
        input
    }

    /// Appends a convolution, a leaky rectifier of slope `slope` (1 for none), and the addition of a tensor.
    ///
    /// # Panics
    /// When the convolution reads another number of channels than `input` has, when what is added has other sides or
    /// channels than the result, or when the result would be larger than the network's input.
    pub fn convolution(
        &mut self,
        input: Tensor,
        convolution: Convolution,
        slope: f32,
        add: Option<Tensor>,
    ) -> Tensor {
        let spec = self.tensors[input.0];
        assert_eq!(spec.channels, convolution.geometry().inputs, "channels that a convolution reads");
        let factor = convolution.factor();
        let reduced = spec.reduction * convolution.geometry().stride;
        assert!(
            reduced.is_multiple_of(factor),
            "sides {factor} times those of a tensor reduced by {reduced}"
        );
        let reduction = reduced / factor;
        let channels = convolution.geometry().outputs / (factor * factor);
        let spec = TensorSpec { channels, reduction };
        if let Some(add) = add {
            assert_eq!(self.tensors[add.0], spec, "what is added to a convolution, and its result");
        }
        let output = self.tensor(spec);
        self.steps
            .push(Step { operation: Operation::Convolution { convolution, input, slope, add }, output });
        output
    }

    /// Appends `x + second(leak(first(x)))`.
    pub fn res_block(&mut self, x: Tensor, first: Convolution, second: Convolution, slope: f32) -> Tensor {
        let inner = self.convolution(x, first, slope, None);
        self.convolution(inner, second, 1.0, Some(x))
    }

    /// Appends a dynamic filter.
    ///
    /// # Panics
    /// When the filter is made for another number of channels than the conditions have, or these have other sides or
    /// channels than the features.
    pub fn dynamic_filter(&mut self, condition: Tensor, features: Tensor, filter: DynamicFilter) -> Tensor {
        let spec = self.tensors[condition.0];
        assert_eq!(spec.channels, filter.channels(), "channels that a dynamic filter reads");
        assert_eq!(self.tensors[features.0], spec, "features of a dynamic filter, and its conditions");
        let output = self.tensor(spec);
        self.steps.push(Step { operation: Operation::DynamicFilter { filter, condition, features }, output });
        output
    }

    /// Appends the concatenation of two tensors' channels.
    ///
    /// # Panics
    /// When the tensors have different sides.
    pub fn concatenate(&mut self, first: Tensor, second: Tensor) -> Tensor {
        let channels = self.tensors[first.0].channels + self.tensors[second.0].channels;
        self.pixelwise(Pixelwise::Concatenate, vec![first, second], channels)
    }

    /// Appends the sum of two tensors.
    ///
    /// # Panics
    /// When the tensors have different sides or channels.
    pub fn add(&mut self, first: Tensor, second: Tensor) -> Tensor {
        let channels = self.tensors[first.0].channels;
        assert_eq!(self.tensors[second.0].channels, channels, "channels of tensors that are added");
        self.pixelwise(Pixelwise::Add, vec![first, second], channels)
    }

    /// Appends `leak(x · sigmoid(scale) + offset)`, the leaky rectifier having slope `slope` (1 for none).
    ///
    /// # Panics
    /// When the tensors have different sides or channels.
    pub fn modulate(&mut self, x: Tensor, scale: Tensor, offset: Tensor, slope: f32) -> Tensor {
        let channels = self.tensors[x.0].channels;
        for other in [scale, offset] {
            assert_eq!(self.tensors[other.0].channels, channels, "channels of what modulates a tensor");
        }
        self.pixelwise(Pixelwise::Modulate { slope }, vec![x, scale, offset], channels)
    }

    fn pixelwise(&mut self, function: Pixelwise, inputs: Vec<Tensor>, channels: usize) -> Tensor {
        let reduction = self.tensors[inputs[0].0].reduction;
        for input in &inputs {
            assert_eq!(self.tensors[input.0].reduction, reduction, "sides of tensors joined pixel by pixel");
        }
        let output = self.tensor(TensorSpec { channels, reduction });
        self.steps.push(Step { operation: Operation::Pixelwise { function, inputs }, output });
        output
    }

    /// The largest number of sides of the input per side of a tensor: the image's sides must be multiples.
    pub fn reduction(&self) -> usize {
        self.tensors.iter().map(|t| t.reduction).max().unwrap_or(1)
    }

    fn tensor(&mut self, spec: TensorSpec) -> Tensor {
        self.tensors.push(spec);
        Tensor(self.tensors.len() - 1)
    }
}
