use ndarray::Array3;
use rand::RngExt as _;

use super::*;
use crate::core::fft::{Boundary, Convolver};
use crate::core::image::LinearImage;
use crate::core::rng::stream;

const SIDE: usize = 160;
const MARGIN: usize = 32;

/// A core and the orders of an oblong lattice, which stand further apart in red than in blue.
fn panel(pitch: [f32; 2]) -> Psf {
    let order = |c: usize, y: usize, x: usize| {
        let factor = 1.15 - 0.15 * c as f32;
        let place = [(y as f32 - 32.0) / (pitch[0] * factor), (x as f32 - 32.0) / (pitch[1] * factor)];
        let [off_y, off_x] =
            [(place[0] - place[0].round()) * pitch[0], (place[1] - place[1].round()) * pitch[1]];
        let envelope = 0.03 * (-0.5 * (place[0] * place[0] + place[1] * place[1]) / 2.0).exp();
        let core = (-((y as f32 - 32.0).powi(2) + (x as f32 - 32.0).powi(2)) / 1.2).exp();
        core + envelope * (-(off_y * off_y + off_x * off_x) / 1.2).exp()
    };
    Psf::from_energy(Array3::from_shape_fn((3, 65, 65), |(c, y, x)| order(c, y, x))).unwrap()
}

/// What a noisy camera sees of overlapping rectangles behind a panel.
fn capture(psf: &Psf) -> AnyImage {
    let side = SIDE + 2 * MARGIN;
    let mut rng = stream(5, "scene");
    let mut scene = Array3::from_elem((3, side, side), 0.2f32);
    for _ in 0..900 {
        let size = 3 + rng.random_range(0..14usize);
        let [y, x] = [0, 0].map(|_: u8| rng.random_range(0..side - size));
        let gray = rng.random_range(0.02..0.8f32);
        for c in 0..3 {
            let light = gray * rng.random_range(0.7..1.3f32);
            scene.slice_mut(s![c, y..y + size, x..x + size]).fill(light);
        }
    }
    let scene = LinearImage::from_planes(scene).unwrap();
    let convolver = Convolver::new([side, side], [psf.height(), psf.width()], Boundary::Replicate).unwrap();
    let seen = convolver.convolve(&convolver.spectrum(&scene).unwrap(), &convolver.otf(psf).unwrap());
    let seen = seen.slice_move(s![.., MARGIN..MARGIN + SIDE, MARGIN..MARGIN + SIDE]);
    let seen = seen.mapv(|light| {
        let uniform: f32 = (0..12).map(|_| rng.random::<f32>()).sum::<f32>() - 6.0;
        (light + 0.004 * uniform).clamp(0.0, 1.0)
    });
    AnyImage::Linear(LinearImage::from_planes(seen).unwrap())
}

fn looks_like(capture: &AnyImage, psf: &Psf) -> Option<LookingLike> {
    let found = Unlike::of(capture, psf, ToneCurve::default(), &Progress::default()).unwrap();
    found.map(|found| found.looks_like)
}

fn changed(psf: &Psf, change: impl Fn(f32) -> f32) -> Psf {
    Psf::from_energy(psf.planes().mapv(change)).unwrap()
}

#[test]
fn a_capture_looks_like_what_its_psf_is_mistaken_for() {
    let psf = panel([9.0, 14.0]);
    let capture = capture(&psf);
    let peak = psf.planes().iter().fold(0.0, |most: f32, value| most.max(*value));
    let blue_red = Psf::from_energy(psf.planes().slice(s![..;-1, .., ..]).to_owned()).unwrap();
    let cases = [
        ("its own", psf.clone(), None),
        ("turned", rotate(&psf, 90.0).unwrap(), Some(LookingLike::QuarterTurned)),
        ("turned by some degrees", rotate(&psf, -5.0).unwrap(), Some(LookingLike::TurnedLeft)),
        ("exchanged", blue_red, Some(LookingLike::ColorsExchanged)),
        ("clipped", changed(&psf, |value| value.min(0.1 * peak)), Some(LookingLike::BrighterCore)),
        ("encoded", changed(&psf, |value| (value / peak).powf(1.0 / 2.2)), Some(LookingLike::Decoded)),
        ("of another panel", panel([11.0, 8.0]), Some(LookingLike::Even)),
    ];
    for (name, psf, expected) in cases {
        assert_eq!(looks_like(&capture, &psf), expected, "a PSF that is {name}");
    }
}

#[test]
fn orders_at_twice_their_distance_are_told() {
    let capture = capture(&panel([7.0, 10.0]));
    assert_eq!(looks_like(&capture, &panel([7.0, 10.0])), None);
    assert_eq!(looks_like(&capture, &panel([14.0, 20.0])), Some(LookingLike::Halved));
}

#[test]
fn the_domain_of_a_capture_and_its_units_make_no_difference() {
    let psf = panel([9.0, 14.0]);
    let AnyImage::Linear(light) = capture(&psf) else { unreachable!() };
    let curve = ToneCurve::default();
    let mapped = AnyImage::ToneMapped(curve.tone_map(&light), None);
    let bright = AnyImage::Linear(light.map_values(|light| 4095.0 * light));
    for capture in [mapped, bright] {
        assert_eq!(looks_like(&capture, &psf), None);
        assert_eq!(looks_like(&capture, &rotate(&psf, 90.0).unwrap()), Some(LookingLike::QuarterTurned));
    }
}

#[test]
fn what_is_small_dark_or_saturated_tells_nothing() {
    let psf = panel([9.0, 14.0]);
    let wrong = panel([11.0, 8.0]);
    let AnyImage::Linear(light) = capture(&psf) else { unreachable!() };
    let small = AnyImage::Linear(light.crop(0, 0, SIDE, SMALLEST_PX - 1));
    let black = AnyImage::Linear(light.map_values(|_| 0.0));
    let clipped = AnyImage::Linear(light.map_values(|light| light.min(0.2)));
    for capture in [small, black, clipped] {
        assert_eq!(looks_like(&capture, &wrong), None);
    }
}

#[test]
fn what_is_told_leads_by_enough_and_by_structure() {
    let leads = |best: f64, even: f64, cells: f64| {
        let mut nats = vec![-50_000.0; LookingLike::MISTAKEN.len()];
        nats[3] = best;
        nats.push(even);
        let leads = Leads { cells: vec![cells; nats.len()], nats, samples: 10_000 };
        leads.told().map(|told| (told.looks_like, told.lead_nats))
    };
    assert_eq!(leads(-10.0, -20.0, 0.9), None, "the PSF leads");
    assert_eq!(leads(200.0, -100.0, 0.9), Some((LookingLike::ColorsExchanged, 200.0)));
    assert_eq!(leads(140.0, -20.0, 0.9), None, "by too little");
    assert_eq!(leads(200.0, -300.0, 0.9), None, "the PSF explains three fifths as well");
    assert_eq!(leads(200.0, -100.0, 0.4), None, "in a few places only");
    assert_eq!(leads(-10.0, 105.0, 0.9), Some((LookingLike::Even, 105.0)));
    assert_eq!(leads(-10.0, 95.0, 0.9), None);
    let even = Some((LookingLike::Even, 300.0));
    assert_eq!(leads(200.0, 300.0, 0.9), even, "nothing explains as much as no structure");
}

#[test]
fn a_psf_without_structure_tells_nothing() {
    let psf = panel([9.0, 14.0]);
    let round = LookingLike::Even.of(&psf).unwrap();
    assert!(structure(&round) < LEAST_STRUCTURE && structure(&psf) > 10.0 * LEAST_STRUCTURE);
    assert_eq!(looks_like(&capture(&psf), &round), None);
}

#[test]
fn a_row_of_pixels_and_a_dark_centre_tell_nothing_and_are_no_errors() {
    let capture = capture(&panel([9.0, 14.0]));
    let row = Array3::from_shape_fn((3, 1, 15), |(_, _, x)| 1.0 + x as f32);
    let far = Array3::from_shape_fn((3, 201, 201), |(_, y, x)| if y == 2 && x > 190 { 1.0 } else { 0.0 });
    for energy in [row, far] {
        assert_eq!(looks_like(&capture, &Psf::from_energy(energy).unwrap()), None);
    }
}

#[test]
fn resampling_keeps_light_in_place() {
    let plane = Array2::from_shape_fn((41, 41), |(y, x)| {
        (-((y as f32 - 20.0).powi(2) + (x as f32 - 24.0).powi(2)) / 4.0).exp()
    });
    let middle = |plane: &Array2<f32>| {
        let sum = plane.sum();
        let along = |axis: fn((usize, usize)) -> usize| {
            plane.indexed_iter().map(|(place, value)| axis(place) as f32 * value).sum::<f32>() / sum
        };
        [along(|place| place.0), along(|place| place.1)]
    };
    let near = |plane: Array2<f32>, expected: [f32; 2]| {
        let found = middle(&plane);
        assert!((0..2).all(|axis| (found[axis] - expected[axis]).abs() < 0.05), "{found:?} for {expected:?}");
    };
    near(resampled(plane.view(), 0.0, 2.0), [20.0, 28.0]);
    near(resampled(plane.view(), 0.0, 0.5), [20.0, 22.0]);
    near(resampled(plane.view(), 30.0, 1.0), [18.0, 23.464]);
    near(even(plane.view()), [20.0, 20.0]);
}
