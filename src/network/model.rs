//! A network ready to restore images, together with where its weights come from.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use serde_json::Value;

use super::architecture::Architecture;
use super::backend::Backend;
use super::engine::{Engine, engine};
use super::inputs::Inputs;
use super::precision::Precision;
use super::weights::{self, Weights};
use crate::core::error::{Error, Result};
use crate::core::image::ToneMappedImage;
use crate::core::progress::Progress;
use crate::core::tone::ToneCurve;
use crate::kernels::Isa;

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

impl Origin {
    /// φ∘C of the images that the network was trained with; none where the file does not say it.
    pub fn tone_curve(&self) -> Option<ToneCurve> {
        let curve = self.training.as_ref()?.get("tone-curve")?;
        let ToneCurve { alpha, x_max } = serde_json::from_value(curve.clone()).ok()?;
        ToneCurve::new(alpha, x_max).ok()
    }
}

/// A network with its weights, for inference: on CPUs whole images go through the kernels, without tensors of Burn, when
/// the network is written for them.
#[derive(Clone, Debug)]
pub struct Model {
    weights: Arc<Weights>,
    backend: Backend,
    /// What computes, where it is not the usual set.
    isa: Option<Isa>,
    /// What tensors on a device are of.
    precision: Precision,
    /// The weights ready for whole images, once the first is restored.
    engine: Arc<OnceLock<Box<dyn Engine>>>,
}

impl Model {
    /// Reads a model file or a PyTorch checkpoint.
    ///
    /// # Errors
    /// Those of [`weights::read`].
    pub fn load(path: &Path) -> Result<Self> {
        Ok(Self::new(weights::read(path)?))
    }

    /// Takes a model from the bytes of a model file, such as one that a program carries; `name` is what messages call it.
    ///
    /// # Errors
    /// Those of [`weights::parse`].
    pub fn parse(bytes: &[u8], name: &str) -> Result<Self> {
        Ok(Self::new(weights::parse(bytes, name)?))
    }

    /// Takes weights over.
    pub fn new(weights: Weights) -> Self {
        let (backend, precision) = (Backend::default(), Precision::default());
        Self { weights: Arc::new(weights), backend, isa: None, precision, engine: Arc::default() }
    }

    /// The same network on another backend.
    #[must_use]
    pub fn with_backend(&self, backend: Backend) -> Self {
        let (isa, precision) = (self.isa, self.precision);
        Self { weights: Arc::clone(&self.weights), backend, isa, precision, engine: Arc::default() }
    }

    /// What it computes on.
    pub fn backend(&self) -> Backend {
        self.backend
    }

    /// The same network, but with products of numbers rounded to bfloat16; nothing where this CPU has no instructions
    /// for them, or the network is not streamed through the kernels, or a device does not compute with such numbers.
    ///
    /// # Accuracy
    /// On the CPU a trained network's results differ from those of 32-bit products by up to 3e-3 of white, 3e-4 in the mean
    /// square: sums, images and features stay 32 bits wide. On a device features are rounded too, but for the last layer's.
    pub fn with_bf16_products(&self) -> Option<Self> {
        if !self.backend.is_cpu() {
            let precision = Precision::Bf16;
            let supports = self.backend.supports(precision);
            return supports.then(|| Self { precision, ..self.with_backend(self.backend) });
        }
        self.architecture().family().stream()?;
        let isa = Isa::current().with_bf16_products()?;
        Some(Self { isa: Some(isa), ..self.with_backend(self.backend) })
    }

    /// Whether products are of numbers rounded to bfloat16.
    pub fn has_bf16_products(&self) -> bool {
        self.isa.is_some() || self.precision == Precision::Bf16
    }

    /// The network's configuration.
    pub fn architecture(&self) -> &Architecture {
        &self.weights.architecture
    }

    /// Where the weights come from.
    pub fn origin(&self) -> &Origin {
        &self.weights.origin
    }

    /// Architecture, weights and origin.
    pub fn weights(&self) -> &Weights {
        &self.weights
    }

    /// Packs the weights for whole images; the first that is restored or asked about does it otherwise.
    pub fn prepare(&self) {
        self.engine();
    }

    /// Restores an image of any size; what the network does not read of its inputs is not looked at.
    ///
    /// # Errors
    /// [`Error::Config`] when the network reads a code or a plane and there is none; [`Error::Shape`] when one does not
    /// fit the image or the network; [`Error::Diverged`] when what the network computes is not finite.
    pub fn restore(&self, inputs: &Inputs<'_>) -> Result<ToneMappedImage> {
        self.restore_in(inputs, u64::MAX, &Progress::default())
    }

    /// Restores an image with up to `room` bytes more than the least that it takes, which many threads make use of. The
    /// result does not depend on `room`.
    ///
    /// # Errors
    /// Those of [`restore`](Self::restore); [`Error::Interrupted`].
    pub fn restore_in(&self, inputs: &Inputs<'_>, room: u64, progress: &Progress) -> Result<ToneMappedImage> {
        let inputs = inputs.checked(self.architecture())?;
        let planes = self.engine().restore(&inputs, room, progress)?;
        ToneMappedImage::from_planes(planes).map_err(|_| {
            let reason = "the network's output holds a NaN or an infinity: its weights have diverged; use a model of an earlier \
                          iteration";
            Error::Diverged(reason.to_owned())
        })
    }

    /// Pixels around a tile, starting at a multiple of [`Architecture::side_multiple`], that its restoration may depend
    /// on.
    pub fn halo(&self) -> usize {
        self.engine().halo()
    }

    /// Estimates the bytes of working memory that restoring an image of these sides takes at least, whatever the number
    /// of threads.
    pub fn working_bytes(&self, height: usize, width: usize) -> u64 {
        self.working_bytes_in(height, width, 0)
    }

    /// Estimates the bytes that it takes with up to `room` bytes more than the least.
    pub fn working_bytes_in(&self, height: usize, width: usize, room: u64) -> u64 {
        self.engine().bytes([height, width], room)
    }

    fn engine(&self) -> &dyn Engine {
        let isa = || self.isa.unwrap_or_else(Isa::current);
        self.engine.get_or_init(|| engine(&self.weights, (self.backend, self.precision), isa())).as_ref()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::kernel_code::KernelCode;
    use crate::network::{Initialisation, Parameters};
    use ndarray::Array3;

    fn model(condition: super::super::Condition) -> Model {
        let architecture = Architecture { features: 2, condition, ..Architecture::default() };
        let parameters = Parameters::random(&architecture, Initialisation::Released, 3);
        Model::new(Weights { architecture, parameters, origin: Origin::default() })
    }

    fn image(height: usize, width: usize) -> ToneMappedImage {
        let planes = Array3::from_shape_fn((3, height, width), |(c, y, x)| (c + 2 * y + 3 * x) as f32 / 99.0);
        ToneMappedImage::from_planes(planes).unwrap()
    }

    #[test]
    fn rounded_products_change_results_by_no_more_than_rounding() {
        let architecture = Architecture { features: 32, ..Architecture::default() };
        let parameters = Parameters::random(&architecture, Initialisation::Released, 3);
        let exact = Model::new(Weights { architecture, parameters, origin: Origin::default() });
        let Some(rounded) = exact.with_bf16_products() else { return };
        assert!(rounded.has_bf16_products() && !exact.has_bf16_products());
        let code = KernelCode::from_elem(5, 0.5);
        let [of_exact, of_rounded] =
            [&exact, &rounded].map(|model| model.restore(&Inputs::new(&image(21, 34), Some(&code))).unwrap());
        let differences = of_exact.as_slice().iter().zip(of_rounded.as_slice()).map(|(a, b)| (a - b).abs());
        let largest = differences.fold(0.0, f32::max);
        assert!(largest > 1e-6 && largest < 3e-3, "{largest}");
    }

    #[test]
    fn images_of_any_size_keep_it() {
        let (model, code) = (model(super::super::Condition::ImagePsf), KernelCode::from_elem(5, 0.5));
        for (height, width) in [(1, 1), (2, 9), (4, 8), (13, 6)] {
            let restored = model.restore(&Inputs::new(&image(height, width), Some(&code))).unwrap();
            assert_eq!((restored.height(), restored.width()), (height, width));
        }
    }

    #[test]
    fn networks_that_need_no_code_do_not_look_at_one() {
        let (model, code) = (model(super::super::Condition::Image), KernelCode::from_elem(2, 0.5));
        let image = image(6, 7);
        let restore = |code| model.restore(&Inputs::new(&image, code)).unwrap();
        assert_eq!(restore(Some(&code)), restore(None));
    }

    #[test]
    fn a_map_of_other_sides_than_the_image_is_refused() {
        let model = model(super::super::Condition::Psf);
        let (image, map) = (image(6, 7), Array3::zeros((5, 6, 6)));
        let inputs = Inputs::new(&image, None).with_map(map.view());
        let message = model.restore(&inputs).unwrap_err().to_string();
        assert!(message.contains("expected 6 × 7"), "{message}");
    }
}
