//! What a network's layers are listed as: names, shapes, the resolution that they are computed at.

/// One layer with weights.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Layer {
    /// The released name, without `.weight` and `.bias`.
    pub(super) name: String,
    /// What it holds.
    pub(super) weights: LayerWeights,
    /// 0 for full resolution, 1 for half, 2 for a quarter, …: where its output is computed.
    pub(super) level: usize,
}

/// The weights of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LayerWeights {
    /// A convolution with bias.
    Convolution { inputs: usize, outputs: usize, size: usize, place: Place },
    /// The one slope of a PReLU.
    Slope,
}

/// Where a convolution stands, by which it is initialised.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// None of those below.
    Plain,
    /// Inside a residual block.
    Residual,
    /// Last of a network whose result is added to an image that is nearly right.
    Correction,
}

/// Name, shape and initial distribution of one weight tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TensorSpec {
    /// The released name.
    pub(super) name: String,
    /// The shape.
    pub(super) shape: Vec<usize>,
    /// The layer that it belongs to.
    pub(super) weights: LayerWeights,
}

impl Layer {
    /// The layer's tensors, in a fixed order.
    pub(super) fn tensors(self) -> Vec<TensorSpec> {
        let weights = self.weights;
        let tensor = |part: &str, shape| TensorSpec { name: format!("{}.{part}", self.name), shape, weights };
        match weights {
            LayerWeights::Convolution { inputs, outputs, size, .. } => {
                vec![tensor("weight", vec![outputs, inputs, size, size]), tensor("bias", vec![outputs])]
            }
            LayerWeights::Slope => vec![tensor("weight", vec![1])],
        }
    }
}

/// Layers in the order in which they are listed.
#[derive(Default)]
pub(super) struct LayerList(pub(super) Vec<Layer>);

impl LayerList {
    /// Appends a convolution of inputs, outputs and size.
    pub(super) fn convolution(&mut self, name: impl Into<String>, extent: [usize; 3], level: usize) {
        self.convolution_at(Place::Plain, name.into(), extent, level);
    }

    /// Appends the convolution of inputs, outputs and size whose result is added to the image.
    pub(super) fn correction(&mut self, name: &str, extent: [usize; 3], level: usize) {
        self.convolution_at(Place::Correction, name.to_owned(), extent, level);
    }

    /// Appends the two 3 × 3 convolutions of a residual block.
    pub(super) fn res_block(&mut self, name: &str, channels: usize, level: usize) {
        for part in ["conv1", "conv2"] {
            self.convolution_at(Place::Residual, format!("{name}.{part}"), [channels, channels, 3], level);
        }
    }

    fn convolution_at(
        &mut self,
        place: Place,
        name: String,
        [inputs, outputs, size]: [usize; 3],
        level: usize,
    ) {
        let weights = LayerWeights::Convolution { inputs, outputs, size, place };
        self.0.push(Layer { name, weights, level });
    }

    /// Appends the slope of a PReLU.
    pub(super) fn slope(&mut self, name: String, level: usize) {
        self.0.push(Layer { name, weights: LayerWeights::Slope, level });
    }
}
