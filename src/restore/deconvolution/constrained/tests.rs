use super::*;
use crate::core::rng;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;
use crate::restore::deconvolution::{Border, Method, wiener};
use ndarray::s;
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
    Blur::new([SIZE, SIZE], panel_psf().view(), Border::Zero)
        .unwrap()
        .apply(scene)
        .mapv(|v| v.clamp(0.0, 500.0))
}

fn config() -> DeconvolutionConfig {
    DeconvolutionConfig { border: Border::Zero, ..DeconvolutionConfig::of_method(Method::Constrained) }
}

fn restored(capture: &Array2<f32>, psf: &Array2<f32>, border: Border) -> Array2<f32> {
    let config = DeconvolutionConfig { border, ..config() };
    restore(capture.view(), psf.view(), &config, 0, &Progress::default()).unwrap()
}

fn psnr(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
    let tone = ToneCurve::default();
    let sum: f64 =
        a.iter().zip(b).map(|(&a, &b)| f64::from(tone.compress(a) - tone.compress(b)).powi(2)).sum();
    -10.0 * (sum / a.len() as f64).log10()
}

fn best_wiener(capture: &Array2<f32>, scene: &Array2<f32>) -> f64 {
    let restored = |balance| {
        let config = DeconvolutionConfig { balance, border: Border::Smooth, ..config() };
        let restored = wiener::restore(capture.view(), panel_psf().view(), &config, 0, &Progress::default());
        psnr(&restored.unwrap(), scene)
    };
    [1e-4, 1e-3, 1e-2, 1e-1].map(restored).into_iter().fold(f64::NEG_INFINITY, f64::max)
}

/// Without noise, saturation or a null space of the PSF the scene itself is the solution; 50 dB is a
/// root mean square error of 0.3 %.
#[test]
fn solves_the_noise_free_case_border_included() {
    let scene = scene(100.0);
    let restored = restored(&capture(&scene), &panel_psf(), Border::Zero);
    assert!(psnr(&restored, &scene) > 50.0, "{}", psnr(&restored, &scene));
    assert!(restored.iter().all(|&v| v >= 0.0));
}

#[test]
fn beats_the_wiener_filter_where_a_lamp_saturates() {
    let scene = scene(3000.0);
    let capture = capture(&scene);
    assert!(saturation::any(capture.view(), saturated_from(500.0)));
    let restored = restored(&capture, &panel_psf(), Border::Zero);
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
    let restored = restored(&capture, &panel_psf(), Border::Zero);
    let (ours, degraded) = (psnr(&restored, &scene), psnr(&capture, &scene));
    assert!(ours > degraded + 1.0, "{degraded} became {ours}");
    assert!(ours > best_wiener(&capture, &scene), "{ours}");
}

#[test]
fn estimates_noise_and_its_absence() {
    let clean = capture(&scene(100.0));
    let blur = Blur::new([SIZE, SIZE], panel_psf().view(), Border::Zero).unwrap();
    let estimate = |capture: &Array2<f32>| noise::estimate(capture.view(), blur.otf(), 0.25);
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
    for border in [Border::Smooth, Border::Periodic, Border::Zero] {
        let one = restored(&Array2::from_elem((1, 1), 0.5), &psf, border);
        assert!(one[[0, 0]].is_finite(), "{border:?}");
        let dark = restored(&Array2::zeros((9, 8)), &psf, border);
        assert!(dark.iter().all(|&v| v == 0.0), "{border:?}");
    }
}

/// A Gaussian core of one pixel in a halo with a fifth of the light: fine detail does not get through.
fn blurring_psf() -> Array2<f32> {
    let k = Array2::from_shape_fn((33, 33), |(y, x)| {
        let (dy, dx) = (y as f32 - 16.0, x as f32 - 16.0);
        (-(dy * dy + dx * dx) / 2.0).exp() + 0.02 * (-(dy * dy + dx * dx).sqrt() / 4.0).exp()
    });
    let sum = k.sum();
    k / sum
}

/// Texture of a size in pixels: the exponential of smoothed normal numbers of a contrast.
fn texture(side: usize, size: f32, contrast: f32) -> Array2<f32> {
    let mut rng = rng::stream(7, "texture");
    let random = Array2::from_shape_simple_fn((side, side), || StandardNormal.sample(&mut rng));
    let centre = (4.0 * size).ceil();
    let gaussian = Array2::from_shape_fn([8 * size.ceil() as usize + 1; 2], |(y, x)| {
        (-((y as f32 - centre).powi(2) + (x as f32 - centre).powi(2)) / (2.0 * size * size)).exp()
    });
    let kernel = &gaussian / gaussian.sum();
    let smooth = Blur::new([side, side], kernel.view(), Border::Periodic).unwrap().apply(&random);
    smooth.mapv(|v| (contrast * v - 1.0).exp())
}

fn add_noise(capture: &Array2<f32>, sigma: f32) -> Array2<f32> {
    let mut rng = rng::stream(8, "noise");
    capture.mapv(|v| {
        let normal: f32 = StandardNormal.sample(&mut rng);
        (v + sigma * normal).clamp(0.0, 500.0)
    })
}

/// A frame from the middle of a larger scene, and its capture, lit by what lies around it.
fn frame_of_larger_scene(larger: &Array2<f32>, psf: &Array2<f32>) -> (Array2<f32>, Array2<f32>) {
    let side = larger.nrows();
    let captured = Blur::new([side, side], psf.view(), Border::Zero).unwrap().apply(larger);
    let frame = s![32..side - 32, 32..side - 32];
    (larger.slice(frame).to_owned(), captured.slice(frame).to_owned())
}

/// A third of a decibel, 4 % of the error, for what the noise that is drawn makes of a restoration that does nothing.
#[test]
fn never_makes_a_noisy_capture_worse() {
    let scenes = [texture(96, 3.0, 6.0), texture(96, 1.5, 6.0), texture(96, 1.5, 3.0), scene(100.0)];
    for (index, scene) in scenes.iter().enumerate() {
        for (name, psf) in [("blurring", blurring_psf()), ("panel", panel_psf())] {
            let (height, width) = scene.dim();
            let clean = Blur::new([height, width], psf.view(), Border::Zero).unwrap().apply(scene);
            for sigma in [0.001, 0.003, 0.01, 0.03] {
                let capture = add_noise(&clean, sigma);
                let degraded = psnr(&capture, scene);
                let found = psnr(&restored(&capture, &psf, Border::Zero), scene);
                assert!(
                    found > degraded - 0.33,
                    "scene {index}, {name}, noise of {sigma}: {degraded} became {found}"
                );
            }
        }
    }
}

#[test]
fn estimates_the_noise_of_smooth_scenes() {
    for (name, psf) in [("blurring", blurring_psf()), ("panel", panel_psf())] {
        let blur = Blur::new([96, 96], psf.view(), Border::Zero).unwrap();
        let clean = blur.apply(&texture(96, 3.0, 3.0));
        let estimate = |capture: &Array2<f32>| noise::estimate(capture.view(), blur.otf(), 0.25);
        // 0.1 % of noise is 60 dB: as good as none.
        assert!(estimate(&clean) < 1e-3, "{name}: {} without noise", estimate(&clean));
        for sigma in [0.003, 0.01, 0.03] {
            let found = estimate(&add_noise(&clean, sigma));
            let median = sigma / (0.25 + (-1.0_f32).exp());
            assert!((found / f64::from(median) - 1.0).abs() < 0.2, "{name}: {found}, {median} expected");
        }
    }
}

/// What shines in over the border is part of the model: the sides are restored as the middle is.
#[test]
fn restores_a_frame_whose_scene_goes_on_around_it() {
    for (name, psf) in [("blurring", blurring_psf()), ("panel", panel_psf())] {
        let (scene, capture) = frame_of_larger_scene(&texture(128, 1.5, 3.0), &psf);
        for sigma in [0.0, 0.003, 0.01] {
            let capture = add_noise(&capture, sigma);
            let of_border = |border| psnr(&restored(&capture, &psf, border), &scene);
            let (smooth, zero) = (of_border(Border::Smooth), of_border(Border::Zero));
            let degraded = psnr(&capture, &scene);
            assert!(
                smooth > degraded + 3.0 && smooth > zero + 2.0,
                "{name}, noise of {sigma}: {degraded} became {smooth}, {zero} where darkness is assumed"
            );
        }
    }
}
