//! Natural scenes have the statistics of natural images.

use rustfft::FftPlanner;
use rustfft::num_complex::Complex32;

use super::light::luminance;
use super::{NaturalKind, natural, paint_natural};
use crate::core::image::LinearImage;

const SIDE: usize = 128;

fn log_luminance(image: &LinearImage) -> Vec<f32> {
    let [red, green, blue] = [0, 1, 2].map(|channel| image.channel(channel));
    let values = red.iter().zip(green).zip(blue);
    values.map(|((r, g), b)| (luminance(&[*r, *g, *b]) + 1e-4).ln()).collect()
}

/// The exponent of the radially averaged power spectrum of the logarithm of the luminance, from 4 to 0.3·side cycles,
/// under a Hann window; octaves weigh the same.
fn spectral_slope(image: &LinearImage) -> f32 {
    let values = log_luminance(image);
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    let window = |i: usize| 0.5 - 0.5 * (std::f32::consts::TAU * i as f32 / SIDE as f32).cos();
    let mut field: Vec<Complex32> = (0..SIDE * SIDE)
        .map(|i| Complex32::from((values[i] - mean) * window(i / SIDE) * window(i % SIDE)))
        .collect();
    let transform = FftPlanner::new().plan_fft_forward(SIDE);
    for _ in 0..2 {
        transform.process(&mut field);
        field = (0..SIDE * SIDE).map(|i| field[i % SIDE * SIDE + i / SIDE]).collect();
    }
    let frequency = |i: usize| i.min(SIDE - i) as f32;
    let mut rings = vec![(0.0f32, 0.0f32); SIDE];
    for (i, value) in field.iter().enumerate() {
        let ring = &mut rings[frequency(i / SIDE).hypot(frequency(i % SIDE)).round() as usize];
        *ring = (ring.0 + value.norm_sqr(), ring.1 + 1.0);
    }
    let points =
        (4..3 * SIDE / 10).map(|k| ((k as f32).ln(), (rings[k].0 / rings[k].1).ln(), 1.0 / k as f32));
    let sum = |f: &dyn Fn(f32, f32) -> f32| points.clone().map(|(x, y, w)| w * f(x, y)).sum::<f32>();
    let weight = sum(&|_, _| 1.0);
    let (x, y) = (sum(&|x, _| x) / weight, sum(&|_, y| y) / weight);
    sum(&|u, v| (u - x) * (v - y)) / sum(&|u, _| (u - x) * (u - x))
}

/// The kurtosis of horizontal differences of the logarithm of the luminance: 3 for Gaussian noise.
fn kurtosis(image: &LinearImage) -> f32 {
    let values = log_luminance(image);
    let changes: Vec<f32> =
        values.chunks(SIDE).flat_map(|row| row.windows(2).map(|pair| pair[1] - pair[0])).collect();
    let moment = |power: i32| changes.iter().map(|v| v.powi(power)).sum::<f32>() / changes.len() as f32;
    moment(4) / moment(2).powi(2)
}

fn share(image: &LinearImage, is_counted: impl Fn(f32) -> bool) -> f32 {
    let values = image.as_slice();
    values.iter().filter(|value| is_counted(**value)).count() as f32 / values.len() as f32
}

/// Three scenes of each kind.
fn examples() -> Vec<(String, LinearImage)> {
    let kinds = NaturalKind::SHARES.map(|(kind, _)| kind);
    let paint = |kind, seed| paint_natural(kind, seed, [SIDE, SIDE]).unwrap();
    let scenes = kinds.into_iter().flat_map(|kind| (0..3).map(move |seed| paint(kind, seed)));
    scenes.map(|scene| (scene.name, scene.image)).collect()
}

#[test]
fn spectra_fall_as_those_of_natural_images() {
    let slopes: Vec<(f32, String)> =
        examples().into_iter().map(|(name, image)| (spectral_slope(&image), name)).collect();
    // Photographs scatter by 0.3 and more around −2: Torralba & Oliva, "Statistics of natural image categories" (2003).
    let outside = |(slope, _): &&(f32, String)| !(-3.2..=-1.2).contains(slope);
    assert_eq!(slopes.iter().find(outside), None, "{slopes:?}");
    let mean = slopes.iter().map(|(slope, _)| slope).sum::<f32>() / slopes.len() as f32;
    assert!((-2.4..=-1.7).contains(&mean), "{mean}: {slopes:?}");
}

#[test]
fn derivatives_are_sparse() {
    for (name, image) in examples() {
        let kurtosis = kurtosis(&image);
        assert!(kurtosis > 3.5, "{name}: {kurtosis}");
    }
}

#[test]
fn mid_tones_are_exposed_and_little_is_clipped() {
    let examples = examples();
    for (name, image) in &examples {
        assert!(share(image, |value| value >= 16.0) <= 0.2, "{name}");
        assert!(
            share(image, |value| value > 0.02) > 0.3 && share(image, |value| value < 1.0) > 0.5,
            "{name}"
        );
        assert!(image.as_slice().iter().all(|value| (0.0..=1e6).contains(value)), "{name}");
    }
    let peaks =
        |from: f32, to: f32| examples.iter().filter(|(_, image)| (from..to).contains(&image.max())).count();
    // Some scenes are without lamps, some have weak and some strong ones.
    assert!(peaks(0.3, 16.0) >= 3 && peaks(16.0, 1e3) >= 3 && peaks(1e3, 1e6) >= 3);
}

#[test]
fn the_same_seed_paints_the_same_scene_and_another_another() {
    let paint = |seed| natural(seed, [40, 56]).unwrap();
    let scene = paint(9);
    assert_eq!((scene.image.height(), scene.image.width()), (40, 56));
    assert_eq!((&scene.name, &scene.image), (&paint(9).name, &paint(9).image));
    assert!((10..20).all(|seed| paint(seed).image != scene.image));
    assert!(natural(9, [0, 3]).is_err());
}

#[test]
fn any_size_is_painted() {
    let kinds = NaturalKind::SHARES.map(|(kind, _)| kind);
    for kind in kinds.into_iter().chain([NaturalKind::Texture]) {
        for (seed, size) in [[1, 1], [1, 40], [33, 2], [17, 90]].into_iter().enumerate() {
            let image = paint_natural(kind, seed as u64, size).unwrap().image;
            assert_eq!([image.height(), image.width()], size, "{}", kind.name());
        }
    }
}

#[test]
fn seeds_draw_every_kind_by_its_share() {
    assert_eq!(NaturalKind::SHARES.iter().map(|(_, share)| share).sum::<u32>(), 100);
    let drawn: Vec<_> = (0..2000).map(NaturalKind::of_seed).collect();
    for (kind, share) in NaturalKind::SHARES {
        let found = drawn.iter().filter(|drawn| **drawn == kind).count() as f32 / 2000.0;
        let expected = share as f32 / 100.0;
        // Four standard deviations of 2000 draws.
        assert!(
            (found - expected).abs() < 4.0 * (expected * (1.0 - expected) / 2000.0).sqrt(),
            "{}: {found}",
            kind.name()
        );
    }
}

#[test]
fn textures_have_the_spectrum_of_natural_images_and_colours_that_differ() {
    let paint = |seed| paint_natural(NaturalKind::Texture, seed, [SIDE, SIDE]).unwrap().image;
    let scenes: Vec<LinearImage> = (0..8).map(paint).collect();
    let slopes: Vec<f32> = scenes.iter().map(spectral_slope).collect();
    assert!(slopes.iter().all(|slope| (-3.5..=-1.5).contains(slope)), "{slopes:?}");
    // Green over red changes from pixel to pixel where colours have noise of their own, and does not where they have none.
    let spread = |image: &LinearImage| {
        let (red, green) = (image.channel(0), image.channel(1));
        let ratios: Vec<f32> = green.iter().zip(red).map(|(g, r)| (g / r.max(1e-6)).ln()).collect();
        let mean = ratios.iter().sum::<f32>() / ratios.len() as f32;
        ratios.iter().map(|ratio| (ratio - mean).powi(2)).sum::<f32>() / ratios.len() as f32
    };
    let spreads: Vec<f32> = scenes.iter().map(spread).collect();
    assert!(spreads.iter().any(|spread| *spread > 0.02), "{spreads:?}");
}
