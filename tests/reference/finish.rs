//! Reference vectors: finishing. A restored image, a colour matrix and a reference picture of the camera's own
//! processing; local contrast by OpenCV.

use std::path::PathBuf;

use ndarray::Array3;
use udc::core::image::ToneMapped;
use udc::core::tone::ToneCurve;
use udc::finish::{FinishConfig, Look, channel_means, finish, read_color_matrix};
use udc::io::{read_image, read_pixels};

fn fixture(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/finish").join(name)
}

fn finished(config: &FinishConfig) -> Array3<f32> {
    let restored = read_image::<ToneMapped>(&fixture("restored_tonemapped.npy")).unwrap();
    let reference = read_pixels(&fixture("reference.png")).unwrap().planes;
    let look = Look {
        ccm: Some(read_color_matrix(&fixture("ccm.txt")).unwrap()),
        reference_means: Some(channel_means(&reference)),
        ..Look::default()
    };
    finish(ToneCurve::default().inverse_tone_map(&restored), &look, config).unwrap()
}

/// The reference is stored in 16 bits, half a step of which is 8e-6.
#[test]
fn is_equal_before_local_contrast() {
    let found = finished(&FinishConfig { clahe: None, ..FinishConfig::default() });
    let expected = read_pixels(&fixture("before_clahe.npy")).unwrap().planes;
    let worst = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 1e-4, "{worst}");
}

#[test]
fn is_within_a_code_of_opencv_after_local_contrast() {
    let found = finished(&FinishConfig::default());
    let expected = read_pixels(&fixture("final.png")).unwrap().planes;
    let code = |v: f32| (255.0 * v).round() as i32;
    let near = found.iter().zip(&expected).filter(|(a, b)| (code(**a) - code(**b)).abs() <= 1).count();
    let equal = found.iter().zip(&expected).filter(|(a, b)| code(**a) == code(**b)).count();
    let share = |count: usize| count as f64 / found.len() as f64;
    println!("within one code: {}, equal: {}", share(near), share(equal));
    assert!(share(near) >= 0.999, "{}", share(near));
    // Nine in ten are equal; a slip in the tables of the tiles would move most by a code.
    assert!(share(equal) > 0.9, "{}", share(equal));
}

#[test]
fn a_matrix_is_the_same_as_text_and_as_an_array() {
    let [text, array] = ["ccm.txt", "ccm.npy"].map(|name| read_color_matrix(&fixture(name)).unwrap());
    for (a, b) in text.0.iter().flatten().zip(array.0.iter().flatten()) {
        assert!((a - b).abs() < 1e-6);
    }
}
