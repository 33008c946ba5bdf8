//! Perspective views against those of a bilinear renderer.

use std::path::PathBuf;

use serde_json::Value;
use udc::core::image::{Linear, LinearImage};
use udc::core::tone::ToneCurve;
use udc::crop::{Panorama, View, crop};
use udc::io;

fn read(name: &str) -> LinearImage {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/panorama").join(name);
    io::read_image::<Linear>(&path).expect("the fixture is readable")
}

/// 40 dB: the reference interpolates between four texels where a view's pixel spans up to several of them.
#[test]
fn views_agree_with_the_reference() {
    let text = include_str!("../fixtures/panorama/cases.json");
    let cases: Value = serde_json::from_str(text).expect("the fixture is JSON");
    for case in cases["views"].as_array().expect("the fixture lists views") {
        let number = |key: &str| case[key].as_f64().expect("a number");
        let view = View {
            yaw_deg: number("yaw_deg"),
            pitch_deg: number("pitch_deg"),
            fov_deg: number("fov_deg"),
            size: 128,
        };
        let panorama = Panorama::new(read(&format!("{}_equirect.npy", case["equirect"]))).unwrap();
        let found = ToneCurve::default().tone_map(&crop(&panorama, &view));
        let reference = read(&format!("{}_{}.npy", case["equirect"], case["view"]));
        let expected = ToneCurve::default().tone_map(&reference);
        let squares = found.as_slice().iter().zip(expected.as_slice()).map(|(a, b)| f64::from(a - b).powi(2));
        let psnr = -10.0 * (squares.sum::<f64>() / found.as_slice().len() as f64).log10();
        assert!(psnr > 40.0, "{view:?}: {psnr:.2} dB");
    }
}
