//! PSNR and SSIM against the published evaluation's definition.

use std::path::PathBuf;

use serde_json::Value;
use udc::core::image::{ToneMapped, ToneMappedImage};
use udc::core::metrics::{MetricDefinition, psnr, ssim};
use udc::io;

fn read(name: &str) -> ToneMappedImage {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/metrics").join(name);
    io::read_image::<ToneMapped>(&path).expect("the fixture is readable")
}

/// A value that lies on a rounding tie in f32 and not in f64 moves one of 61440 values by 1/255: 1e-4 dB.
#[test]
fn psnr_and_ssim_equal_the_reference() {
    let cases: Value = serde_json::from_str(include_str!("../fixtures/metrics/cases.json")).expect("JSON");
    for case in cases.as_array().expect("a list of cases") {
        let number = case["case"].as_u64().expect("cases are numbered");
        let (a, b) = (read(&format!("{number}_a.npy")), read(&format!("{number}_b.npy")));
        let expect = |what: &str, found: f64, tolerance: f64| {
            let expected = case[what].as_f64().expect("a number");
            assert!((found - expected).abs() < tolerance, "case {number}: {what} is {found} for {expected}");
        };
        let (released, float) = (MetricDefinition::released(), MetricDefinition::float());
        expect("psnr_8bit", psnr(&a, &b, &released).unwrap(), 2e-4);
        expect("psnr_float", psnr(&a, &b, &float).unwrap(), 1e-5);
        expect("ssim_8bit", ssim(&a, &b, &released).unwrap(), 2e-6);
    }
}
