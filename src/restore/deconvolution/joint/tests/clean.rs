//! Of captures without noise.

use super::*;

#[test]
fn inverts_noise_free_captures_as_constrained_does() {
    let scene = room(100.0);
    let seen = capture(&scene, 0.0, 500.0);
    let restored = |method| {
        deconvolve(&seen, &psf(), &config(method, Border::Zero, 500.0), &Progress::default()).unwrap()
    };
    let quality = psnr(&restored(Method::Joint), &scene, 500.0);
    assert!(quality > 60.0, "{quality}");
    assert_eq!(restored(Method::Joint), restored(Method::Constrained));
}

/// A lamp just outside of the frame, whose flare enters.
#[test]
fn light_from_outside_of_noise_free_captures_costs_no_more_than_by_constrained() {
    const CUT: usize = 16;
    let side = SIZE - CUT;
    let mut whole = room(1.0).into_planes();
    whole.slice_mut(ndarray::s![.., 30..33, 10..13]).fill(300.0);
    let whole = LinearImage::from_planes(whole).unwrap();
    let seen = capture(&whole, 0.0, 500.0).crop(0, CUT, SIZE, side);
    let scene = whole.crop(0, CUT, SIZE, side);
    let of = |method| {
        let config = config(method, Border::Smooth, 500.0);
        psnr(&deconvolve(&seen, &psf(), &config, &Progress::default()).unwrap(), &scene, 500.0)
    };
    let (joint, constrained) = (of(Method::Joint), of(Method::Constrained));
    assert!(joint > constrained - 0.1, "{joint}, constrained {constrained}");
}

#[test]
fn a_scene_without_noise_is_not_refined() {
    let (seen, psf) = (capture(&room(1.0), 0.0, 500.0), psf());
    let config = config(Method::Joint, Border::Zero, 500.0);
    let frame = frame_of(&seen, &psf, &config);
    let mut colors = Colors::start(&frame, (&seen, &psf), (&config, None), &Progress::default()).unwrap();
    assert!(colors.refined(&Progress::default()).unwrap().is_none());
}

/// A window and a lamp are clipped: what they hide is told by no least squares, with noise or without, so that a capture without noise is
/// explained as a photograph first, and to its last digit from there.
#[test]
fn a_capture_with_lamps_is_restored_no_worse_for_having_no_noise() {
    let level = 1.2;
    let (scene, config) = (room(40.0), config(Method::Joint, Border::Zero, level));
    let restored = |sigma: f32| {
        let seen = capture(&scene, sigma, level);
        let clipped = seen.planes().iter().filter(|y| **y >= level).count();
        assert!(clipped > 3 * 96 * 96 / 100, "{clipped}");
        psnr(&deconvolve(&seen, &psf(), &config, &Progress::default()).unwrap(), &scene, level)
    };
    let (clean, noisy) = (restored(0.0), restored(0.02));
    // Two hundred steps are not the same to 0.3 dB; from the first round on to the last digit, it is 1.2 dB worse.
    assert!(clean > noisy - 0.6, "{clean} {noisy}");
    let (seen, psf) = (capture(&scene, 0.0, level), psf());
    let frame = frame_of(&seen, &psf, &config);
    let colors = Colors::start(&frame, (&seen, &psf), (&config, None), &Progress::default()).unwrap();
    for mut channel in colors.channels {
        let photograph = channel.effort();
        assert!(channel.has_lamps() && photograph[0] > 0 && photograph != [8, 25], "{photograph:?}");
        assert_eq!(channel.finish(), [8, 25]);
    }
}

/// Houses with windows, and a softbox beyond the left border whose flare enters, cut to a frame.
fn street(side: usize, cut: usize) -> [LinearImage; 2] {
    let light = |c: usize, y: usize, x: usize| match (y, x) {
        (20..60, 0..8) => 20.0 + c as f32,
        _ if y % 48 < 12 && x % 40 < 9 => 1.5 + 0.2 * c as f32,
        _ => 0.2 + 0.1 * ((y * x) as f32 / 90.0).sin() + 0.05 * (x as f32 / (7.0 + c as f32)).cos(),
    };
    let whole = image(light, [side, side]);
    [&capture(&whole, 0.0, 500.0), &whole].map(|image| image.crop(0, cut, side, side - cut))
}

/// Small captures begin from what it makes of them, large ones from the blurred scene.
#[test]
fn nothing_clipped_is_restored_no_worse_than_by_constrained() {
    for side in [96, 760] {
        let [seen, scene] = street(side, 16);
        let of = |method| {
            let config = config(method, Border::Smooth, 500.0);
            psnr(&deconvolve(&seen, &psf(), &config, &Progress::default()).unwrap(), &scene, 500.0)
        };
        let (joint, constrained) = (of(Method::Joint), of(Method::Constrained));
        assert!(joint > constrained - 0.1, "{side}: {joint}, constrained {constrained}");
    }
}
