//! Perspective views of panoramas that are functions of the direction.

use ndarray::Array3;
use udc::core::image::LinearImage;
use udc::core::tone::ToneCurve;
use udc::crop::{Panorama, View, crop, crop_with_margin};

/// Samples `light(longitude, latitude, channel)` at the texel centres of a panorama.
#[expect(clippy::cast_possible_truncation, reason = "images are f32")]
fn panorama(height: usize, light: impl Fn(f64, f64, usize) -> f64) -> Panorama {
    let width = 2 * height;
    let planes = Array3::from_shape_fn((3, height, width), |(c, y, x)| {
        let longitude = ((x as f64 + 0.5) / width as f64 - 0.5) * 360f64.to_radians();
        let latitude = (0.5 - (y as f64 + 0.5) / height as f64) * 180f64.to_radians();
        light(longitude, latitude, c) as f32
    });
    Panorama::new(LinearImage::from_planes(planes).unwrap()).unwrap()
}

fn view(yaw_deg: f64, pitch_deg: f64, fov_deg: f64, size: usize) -> View {
    View { yaw_deg, pitch_deg, fov_deg, size }
}

/// A low polynomial of the unit direction (x right, y up, z ahead): smooth all over the sphere.
fn harmonic(x: f64, y: f64, z: f64, channel: usize) -> f64 {
    match channel {
        0 => 2.0 + x + 0.5 * y * z,
        1 => 2.0 + y - 0.5 * x * z,
        _ => 2.0 + z + 0.5 * x * y,
    }
}

/// The mean over a pixel of step s = 2·tan(40°)/120 is off by s²/24 times the Laplacian (at most 2 + 6/4),
/// bilinear interpolation between texels t = 2π/1024 apart by t²/8 times the second derivatives (at most 2
/// along each axis): 2.9e-5 + 1.9e-5. A shift by one pixel would show as 1e-2.
#[test]
fn shows_each_direction_at_its_pixel() {
    let light =
        |lon: f64, lat: f64, c: usize| harmonic(lon.sin() * lat.cos(), lat.sin(), lon.cos() * lat.cos(), c);
    let panorama = panorama(512, light);
    for (yaw, pitch) in
        [(0.0, 0.0), (37.0, 0.0), (180.0, 0.0), (-120.0, 40.0), (95.0, -65.0), (10.0, 90.0), (70.0, -90.0)]
    {
        let size = 121;
        let image = crop(&panorama, &view(yaw, pitch, 80.0, size));
        let (half, last) = (40f64.to_radians().tan(), (size - 1) as f64);
        for ((c, row, column), &found) in image.planes().indexed_iter() {
            // A ray of the camera at rest, then turned up by the pitch, then to the right by the yaw.
            let (right, up) =
                ((2.0 * column as f64 / last - 1.0) * half, (1.0 - 2.0 * row as f64 / last) * half);
            let (pitch, yaw) = (f64::to_radians(pitch), f64::to_radians(yaw));
            let (y, ahead) = (up * pitch.cos() + pitch.sin(), pitch.cos() - up * pitch.sin());
            let (x, z) = (right * yaw.cos() + ahead * yaw.sin(), ahead * yaw.cos() - right * yaw.sin());
            let norm = (x * x + y * y + z * z).sqrt();
            let expected = harmonic(x / norm, y / norm, z / norm, c);
            let error = (f64::from(found) - expected).abs();
            assert!(error < 5e-5, "yaw {yaw}, pitch {pitch}, row {row}, column {column}: {error}");
        }
    }
}

/// sin(latitude) is zero on the horizon, which a camera without roll sees as a level line.
#[test]
fn keeps_the_horizon_straight() {
    let panorama = panorama(256, |_, latitude, _| latitude.sin());
    // One row is 2·tan(45°)/100; a pitch of atan(0.5) lifts the middle by 25 rows.
    let image = crop(&panorama, &view(33.0, 0.5f64.atan().to_degrees(), 90.0, 101));
    for column in 0..101 {
        assert!(image.planes()[[0, 75, column]].abs() < 1e-5, "column {column}");
        assert!(image.planes()[[0, 74, column]] > 0.005 && image.planes()[[0, 76, column]] < -0.005);
    }
}

/// The same scene half way around the panorama: only the rounding of the angles differs.
#[test]
fn does_not_show_the_seam() {
    let texture = |x: usize, y: usize, c: usize| ((x * 31 + y * 17 + c * 7) % 29) as f64 / 29.0;
    let column = |longitude: f64| ((longitude / 360f64.to_radians() + 0.5) * 128.0) as usize;
    let row = |latitude: f64| ((0.5 - latitude / 180f64.to_radians()) * 64.0) as usize;
    let plain = panorama(64, |lon, lat, c| texture(column(lon), row(lat), c));
    let turned = panorama(64, |lon, lat, c| texture((column(lon) + 64) % 128, row(lat), c));
    for pitch in [0.0, 50.0, -90.0] {
        let front = crop(&plain, &view(0.0, pitch, 100.0, 40));
        let back = crop(&turned, &view(180.0, pitch, 100.0, 40));
        for (a, b) in front.as_slice().iter().zip(back.as_slice()) {
            assert!((a - b).abs() < 1e-5, "pitch {pitch}: {a} {b}");
        }
    }
}

#[test]
fn leaves_an_even_light_even() {
    let panorama = panorama(300, |_, _, c| 0.3 + c as f64);
    for (pitch, fov, size) in [(0.0, 90.0, 50), (90.0, 120.0, 33), (-45.0, 20.0, 64)] {
        let image = crop(&panorama, &view(12.0, pitch, fov, size));
        for ((c, _, _), &value) in image.planes().indexed_iter() {
            assert!((value / (0.3 + c as f32) - 1.0).abs() <= f32::EPSILON);
        }
    }
}

/// A panorama of noise and lamps with 3.3 texels a pixel, as 8192 columns for 800 pixels, against 8 × 8
/// bilinear samples in every pixel.
#[test]
fn does_not_alias_when_the_panorama_is_finer_than_the_view() {
    let noise = |longitude: f64, latitude: f64, c: usize| {
        let cell = ((longitude * 1e3).floor() * 12.9898 + (latitude * 1e3).floor() * 78.233 + c as f64).sin();
        let share = (cell * 43758.5453).rem_euclid(1.0);
        if share > 0.9999 { 1000.0 } else { share }
    };
    let (panorama, size, fine) = (panorama(1024, noise), 200, 8);
    let found = crop(&panorama, &view(20.0, 30.0, 90.0, size));
    // The fine view has `fine` pixels for each one: its outermost centres lie half a pixel, less half a fine
    // one, outside of the coarse view's.
    let widening = (size * fine - 1) as f64 / (fine * (size - 1)) as f64;
    let fov = 2.0 * widening.atan().to_degrees();
    let samples = crop(&panorama, &view(20.0, 30.0, fov, size * fine));
    let mean = mean_of_blocks(&samples, fine);
    let point = LinearImage::from_planes(Array3::from_shape_fn((3, size, size), |(c, y, x)| {
        samples.planes()[[c, y * fine + fine / 2, x * fine + fine / 2]]
    }))
    .unwrap();
    let (ours, aliased) = (psnr(&found, &mean), psnr(&point, &mean));
    assert!(ours > 40.0, "{ours:.2} dB");
    assert!(aliased < 25.0, "{aliased:.2} dB: the panorama is too smooth to show aliasing");
}

#[expect(clippy::cast_possible_truncation, reason = "images are f32")]
fn mean_of_blocks(image: &LinearImage, side: usize) -> LinearImage {
    let size = image.height() / side;
    let planes = Array3::from_shape_fn((3, size, size), |(c, y, x)| {
        let block = ndarray::s![c, y * side..(y + 1) * side, x * side..(x + 1) * side];
        let sum: f64 = image.planes().slice(block).iter().map(|&v| f64::from(v)).sum();
        (sum / (side * side) as f64) as f32
    });
    LinearImage::from_planes(planes).unwrap()
}

fn psnr(a: &LinearImage, b: &LinearImage) -> f64 {
    let curve = ToneCurve::default();
    let (a, b) = (curve.tone_map(a), curve.tone_map(b));
    let squares = a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| f64::from(a - b).powi(2));
    -10.0 * (squares.sum::<f64>() / a.as_slice().len() as f64).log10()
}

/// The same rays through the same footprints, so that not a bit differs; and what lies around the frame is what a wider
/// view at the same focal length shows.
#[test]
fn the_middle_of_a_view_with_a_margin_is_the_view() {
    let texture =
        |lon: f64, lat: f64, c: usize| ((37.0 * lon).sin() * (29.0 * lat).cos() + 1.5) * (c + 1) as f64;
    let panorama = panorama(96, texture);
    for (size, margin) in [(24, 7), (25, 10)] {
        let frame = view(33.0, -20.0, 60.0, size);
        let with_margin = crop_with_margin(&panorama, &frame, margin);
        assert_eq!((with_margin.height(), with_margin.width()), (size + 2 * margin, size + 2 * margin));
        assert_eq!(with_margin.crop(margin, margin, size, size), crop(&panorama, &frame));
        let wider = View { fov_deg: frame.fov_with_margin_deg(margin), size: size + 2 * margin, ..frame };
        let wider = crop(&panorama, &wider);
        // Subsamples may be one more or fewer where the rounding of the angle tips the balance.
        let nearest =
            with_margin.as_slice().iter().zip(wider.as_slice()).filter(|(a, b)| (*a - *b).abs() < 1e-4);
        let share = nearest.count() as f64 / wider.as_slice().len() as f64;
        assert!(share > 0.99, "{share} of the pixels agree");
    }
}
