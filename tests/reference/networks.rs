//! The networks that DISCNet is compared with against the same networks in PyTorch.

use std::path::{Path, PathBuf};

use ndarray::{Array1, Array3};
use udc::core::image::ToneMappedImage;
use udc::network::weights::{self, Weights};
use udc::network::{Architecture, Condition, Inputs, Kind, Model};

use crate::discnet::npy;

fn fixture(name: impl AsRef<Path>) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

fn image(name: &str) -> ToneMappedImage {
    let rows: Array3<f32> = npy(&fixture(name)).into_dimensionality().expect("images have three axes");
    ToneMappedImage::from_planes(rows.permuted_axes([2, 0, 1])).expect("images are RGB")
}

/// The sums of the deepest network, some hundred layers, round to about 1e-5 of their largest.
#[test]
fn every_network_computes_what_pytorch_computes() {
    for kind in ["srmdnf", "sftmd", "de-unet"] {
        let model = Model::load(&fixture(format!("networks/{kind}.safetensors"))).unwrap();
        let code: Array1<f32> =
            npy(&fixture(format!("networks/{kind}_code.npy"))).into_dimensionality().unwrap();
        let input = image(&format!("networks/{kind}_input.npy"));
        let restored = model.restore(&Inputs::new(&input, Some(&code))).unwrap();
        let expected = image(&format!("networks/{kind}_output.npy"));
        let largest = expected.as_slice().iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let pairs = restored.as_slice().iter().zip(expected.as_slice());
        let error = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(error <= 2e-5 * largest, "{kind}: {error:e} of {largest}");
    }
}

#[test]
fn a_unet_is_a_discnet_without_conditions() {
    let path = (0..7)
        .map(|case| fixture(format!("discnet/{case}.pth")))
        .find(|path| weights::read(path).unwrap().architecture.condition == Condition::None)
        .expect("one of the fixtures has no condition");
    let discnet = weights::read(&path).unwrap();
    let architecture = Architecture { kind: Kind::Unet, ..discnet.architecture.clone() };
    let unet = Weights { architecture, ..discnet.clone() };
    let restore = |weights: &Weights| {
        let model = Model::new(weights.clone());
        model.restore(&Inputs::new(&image("networks/de-unet_input.npy"), None)).unwrap()
    };
    assert_eq!(restore(&unet), restore(&discnet));
}
