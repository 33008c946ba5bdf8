//! A network ready to restore images, together with where its weights come from.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use ndarray::{Array3, ArrayRef3, ArrayView3, Axis};
use serde_json::Value;

use super::architecture::Architecture;
use super::backend::Backend;
use super::discnet::DiscNet;
use super::weights::{self, Weights};
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::core::kernel_code::KernelCode;

/// Where weights come from, as far as their file says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Origin {
    /// The training's configuration and length.
    pub training: Option<Value>,
    /// Identity of the kernel bank whose codes the network was trained with.
    pub kernel_bank_sha256: Option<String>,
    /// The state dict of a PyTorch checkpoint that was read, where it has several.
    pub state_dict: Option<String>,
}

/// A network with its weights on a device, for inference.
#[derive(Clone, Debug)]
pub struct Model {
    network: DiscNet,
    origin: Origin,
    device: Device,
}

impl Model {
    /// Reads a model file or a PyTorch checkpoint.
    ///
    /// # Errors
    /// Those of [`weights::read`].
    pub fn load(path: &Path) -> Result<Self> {
        Self::load_on(path, Backend::default())
    }

    /// Reads a model file or a PyTorch checkpoint for a backend of choice.
    ///
    /// # Errors
    /// Those of [`weights::read`].
    pub fn load_on(path: &Path, backend: Backend) -> Result<Self> {
        Ok(Self::new(&weights::read(path)?, backend))
    }

    /// Puts weights on a backend's device.
    pub fn new(weights: &Weights, backend: Backend) -> Self {
        let device = backend.device();
        let network = DiscNet::new(&weights.architecture, &weights.parameters, &device);
        Self { network, origin: weights.origin.clone(), device }
    }

    /// The network's configuration.
    pub fn architecture(&self) -> &Architecture {
        self.network.architecture()
    }

    /// Where the weights come from.
    pub fn origin(&self) -> &Origin {
        &self.origin
    }

    /// Copies the weights to main memory.
    pub fn to_weights(&self) -> Weights {
        Weights {
            architecture: self.architecture().clone(),
            parameters: self.network.parameters(),
            origin: self.origin.clone(),
        }
    }

    /// Restores an image of any size; `code` describes its PSF, and is not looked at by networks that need
    /// none.
    ///
    /// # Errors
    /// [`Error::Config`] when the network needs a code and there is none; [`Error::Shape`] when the code has
    /// another length.
    pub fn restore(&self, image: &ToneMappedImage, code: Option<&KernelCode>) -> Result<ToneMappedImage> {
        let map = code.map(|code| code.view().insert_axis(Axis(1)).insert_axis(Axis(2)));
        self.run(image, map)
    }

    /// Restores an image whose PSF changes from pixel to pixel.
    ///
    /// # Shapes
    /// `map` `[b, height, width]`, of the image's sides.
    ///
    /// # Errors
    /// [`Error::Shape`] when the map does not fit the image or the network.
    pub fn restore_with_map(&self, image: &ToneMappedImage, map: &ArrayRef3<f32>) -> Result<ToneMappedImage> {
        let (_, height, width) = map.dim();
        if (height, width) != (image.height(), image.width()) {
            let expected = format!("{} × {} as the image has", image.height(), image.width());
            return Err(Error::shape("degradation map", expected, format!("{height} × {width}")));
        }
        self.run(image, Some(map.view()))
    }

    fn run(&self, image: &ToneMappedImage, map: Option<ArrayView3<'_, f32>>) -> Result<ToneMappedImage> {
        let map = if self.architecture().condition.uses_code() { Some(self.check_map(map)?) } else { None };
        let map = map.map(|map| self.batch(map.iter().copied().collect(), map.dim()));
        let (height, width) = (image.height(), image.width());
        let batch = self.batch(image.as_slice().to_vec(), (CHANNELS, height, width));
        let restored = self.network.forward(batch, map);
        let values = restored.try_into_vec_as::<f32>().expect("the network computes 32-bit floats");
        let planes = Array3::from_shape_vec((CHANNELS, height, width), values)
            .expect("the network keeps the image's shape");
        ToneMappedImage::from_planes(planes)
    }

    fn check_map<'a>(&self, map: Option<ArrayView3<'a, f32>>) -> Result<ArrayView3<'a, f32>> {
        let expected = self.architecture().code_dim;
        let Some(map) = map else {
            return Err(Error::config(
                "kernel code",
                format!(
                    "the model needs a code of {expected} numbers; give --bank BANK --angle A, --code FILE or \
                     --psf PSF"
                ),
            ));
        };
        if map.dim().0 != expected {
            let found = format!("{}; use the bank that the model was trained with", map.dim().0);
            return Err(Error::shape("kernel code", format!("{expected} numbers"), found));
        }
        Ok(map)
    }

    fn batch(&self, values: Vec<f32>, (channels, height, width): (usize, usize, usize)) -> Tensor<4> {
        Tensor::from_data(TensorData::new(values, [1, channels, height, width]), &self.device)
    }
}
