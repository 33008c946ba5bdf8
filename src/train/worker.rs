//! What computes the loss of samples and its gradients on one device.

use burn::tensor::{Device, Gradients as BurnGradients, Tensor, TensorData};

use super::config::TrainConfig;
use super::data::Patch;
use super::loss::Loss;
use super::on_device::Gather;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::network::{Architecture, Backend, InputTensors, Network, Parameters, Plane, Precision};

/// A device with the loss of a training on it.
#[derive(Clone, Debug)]
pub(super) struct Worker {
    pub(super) backend: Backend,
    /// Its device with gradients.
    pub(super) device: Device,
    loss: Loss,
    architecture: Architecture,
    precision: Precision,
    /// The names of all weights.
    names: Vec<String>,
}

impl Worker {
    /// Reads what the loss needs.
    ///
    /// # Errors
    /// Those of [`Loss::new`], of [`Backend::check_training`] and of [`Backend::check_batch`].
    pub(super) fn new(config: &TrainConfig, parameters: &Parameters, backend: Backend) -> Result<Self> {
        backend.check_training(config.precision)?;
        backend.check_batch(config.data.batch * config.data.crop.pow(2))?;
        Ok(Self {
            backend,
            device: backend.device().autodiff(),
            loss: Loss::new(&config.loss, backend)?,
            architecture: config.architecture.clone(),
            precision: config.precision,
            names: parameters.iter().map(|parameter| parameter.name.clone()).collect(),
        })
    }

    /// The same with another loss.
    #[cfg(test)]
    pub(super) fn with_loss(self, loss: Loss) -> Self {
        Self { loss, ..self }
    }

    /// The network of weights in main memory.
    pub(super) fn network(&self, parameters: &Parameters) -> Network {
        Network::new(&self.architecture, parameters, &self.device).in_precision(self.precision)
    }

    /// The network of weights that the device holds one after another.
    pub(super) fn network_of_flat(&self, weights: &Tensor<1>) -> Network {
        Network::of_flat(&self.architecture, weights, &self.device).in_precision(self.precision)
    }

    /// The loss of a batch.
    pub(super) fn loss(&self, network: &Network, patches: &[Patch]) -> Result<f64> {
        let batch = Batch::new(network, patches, &self.device)?;
        Ok(self.loss.of(network.forward(batch.inputs), batch.ground_truth)?.0)
    }

    /// The loss of a batch, and what Burn makes of it on the way back.
    pub(super) fn backward(&self, network: &Network, patches: &[Patch]) -> Result<(f64, BurnGradients)> {
        let batch = Batch::new(network, patches, &self.device)?;
        let restored = network.forward(batch.inputs);
        let (value, loss) = self.loss.of(restored, batch.ground_truth)?;
        Ok((value, loss.backward()))
    }

    /// The loss of a batch and its gradients, one after another on the device.
    pub(super) fn gradients(&self, network: &Network, patches: &[Patch]) -> Result<(f64, Tensor<1>)> {
        let (loss, backward) = self.backward(network, patches)?;
        let found = Gather::of(network, backward, self.names.len());
        Ok((loss, Tensor::cat(self.complete(found)?, 0)))
    }

    /// Every weight's gradient; refuses to take one that is missing for zero, under which it would never change.
    pub(super) fn complete<G>(&self, found: Vec<Option<G>>) -> Result<Vec<G>> {
        let missing = |(values, name): (&Option<G>, &String)| values.is_none().then(|| name.clone());
        let names: Vec<String> = found.iter().zip(&self.names).filter_map(missing).collect();
        if names.is_empty() {
            return Ok(found.into_iter().flatten().collect());
        }
        Err(Error::Unsupported(format!(
            "the loss has no gradient to {}: the network does not use it, and it would stay as it is; this is a fault of \
             the architecture in udc, please report it with the run's config.toml",
            names.join(", ")
        )))
    }
}

/// Samples as tensors.
pub(super) struct Batch {
    pub(super) inputs: InputTensors,
    pub(super) ground_truth: Tensor<4>,
}

impl Batch {
    pub(super) fn new(network: &Network, patches: &[Patch], device: &Device) -> Result<Self> {
        let degraded = stack(patches.iter().map(|patch| &patch.degraded), device);
        let mut inputs = InputTensors::new(degraded, Self::codes(network, patches, device)?);
        for &plane in network.architecture().planes() {
            let planes = patches.iter().map(|patch| patch.planes.get(plane).ok_or_else(|| lacking(plane)));
            inputs.planes.insert(plane, stack(planes.collect::<Result<Vec<_>>>()?.into_iter(), device));
        }
        Ok(Self { inputs, ground_truth: stack(patches.iter().map(|patch| &patch.ground_truth), device) })
    }

    fn codes(network: &Network, patches: &[Patch], device: &Device) -> Result<Option<Tensor<4>>> {
        let Some(dim) = network.architecture().code_len() else { return Ok(None) };
        let mut values = Vec::with_capacity(patches.len() * dim);
        for patch in patches {
            let code = patch.code.as_ref().map_or(&[][..], |code| code.as_slice().unwrap_or_default());
            if code.len() != dim {
                let expected = format!("{dim} numbers, architecture.code-dim");
                return Err(Error::shape(
                    "kernel code of the training data",
                    expected,
                    code.len().to_string(),
                ));
            }
            values.extend_from_slice(code);
        }
        Ok(Some(Tensor::from_data(TensorData::new(values, [patches.len(), dim, 1, 1]), device)))
    }
}

/// Images of one size, one after another.
fn stack<'a>(
    images: impl ExactSizeIterator<Item = &'a ToneMappedImage> + Clone,
    device: &Device,
) -> Tensor<4> {
    let count = images.len();
    let first = images.clone().next().expect("a batch has samples");
    let shape = [count, CHANNELS, first.height(), first.width()];
    let values: Vec<f32> = images.flat_map(|image| image.as_slice()).copied().collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

fn lacking(plane: Plane) -> Error {
    let reason = format!(
        "the network reads the plane \"{}\" of every image, and the training data have none",
        plane.name()
    );
    Error::config("planes", reason)
}
