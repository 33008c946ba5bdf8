use super::super::frame::Frame;
use super::super::tests::panel_psf;
use super::*;
use crate::core::fft::TransformPrecision;
use crate::core::rng::stream;
use crate::restore::deconvolution::Border;
use rand::RngExt as _;

const LEVEL: f32 = 16.0;

/// A capture of 64 × 64 pixels with 2 × 2 that are so many times above saturation, through a panel.
struct Lamp {
    frame: Frame,
    psf: Array2<f32>,
    capture: Array2<f32>,
    saturated: Array2<bool>,
    brightness: Array2<f32>,
}

impl Lamp {
    fn new(times_level: f32) -> Self {
        Self::of_scene(|y, x| match (y, x) {
            (30..32, 36..38) => times_level * LEVEL,
            _ => 0.2 + 0.05 * (y as f32 / 9.0).sin() * (x as f32 / 7.0).cos(),
        })
    }

    fn of_scene(light: impl Fn(usize, usize) -> f32) -> Self {
        let psf = panel_psf(65);
        let frame = Frame::new([64, 64], [65, 65], Border::Zero, TransformPrecision::Single);
        let scene = Array2::from_shape_fn((64, 64), |(y, x)| light(y, x));
        let mut capture = frame.plane();
        frame.blur(psf.view()).unwrap().apply(&scene, &mut capture);
        capture.mapv_inplace(|y| y.clamp(0.0, LEVEL));
        let saturated = capture.mapv(|y| y >= LEVEL);
        let brightness = super::super::smooth::local_mean(&capture, 4.0) + 0.25;
        Self { frame, psf, capture, saturated, brightness }
    }

    /// Calls with the channel and how many of its pixels are saturated.
    fn with(&self, check: impl FnOnce(&Clipped<'_>, &Blur<'_>, usize)) {
        let Self { frame, psf, capture, saturated, brightness } = self;
        let (blur, squared) = (frame.blur(psf.view()).unwrap(), frame.squared_blur(psf.view()).unwrap());
        let (capture, brightness) = (capture.view(), brightness.view());
        let seen = seen_pixels(&blur, saturated);
        let clipped = Clipped::new(&blur, capture, [saturated, &seen], (brightness, LEVEL));
        check(&clipped, &squared, saturated.iter().filter(|saturated| **saturated).count());
    }
}

#[test]
fn the_light_of_a_lamp_a_thousand_times_above_saturation_is_found() {
    Lamp::new(1000.0).with(|clipped, squared, count| {
        assert!(count < 1000, "{count} pixels of 4096 are saturated");
        let light = clipped.measure(squared, &Progress::default()).unwrap().light;
        let of_level = clipped.saturated.mapv(|saturated| if saturated { LEVEL } else { 0.0 });
        assert!(clipped.misfit(&light) < 1e-2 * clipped.misfit(&of_level));
        let dark = light.iter().zip(clipped.saturated).filter(|(_, saturated)| !**saturated);
        assert!(dark.map(|(light, _)| *light).all(|light| light == 0.0));
        let part = light.sum() / (4000.0 * LEVEL);
        assert!((part - 1.0).abs() < 0.05, "{part}");
    });
}

#[test]
fn light_convinces_where_it_explains_much_and_is_that_of_few_pixels() {
    Lamp::new(30_000.0).with(|clipped, squared, _| {
        let light = clipped.measure(squared, &Progress::default()).unwrap().light;
        assert!(clipped.is_convincing(&light));
        assert!(!clipped.is_convincing(&clipped.at_level()), "explains nothing");
        let spread = clipped.saturated.mapv(|saturated| if saturated { 8.0 * LEVEL } else { 0.0 });
        assert!(!clipped.is_convincing(&spread), "shines all over");
    });
}

/// A lamp's light is believed as it is, and of a hundred times a window's, which would throw more flare than there is, the window's.
#[test]
fn light_that_outshines_the_capture_is_not_believed() {
    Lamp::new(1000.0).with(|clipped, squared, _| {
        let light = clipped.fitted(squared, &Progress::default()).unwrap().light;
        assert!(clipped.measure(squared, &Progress::default()).unwrap().light == light);
    });
    Lamp::of_scene(|y, x| match (y, x) {
        (0..44, 4..22) if x != 12 && y != 20 => 1.1 * LEVEL,
        _ => 0.6 + 0.3 * (y as f32 / 9.0).sin() * (x as f32 / 3.0).cos(),
    })
    .with(|clipped, _, count| {
        assert!(count > 100, "{count} pixels are saturated");
        let of_level = clipped.at_level();
        let believed =
            |light: &Array2<f32>| clipped.plausible(light, &of_level).unwrap_or_else(|| light.clone());
        assert_eq!(believed(&of_level), of_level);
        assert_eq!(believed(&(&of_level * 100.0)), of_level);
        // As a lamp shines, and some flare is believed.
        let mut light = of_level.clone();
        light[[10, 8]] = 1e4 * LEVEL;
        let part = believed(&light)[[10, 8]] / light[[10, 8]];
        assert!((0.01..0.5).contains(&part), "{part}");
    });
}

/// Beside leaves in the sun the flare explains little, and what it is brighter than the capture by is more than noise.
#[test]
fn the_light_of_a_sun_is_believed_in_a_scene_that_drowns_its_flare() {
    let mut rng = stream(4, "leaves");
    let leaves = Array2::from_shape_simple_fn((22, 22), || rng.random_range(0.02..3.0f32));
    Lamp::of_scene(|y, x| match (y, x) {
        (30..32, 36..38) => 1000.0 * LEVEL,
        _ => leaves[[y / 3, x / 3]],
    })
    .with(|clipped, squared, _| {
        let light = clipped.measure(squared, &Progress::default()).unwrap().light;
        assert!(clipped.misfit(&light) > CONVINCING * clipped.left_by_level().1, "explains much");
        let part = light.sum() / (4000.0 * LEVEL);
        assert!((0.7..1.4).contains(&part), "{part}");
    });
}

/// What the glare of a sun saturates is painted over, and windows stay.
#[test]
fn glare_is_taken_away_and_windows_are_not() {
    Lamp::new(30_000.0).with(|clipped, squared, count| {
        let light = clipped.measure(squared, &Progress::default()).unwrap().light;
        let without = clipped.without_glare(light.clone());
        let pairs = without.iter().zip(&light).zip(clipped.saturated);
        let taken = pairs.filter(|((without, _), saturated)| **saturated && **without <= 0.0).count();
        assert!(2 * taken > count, "{taken} of {count}");
        assert!(without.sum() > 0.9 * light.sum());
        for times in [3.0, 500.0] {
            let window = clipped.at_level() * times;
            assert_eq!(clipped.without_glare(window.clone()), window);
        }
    });
}

/// Half the resolution tells the light of blocks, here four fifths of it over nine times a lamp's pixels; what is right already stays.
#[test]
fn light_from_half_the_resolution_is_corrected() {
    Lamp::new(1000.0).with(|clipped, _, _| {
        let truth = |y: usize, x: usize| (30..32).contains(&y) && (36..38).contains(&x);
        let spread = |y: usize, x: usize| (28..34).contains(&y) && (34..40).contains(&x);
        let plane = |light: &dyn Fn(usize, usize) -> f32| {
            Array2::from_shape_fn(
                (64, 64),
                |(y, x)| if clipped.saturated[[y, x]] { light(y, x) } else { 0.0 },
            )
        };
        let coarse = plane(&|y, x| if spread(y, x) { 0.8 / 9.0 * 1000.0 * LEVEL } else { 0.0 });
        let corrected = clipped.corrected(coarse.clone(), &Progress::default()).unwrap();
        assert!(clipped.misfit(&corrected) < 0.1 * clipped.misfit(&coarse));
        let part = corrected.sum() / (4000.0 * LEVEL);
        assert!((part - 1.0).abs() < 0.05, "{part}");
        let right = plane(&|y, x| if truth(y, x) { 1000.0 * LEVEL } else { 0.0 });
        let kept = clipped.corrected(right.clone(), &Progress::default()).unwrap();
        assert!(clipped.misfit(&kept) <= clipped.misfit(&right));
    });
}

/// Its glare saturates hundreds of pixels, over which steps of one size spread its light: a three-thousandth of it is left to
/// its own four, and fifty times as much of the flare is missed.
#[test]
fn the_light_of_a_sun_gathers_in_its_own_pixels() {
    Lamp::new(100_000.0).with(|clipped, squared, count| {
        assert!((200..1000).contains(&count), "{count} pixels of 4096 are saturated");
        let light = clipped.measure(squared, &Progress::default()).unwrap().light;
        let part = light.slice(ndarray::s![30..32, 36..38]).sum() / light.sum();
        assert!(part > 0.4, "{part}");
    });
}
