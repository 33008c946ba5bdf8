use super::*;
use crate::core::rng;
use crate::core::tone::ToneCurve;
use crate::restore::deconvolution::{Method, wiener};
use rand_distr::{Distribution, StandardNormal};

const SIZE: usize = 64;

/// A sharp core in a halo with a grating's orders; a third of the light is halo.
fn panel_psf() -> Array2<f32> {
    let k = Array2::from_shape_fn((49, 49), |(y, x)| {
        let (dy, dx) = (y as f32 - 24.0, x as f32 - 24.0);
        let core = (-(dy * dy + dx * dx) / 0.8).exp();
        let order = if y % 8 == 0 && x % 8 == 0 { 0.01 } else { 0.0 };
        core + (order + 0.001) * (-(dy * dy + dx * dx).sqrt() / 12.0).exp()
    });
    let sum = k.sum();
    k / sum
}

/// Night: dark texture, two windows and a small lamp of brightness `lamp`.
fn scene(lamp: f32) -> Array2<f32> {
    Array2::from_shape_fn((SIZE, SIZE), |(y, x)| {
        let texture = 0.1 + 0.02 * (y as f32 * 1.1).sin() * (x as f32 * 0.7).sin();
        match (y, x) {
            (10..20, 40..52) | (0..6, 0..9) => 3.0 + texture,
            (44..46, 20..22) => lamp,
            _ => texture,
        }
    })
}

fn capture(scene: &Array2<f32>) -> Array2<f32> {
    Blur::new([SIZE, SIZE], panel_psf().view()).unwrap().apply(scene).mapv(|v| v.clamp(0.0, 500.0))
}

fn config() -> DeconvolutionConfig {
    DeconvolutionConfig::of_method(Method::Constrained)
}

fn psnr(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    let tone = ToneCurve::default();
    let sum: f64 =
        a.iter().zip(b).map(|(&a, &b)| f64::from(tone.compress(a) - tone.compress(b)).powi(2)).sum();
    -10.0 * (sum / a.len() as f64).log10()
}

fn best_wiener(capture: &Array2<f32>, scene: &Array2<f32>) -> f64 {
    let restored = |balance| {
        let config = DeconvolutionConfig { balance, ..config() };
        psnr(&wiener::restore(capture.view(), panel_psf().view(), &config).unwrap(), scene)
    };
    [1e-4, 1e-3, 1e-2, 1e-1].map(restored).into_iter().fold(f64::NEG_INFINITY, f64::max)
}

/// Without noise, saturation or a null space of the PSF the scene itself is the solution; 50 dB is a
/// root mean square error of 0.3 %.
#[test]
fn solves_the_noise_free_case_border_included() {
    let scene = scene(100.0);
    let restored = restore(capture(&scene).view(), panel_psf().view(), &config()).unwrap();
    assert!(psnr(&restored, &scene) > 50.0, "{}", psnr(&restored, &scene));
    assert!(restored.iter().all(|&v| v >= 0.0));
}

#[test]
fn beats_the_wiener_filter_where_a_lamp_saturates() {
    let scene = scene(3000.0);
    let capture = capture(&scene);
    assert!(saturation::any(capture.view(), saturation::level(500.0)));
    let restored = restore(capture.view(), panel_psf().view(), &config()).unwrap();
    let (ours, wiener) = (psnr(&restored, &scene), best_wiener(&capture, &scene));
    assert!(ours > wiener + 3.0 && ours > psnr(&capture, &scene) + 3.0, "{ours} against {wiener}");
}

#[test]
fn stops_before_noise_is_amplified() {
    let scene = scene(100.0);
    let mut capture = capture(&scene);
    let mut rng = rng::stream(5, "capture");
    // 4 % of the light and of α: the relative noise of a 10-bit bracket.
    capture.mapv_inplace(|v| {
        let normal: f32 = StandardNormal.sample(&mut rng);
        (v + 0.04 * (v + 0.25) * normal).max(0.0)
    });
    let restored = restore(capture.view(), panel_psf().view(), &config()).unwrap();
    let (ours, degraded) = (psnr(&restored, &scene), psnr(&capture, &scene));
    assert!(ours > degraded + 1.0, "{degraded} became {ours}");
    assert!(ours > best_wiener(&capture, &scene), "{ours}");
}

#[test]
fn estimates_noise_and_its_absence() {
    let clean = capture(&scene(100.0));
    let blur = Blur::new([SIZE, SIZE], panel_psf().view()).unwrap();
    let estimate = |capture: &Array2<f32>| noise::estimate(capture.view(), blur.otf(), blur.grid()[1], 0.25);
    assert_eq!(estimate(&clean), 0.0);
    let mut rng = rng::stream(6, "capture");
    let noisy = clean.mapv(|v| {
        let normal: f32 = StandardNormal.sample(&mut rng);
        v + 0.04 * (v + 0.25) * normal
    });
    // 1024 details give a median to 4 %; what is taken off for the scene makes it smaller.
    let sigma = estimate(&noisy);
    assert!((0.03..0.044).contains(&sigma), "{sigma}");
}

#[test]
fn a_frame_of_one_pixel_and_a_dark_frame_are_restored() {
    let psf = panel_psf();
    let one = restore(Array2::from_elem((1, 1), 0.5).view(), psf.view(), &config()).unwrap();
    assert!(one[[0, 0]].is_finite());
    let dark = restore(Array2::zeros((9, 8)).view(), psf.view(), &config()).unwrap();
    assert!(dark.iter().all(|&v| v == 0.0));
}
