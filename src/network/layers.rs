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
    /// A convolution with bias; those inside residual blocks are initialised on their own terms.
    Convolution { inputs: usize, outputs: usize, size: usize, residual: bool },
    /// The one slope of a PReLU.
    Slope,
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
    /// Appends a convolution.
    pub(super) fn convolution(
        &mut self,
        name: impl Into<String>,
        [inputs, outputs, size]: [usize; 3],
        level: usize,
    ) {
        let weights = LayerWeights::Convolution { inputs, outputs, size, residual: false };
        self.0.push(Layer { name: name.into(), weights, level });
    }

    /// Appends the two 3 × 3 convolutions of a residual block.
    pub(super) fn res_block(&mut self, name: &str, channels: usize, level: usize) {
        let weights =
            LayerWeights::Convolution { inputs: channels, outputs: channels, size: 3, residual: true };
        for part in ["conv1", "conv2"] {
            self.0.push(Layer { name: format!("{name}.{part}"), weights, level });
        }
    }

    /// Appends the slope of a PReLU.
    pub(super) fn slope(&mut self, name: String, level: usize) {
        self.0.push(Layer { name, weights: LayerWeights::Slope, level });
    }
}
