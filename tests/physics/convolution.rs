//! Analytic truth: convolution, in image space and by its laws.

#![expect(clippy::unwrap_used, reason = "a test fails where it unwraps")]
#![expect(clippy::needless_pass_by_value, reason = "views of arrays are values")]
#![expect(clippy::cast_sign_loss, reason = "positions are checked to be inside")]

use ndarray::{Array3, ArrayView2, Axis};
use rand::Rng as _;
use udc::core::fft::{Boundary, Convolver, SINGLE_PEAK, SINGLE_RMS};
use udc::core::image::LinearImage;
use udc::core::psf::Psf;
use udc::core::rng::stream;

const BOUNDARIES: [Boundary; 4] =
    [Boundary::Zero, Boundary::Replicate, Boundary::Reflect, Boundary::Periodic];

/// Scene and PSF sizes: odd and even, square and not, PSFs smaller and larger than the scene.
const SIZES: [([usize; 2], [usize; 2]); 6] = [
    ([12, 17], [5, 5]),
    ([12, 17], [4, 6]),
    ([17, 12], [7, 4]),
    ([9, 8], [8, 9]),
    ([5, 6], [23, 14]),
    ([1, 7], [6, 3]),
];

fn random_planes([height, width]: [usize; 2], label: &str) -> Array3<f32> {
    let mut rng = stream(5, label);
    Array3::from_shape_simple_fn((3, height, width), || rng.next_u32() as f32 / u32::MAX as f32)
}

fn random_image(size: [usize; 2], label: &str) -> LinearImage {
    LinearImage::from_planes(random_planes(size, label)).unwrap()
}

fn random_psf(size: [usize; 2], label: &str) -> Psf {
    Psf::from_energy(random_planes(size, label)).unwrap()
}

fn convolve(image: &LinearImage, psf: &Psf, boundary: Boundary) -> Array3<f32> {
    let size = [image.height(), image.width()];
    let convolver = Convolver::new(size, [psf.height(), psf.width()], boundary).unwrap();
    convolver.convolve(&convolver.spectrum(image).unwrap(), &convolver.otf(psf).unwrap())
}

/// The value of a plane at any position, written without the implementation's index arithmetic.
fn continued(plane: ArrayView2<'_, f32>, y: isize, x: isize, boundary: Boundary) -> f64 {
    let continue_axis = |mut i: isize, n: isize| -> Option<usize> {
        match boundary {
            Boundary::Zero if i < 0 || i >= n => return None,
            Boundary::Zero => {}
            Boundary::Replicate => i = i.max(0).min(n - 1),
            Boundary::Reflect => {
                while n > 1 && (i < 0 || i >= n) {
                    i = if i < 0 { -i } else { 2 * (n - 1) - i };
                }
                i = if n == 1 { 0 } else { i };
            }
            Boundary::Periodic => {
                while i < 0 {
                    i += n;
                }
                i %= n;
            }
        }
        Some(i as usize)
    };
    let (height, width) = plane.dim();
    match (continue_axis(y, height as isize), continue_axis(x, width as isize)) {
        (Some(y), Some(x)) => f64::from(plane[[y, x]]),
        _ => 0.0,
    }
}

/// The definition, in image space: out[y, x] = Σ psf[cy + dy, cx + dx] · image[y − dy, x − dx].
fn convolve_directly(image: &LinearImage, psf: &Psf, boundary: Boundary) -> Array3<f64> {
    let (cy, cx) = psf.centre();
    Array3::from_shape_fn(image.planes().dim(), |(c, y, x)| {
        let taps = psf.channel(c);
        taps.indexed_iter().fold(0.0, |sum, ((ky, kx), &tap)| {
            let (dy, dx) = (ky as isize - cy as isize, kx as isize - cx as isize);
            let value = continued(image.channel(c), y as isize - dy, x as isize - dx, boundary);
            sum + f64::from(tap) * value
        })
    })
}

/// What [`Convolver`] promises for values of order 1.
const TOLERANCE: f64 = 1e-6;

#[test]
fn agrees_with_the_definition_for_every_boundary_and_size() {
    for boundary in BOUNDARIES {
        for (scene, kernel) in SIZES {
            let (image, psf) = (random_image(scene, "scene"), random_psf(kernel, "psf"));
            let found = convolve(&image, &psf, boundary);
            let expected = convolve_directly(&image, &psf, boundary);
            for (index, expected) in expected.indexed_iter() {
                let error = (f64::from(found[index]) - expected).abs();
                assert!(error < TOLERANCE, "{boundary:?} {scene:?} ∗ {kernel:?} at {index:?}: {error}");
            }
        }
    }
}

#[test]
fn a_point_psf_changes_nothing() {
    for boundary in BOUNDARIES {
        for size in [[9, 9], [8, 8], [9, 8], [31, 30]] {
            let mut energy = Array3::zeros((3, size[0], size[1]));
            energy.slice_mut(ndarray::s![.., size[0] / 2, size[1] / 2]).fill(1.0);
            let image = random_image([13, 10], "scene");
            let found = convolve(&image, &Psf::from_energy(energy).unwrap(), boundary);
            for (found, expected) in found.iter().zip(image.as_slice()) {
                assert!(f64::from((found - expected).abs()) < TOLERANCE, "{boundary:?} {size:?}");
            }
        }
    }
}

/// A PSF whose light lies one row below and two columns right of the centre moves the image there.
#[test]
fn an_off_centre_psf_shifts_down_and_right() {
    let mut energy = Array3::zeros((3, 6, 7));
    energy.slice_mut(ndarray::s![.., 3 + 1, 3 + 2]).fill(1.0);
    let image = random_image([10, 11], "scene");
    let found = convolve(&image, &Psf::from_energy(energy).unwrap(), Boundary::Zero);
    for ((c, y, x), &value) in found.indexed_iter() {
        let expected = if y >= 1 && x >= 2 { image.planes()[[c, y - 1, x - 2]] } else { 0.0 };
        assert!(f64::from((value - expected).abs()) < TOLERANCE, "at {c} {y} {x}");
    }
}

/// Far from the border no light leaves: the sum of the image is kept, as the PSF has unit sum.
#[test]
fn light_inside_is_conserved() {
    let mut planes = Array3::zeros((3, 40, 40));
    planes.slice_mut(ndarray::s![.., 15..25, 15..25]).assign(&random_planes([10, 10], "patch"));
    let before: f64 = planes.iter().map(|&v| f64::from(v)).sum();
    let image = LinearImage::from_planes(planes).unwrap();
    let after = convolve(&image, &random_psf([14, 15], "psf"), Boundary::Zero);
    let after: f64 = after.iter().map(|&v| f64::from(v)).sum();
    assert!((after / before - 1.0).abs() < 1e-6, "{before} became {after}");
}

/// A constant scene stays constant where the border continues it.
#[test]
fn a_constant_scene_stays_constant_but_at_a_dark_border() {
    let image = LinearImage::from_planes(Array3::from_elem((3, 11, 14), 3.0)).unwrap();
    let psf = random_psf([8, 9], "psf");
    for boundary in [Boundary::Replicate, Boundary::Reflect, Boundary::Periodic] {
        let found = convolve(&image, &psf, boundary);
        assert!(found.iter().all(|&v| f64::from((v - 3.0).abs()) < 3.0 * TOLERANCE), "{boundary:?}");
    }
    assert!(convolve(&image, &psf, Boundary::Zero)[[0, 0, 0]] < 2.0);
}

#[test]
fn is_linear() {
    let (a, b) = (random_image([21, 18], "a"), random_image([21, 18], "b"));
    let psf = random_psf([10, 9], "psf");
    let sum = LinearImage::from_planes(&a.planes() * 2.0 + b.planes()).unwrap();
    let together = convolve(&sum, &psf, Boundary::Reflect);
    let apart = convolve(&a, &psf, Boundary::Reflect) * 2.0 + convolve(&b, &psf, Boundary::Reflect);
    for (together, apart) in together.iter().zip(&apart) {
        assert!(f64::from((together - apart).abs()) < 3.0 * TOLERANCE);
    }
}

/// ⟨A x, y⟩ = ⟨x, Aᵀ y⟩ with A the convolution and its boundary.
#[test]
fn correlation_is_the_transpose_of_convolution() {
    for boundary in BOUNDARIES {
        for (scene, kernel) in SIZES {
            let (x, y) = (random_image(scene, "x"), random_planes(scene, "y"));
            let psf = random_psf(kernel, "psf");
            let convolver = Convolver::new(scene, kernel, boundary).unwrap();
            let otf = convolver.otf(&psf).unwrap();
            let forward = convolver.convolve(&convolver.spectrum(&x).unwrap(), &otf);
            let mut back = Array3::zeros(y.dim());
            for (c, mut plane) in back.outer_iter_mut().enumerate() {
                let otf = convolver.kernel_spectrum(psf.channel(c)).unwrap();
                plane.assign(&convolver.correlate_plane(y.index_axis(Axis(0), c), &otf));
            }
            let product = |a: &Array3<f32>, b: ndarray::ArrayView3<'_, f32>| -> f64 {
                a.iter().zip(b.iter()).map(|(a, b)| f64::from(a * b)).sum()
            };
            let (left, right) = (product(&forward, y.view()), product(&back, x.planes()));
            assert!((left / right - 1.0).abs() < 1e-5, "{boundary:?} {scene:?} {kernel:?}: {left} {right}");
        }
    }
}

/// Beside a highlight of 10⁶, in 32-bit transforms the dark pixels would be off by about 0.1.
#[test]
fn dark_pixels_survive_highlights() {
    let mut planes = random_planes([64, 64], "scene");
    planes.slice_mut(ndarray::s![.., 10..14, 10..14]).fill(1e6);
    let image = LinearImage::from_planes(planes).unwrap();
    let psf = random_psf([9, 9], "psf");
    let found = convolve(&image, &psf, Boundary::Zero);
    let expected = convolve_directly(&image, &psf, Boundary::Zero);
    for (found, expected) in found.iter().zip(&expected) {
        let error = (f64::from(*found) - expected).abs();
        assert!(error <= TOLERANCE * expected.max(1.0), "{found} instead of {expected}");
    }
}

/// The brightest scenes that are convolved in 32 bits, against the same in 64: light in one pixel, in a lamp, at
/// random and everywhere; PSFs that keep a point a point, spread it over a few pixels and over all of them.
#[test]
fn the_32_bit_path_keeps_its_error_bound() {
    let size = [800, 640];
    let convolver = Convolver::new(size, size, Boundary::Zero).unwrap();
    let [rows, columns] = convolver.transform_size();
    let lamp = |side| move |y: usize, x: usize| f32::from(y.abs_diff(300) < side && x.abs_diff(200) < side);
    let random = random_planes(size, "scene");
    let scenes: [Box<dyn Fn(usize, usize) -> f32>; 4] = [
        Box::new(lamp(1)),
        Box::new(lamp(20)),
        Box::new(move |y, x| random[[0, y, x]]),
        Box::new(|_, _| 1.0),
    ];
    let psfs = [1, 4, 400].map(|radius| {
        let mut energy = random_planes(size, "psf");
        for ((_, y, x), value) in energy.indexed_iter_mut() {
            *value *= f32::from(y.abs_diff(400) < radius && x.abs_diff(320) < radius);
        }
        Psf::from_energy(energy).unwrap()
    });
    for scene in scenes {
        let planes = Array3::from_shape_fn((3, size[0], size[1]), |(_, y, x)| scene(y, x));
        let plane = planes.index_axis(Axis(0), 0);
        let energy: f64 = plane.iter().map(|&v| f64::from(v).powi(2)).sum();
        let rms = (energy / (rows * columns) as f64).sqrt() as f32;
        let peak = plane.iter().fold(0.0f32, |peak, &v| peak.max(v));
        let scale = 0.999 * (SINGLE_PEAK / peak).min(SINGLE_RMS as f32 / rms);
        let image = LinearImage::from_planes(planes * scale).unwrap();
        let spectrum = convolver.spectrum(&image).unwrap();
        for psf in &psfs {
            let found = convolver.convolve(&spectrum, &convolver.otf(psf).unwrap());
            let otf = convolver.kernel_spectrum(psf.channel(1)).unwrap();
            let expected = convolver.convolve_plane(image.channel(1), &otf);
            let error =
                found.index_axis(Axis(0), 1).iter().zip(&expected).fold(0.0, |worst: f64, (a, b)| {
                    worst.max(f64::from((a - b).abs()) - 1e-6 * f64::from(*b))
                });
            assert!(error < 5e-6, "off by {error}");
        }
    }
}

#[test]
fn refuses_images_and_psfs_of_another_size() {
    let convolver = Convolver::new([8, 8], [5, 5], Boundary::Zero).unwrap();
    assert!(convolver.spectrum(&random_image([8, 9], "x")).is_err());
    assert!(convolver.otf(&random_psf([5, 6], "psf")).is_err());
    assert!(Convolver::new([0, 8], [5, 5], Boundary::Zero).is_err());
}

#[test]
fn gives_the_same_bits_with_one_thread_and_with_three() {
    let (image, psf) = (random_image([90, 70], "scene"), random_psf([64, 33], "psf"));
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| convolve(&image, &psf, Boundary::Replicate))
    };
    assert_eq!(run(1), run(3));
}
