//! Restores a window of an image by a network under the kernel code of its PSF.

use ndarray::{Array3, s};

use super::tiles::{ALIGNMENT, WindowCost, WindowOperator};
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::core::kernel_code::KernelCode;
use crate::core::progress::Progress;
use crate::network::{Inputs, Model, Planes};

/// What a network is told about the PSF.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Conditioning {
    /// Nothing.
    None,
    /// One code for the whole image.
    Code(KernelCode),
    /// A code for every pixel, `[b, height, width]` of the whole image.
    Map(Array3<f32>),
}

/// A network with what it is told about the PSF.
#[derive(Clone, Debug)]
pub(super) struct NetworkOperator<'a> {
    model: &'a Model,
    conditioning: Conditioning,
    /// The planes of the whole image that the network reads.
    planes: &'a Planes,
    /// Bytes beyond the least that many threads may take.
    room: u64,
}

impl<'a> NetworkOperator<'a> {
    /// Takes a network that is told nothing yet, and takes as much memory as its threads can use.
    pub(super) fn new(model: &'a Model) -> Self {
        Self { model, conditioning: Conditioning::None, planes: Planes::NONE, room: u64::MAX }
    }

    /// The network with what it is told; networks that need no code are told nothing.
    ///
    /// # Errors
    /// [`Error::Config`] when the network needs a code and there is none; [`Error::Shape`] when the code has
    /// another length than the network's.
    pub(super) fn told(self, conditioning: Conditioning) -> Result<Self> {
        let Some(expected) = self.model.architecture().code_len() else { return Ok(self) };
        let dim = match &conditioning {
            Conditioning::None => {
                let reason = format!("the model needs one of {expected} numbers");
                return Err(Error::config("kernel code", reason));
            }
            Conditioning::Code(code) => code.len(),
            Conditioning::Map(map) => map.dim().0,
        };
        if dim != expected {
            let found = format!("{dim}; use the bank that the model was trained with");
            return Err(Error::shape("kernel code", format!("{expected} numbers"), found));
        }
        Ok(Self { conditioning, ..self })
    }

    /// Hands the network planes of the whole image.
    pub(super) fn with_planes(self, planes: &'a Planes) -> Self {
        Self { planes, ..self }
    }

    /// Takes no more than `bytes` beyond the least, however many threads there are.
    pub(super) fn with_room(self, bytes: u64) -> Self {
        Self { room: bytes, ..self }
    }
}

impl WindowCost for NetworkOperator<'_> {
    fn halo(&self) -> usize {
        self.model.halo().next_multiple_of(self.alignment())
    }

    fn alignment(&self) -> usize {
        self.model.architecture().side_multiple().next_multiple_of(ALIGNMENT)
    }

    fn window_bytes(&self, height: usize, width: usize, room: u64) -> u64 {
        self.model.working_bytes_in(height, width, room)
    }

    fn copied_floats(&self) -> usize {
        CHANNELS * self.model.architecture().planes().len()
    }
}

impl WindowOperator for NetworkOperator<'_> {
    fn apply(
        &self,
        image: &ToneMappedImage,
        top: usize,
        left: usize,
        progress: &Progress,
    ) -> Result<ToneMappedImage> {
        let inputs = match &self.conditioning {
            Conditioning::None => Inputs::new(image, None),
            Conditioning::Code(code) => Inputs::new(image, Some(code)),
            Conditioning::Map(map) => {
                let window = s![.., top..top + image.height(), left..left + image.width()];
                Inputs::new(image, None).with_map(map.slice(window))
            }
        };
        let planes = self.planes.window([top, left], [image.height(), image.width()]);
        self.model.restore_in(&inputs.with_planes(&planes), self.room, progress)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::weights::Weights;
    use crate::network::{Architecture, Condition, Initialisation, Kind, Origin, Parameters, testing};
    use crate::restore::tiles::{Tiling, restore_tiled};

    fn model(kind: Kind, condition: Condition) -> Model {
        let architecture = Architecture { kind, condition, features: 2, ..Architecture::default() };
        let parameters = Parameters::random(&architecture, Initialisation::Paper, 6);
        Model::new(Weights { architecture, parameters, origin: Origin::default() })
    }

    /// Sums of 32-bit floats differ where windows begin elsewhere.
    #[test]
    fn tiles_of_every_network_are_those_of_the_whole_image() {
        let kinds = [
            (Kind::Discnet, Condition::ImagePsf),
            (Kind::Unet, Condition::None),
            (Kind::Srmdnf, Condition::ImagePsf),
            (Kind::Sftmd, Condition::ImagePsf),
            (Kind::DeUnet, Condition::Image),
            (Kind::Guided, Condition::None),
            (Kind::AllPlanes, Condition::None),
            (Kind::AllPlanesTensors, Condition::None),
        ];
        let value = |(c, y, x)| ((c * 7919 + y * 104_729 + x * 1299) % 1000) as f32 / 1000.0;
        let image = ToneMappedImage::from_planes(Array3::from_shape_fn((3, 50, 403), value)).unwrap();
        for (kind, condition) in kinds {
            let model = model(kind, condition);
            let code = Conditioning::Code(KernelCode::from_elem(5, 0.3));
            let planes = testing::planes_of(&image);
            let operator = NetworkOperator::new(&model).told(code).unwrap().with_planes(&planes);
            let whole = operator.apply(&image, 0, 0, &Progress::default()).unwrap();
            let largest = whole.as_slice().iter().fold(0.0f32, |m, v| m.max(v.abs()));
            let tiling = Tiling::with_tile([50, 403], 48, &operator).unwrap();
            let tiled = restore_tiled(&image, &tiling, &operator, &Progress::default()).unwrap();
            let pairs = whole.as_slice().iter().zip(tiled.as_slice());
            let error = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(error <= 1e-5 * largest, "{kind:?}: {error:e} of {largest}");
        }
    }

    #[test]
    fn an_interrupt_ends_the_restoration_of_a_window() {
        let model = model(Kind::Unet, Condition::None);
        let operator = NetworkOperator::new(&model);
        let image = ToneMappedImage::from_planes(Array3::zeros((3, 40, 40))).unwrap();
        let interrupted = Progress::new(None, std::sync::Arc::new(true.into()));
        assert!(matches!(operator.apply(&image, 0, 0, &interrupted), Err(Error::Interrupted)));
        operator.apply(&image, 0, 0, &Progress::default()).unwrap();
    }

    #[test]
    fn tiles_that_a_deep_network_cannot_halve_are_refused() {
        let model = model(Kind::DeUnet, Condition::Image);
        let operator = NetworkOperator::new(&model);
        let message = Tiling::with_tile([64, 64], 36, &operator).unwrap_err().to_string();
        assert!(message.contains("multiple of 16"), "{message}");
    }
}
