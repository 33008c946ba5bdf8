//! A capture behind a panel that is turned and scaled tells by how much.

use ndarray::{Array2, Array3, s};
use rand::RngExt as _;

use super::*;
use crate::core::fft::{Boundary, Convolver};
use crate::core::rng::stream;

const SIDE: usize = 160;
const LEVEL: f32 = 16.0;

/// A core, spikes along the axes and orders upon them, out to 48 pixels, of a panel in a pose.
fn panel([turn_deg, scale]: Pose2) -> Psf {
    let (sin, cos) = turn_deg.to_radians().sin_cos();
    let light = |y: usize, x: usize| {
        let (dy, dx) = (y as f64 - 50.0, x as f64 - 50.0);
        // Counter-clockwise as displayed.
        let u = (cos * dx - sin * dy) / (1.0 + scale);
        let v = (sin * dx + cos * dy) / (1.0 + scale);
        let spike = |along: f64, across: f64| (-across.powi(2) / 2.0 - along.abs() / 15.0).exp();
        let order = |a: f64, b: f64| (-((u - a).powi(2) + (v - b).powi(2)) / 3.0).exp();
        let orders: f64 = [16.0, 32.0, 48.0]
            .into_iter()
            .map(|r| (order(r, 0.0) + order(-r, 0.0) + order(0.0, r) + order(0.0, -r)) * 8.0 / r)
            .sum();
        (-(u * u + v * v) / 2.0).exp() + 2e-3 * (spike(u, v) + spike(v, u)) + 2e-3 * orders
    };
    Psf::from_energy(Array3::from_shape_fn((3, 101, 101), |(_, y, x)| light(y, x) as f32)).unwrap()
}

/// A core and a lattice of orders, out to 80 pixels, of a panel in a pose.
fn lattice(pose: Pose2) -> Psf {
    lattice_of(pose, 2.0)
}

/// The same of orders as small as that: twice the square of their deviation, in pixels.
fn lattice_of([turn_deg, scale]: Pose2, size: f64) -> Psf {
    let (sin, cos) = turn_deg.to_radians().sin_cos();
    let light = |y: usize, x: usize| {
        let (dy, dx) = (y as f64 - 80.0, x as f64 - 80.0);
        let [u, v] = [cos * dx - sin * dy, sin * dx + cos * dy].map(|at| at / (1.0 + scale));
        let nearest = |at: f64| 8.0 * (at / 8.0).round();
        let squares = (u - nearest(u)).powi(2) + (v - nearest(v)).powi(2);
        (-(u * u + v * v) / 2.0).exp() + 1e-3 * (-squares / size - u.hypot(v) / 50.0).exp()
    };
    Psf::from_energy(Array3::from_shape_fn((3, 161, 161), |(_, y, x)| light(y, x) as f32)).unwrap()
}

/// A textured scene with discs of light: (row, column, radius, light).
fn scene(lamps: &[(f64, f64, f64, f32)]) -> LinearImage {
    let mut rng = stream(11, "walls");
    let texture = Array2::from_shape_simple_fn((SIDE, SIDE), || rng.random::<f32>());
    LinearImage::from_planes(Array3::from_shape_fn((3, SIDE, SIDE), |(_, y, x)| {
        let disc = |&(cy, cx, radius, light): &(f64, f64, f64, f32)| {
            if (y as f64 - cy).hypot(x as f64 - cx) <= radius { light } else { 0.0 }
        };
        let wall = if (x / 20 + y / 27) % 2 == 0 { 0.3 } else { 0.15 };
        wall + 0.05 * texture[[y, x]] + lamps.iter().map(disc).fold(0.0, f32::max)
    }))
    .unwrap()
}

/// The capture of a scene, clipped at a level.
fn capture(scene: &LinearImage, psf: &Psf, level: f32) -> LinearImage {
    let convolver = Convolver::new([SIDE, SIDE], [psf.height(), psf.width()], Boundary::Zero).unwrap();
    let seen = convolver.convolve(&convolver.spectrum(scene).unwrap(), &convolver.otf(psf).unwrap());
    LinearImage::from_planes(seen.mapv(|value| value.clamp(0.0, level))).unwrap()
}

fn search(capture: &LinearImage, level: f32) -> FoundPose {
    search_beyond(capture, level, [0.0; 2])
}

fn search_beyond(capture: &LinearImage, level: f32, least_move: Pose2) -> FoundPose {
    find_pose(capture, &panel([0.0; 2]), &config(level, least_move), &Progress::default()).unwrap()
}

fn config(level: f32, least_move: Pose2) -> PoseConfig {
    PoseConfig { alpha: 0.25, saturation: [level; CHANNELS], least_move }
}

/// Searches a pose; the estimate is within four of its deviations.
fn found(lamps: &[(f64, f64, f64, f32)], level: f32, pose: Pose2) -> PoseEstimate {
    let found = search(&capture(&scene(lamps), &panel(pose), level), level).expect("the flare is strong");
    let errors =
        [(found.turn_deg - pose[0]) / found.turn_sigma_deg, (found.scale - pose[1]) / found.scale_sigma];
    assert!(errors.iter().all(|error| error.abs() < 4.0), "{errors:?} deviations off: {found:?}");
    assert!((found.turn_deg - pose[0]).abs() < 0.03, "{found:?} for {pose:?}");
    found
}

fn assert_found(lamps: &[(f64, f64, f64, f32)], pose: Pose2) {
    let found = found(lamps, LEVEL, pose);
    assert!((found.scale - pose[1]).abs() < 1e-3, "{found:?} for {pose:?}");
}

const SUN: [(f64, f64, f64, f32); 1] = [(70.3, 85.6, 3.0, 1500.0)];
const LAMPS: [(f64, f64, f64, f32); 4] = [
    (40.0, 50.0, 1.5, 900.0),
    (50.0, 120.0, 2.5, 500.0),
    (118.0, 70.0, 2.0, 700.0),
    (100.0, 130.0, 1.5, 1500.0),
];

#[test]
fn finds_the_pose_from_a_sun() {
    assert_found(&SUN, [0.3, 0.004]);
}

#[test]
fn finds_the_pose_from_lamps() {
    assert_found(&LAMPS, [0.3, 0.004]);
    assert_found(&LAMPS, [-0.55, -0.006]);
}

/// The sun itself is not in the frame: it tells by its orders alone, and shines in pixels that the pose of the PSF would not have it in.
#[test]
fn finds_the_pose_from_a_sun_beyond_the_border() {
    const CUT: usize = 24;
    let (sun, config) = ([(70.3, 8.6, 1.5, 6000.0)], config(LEVEL, [0.0; 2]));
    for pose in [[0.4, 0.005], [-0.3, -0.006], [0.0, 0.0]] {
        let seen = capture(&scene(&sun), &lattice(pose), LEVEL).crop(0, CUT, SIDE, SIDE - CUT);
        let found =
            find_pose_by_lamp_outside(&seen, &lattice([0.0; 2]), &config, &Progress::default()).unwrap();
        let found = found.pose().expect("the flare is strong");
        assert!((found.turn_deg - pose[0]).abs() < 4.0 * found.turn_sigma_deg, "{found:?} for {pose:?}");
        assert!((found.scale - pose[1]).abs() < 4.0 * found.scale_sigma, "{found:?} for {pose:?}");
        assert!((found.turn_deg - pose[0]).abs() < 0.1, "{found:?} for {pose:?}");
    }
    let none = scene(&[]).crop(0, CUT, SIDE, SIDE - CUT);
    let found = find_pose_by_lamp_outside(&none, &lattice([0.0; 2]), &config, &Progress::default());
    assert_eq!(found.unwrap(), FromOutside::NoLamp);
}

/// The orders that are clipped too tell nothing by themselves, and light that may shine there would explain those beside them.
#[test]
fn finds_far_poses_from_a_sun_whose_orders_are_clipped() {
    let sun = [(SUN[0].0, SUN[0].1, SUN[0].2, 5000.0)];
    for pose in [[0.3, 0.004], [0.9, -0.01], [-0.8, 0.012]] {
        let found = search(&capture(&scene(&sun), &panel(pose), LEVEL), LEVEL).expect("the flare is strong");
        assert!((found.turn_deg - pose[0]).abs() < 0.05, "{found:?} for {pose:?}");
    }
}

/// The poses of the grid pass beside orders of 0.6 pixels, up to 80 pixels from the lamp, and tell nothing.
#[test]
fn finds_poses_between_those_of_the_grid_by_sharp_orders() {
    const SIZE: f64 = 0.7;
    let (psf, progress) = (lattice_of([0.0; 2], SIZE), Progress::default());
    let movable = Movable::new(psf.channel(1));
    for pose in [[-0.82, -0.0059], [0.52, 0.0031], [0.38, -0.009]] {
        let dim = LAMPS.map(|(y, x, radius, light)| (y, x, radius, 0.6 * light));
        let seen = capture(&scene(&dim), &lattice_of(pose, SIZE), LEVEL);
        let scene = Scene::new(seen.channel(1), movable.size(), (LEVEL, 0.25), 1.0).unwrap();
        let mut search = Search::new(scene, &movable, &progress).unwrap();
        search.start().unwrap();
        assert!(!search.tells_much().unwrap(), "{pose:?} is none between those of the grid");
        let found = find_pose(&seen, &psf, &config(LEVEL, [0.0; 2]), &progress).unwrap();
        let found = found.expect("the flare is strong");
        assert!((found.turn_deg - pose[0]).abs() < 0.05, "{found:?} for {pose:?}");
        assert!((found.scale - pose[1]).abs() < 1e-3, "{found:?} for {pose:?}");
    }
}

#[test]
fn hot_pixels_are_no_lamps() {
    let pose = [0.2, -0.003];
    let mut planes = capture(&scene(&LAMPS), &panel(pose), 1e4).into_planes();
    (10..150).step_by(20).for_each(|at| planes.slice_mut(ndarray::s![.., at, 160 - at]).fill(1e4));
    let found = search(&LinearImage::from_planes(planes).unwrap(), 1e4).expect("the flare is strong");
    assert!((found.turn_deg - pose[0]).abs() < 0.05, "{found:?}");
}

/// Their orders, bright as they are, count as lamps too, and the scale is known less well.
#[test]
fn finds_the_turn_from_lamps_that_are_not_clipped() {
    found(&LAMPS, 1e4, [0.2, -0.003]);
}

#[test]
fn a_psf_in_its_pose_stays_there() {
    assert_found(&SUN, [0.0, 0.0]);
}

/// One that stays is not told, and of one that moves the same is told as without a least move.
#[test]
fn moves_below_the_least_are_not_told() {
    let seen = |pose| capture(&scene(&SUN), &panel(pose), LEVEL);
    let least_move = [0.02, 1e-3];
    assert_eq!(search_beyond(&seen([0.0, 0.0]), LEVEL, least_move), Err(UntoldPose::InPlace));
    for pose in [[0.1, 0.0], [0.0, 0.004]] {
        let seen = seen(pose);
        assert_eq!(search_beyond(&seen, LEVEL, least_move), Ok(search(&seen, LEVEL).unwrap()), "{pose:?}");
    }
}

#[test]
fn without_lamps_nothing_is_told() {
    assert_eq!(search(&capture(&scene(&[]), &panel([0.3, 0.004]), LEVEL), LEVEL), Err(UntoldPose::NoLamps));
    let flat = LinearImage::from_planes(Array3::from_elem((3, SIDE, SIDE), LEVEL)).unwrap();
    assert_eq!(search(&flat, LEVEL), Err(UntoldPose::MuchSaturated), "nothing but light");
    let dark = LinearImage::from_planes(Array3::zeros((3, SIDE, SIDE))).unwrap();
    assert_eq!(search(&dark, LEVEL), Err(UntoldPose::NoLamps));
}

/// A pose of the sun, and a sky that is saturated as well.
#[test]
fn what_is_saturated_for_a_large_part_tells_nothing() {
    let seen = capture(&scene(&SUN), &panel([0.3, 0.004]), LEVEL);
    for (rows, is_told) in [(SIDE / 8, true), (SIDE / 2, false)] {
        let mut planes = seen.clone().into_planes();
        planes.slice_mut(s![.., SIDE - rows.., ..]).fill(LEVEL);
        let found = search(&LinearImage::from_planes(planes).unwrap(), LEVEL);
        assert_eq!(found != Err(UntoldPose::MuchSaturated), is_told, "{rows}: {found:?}");
    }
}

/// Of a wall of windows any pose may be the best.
#[test]
fn light_from_all_over_tells_nothing() {
    let places = [30.0, 80.0, 130.0];
    let windows: Vec<_> = places.iter().flat_map(|y| places.map(|x| (*y, x, 6.0, 20.0 * LEVEL))).collect();
    let found = search(&capture(&scene(&windows), &panel([0.3, 0.004]), LEVEL), LEVEL);
    assert_eq!(found, Err(UntoldPose::Wide));
}

/// Light that is clipped by a hair has no flare that could be told from the scene's detail.
#[test]
fn weak_flare_tells_nothing() {
    let window = [(60.0, 80.0, 9.0, 1.2 * LEVEL)];
    assert_eq!(
        search(&capture(&scene(&window), &panel([0.3, 0.004]), LEVEL), LEVEL),
        Err(UntoldPose::WeakFlare)
    );
}

#[test]
fn refuses_a_saturation_that_is_no_light() {
    let config = PoseConfig { alpha: 0.25, saturation: [1.0, 0.0, 1.0], least_move: [0.0; 2] };
    let image = scene(&[]);
    let error = find_pose(&image, &panel([0.0; 2]), &config, &Progress::default()).unwrap_err();
    assert!(error.to_string().contains("saturation"), "{error}");
}

/// Whole steps would swing about 0.3 from 0 to 0.6 and back, nine tenths as far each time; or take 22 rounds to come as close to it.
#[test]
fn steps_that_turn_back_or_are_short_end_in_the_middle() {
    for share in [1.9, 0.4] {
        let (mut place, mut of_last) = (0.0, (0.0, 0.0));
        for _ in 0..2 {
            let step = share * (0.3 - place);
            let taken = secant(step, of_last);
            of_last = (step, taken);
            place += taken;
        }
        assert!((place - 0.3_f64).abs() < 1e-12, "{place} of {share}");
    }
    assert_eq!(secant(0.2, (0.5, 0.5)), 0.2 / 0.6, "two thirds of the step are left of each");
    assert_eq!(secant(0.2, (0.2, 0.2)), 0.2 * FURTHER, "no end is in sight");
    assert_eq!(secant(0.2, (0.1, 0.1)), 0.2 * FURTHER, "steps become longer");
    assert_eq!([secant(0.2, (0.0, 0.0)), secant(0.0, (0.1, 0.1))], [0.2, 0.0]);
}

#[test]
fn a_sky_that_one_colour_clips_in_is_no_lamp() {
    let config = PoseConfig { alpha: 0.25, saturation: [1.0; CHANNELS], least_move: [0.0; 2] };
    let capture = |blue: usize| {
        LinearImage::from_planes(Array3::from_shape_fn((CHANNELS, 40, 50), |(channel, y, x)| match channel {
            2 if y < blue => 1.0,
            1 if y == 30 && x < 20 => 1.0,
            0 if y == 30 && x < 10 => 1.0,
            _ => 0.5,
        }))
        .unwrap()
    };
    assert_eq!(channel_of_lamps(&capture(0), &config), (1, 20));
    assert_eq!(channel_of_lamps(&capture(1), &config), (2, 50), "blue lamps");
    assert_eq!(channel_of_lamps(&capture(3), &config), (1, 20), "blue has 150");
    assert_eq!(channel_of_lamps(&capture(10), &config), (1, 20), "blue has 500");
}

#[test]
fn poses_are_relative_to_where_a_search_begins() {
    let movable = || Movable::new(lattice([0.0; 2]).channel(1));
    let mut begun = movable();
    begun.begin_at([0.5, 0.004]);
    let (moved, at_once) = (begun.at([-0.1, 0.01]), movable().at([0.4, 1.004 * 1.01 - 1.0]));
    let apart = moved.iter().zip(&at_once).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(apart < 1e-8, "{apart}");
}
