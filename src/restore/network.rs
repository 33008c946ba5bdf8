//! Restores a window of an image by a network under the kernel code of its PSF.

use ndarray::{Array3, s};

use super::tiles::Restorer;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::core::kernel_code::KernelCode;
use crate::network::Model;

/// What a network is told about the PSF.
#[derive(Clone, Debug, PartialEq)]
pub enum Conditioning {
    /// Nothing.
    None,
    /// One code for the whole image.
    Code(KernelCode),
    /// A code for every pixel, `[b, height, width]` of the whole image.
    Map(Array3<f32>),
}

/// A network with what it is told about the PSF.
#[derive(Clone, Debug)]
pub struct NetworkRestorer<'a> {
    model: &'a Model,
    conditioning: Conditioning,
}

impl<'a> NetworkRestorer<'a> {
    /// Puts a network and a code together.
    ///
    /// # Errors
    /// [`Error::Config`] when the network needs a code and there is none; [`Error::Shape`] when the code has
    /// another length than the network's.
    pub fn new(model: &'a Model, conditioning: Conditioning) -> Result<Self> {
        let architecture = model.architecture();
        if !architecture.condition.uses_code() {
            return Ok(Self { model, conditioning: Conditioning::None });
        }
        let dim = match &conditioning {
            Conditioning::None => {
                let reason = format!("the model needs one of {} numbers", architecture.code_dim);
                return Err(Error::config("kernel code", reason));
            }
            Conditioning::Code(code) => code.len(),
            Conditioning::Map(map) => map.dim().0,
        };
        if dim != architecture.code_dim {
            let found = format!("{dim}; use the bank that the model was trained with");
            return Err(Error::shape("kernel code", format!("{} numbers", architecture.code_dim), found));
        }
        Ok(Self { model, conditioning })
    }
}

impl Restorer for NetworkRestorer<'_> {
    fn window_bytes(&self, height: usize, width: usize) -> u64 {
        // The window is copied out of the image and restored to another copy.
        let copies = 2 * (CHANNELS * size_of::<f32>() * height * width) as u64;
        copies + self.model.working_bytes(height, width)
    }

    fn restore(&self, image: &ToneMappedImage, top: usize, left: usize) -> Result<ToneMappedImage> {
        match &self.conditioning {
            Conditioning::None => self.model.restore(image, None),
            Conditioning::Code(code) => self.model.restore(image, Some(code)),
            Conditioning::Map(map) => {
                let window = s![.., top..top + image.height(), left..left + image.width()];
                self.model.restore_with_map(image, &map.slice(window))
            }
        }
    }
}
