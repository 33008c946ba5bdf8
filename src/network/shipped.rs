//! The models that the program carries.

use std::path::Path;
use std::sync::LazyLock;

use sha2::{Digest, Sha256};

use super::model::Model;
use super::weights::{self, Weights};
use crate::core::error::Result;
use crate::core::psf::hex;

/// The name of the network that restores captures of any panel.
pub const GUIDED: &str = "guided";

/// Its weights; `assets/README.md` says what they were trained on.
static GUIDED_FILE: &[u8] = include_bytes!("../../assets/guided.safetensors");

static GUIDED_SHA256: LazyLock<String> = LazyLock::new(|| hex(&Sha256::digest(GUIDED_FILE)));

/// The bytes of the model that a name stands for, unless a file of that name is there; a folder of that name is no model.
pub fn shipped(name: &Path) -> Option<&'static [u8]> {
    (name == Path::new(GUIDED) && !name.is_file()).then_some(GUIDED_FILE)
}

/// The network that restores captures of any panel, whatever files there are.
///
/// # Errors
/// Those of [`weights::parse`], if the program is damaged.
pub fn guided_model() -> Result<Model> {
    guided_weights().map(Model::new)
}

/// As [`guided_model`], its weights.
///
/// # Errors
/// As [`guided_model`].
pub fn guided_weights() -> Result<Weights> {
    weights::parse(GUIDED_FILE, GUIDED)
}

/// SHA-256 of the file of [`guided_model`].
pub fn guided_sha256() -> &'static str {
    &GUIDED_SHA256
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::ToneMappedImage;
    use crate::network::{Backend, Inputs, Kind, Model, Plane, Planes};
    use ndarray::Array3;

    #[test]
    fn the_guided_network_is_carried_in_half_precision_and_reads_like_a_file() {
        let model = Model::load(Path::new(GUIDED)).unwrap();
        assert_eq!(model.architecture().kind, Kind::Guided);
        assert!(GUIDED_FILE.len() <= 3 << 20, "{} bytes", GUIDED_FILE.len());
        assert!(shipped(Path::new("guided.safetensors")).is_none());
    }

    /// What it adds to the deconvolved image is a few hundredths, and is off by a few hundredths of that.
    #[test]
    fn in_bfloat16_on_a_device_the_guided_network_is_near_itself() {
        let value = |(c, y, x): (usize, usize, usize)| {
            0.5 + 0.3 * ((c + y) as f32 * 0.3).sin() + 0.2 * ((x * y) as f32 * 0.05).cos()
        };
        let image = ToneMappedImage::from_planes(Array3::from_shape_fn((3, 64, 72), value)).unwrap();
        let planes =
            [(Plane::Deconvolved, 1.05, 0.0), (Plane::Noise, 0.02, 0.0), (Plane::Saturated, 0.0, 0.0)];
        let planes = planes.into_iter().chain([(Plane::Outside, 0.0, 0.4)]);
        let planes = planes.map(|(plane, scale, shift)| (plane, image.map_values(|v| scale * v + shift)));
        let planes: Planes = planes.collect();
        let exact = Model::load(Path::new(GUIDED)).unwrap().with_backend(Backend::AsDevice);
        let rounded = exact.with_bf16_products().unwrap();
        let restore = |model: Model| model.restore(&Inputs::new(&image, None).with_planes(&planes)).unwrap();
        let [exact, rounded] = [exact, rounded].map(restore);
        let errors = || exact.as_slice().iter().zip(rounded.as_slice()).map(|(a, b)| (a - b).abs());
        let largest = errors().fold(0.0, f32::max);
        let mean = errors().sum::<f32>() / exact.as_slice().len() as f32;
        assert!(largest > 1e-5 && largest < 2e-2 && mean < 2e-3, "{largest:e} {mean:e}");
    }
}
