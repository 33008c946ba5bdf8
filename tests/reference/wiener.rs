//! Reference vectors: the Wiener–Hunt filter of scikit-image (`fixtures/wiener`).

use std::path::Path;

use udc::core::image::LinearImage;
use udc::core::progress::Progress;
use udc::io::{read_image, read_psf};
use udc::restore::deconvolution::{Border, DeconvolutionConfig, Method, deconvolve};

/// Both compute the same expression; theirs in f64, ours in f32. The filter amplifies the rounding of the
/// transforms, 1e-7 of values up to 10, by at most 1/(2√balance·|Λ|), some ten times: 1e-4 leaves room.
#[test]
fn wiener_hunt_equals_scikit_image() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/wiener");
    let degraded: LinearImage = read_image(&folder.join("degraded.npy")).unwrap();
    let psf = read_psf(&folder.join("psf.npy")).unwrap();
    let expected: LinearImage = read_image(&folder.join("restored.npy")).unwrap();
    let config = DeconvolutionConfig {
        balance: 1e-3,
        border: Border::Periodic,
        ..DeconvolutionConfig::of_method(Method::Wiener)
    };
    let restored = deconvolve(&degraded, &psf, &config, &Progress::default()).unwrap();
    for (restored, expected) in restored.as_slice().iter().zip(expected.as_slice()) {
        assert!((restored - expected).abs() <= 1e-4, "{restored} where {expected} is expected");
    }
}
