use super::super::tests::panel_psf;
use super::*;
use crate::core::fft::TransformPrecision;
use crate::core::rng::stream;
use crate::restore::deconvolution::Border;
use rand::RngExt as _;

const LEVEL: f32 = 16.0;

/// The light that is found of a capture of some brightness, and whether it is measured.
fn found(
    frame: &Frame,
    psf: &Array2<f32>,
    [capture, brightness]: [&Array2<f32>; 2],
    pixels: &Array2<bool>,
) -> (Array2<f32>, bool) {
    let saturated = Saturated { frame, capture: capture.view(), psf: psf.view(), pixels, level: LEVEL };
    let light = saturated.light((brightness.view(), &[]), (None, false), &Progress::default()).unwrap();
    let mut plane = Array2::zeros(pixels.dim());
    light.of_pixels.write(pixels, &mut plane);
    (plane, light.is_measured)
}

#[test]
fn a_psf_of_few_pixels_throws_no_flare() {
    let square = |side: usize, middle: usize| {
        Array2::from_shape_fn((33, 33), |(y, x)| {
            let is_core = y.abs_diff(16) <= middle && x.abs_diff(16) <= middle;
            if is_core && y < side && x < side { 1.0 } else { 0.0 }
        })
    };
    assert!(!throws_flare(square(33, 0).view()) && !throws_flare(square(17, 1).view()));
    assert!(throws_flare(panel_psf(33).view()));
}

/// The light of the lamp is that at which it saturates either way; what is around it is nearer to the scene.
#[test]
fn scenes_with_lamps_begin_sharper_from_an_inverse() {
    let truth = Array2::from_shape_fn((96, 96), |(y, x)| match (y, x) {
        (48..50, 48..50) => 1.5 * LEVEL,
        _ => 0.2 + 0.3 * ((y / 4 + x / 4) % 2) as f32,
    });
    let psf = panel_psf(65);
    let frame = Frame::new([96, 96], [65, 65], Border::Zero, TransformPrecision::Single);
    let mut capture = frame.plane();
    frame.blur(psf.view()).unwrap().apply(&truth, &mut capture);
    let pixels = Array2::from_shape_fn((96, 96), |(y, x)| (47..51).contains(&y) && (47..51).contains(&x));
    capture.zip_mut_with(&pixels, |y, saturated| *y = if *saturated { LEVEL } else { *y });
    let saturated =
        Saturated { frame: &frame, capture: capture.view(), psf: psf.view(), pixels: &pixels, level: LEVEL };
    let first = |smoothness: Option<f32>| {
        let of_pixels = OfMembers::new(&pixels, |_| LEVEL);
        let light = Light { of_pixels, is_measured: true, is_coarse: true };
        let mut brightness = local_mean(&capture, 4.0) + 0.25;
        let given = Presumed { darkness: 0.2, is_guarded: false, smoothness };
        saturated.start(light, &mut brightness, given).unwrap().1
    };
    let scenes = [None, Some(0.01)].map(first);
    let errors = scenes.map(|scene| {
        assert!(scene.iter().zip(&pixels).all(|(light, saturated)| !*saturated || *light == LEVEL));
        let apart = ndarray::s![8..40, 8..88];
        (&scene.slice(apart) - &truth.slice(apart)).mapv(|error| error * error).sum()
    });
    assert!(errors[1] < 0.3 * errors[0], "{errors:?}");
}

/// A sun whose glare saturates a fourteenth of a small frame is measured as one that saturates less of a larger.
#[test]
fn a_sun_is_measured_whatever_share_of_the_frame_its_glare_saturates() {
    const TIMES: f32 = 30_000.0;
    let psf = panel_psf(65);
    let part_of_light = |side: usize| {
        let middle = side / 2..side / 2 + 2;
        let truth = Array2::from_shape_fn((side, side), |(y, x)| {
            let is_sun = middle.contains(&y) && middle.contains(&x);
            if is_sun { TIMES * LEVEL } else { 0.2 + 0.05 * (y as f32 / 9.0).sin() }
        });
        let frame = Frame::new([side, side], [65, 65], Border::Zero, TransformPrecision::Single);
        let mut capture = frame.plane();
        frame.blur(psf.view()).unwrap().apply(&truth, &mut capture);
        capture.mapv_inplace(|y| y.clamp(0.0, LEVEL));
        let pixels = capture.mapv(|y| y >= LEVEL);
        let share = pixels.iter().filter(|saturated| **saturated).count() as f64 / pixels.len() as f64;
        let brightness = local_mean(&capture, 4.0) + 0.25;
        let (light, is_measured) = found(&frame, &psf, [&capture, &brightness], &pixels);
        (share, is_measured, light.sum() / (4.0 * TIMES * LEVEL))
    };
    for side in [48, 96] {
        let (share, is_measured, part) = part_of_light(side);
        assert_eq!(share > MOST_MEASURED, side == 48, "{share}");
        assert!(share < MOST_LOOKED_AT && is_measured && (part - 1.0).abs() < 0.1, "{share} {part}");
    }
    let beliefs = [0.03, 0.1, 0.3, 0.6].map(|share| Belief::of(share, 0.04));
    assert_eq!(beliefs, [Belief::Always, Belief::IfConvincing, Belief::IfOfSuns, Belief::Never]);
}

/// A capture of a window that is on average so many times as bright as what saturates, and its saturated pixels.
fn window_before_a_room(frame: &Frame, psf: &Array2<f32>, times: f32) -> (Array2<f32>, Array2<bool>) {
    let mut rng = stream(7, "window");
    let truth = Array2::from_shape_fn(frame.size(), |(y, x)| match (y, x) {
        (20..125, 30..130) => LEVEL * (times + rng.random_range(-0.4..0.4f32)),
        _ => 0.2 + 0.5 * ((y / 5 + x / 7) % 2) as f32,
    });
    let mut capture = Array2::zeros(frame.size());
    frame.blur(psf.view()).unwrap().apply(&truth, &mut capture);
    capture.mapv_inplace(|y| (y + 0.02 * rng.random_range(-1.0..1.0f32)).clamp(0.0, LEVEL));
    let pixels = capture.mapv(|y| y >= LEVEL);
    (capture, pixels)
}

/// What no sun explains is told by the flare of all of a window, the diffraction orders of its edges: how bright it is.
#[test]
fn an_area_is_as_bright_as_its_flare_tells() {
    let mut psf = Array2::zeros((33, 33));
    psf[[16, 16]] = 0.6;
    for order in [[4, 16], [28, 16], [16, 4], [16, 28]] {
        psf[order] = 0.1;
    }
    let frame = Frame::new([160; 2], [33; 2], Border::Smooth, TransformPrecision::Single);
    for times in [1.0, 1.5, 2.2] {
        let (capture, pixels) = window_before_a_room(&frame, &psf, times);
        let brightness = local_mean(&capture, 4.0) + 0.25;
        let (light, is_measured) = found(&frame, &psf, [&capture, &brightness], &pixels);
        let part = light[[70, 80]] / (times * LEVEL);
        assert!(!is_measured && (part - 1.0).abs() < 0.15, "{times}: {part}");
    }
}

/// Much brighter than what is presumed of areas that are alike: its flare explains so much that it is believed pixel by pixel.
#[test]
fn a_window_that_outshines_all_is_as_bright_as_its_flare_tells() {
    const TIMES: f32 = 9.0;
    let mut psf = Array2::zeros((65, 65));
    psf[[32, 32]] = 0.9;
    for (step, share) in [(10, 0.006), (20, 0.003), (30, 0.002)] {
        for order in [[32 - step, 32], [32 + step, 32], [32, 32 - step], [32, 32 + step]] {
            psf[order] = share;
        }
    }
    let frame = Frame::new([160; 2], [65; 2], Border::Zero, TransformPrecision::Single);
    let truth = Array2::from_shape_fn(frame.size(), |(y, x)| match (y, x) {
        (40..90, 50..85) => TIMES * LEVEL * (1.0 + 0.2 * (y as f32 / 4.0).sin()),
        _ => 0.1 + 0.1 * ((y / 9 + x / 11) % 2) as f32,
    });
    let mut capture = Array2::zeros(frame.size());
    frame.blur(psf.view()).unwrap().apply(&truth, &mut capture);
    capture.mapv_inplace(|y| y.clamp(0.0, LEVEL));
    let pixels = capture.mapv(|y| y >= LEVEL);
    let share = pixels.iter().filter(|saturated| **saturated).count() as f64 / pixels.len() as f64;
    let (light, is_measured) = found(&frame, &psf, [&capture, &(local_mean(&capture, 4.0) + 0.25)], &pixels);
    let bright: f32 = truth.iter().filter(|light| **light > LEVEL).sum();
    let part = light.sum() / bright;
    assert!(
        share > MOST_MEASURED && is_measured && (part - 1.0).abs() < 0.15,
        "{share} {is_measured} {part}"
    );
}

/// No flare tells the light of pixels within an area that is larger than the PSF: a sun there would be of rounding's making.
#[test]
fn light_that_throws_no_flare_out_of_an_area_is_not_made_up() {
    let (frame, psf) =
        (Frame::new([160; 2], [33; 2], Border::Smooth, TransformPrecision::Single), panel_psf(33));
    let (capture, pixels) = window_before_a_room(&frame, &psf, 1.5);
    let (psf, brightness) = (psf.view(), local_mean(&capture, 4.0) + 0.25);
    let blur = frame.blur(psf).unwrap();
    let seen = seen_pixels(&blur, &pixels);
    let clipped = Clipped::new(&blur, capture.view(), [&pixels, &seen], (brightness.view(), LEVEL));
    let light = clipped.measure(&frame.squared_blur(psf).unwrap(), &Progress::default()).unwrap().light;
    let (mut hidden, mut told) = (0, 0);
    for ((y, x), light) in light.indexed_iter() {
        // The guard of two pixels, and the reach of sixteen.
        let is_hidden = (40..105).contains(&y) && (50..110).contains(&x) && pixels[[y, x]];
        hidden += usize::from(is_hidden);
        told += usize::from(is_hidden && *light != LEVEL);
    }
    assert!(hidden > 3000 && told == 0, "{told} of {hidden}");
}

/// A sun saturates all colours, and the blue of a sky alone may be a few times as bright as what saturates.
#[test]
fn light_of_a_colour_suits_the_others() {
    let of_area = |rows: std::ops::Range<usize>| {
        Array2::from_shape_fn((60, 60), |(y, x)| rows.contains(&y) && (10..50).contains(&x))
    };
    let (frame, psf) =
        (Frame::new([60; 2], [33; 2], Border::Zero, TransformPrecision::Single), panel_psf(33));
    let (pixels, capture) = (of_area(5..40), Array2::from_elem((60, 60), LEVEL));
    let saturated =
        Saturated { frame: &frame, capture: capture.view(), psf: psf.view(), pixels: &pixels, level: LEVEL };
    let suits = |of_area: f32, [y, x]: [usize; 2], others: &Array2<bool>| {
        let mut light = pixels.mapv(|pixel| if pixel { of_area * LEVEL } else { 0.0 });
        light[[y, x]] = 1e4 * LEVEL;
        let of_colors = [others.clone(), others.clone(), pixels.clone()];
        saturated.suits_colors(&light, (&Window::whole([60; 2]), &of_colors))
    };
    let (none, sun) = (of_area(0..0), of_area(18..22));
    assert!(!suits(1.0, [20, 20], &none) && suits(1.0, [20, 20], &sun) && !suits(1.0, [30, 20], &sun));
    let of_sky = |times: f32| {
        let light = pixels.mapv(|pixel| if pixel { times * LEVEL } else { 0.0 });
        saturated
            .suits_colors(&light, (&Window::whole([60; 2]), &[none.clone(), none.clone(), pixels.clone()]))
    };
    assert!(of_sky(2.5) && !of_sky(6.0));
}

/// What its flare does not reach has no part in the light of a lamp: it is the same in what is cut out around it.
#[test]
fn light_is_told_by_what_its_flare_reaches() {
    let (size, psf) = ([150, 190], panel_psf(33));
    let truth = Array2::from_shape_fn(size, |(y, x)| match (y, x) {
        (118..121, 30..32) => 300.0 * LEVEL,
        _ => 0.2 + 0.3 * ((y / 5 + x / 7) % 2) as f32,
    });
    let frame = Frame::new(size, [33, 33], Border::Smooth, TransformPrecision::Single);
    let mut capture = Array2::zeros(size);
    frame.blur(psf.view()).unwrap().apply(&truth, &mut capture);
    capture.mapv_inplace(|y| y.clamp(0.0, LEVEL));
    let pixels = capture.mapv(|y| y >= LEVEL);
    let window = Window::around(&pixels, [16 + high_pass_reach(); 2]).unwrap();
    let [height, width] = window.size();
    assert!(height < 120 && width < 120, "{height} × {width}");
    let light_of = |capture: Array2<f32>, pixels: Array2<bool>| {
        let frame = Frame::new(capture.dim().into(), [33, 33], Border::Smooth, TransformPrecision::Single);
        found(&frame, &psf, [&capture, &capture.mapv(|y| y + 0.25)], &pixels).0
    };
    let of_window = light_of(window.cut(capture.view()).to_owned(), window.cut(pixels.view()).to_owned());
    let of_frame = light_of(capture, pixels);
    assert_eq!(window.cut(of_frame.view()), of_window);
    assert_eq!(of_frame.sum(), of_window.sum());
}
