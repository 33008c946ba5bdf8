//! What computes whole images: the kernels' streamed rows, or the tensors of a device.

use std::fmt::Debug;

use burn::tensor::{Device, Tensor, TensorData};
use ndarray::{Array3, ArrayView3};

use super::backend::Backend;
use super::inputs::{InputTensors, Inputs};
use super::layers::LayerWeights;
use super::networks::Network;
use super::operations::uses_kernels;
use super::streamed::Streamed;
use super::weights::Weights;
use crate::core::error::Result;
use crate::core::image::CHANNELS;
use crate::core::progress::Progress;
use crate::kernels::Isa;

/// Feature maps as wide as what the widest layer of a resolution reads and writes together that exist at once: those of
/// the layer, its sums before the activation, and skip connections.
const LIVE_FEATURES: usize = 4;

/// A network ready to restore whole images, one after another or several at once.
pub(super) trait Engine: Debug + Send + Sync {
    /// Restores an image with up to `room` bytes more than the least to use; the result does not depend on `room`. The
    /// inputs are those that the network reads.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::core::error::Error::Interrupted).
    fn restore(&self, inputs: &Inputs<'_>, room: u64, progress: &Progress) -> Result<Array3<f32>>;

    /// Estimates the bytes that restoring an image of height and width takes with `room` bytes more than the least to
    /// use, the weights included, the image's own and the result's not.
    fn bytes(&self, size: [usize; 2], room: u64) -> u64;

    /// Pixels around a tile that its restoration may depend on.
    fn halo(&self) -> usize;
}

/// The engine for a network on a backend: streamed rows where the kernels compute and the network is written for them.
pub(super) fn engine(weights: &Weights, backend: Backend, isa: Isa) -> Box<dyn Engine> {
    let (Weights { architecture, parameters, .. }, device) = (weights, backend.device());
    match architecture.family().stream() {
        Some(stream) if uses_kernels(&device) => {
            Box::new(Streamed::new(architecture, parameters, stream, isa))
        }
        _ => Box::new(Tensors { network: Network::new(architecture, parameters, &device), device }),
    }
}

/// The network in Burn on any device, an image or tile at once.
#[derive(Debug)]
struct Tensors {
    network: Network,
    device: Device,
}

impl Tensors {
    fn tensor(&self, planes: ArrayView3<'_, f32>) -> Tensor<4> {
        let (channels, height, width) = planes.dim();
        let data = TensorData::new(planes.iter().copied().collect(), [1, channels, height, width]);
        Tensor::from_data(data, &self.device)
    }
}

impl Engine for Tensors {
    fn restore(&self, inputs: &Inputs<'_>, _room: u64, progress: &Progress) -> Result<Array3<f32>> {
        progress.check()?;
        let plane = |&plane| Some((plane, self.tensor(inputs.planes.get(plane)?.planes())));
        let restored = self.network.forward(InputTensors {
            image: self.tensor(inputs.image.planes()),
            map: inputs.map.map(|map| self.tensor(map)),
            planes: self.network.architecture().planes().iter().filter_map(plane).collect(),
        });
        let values = restored.try_into_vec_as::<f32>().expect("images are 32-bit floats");
        let shape = (CHANNELS, inputs.image.height(), inputs.image.width());
        Ok(Array3::from_shape_vec(shape, values).expect("a restored image has the sides of its input"))
    }

    /// Burn does not say what it takes: counted are [`LIVE_FEATURES`] of every resolution, and all that the network is
    /// given.
    fn bytes(&self, [height, width]: [usize; 2], _room: u64) -> u64 {
        let architecture = self.network.architecture();
        let padded = |side: usize| side.next_multiple_of(architecture.side_multiple());
        let mut widest = Vec::new();
        for layer in architecture.layers() {
            let LayerWeights::Convolution { inputs, outputs, .. } = layer.weights else { continue };
            widest.resize(widest.len().max(layer.level + 1), 0);
            widest[layer.level] = widest[layer.level].max(inputs + outputs);
        }
        let pixels = |level: usize| (padded(height) >> level) * (padded(width) >> level);
        let features: usize =
            widest.iter().enumerate().map(|(level, widest)| LIVE_FEATURES * widest * pixels(level)).sum();
        let given = CHANNELS * (1 + architecture.planes().len()) + architecture.code_len().unwrap_or(0);
        let floats = (features + given * pixels(0)) as u64 + architecture.parameters();
        floats * size_of::<f32>() as u64
    }

    fn halo(&self) -> usize {
        self.network.architecture().halo()
    }
}
