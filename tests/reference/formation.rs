//! Reference vectors: degraded images of scenes with highlights up to 4000, odd and even PSFs, x_max = 500.

#![expect(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use std::path::{Path, PathBuf};

use udc::core::image::{Linear, LinearImage, ToneMapped};
use udc::dataset::FormationConfig;
use udc::io;
use udc::synth::Formation;

fn fixture(case: usize, what: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("tests/fixtures/formation/{case}_{what}.npy"))
}

fn degrade(case: usize) -> LinearImage {
    let scene = io::read_image::<Linear>(&fixture(case, "gt")).unwrap();
    let psf = io::read_psf(&fixture(case, "psf")).unwrap();
    Formation::new(FormationConfig::default(), 0).unwrap().degrade(&scene, &psf, "reference").unwrap()
}

/// The largest error in units of its bound, 1e-5 relative plus 1e-5 absolute.
fn worst(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let errors = found.iter().zip(expected).map(|(&found, &expected)| {
        let (found, expected) = (f64::from(found), f64::from(expected));
        (found - expected).abs() / (1e-5 * expected.abs() + 1e-5)
    });
    errors.fold(0.0, f64::max)
}

fn agrees(case: usize) {
    let expected = io::read_image::<Linear>(&fixture(case, "degraded")).unwrap();
    let worst = worst(degrade(case).as_slice(), expected.as_slice());
    assert!(worst <= 1.0, "case {case}: {worst} times the bound");
}

#[test]
fn an_even_psf_with_clipped_highlights_agrees() {
    agrees(1);
}

#[test]
fn a_large_odd_psf_agrees() {
    agrees(2);
}

#[test]
fn an_odd_psf_with_clipped_highlights_agrees() {
    agrees(3);
}

#[test]
fn the_tone_mapped_image_agrees() {
    let curve = FormationConfig::default().curve().unwrap();
    let found = curve.tone_map(&degrade(1));
    let expected = io::read_image::<ToneMapped>(&fixture(1, "tonemapped")).unwrap();
    let worst = worst(found.as_slice(), expected.as_slice());
    assert!(worst <= 1.0, "{worst} times the bound");
}
