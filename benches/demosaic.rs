//! Prints how close demosaicing comes to the scene: `cargo bench --bench demosaic [-- VIEWS]`.
//!
//! VIEWS is a folder of linear images, as `udc crop` makes them of panoramas; without one, scenes are generated. Each is
//! scaled to a median of 0.18, sampled through a Bayer mosaic and interpolated: bilinearly, by Malvar, He and Cutler's
//! filters in linear light, and by the same in compressed light, as `udc restore` and `udc fuse` do. PSNR of tone-mapped
//! images, 4 pixels of border left out; the mean gain has to be 2 dB at least.
#![expect(clippy::print_stdout, reason = "a benchmark prints its result")]

use std::path::PathBuf;

use ndarray::{Array2, Array3, ArrayView2};
use udc::capture::bayer::{BayerPattern, demosaic, demosaic_scene};
use udc::core::image::{Linear, ToneMappedImage};
use udc::core::metrics::{MetricDefinition, psnr};
use udc::core::tone::ToneCurve;
use udc::io::{expand_inputs, read_image};

const PATTERN: BayerPattern = BayerPattern::Rggb;

/// Median irradiance of a well exposed picture: the grey card.
const MEDIAN: f32 = 0.18;

/// The gain over bilinear interpolation that is asked for, in dB.
const GOAL_DB: f64 = 2.0;

fn main() {
    let folder = std::env::args().skip(1).find(|argument| !argument.starts_with("--"));
    let scenes = folder.map_or_else(generated, |folder| views(PathBuf::from(folder)));
    println!("{:24} {:>9} {:>9} {:>11} {:>6}", "PSNR in dB", "bilinear", "linear", "compressed", "gain");
    let mut sums = [0.0; 3];
    for (name, scene) in &scenes {
        let scene = exposed(scene);
        let mosaic = sampled(&scene);
        let found = [
            bilinear(mosaic.view()),
            demosaic(mosaic.view(), PATTERN).expect("the view is large enough"),
            demosaic_scene(mosaic.view(), PATTERN).expect("the view is large enough"),
        ]
        .map(|planes| tone_mapped_psnr(&planes, &scene));
        print_row(name, found);
        sums.iter_mut().zip(found).for_each(|(sum, value)| *sum += value);
    }
    let means = sums.map(|sum| sum / scenes.len() as f64);
    print_row("mean", means);
    assert!(means[2] - means[0] >= GOAL_DB, "less than {GOAL_DB} dB above bilinear interpolation");
}

fn print_row(name: &str, [simple, linear, compressed]: [f64; 3]) {
    println!("{name:24} {simple:9.2} {linear:9.2} {compressed:11.2} {:+6.2}", compressed - simple);
}

fn views(folder: PathBuf) -> Vec<(String, Array3<f32>)> {
    let files = expand_inputs(&[folder]).expect("a folder of images");
    let read = |file: PathBuf| {
        let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        (name, read_image::<Linear>(&file).expect("a linear image").into_planes())
    };
    files.into_iter().map(read).collect()
}

/// Scenes of 256 × 256 with texture, edges of colour and lamps: by day, at dusk, at night.
fn generated() -> Vec<(String, Array3<f32>)> {
    let scene = |lamp: f32| {
        Array3::from_shape_fn((3, 256, 256), |(c, y, x)| {
            let (v, u) = (y as f32, x as f32);
            let texture = 1.0 + 0.3 * (0.9 * v + 0.4 * u).sin() + 0.3 * (0.004 * u * v).cos();
            let paint = [0.3, 0.25, 0.2][(c + usize::from((u + 0.6 * v) % 90.0 < 40.0)) % 3];
            let is_lamp = (u % 64.0 - 30.0).hypot(v % 80.0 - 37.0) < 3.0;
            if is_lamp { lamp * [1.0, 0.9, 0.7][c] } else { paint * texture }
        })
    };
    [("day", 1.0), ("dusk", 20.0), ("night", 400.0)]
        .map(|(name, lamp)| (name.to_owned(), scene(lamp)))
        .to_vec()
}

fn exposed(scene: &Array3<f32>) -> Array3<f32> {
    let mut values: Vec<f32> = scene.iter().copied().collect();
    let middle = values.len() / 2;
    let median = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
    let curve = ToneCurve::default();
    scene.mapv(|value| curve.clip(value * MEDIAN / median.max(f32::MIN_POSITIVE)))
}

fn sampled(scene: &Array3<f32>) -> Array2<f32> {
    let (_, height, width) = scene.dim();
    Array2::from_shape_fn((height, width), |(y, x)| scene[[PATTERN.channel(y, x), y, x]])
}

/// The mean of the neighbours of the wanted colour, of the 3 × 3 photosites around.
fn bilinear(mosaic: ArrayView2<'_, f32>) -> Array3<f32> {
    let (height, width) = mosaic.dim();
    Array3::from_shape_fn((3, height, width), |(c, y, x)| {
        if PATTERN.channel(y, x) == c {
            return mosaic[[y, x]];
        }
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let places = rows.flat_map(|y| (x.saturating_sub(1)..(x + 2).min(width)).map(move |x| (y, x)));
        let (sum, count) = places
            .filter(|&(y, x)| PATTERN.channel(y, x) == c)
            .fold((0.0, 0.0), |(sum, count), place| (sum + mosaic[place], count + 1.0));
        sum / count
    })
}

fn tone_mapped_psnr(found: &Array3<f32>, expected: &Array3<f32>) -> f64 {
    let curve = ToneCurve::default();
    let tone_mapped = |planes: &Array3<f32>| {
        ToneMappedImage::from_planes(planes.mapv(|x| curve.compress(x.max(0.0)))).expect("finite light")
    };
    let definition = MetricDefinition { border: 4, ..MetricDefinition::float() };
    psnr(&tone_mapped(found), &tone_mapped(expected), &definition).expect("images of one size")
}
