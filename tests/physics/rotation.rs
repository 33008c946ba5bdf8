//! Rotation of PSFs against shapes whose rotation is known.

use ndarray::Array3;
use udc::codes::{rotate, rotate_each};
use udc::core::psf::Psf;

/// An elongated Gaussian whose long axis is turned by `angle_deg`, counter-clockwise as displayed, and whose
/// middle lies `away` pixels from the centre along that axis.
#[expect(clippy::cast_possible_truncation, reason = "PSFs are f32")]
fn ellipse(size: usize, angle_deg: f64, away: f64) -> Psf {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let centre = (size / 2) as f64;
    let energy = Array3::from_shape_fn((3, size, size), |(c, y, x)| {
        let (right, up) = (x as f64 - centre, centre - y as f64);
        let (along, across) = (right * cos + up * sin - away, up * cos - right * sin);
        let (long, short) = (5.0 + c as f64, 3.0);
        (-0.5 * ((along / long).powi(2) + (across / short).powi(2))).exp() as f32
    });
    Psf::from_energy(energy).unwrap()
}

fn l1(a: &Psf, b: &Psf) -> f64 {
    a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>() / 3.0
}

/// The cubic spline's error is about (2π/σ)⁴·10⁻⁵ of the finest detail, here σ = 3: a few parts in 10⁴.
#[test]
fn turns_an_ellipse_counter_clockwise_about_the_centre_of_odd_and_even_grids() {
    for size in [64, 65] {
        let start = ellipse(size, 10.0, 4.0);
        for angle in [-12.0, 3.0, 37.5, 90.0, 118.0, 180.0, 270.0] {
            let error = l1(&rotate(&start, angle).unwrap(), &ellipse(size, 10.0 + angle, 4.0));
            assert!(error < 1e-3, "size {size}, {angle}°: {error}");
            let opposite = l1(&rotate(&start, angle).unwrap(), &ellipse(size, 10.0 - angle, 4.0));
            assert!(angle == 180.0 || opposite > 0.05, "size {size}, {angle}°: cannot tell the direction");
        }
    }
}

#[test]
fn lifts_a_spot_on_the_right_to_the_top() {
    let mut energy = Array3::zeros((3, 11, 11));
    energy.slice_mut(ndarray::s![.., 5, 9]).fill(1.0);
    let turned = rotate(&Psf::from_energy(energy).unwrap(), 90.0).unwrap();
    assert_eq!(turned.planes()[[0, 1, 5]], 1.0);
}

#[test]
fn keeps_the_light_of_every_channel() {
    for psf in rotate_each(&ellipse(48, 0.0, 0.0), &[-12.0, -0.5, 45.0, 200.0]).unwrap() {
        for channel in 0..3 {
            let sum: f64 = psf.channel(channel).iter().map(|&v| f64::from(v)).sum();
            assert!((sum - 1.0).abs() < f64::from(f32::EPSILON), "{sum}");
            assert!(psf.channel(channel).iter().all(|&v| v >= 0.0));
        }
    }
}
