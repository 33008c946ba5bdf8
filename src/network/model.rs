//! A network ready to restore images, together with where its weights come from.

use std::path::Path;
use std::sync::{Arc, OnceLock};

use ndarray::{ArrayRef3, ArrayView3, Axis};
use serde_json::Value;

use super::architecture::Architecture;
use super::inference::Inference;
use super::weights::{self, Weights};
use crate::core::error::{Error, Result};
use crate::core::image::ToneMappedImage;
use crate::core::kernel_code::KernelCode;
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

/// A network with its weights, for inference: whole images go through the kernels, without tensors of Burn.
#[derive(Clone, Debug)]
pub struct Model {
    weights: Arc<Weights>,
    /// What computes, where it is not the usual set.
    isa: Option<Isa>,
    /// The weights packed for whole images, once the first is restored.
    inference: Arc<OnceLock<Inference>>,
}

impl Model {
    /// Reads a model file or a PyTorch checkpoint.
    ///
    /// # Errors
    /// Those of [`weights::read`].
    pub fn load(path: &Path) -> Result<Self> {
        Ok(Self::new(weights::read(path)?))
    }

    /// Takes weights over.
    pub fn new(weights: Weights) -> Self {
        Self { weights: Arc::new(weights), isa: None, inference: Arc::default() }
    }

    /// The same network, but with products of numbers rounded to bfloat16; nothing where this CPU has no instructions
    /// for them.
    ///
    /// # Accuracy
    /// A trained network's results differ from those of 32-bit products by up to 3e-3 of white, 3e-4 in the mean square:
    /// sums, images and features stay 32 bits wide.
    pub fn with_bf16_products(&self) -> Option<Self> {
        let isa = Isa::current().with_bf16_products()?;
        Some(Self { weights: Arc::clone(&self.weights), isa: Some(isa), inference: Arc::default() })
    }

    /// Whether products are of numbers rounded to bfloat16.
    pub fn has_bf16_products(&self) -> bool {
        self.isa.is_some()
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
        self.inference();
    }

    /// Restores an image of any size; `code` describes its PSF, and is not looked at by networks that need
    /// none.
    ///
    /// # Errors
    /// [`Error::Config`] when the network needs a code and there is none; [`Error::Shape`] when the code has
    /// another length; [`Error::Diverged`] when what the network computes is not finite.
    pub fn restore(&self, image: &ToneMappedImage, code: Option<&KernelCode>) -> Result<ToneMappedImage> {
        self.restore_in(image, code.map(map_of_code), u64::MAX, &Progress::default())
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
        self.restore_in(image, Some(map.view()), u64::MAX, &Progress::default())
    }

    /// Restores an image with up to `room` bytes more than the least that it takes, which many threads make use of;
    /// `map` has the image's sides, or is that of one code. The result does not depend on `room`.
    pub(crate) fn restore_in(
        &self,
        image: &ToneMappedImage,
        map: Option<ArrayView3<'_, f32>>,
        room: u64,
        progress: &Progress,
    ) -> Result<ToneMappedImage> {
        let map = if self.architecture().condition.uses_code() { Some(self.check_map(map)?) } else { None };
        let planes = self.inference().restore(image, map, room, progress)?;
        if let Some(value) = planes.iter().find(|value| !value.is_finite()) {
            return Err(Error::Diverged(format!(
                "the network's output holds {value}: its weights have diverged; use a model of an earlier iteration"
            )));
        }
        ToneMappedImage::from_planes(planes)
    }

    /// Estimates the bytes of working memory that restoring an image of these sides takes at least, whatever the number
    /// of threads.
    pub fn working_bytes(&self, height: usize, width: usize) -> u64 {
        self.working_bytes_in(height, width, 0)
    }

    /// Estimates the bytes that it takes with up to `room` bytes more than the least.
    pub(crate) fn working_bytes_in(&self, height: usize, width: usize, room: u64) -> u64 {
        self.inference().bytes(self.architecture(), [height, width], room)
    }

    fn inference(&self) -> &Inference {
        let isa = || self.isa.unwrap_or_else(Isa::current);
        self.inference.get_or_init(|| Inference::new(self.architecture(), &self.weights.parameters, isa()))
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
}

/// A code as the degradation map of an image of one pixel.
pub(crate) fn map_of_code(code: &KernelCode) -> ArrayView3<'_, f32> {
    code.view().insert_axis(Axis(1)).insert_axis(Axis(2))
}

#[cfg(test)]
mod tests {
    use super::*;
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
            [&exact, &rounded].map(|model| model.restore(&image(21, 34), Some(&code)).unwrap());
        let differences = of_exact.as_slice().iter().zip(of_rounded.as_slice()).map(|(a, b)| (a - b).abs());
        let largest = differences.fold(0.0, f32::max);
        assert!(largest > 1e-6 && largest < 3e-3, "{largest}");
    }

    #[test]
    fn images_of_any_size_keep_it() {
        let (model, code) = (model(super::super::Condition::ImagePsf), KernelCode::from_elem(5, 0.5));
        for (height, width) in [(1, 1), (2, 9), (4, 8), (13, 6)] {
            let restored = model.restore(&image(height, width), Some(&code)).unwrap();
            assert_eq!((restored.height(), restored.width()), (height, width));
        }
    }

    #[test]
    fn networks_that_need_no_code_do_not_look_at_one() {
        let (model, code) = (model(super::super::Condition::Image), KernelCode::from_elem(2, 0.5));
        let image = image(6, 7);
        assert_eq!(model.restore(&image, Some(&code)).unwrap(), model.restore(&image, None).unwrap());
    }

    #[test]
    fn a_map_of_other_sides_than_the_image_is_refused() {
        let model = model(super::super::Condition::Psf);
        let message =
            model.restore_with_map(&image(6, 7), &Array3::zeros((5, 6, 6))).unwrap_err().to_string();
        assert!(message.contains("expected 6 × 7"), "{message}");
    }
}
