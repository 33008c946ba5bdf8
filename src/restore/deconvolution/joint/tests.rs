mod clean;
mod outside;

use super::*;
use crate::core::rng;
use crate::core::tone::ToneCurve;
use crate::restore::deconvolution::{
    Border, LampOutside, Method, deconvolve, filter_by_truth, without_lamps_outside,
};
use ndarray::Array2;
use rand_distr::{Distribution, StandardNormal};

const SIZE: usize = 96;

/// A sharp core with the orders of a grating and a faint halo.
pub(super) fn panel_psf(side: usize) -> Array2<f32> {
    let centre = side / 2;
    let k = Array2::from_shape_fn((side, side), |(y, x)| {
        let (dy, dx) = (y as f32 - centre as f32, x as f32 - centre as f32);
        let is_order = y.abs_diff(centre) % 8 == 0 && x.abs_diff(centre) % 8 == 0;
        let order = if is_order { 1e-3 } else { 1e-5 };
        (-(dy * dy + dx * dx) / 0.8).exp() + order * (-dy.hypot(dx) / 12.0).exp()
    });
    let sum = k.sum();
    k / sum
}

fn psf() -> Psf {
    let plane = panel_psf(65);
    Psf::from_energy(Array3::from_shape_fn((3, 65, 65), |(_, y, x)| plane[[y, x]])).unwrap()
}

fn image(light: impl Fn(usize, usize, usize) -> f32, size: [usize; 2]) -> LinearImage {
    LinearImage::from_planes(Array3::from_shape_fn((3, size[0], size[1]), |(c, y, x)| light(c, y, x)))
        .unwrap()
}

/// A room with a window and a lamp.
fn room(lamp: f32) -> LinearImage {
    let light = |c: usize, y: usize, x: usize| match (y, x) {
        (20..40, 50..80) => 1.5 + 0.2 * c as f32,
        (60..63, 30..33) => lamp,
        _ => 0.2 + 0.05 * ((y as f32 / 9.0).sin() + (x as f32 / (7.0 + c as f32)).cos()),
    };
    image(light, [SIZE, SIZE])
}

/// The capture of a scene with relative noise, clipped at `level`.
fn capture(scene: &LinearImage, sigma: f32, level: f32) -> LinearImage {
    let size = [scene.height(), scene.width()];
    let frame = Frame::new(size, [65, 65], Border::Zero, TransformPrecision::Double);
    let blur = frame.blur(panel_psf(65).slice(ndarray::s![.., ..])).unwrap();
    let mut rng = rng::stream(4, "joint");
    let mut planes = scene.planes().to_owned();
    for mut plane in planes.axis_iter_mut(Axis(0)) {
        let mut seen = frame.plane();
        blur.apply(&plane.to_owned(), &mut seen);
        seen.mapv_inplace(|y| {
            let normal: f32 = StandardNormal.sample(&mut rng);
            (y + sigma * (y + 0.25) * normal).clamp(0.0, level)
        });
        plane.assign(&seen);
    }
    LinearImage::from_planes(planes).unwrap()
}

fn config(method: Method, border: Border, level: f32) -> DeconvolutionConfig {
    DeconvolutionConfig { border, saturation: [level; 3], ..DeconvolutionConfig::of_method(method) }
}

fn psnr(a: &LinearImage, b: &LinearImage, most: f32) -> f64 {
    let tone = ToneCurve::default();
    let error = |(a, b): (&f32, &f32)| f64::from(tone.compress(a.min(most)) - tone.compress(b.min(most)));
    let (a, b) = (a.planes(), b.planes());
    let sum: f64 = a.iter().zip(&b).map(error).map(|error| error.powi(2)).sum();
    -10.0 * (sum / a.len() as f64).log10()
}

/// A window five pixels from the border, which would shine from beyond it too if the capture were taken to be mirrored there, seen
/// through a panel of much haze.
#[test]
fn a_window_near_the_border_is_not_mirrored_beyond_it() {
    let (haze, mut rng) = (hazy_psf(65), rng::stream(6, "window"));
    let light = Array2::from_shape_fn((SIZE, SIZE), |(y, x)| match (y, x) {
        (6..40, 16..80) => 14.0,
        _ => 0.3 + 0.05 * ((y as f32 / 9.0).sin() + (x as f32 / 7.0).cos()),
    });
    let frame = Frame::new([SIZE, SIZE], [65, 65], Border::Zero, TransformPrecision::Double);
    let mut seen = frame.plane();
    frame.blur(haze.view()).unwrap().apply(&light, &mut seen);
    seen.mapv_inplace(|y| {
        let normal: f32 = StandardNormal.sample(&mut rng);
        (y + 0.01 * (y + 0.25) * normal).max(0.0)
    });
    let seen = image(|_, y, x| seen[[y, x]], [SIZE, SIZE]);
    let psf = Psf::from_energy(Array3::from_shape_fn((3, 65, 65), |(_, y, x)| haze[[y, x]])).unwrap();
    let config = config(Method::Joint, Border::Smooth, 500.0);
    let restored = deconvolve(&seen, &psf, &config, &Progress::default()).unwrap();
    let between = ndarray::s![0..5, 30..66];
    let found = restored.channel(1).slice(between).mean().unwrap();
    let expected = light.slice(between).mean().unwrap();
    assert!((found / expected - 1.0).abs() < 0.25, "{found} of {expected}");
}

/// A sharp core, and a third of the light in a wide halo.
fn hazy_psf(side: usize) -> Array2<f32> {
    let centre = (side / 2) as f32;
    let of = |width: f32| {
        let lobe = Array2::from_shape_fn((side, side), |(y, x)| {
            (-(y as f32 - centre).hypot(x as f32 - centre) / width).exp()
        });
        let sum = lobe.sum();
        lobe / sum
    };
    of(0.5) * 0.67 + of(8.0) * 0.33
}

/// The capture of a wall and of a sun of 4 pixels beyond its left border, what the wall alone would be captured as, and the wall.
fn wall_and_sun_outside(sun: f32, sigma: f32) -> [LinearImage; 3] {
    const CUT: usize = 16;
    let whole = |sun: f32| {
        let waves =
            |c: usize, y: usize, x: usize| (y as f32 / 9.0).sin() + (x as f32 / (7.0 + c as f32)).cos();
        let wall = image(|c, y, x| 0.2 + 0.05 * waves(c, y, x), [SIZE, SIZE]);
        let mut whole = wall.into_planes();
        for (channel, mut plane) in whole.outer_iter_mut().enumerate() {
            plane.slice_mut(ndarray::s![30..32, 10..12]).fill(sun * (1.0 + 0.1 * channel as f32));
        }
        LinearImage::from_planes(whole).unwrap()
    };
    let seen = |sun: f32| capture(&whole(sun), sigma, 16.0);
    [seen(sun), seen(0.3), whole(0.3)].map(|image| image.crop(0, CUT, SIZE, SIZE - CUT))
}

#[test]
fn finds_a_sun_beyond_the_border_and_takes_its_flare_away() {
    let config = config(Method::Joint, Border::Smooth, 16.0);
    for sigma in [0.0, 0.01] {
        let [seen, alone, _] = wall_and_sun_outside(3000.0, sigma);
        let found = without_lamps_outside(&seen, &psf(), &config, &Progress::default()).unwrap().unwrap();
        let [LampOutside { position: [y, x], pixels, light }] = found.lamps[..] else {
            panic!("{:?}", found.lamps)
        };
        assert!((y - 30.5).abs() < 0.5 && (x + 5.5).abs() < 0.5 && pixels < 20, "{:?}", found.lamps);
        for (channel, light) in light.into_iter().enumerate() {
            let truth = 4.0 * 3000.0 * (1.0 + 0.1 * channel as f64);
            assert!((light / truth - 1.0).abs() < 0.1, "{channel}: {light} of {truth}");
        }
        let [before, after] = [&seen, &found.image].map(|image| psnr(image, &alone, 16.0));
        assert!(after > before + 10.0, "{before} dB, then {after} dB");
    }
}

#[test]
fn takes_nothing_away_where_no_lamp_beyond_the_border_is_told_by_its_flare() {
    let of = |capture: &LinearImage, border| {
        let config = config(Method::Joint, border, 16.0);
        without_lamps_outside(capture, &psf(), &config, &Progress::default()).unwrap()
    };
    for sigma in [0.0, 0.01] {
        let [lit, alone, scene] = wall_and_sun_outside(3000.0, sigma);
        assert!(of(&alone, Border::Smooth).is_none());
        assert!(of(&scene, Border::Smooth).is_none());
        // What would be no brighter than the frame, were it there, is no lamp; what would, is one, though nothing saturates there.
        let [dim, ..] = wall_and_sun_outside(1.0, sigma);
        assert!(of(&dim, Border::Smooth).is_none());
        let bright = config(Method::Joint, Border::Smooth, 1e5);
        assert!(without_lamps_outside(&lit, &psf(), &bright, &Progress::default()).unwrap().is_some());
        // Beyond that border it is dark.
        assert!(of(&lit, Border::Zero).is_none());
        assert!(of(&capture(&room(3000.0), sigma, 16.0), Border::Smooth).is_none());
    }
}

/// A lamp beyond the border would explain all of the few pixels that there are.
#[test]
fn a_frame_of_few_pixels_tells_of_no_lamp_beyond_it() {
    let light = |c: usize, y: usize, x: usize| ((c * 5 + y * 31 + x * 17) % 23) as f32 / 23.0;
    let config = config(Method::Joint, Border::Smooth, 16.0);
    for size in [[5, 3], [5, 4], [8, 8]] {
        let seen = image(light, size);
        assert!(without_lamps_outside(&seen, &psf(), &config, &Progress::default()).unwrap().is_none());
        let restored = deconvolve(&seen, &psf(), &config, &Progress::default()).unwrap();
        let [before, after] = [&seen, &restored].map(|image| image.planes().mean().unwrap());
        assert!((after / before - 1.0).abs() < 0.5, "{size:?}: {before}, then {after}");
    }
}

/// Nothing saturates, and what shines hundreds of times as bright as the wall drowns it in its flare.
#[test]
fn signs_on_a_dark_wall_are_explained_by_further_rounds() {
    let light = |c: usize, y: usize, x: usize| match ((y / 5) % 2, (5 * x + 3 * (y / 5)) % 16) {
        (0, 0..7) => 12.0 + c as f32,
        _ => 0.02 + 0.01 * (x as f32 / 7.0).sin(),
    };
    let scene = image(light, [SIZE, SIZE]);
    let (seen, psf) = (capture(&scene, 0.01, 500.0), psf());
    let config = config(Method::Joint, Border::Zero, 500.0);
    let (frame, progress) = (frame_of(&seen, &psf, &config), Progress::default());
    let start = || Colors::start(&frame, (&seen, &psf), (&config, None), &progress).unwrap();
    let quality = |colors: Colors| psnr(&LinearImage::from_planes(colors.scene()).unwrap(), &scene, 500.0);
    let mut first = start();
    let efforts: Vec<_> = first.channels.iter().map(Channel::effort).collect();
    first.improve(&efforts, &progress).unwrap();
    let (first, all) = (quality(first), quality(start().restore(&progress).unwrap()));
    assert!(all > first + 1.0, "{first} dB, then {all} dB");
}

/// In darkness all that is not explained is in the residual.
#[test]
fn tells_what_it_leaves_of_the_capture() {
    let scene = room(100.0);
    let seen = capture(&scene, 0.03, 50.0);
    let config = config(Method::Joint, Border::Zero, 50.0);
    let Solution { scene, residual, .. } =
        solve((&seen, &psf()), &config, None, &Progress::default()).unwrap();
    let again = capture(&scene, 0.0, f32::MAX);
    let mut saturated = 0;
    for ((place, residual), (seen, again)) in
        residual.indexed_iter().zip(seen.planes().iter().zip(&again.planes()))
    {
        if *seen >= 50.0 {
            saturated += 1;
            assert_eq!(*residual, 0.0);
        } else {
            // The local brightness is above a third of the value, and at least α.
            let left = seen - again;
            assert!(residual.abs() * 0.25 <= left.abs() + 1e-5, "{place:?}: {residual}, {left}");
            assert!(*residual == 0.0 || (*residual > 0.0) == (left > 0.0) || left.abs() < 1e-5, "{place:?}");
        }
    }
    assert!(saturated > 0);
    let mean = residual.iter().map(|residual| residual.powi(2)).sum::<f32>() / residual.len() as f32;
    assert!((0.02..0.04).contains(&mean.sqrt()), "{} of noise of 0.03", mean.sqrt());
}

/// With and without light around the frame that is not known.
#[test]
fn beats_constrained_where_a_lamp_saturates() {
    let scene = room(4000.0);
    let seen = capture(&scene, 0.02, 16.0);
    for border in [Border::Zero, Border::Smooth] {
        let of = |method| {
            let config = config(method, border, 16.0);
            psnr(&deconvolve(&seen, &psf(), &config, &Progress::default()).unwrap(), &scene, 16.0)
        };
        let (joint, constrained) = (of(Method::Joint), of(Method::Constrained));
        assert!(joint > constrained + 1.0, "{border:?}: {joint}, constrained {constrained}");
    }
}

/// Median for median, so that the few pixels at edges do not count.
#[test]
fn tells_its_error() {
    let scene =
        image(|c, y, x| 0.5 + 0.3 * ((y + c) as f32 / 15.0).sin() * (x as f32 / 20.0).cos(), [SIZE; 2]);
    let seen = capture(&scene, 0.03, 500.0);
    let config = config(Method::Joint, Border::Zero, 500.0);
    let Solution { scene: restored, deviation, relative_noise, .. } =
        solve((&seen, &psf()), &config, None, &Progress::default()).unwrap();
    assert!(relative_noise.iter().all(|noise| (0.02..0.04).contains(noise)), "{relative_noise:?} of 0.03");
    let mut ratios: Vec<f32> = (&restored.planes() - &scene.planes())
        .iter()
        .zip(&deviation)
        .map(|(error, deviation)| error.abs() / deviation)
        .collect();
    ratios.sort_unstable_by(f32::total_cmp);
    let ratio = ratios[ratios.len() / 2] / 0.6745;
    assert!((1.0 / 1.5..1.5).contains(&ratio), "errors are {ratio} times as large as told");
}

#[test]
fn lamps_are_told_to_be_less_certain() {
    let config = config(Method::Joint, Border::Zero, 16.0);
    let seen = capture(&room(4000.0), 0.02, 16.0);
    let Solution { scene, deviation, .. } =
        solve((&seen, &psf()), &config, None, &Progress::default()).unwrap();
    assert!(scene.planes()[[0, 61, 31]] > 16.0, "{}", scene.planes()[[0, 61, 31]]);
    assert!(deviation[[0, 61, 31]] > 20.0 * deviation[[0, 10, 10]]);
}

/// Where there is little noise, the light of a lamp is not smeared over what is dark beside it, to whichever side.
#[test]
fn small_lamps_are_told_from_the_dark_beside_them() {
    let scene = image(
        |c, y, x| match (y, x) {
            (40..43, 60..63) | (70..72, 24..28) => 60.0 - 10.0 * c as f32,
            _ => 0.2 + 0.15 * (y as f32 / (4 + c) as f32).sin() * (x as f32 / 7.0).cos(),
        },
        [SIZE; 2],
    );
    let seen = capture(&scene, 0.002, 16.0);
    let config = config(Method::Joint, Border::Zero, 16.0);
    let restored = deconvolve(&seen, &psf(), &config, &Progress::default()).unwrap();
    let quality = psnr(&restored, &scene, 16.0);
    assert!(quality > 45.0, "{quality}");
    let light = restored.planes()[[0, 41, 61]];
    assert!((light - 60.0).abs() < 6.0, "{light} of 60");
}

/// A window that reaches out of the frame, somewhat brighter than white: its flare does not tell how the light lies in it.
#[test]
fn a_large_clipped_window_stays_whole() {
    for side in [14, 36] {
        let is_window = |y: usize, x: usize| (10..10 + side).contains(&y) && x + side >= SIZE;
        let room = room(1.0);
        let light = |c: usize, y: usize, x: usize| {
            2.0 + 0.5 * c as f32 + 1.5 * (y as f32 / 9.0).sin() + 0.01 * x as f32
        };
        let scene = image(
            |c, y, x| if is_window(y, x) { light(c, y, x) } else { room.planes()[[c, y, x]].min(0.5) },
            [SIZE; 2],
        );
        let seen = capture(&scene, 0.01, 1.0);
        let restored = |method| {
            deconvolve(&seen, &psf(), &config(method, Border::Zero, 1.0), &Progress::default()).unwrap()
        };
        let (joint, constrained) = (restored(Method::Joint), restored(Method::Constrained));
        let [joint_psnr, constrained_psnr] = [&joint, &constrained].map(|found| psnr(found, &scene, 1.0));
        let planes = joint.planes();
        let lit = planes.indexed_iter().filter(|((_, y, x), _)| is_window(*y, *x));
        let holes = lit.filter(|(_, light)| **light < 0.5).count();
        assert!(joint_psnr > constrained_psnr + 1.0, "{side}: {joint_psnr} against {constrained_psnr}");
        assert!(20 * holes < 3 * side * side, "{side}: {holes} dark pixels of the window");
    }
}

/// PSFs larger than the image, nothing but saturated pixels, no light, one light, steps: all give finite light.
#[test]
fn whatever_comes_in_light_comes_out() {
    let captures = [
        image(|_, _, _| 0.5, [1, 1]),
        image(|_, _, _| 16.0, [1, 1]),
        image(|_, _, _| 0.0, [9, 12]),
        image(|_, _, _| 0.7, [12, 9]),
        image(|_, _, _| 16.0, [20, 24]),
        image(|_, _, x| if x < 12 { 16.0 } else { 0.0 }, [20, 24]),
        image(|c, y, x| if c == 1 && y + x == 5 { 16.0 } else { 1e-6 }, [20, 24]),
        image(|_, y, x| if (y, x) == (3, 4) { 1e6 } else { 0.0 }, [7, 70]),
        image(|_, y, x| if (y + x) % 2 == 0 { -0.1 } else { 0.3 }, [33, 17]),
    ];
    for (index, capture) in captures.iter().enumerate() {
        for border in [Border::Smooth, Border::Periodic, Border::Zero] {
            let config = config(Method::Joint, border, 16.0);
            let Solution { scene, deviation, .. } =
                solve((capture, &psf()), &config, None, &Progress::default()).unwrap();
            assert_eq!(scene.planes().dim(), capture.planes().dim());
            let is_light = |light: &f32| light.is_finite() && *light >= 0.0;
            assert!(scene.planes().iter().all(is_light), "{index}, {border:?}: {:?}", scene.planes());
            assert!(deviation.iter().all(is_light), "{index}, {border:?}: {deviation:?}");
        }
    }
}

/// A fence before a wall: what the penalty on differences takes for noise, its own spectrum tells.
#[test]
fn local_spectra_refine_a_noisy_scene() {
    let scene = image(
        |c, y, x| {
            0.4 + 0.05 * c as f32 + 0.08 * ((x + y / 3) as f32 * 1.3).sin() + 0.2 * (y as f32 / 25.0).sin()
        },
        [SIZE; 2],
    );
    let seen = capture(&scene, 0.04, 500.0);
    let (config, psf) = (config(Method::Joint, Border::Zero, 500.0), psf());
    let frame = frame_of(&seen, &psf, &config);
    let progress = Progress::default();
    let start = || {
        Colors::start(&frame, (&seen, &psf), (&config, None), &progress).unwrap().restore(&progress).unwrap()
    };
    let before = psnr(&LinearImage::from_planes(start().scene()).unwrap(), &scene, 500.0);
    let refined = start().refined(&progress).unwrap().expect("there is noise");
    let after = psnr(&LinearImage::from_planes(refined.scene).unwrap(), &scene, 500.0);
    assert!(after > before + 1.0, "{after} after {before}");
}

/// Of a noisy capture the solution says that its error is told, as its pixels were measured, of a computed one and of one whose neighbours
/// were averaged it does not: the guard of the network's corrections asks.
#[test]
fn a_solution_says_whether_its_error_is_told() {
    let is_told = |capture: &LinearImage| {
        let config = config(Method::Joint, Border::Zero, 16.0);
        solve((capture, &psf()), &config, None, &Progress::default()).unwrap().is_told
    };
    let noisy = capture(&room(1.0), 0.02, 16.0);
    let averaged = image(
        |c, y, x| {
            let channel = noisy.channel(c);
            0.5 * (channel[[y, x]] + channel[[(y + 1).min(SIZE - 1), x]])
        },
        [SIZE, SIZE],
    );
    // What all colours share is the scene's, however fine.
    let mut rng = rng::stream(8, "grain");
    let grain = Array2::from_shape_simple_fn((SIZE, SIZE), || {
        let normal: f32 = StandardNormal.sample(&mut rng);
        1.0 + 0.2 * normal
    });
    let grained = image(|c, y, x| noisy.channel(c)[[y, x]] * grain[[y, x]], [SIZE, SIZE]);
    assert!(is_told(&noisy) && is_told(&grained));
    assert!(!is_told(&averaged));
    assert!(!is_told(&capture(&room(1.0), 0.0, 16.0)));
}

/// A few lamps in much darkness: of a large capture so little is clipped that a small one would not be halved for it. Measured at the full
/// resolution from nothing, 0.44 of their light is found.
#[test]
fn lamps_in_large_captures_are_found_at_half_the_resolution_first() {
    const LAMP: f32 = 2000.0;
    const LEVEL: f32 = 16.0;
    let is_lamp = |y: usize, x: usize| (y % 280).abs_diff(141) < 2 && (x % 280).abs_diff(140) < 2;
    let seen_of = |side: usize| {
        let scene = image(
            |c, y, x| match is_lamp(y, x) {
                true => LAMP,
                false => 0.2 + 0.05 * ((y as f32 / 9.0).sin() + (x as f32 / (7.0 + c as f32)).cos()),
            },
            [side; 2],
        );
        (capture(&scene, 0.01, LEVEL), scene)
    };
    let config = config(Method::Joint, Border::Smooth, LEVEL);
    let is_halved = |seen: &LinearImage| {
        let from = saturated_from(LEVEL);
        let saturated: Vec<_> = (0..CHANNELS).map(|c| seen.channel(c).mapv(|y| y >= from)).collect();
        let psf = psf();
        let frame = frame_of(seen, &psf, &config);
        let given = Given {
            image: seen,
            psf: &psf,
            config: &config,
            saturated,
            is_guarded: false,
            whole: None,
            noise: None,
        };
        let noise = given.noise_levels(&frame).unwrap();
        given.coarse_scene(&frame, &noise, &Progress::default()).unwrap().is_some()
    };
    assert!(!is_halved(&seen_of(280).0));
    let (seen, scene) = seen_of(840);
    assert!(is_halved(&seen));
    let restored = deconvolve(&seen, &psf(), &config, &Progress::default()).unwrap();
    for (y, x) in [(141, 140), (421, 700)] {
        let lamp = ndarray::s![y - 3..y + 4, x - 3..x + 4];
        let part = restored.channel(1).slice(lamp).sum() / scene.channel(1).slice(lamp).sum();
        assert!((0.55..1.05).contains(&part), "{part}");
    }
}

/// Told the scene's spectra, a filter comes nearer to it than the search; the light of a lamp that may be clipped in the scene too is
/// estimated, all else being known.
#[test]
fn a_filter_that_is_told_the_scene_is_a_bound() {
    let (scene, level, config) = (room(1600.0), 16.0, config(Method::Joint, Border::Zero, 16.0));
    let seen = capture(&scene, 0.02, level);
    let progress = Progress::default();
    let bound = filter_by_truth((&seen, &scene), &psf(), &config, &progress).unwrap();
    let found = deconvolve(&seen, &psf(), &config, &progress).unwrap();
    let (of_bound, of_found) = (psnr(&bound, &scene, level), psnr(&found, &scene, level));
    assert!(of_bound > of_found + 1.0, "{of_bound} {of_found}");
    let lamp = bound.planes()[[1, 61, 31]];
    assert!((lamp / 1600.0 - 1.0).abs() < 0.01, "{lamp}");
    // It is a filter: noise keeps it from the scene.
    assert!(of_bound < 50.0, "{of_bound}");
    let other = image(|_, _, _| 1.0, [SIZE, SIZE - 1]);
    let refused = filter_by_truth((&seen, &other), &psf(), &config, &progress).unwrap_err();
    assert!(refused.to_string().contains("96 × 95"), "{refused}");
}

/// Noise of which half is below zero, as of a capture whose black was subtracted: what was cut off of it would be a veil.
#[test]
fn dark_scenes_in_noise_below_zero_stay_as_dark() {
    let mut rng = rng::stream(11, "dark");
    let mut noise = || -> f32 { StandardNormal.sample(&mut rng) };
    let noisy = Array3::from_shape_fn((3, SIZE, SIZE), |(_, y, x)| {
        let light = if (y / 24 + x / 24) % 2 == 0 { 0.002 } else { 0.01 };
        light + 0.02 * noise()
    });
    let mean = noisy.mean().unwrap();
    let noisy = LinearImage::from_planes(noisy).unwrap();
    let config = config(Method::Joint, Border::Smooth, 500.0);
    let restored = deconvolve(&noisy, &psf(), &config, &Progress::default()).unwrap();
    let found = restored.planes().mean().unwrap();
    assert!((found / mean - 1.0).abs() < 0.15, "{found} of {mean}");
}
