//! DISCNet against the same networks in PyTorch: outputs, parameter counts, recognised architectures.

use std::path::{Path, PathBuf};

use ndarray::{Array1, Array3, ArrayD};
use serde_json::Value;
use udc::core::image::ToneMappedImage;
use udc::io::FloatWidth;
use udc::network::{Architecture, Condition, Inputs, Model, Scales, weights};

/// Reads an array of a fixture.
pub(crate) fn npy(path: &Path) -> ArrayD<f32> {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let file = npyz::NpyFile::new(&bytes[..]).expect("fixtures are arrays");
    let shape: Vec<usize> =
        file.shape().iter().map(|&side| usize::try_from(side).expect("fixtures are small")).collect();
    let values = file.into_vec::<f32>().expect("fixtures hold 32-bit floats");
    ArrayD::from_shape_vec(shape, values).expect("an array has as many values as its shape says")
}

fn fixture(name: impl AsRef<Path>) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/discnet").join(name)
}

fn cases() -> Vec<Value> {
    let text = std::fs::read_to_string(fixture("cases.json")).expect("the fixture is there");
    serde_json::from_str(&text).expect("the fixture is JSON")
}

fn image(name: String) -> ToneMappedImage {
    let rows: Array3<f32> = npy(&fixture(name)).into_dimensionality().expect("images have three axes");
    ToneMappedImage::from_planes(rows.permuted_axes([2, 0, 1])).expect("images are RGB")
}

fn code(case: usize) -> Array1<f32> {
    npy(&fixture(format!("{case}_code.npy"))).into_dimensionality().expect("codes have one axis")
}

/// The fixture's description in our terms.
fn architecture(case: &Value) -> Architecture {
    let number =
        |key: &str| usize::try_from(case[key].as_u64().expect("a number")).expect("fixtures are small");
    let condition = match case["condition"].as_str().expect("a name") {
        "none" => Condition::None,
        "img" => Condition::Image,
        "psf" => Condition::Psf,
        "img-psf" => Condition::ImagePsf,
        other => panic!("unknown condition {other}"),
    };
    // A network without conditions has no filters, so that neither their number nor their size shows.
    let is_multi = case["multi_scale"].as_bool().expect("a flag") || condition == Condition::None;
    let scales = if is_multi { Scales::Multi } else { Scales::Single };
    let (features, filter_size) = (number("features"), number("filter_size"));
    Architecture { features, condition, scales, filter_size, ..Architecture::default() }
}

/// The largest difference between two images of one shape.
fn difference(a: &ToneMappedImage, b: &ToneMappedImage) -> f32 {
    assert_eq!(a.planes().dim(), b.planes().dim());
    a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn every_architecture_is_recognised_from_its_checkpoint() {
    for (index, case) in cases().iter().enumerate() {
        let description = weights::describe(&fixture(format!("{index}.pth"))).unwrap();
        assert_eq!(description.architecture, architecture(case), "case {index}");
        assert_eq!(description.architecture.parameters(), case["params"].as_u64().unwrap(), "case {index}");
    }
}

/// 1e-5 is the accuracy promised; sums of some thousand products of order one round to about 1e-6.
#[test]
fn every_network_computes_what_pytorch_computes() {
    for index in 0..cases().len() {
        let model = Model::load(&fixture(format!("{index}.pth"))).unwrap();
        let restored =
            model.restore(&Inputs::new(&image(format!("{index}_input.npy")), Some(&code(index)))).unwrap();
        let error = difference(&restored, &image(format!("{index}_output.npy")));
        assert!(error <= 1e-5, "case {index}: {error:e}");
    }
}

#[test]
fn a_model_file_computes_what_its_checkpoint_computes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    weights::convert(&fixture("5.pth"), &path, FloatWidth::Single, false).unwrap();
    let (before, after) = (Model::load(&fixture("5.pth")).unwrap(), Model::load(&path).unwrap());
    assert_eq!(before.architecture(), after.architecture());
    let (image, code) = (image("5_input.npy".to_owned()), code(5));
    assert_eq!(
        before.restore(&Inputs::new(&image, Some(&code))).unwrap(),
        after.restore(&Inputs::new(&image, Some(&code))).unwrap()
    );
}

#[test]
fn a_uniform_degradation_map_equals_its_code() {
    let model = Model::load(&fixture("0.pth")).unwrap();
    let (image, code) = (image("0_input.npy".to_owned()).crop(3, 5, 22, 30), code(0));
    let map = Array3::from_shape_fn((code.len(), 22, 30), |(i, _, _)| code[i]);
    let by_map = model.restore(&Inputs::new(&image, None).with_map(map.view())).unwrap();
    assert_eq!(by_map, model.restore(&Inputs::new(&image, Some(&code))).unwrap());
}

#[test]
fn a_missing_code_and_one_of_another_length_are_refused() {
    let model = Model::load(&fixture("5.pth")).unwrap();
    let image = image("5_input.npy".to_owned());
    let message = model.restore(&Inputs::new(&image, None)).unwrap_err().to_string();
    assert!(message.contains("needs a code of 5 numbers"), "{message}");
    let message = model.restore(&Inputs::new(&image, Some(&Array1::zeros(4)))).unwrap_err().to_string();
    assert!(message.contains("expected 5 numbers, found 4"), "{message}");
}
