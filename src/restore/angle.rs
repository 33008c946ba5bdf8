//! Finds the rotation of the panel from a capture: the one whose kernel explains the capture best.

use ndarray::Array3;

use crate::core::error::{Error, Result};
use crate::core::fft::{Boundary, Convolver};
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::kernel_code::KernelBank;
use crate::core::progress::Progress;
use crate::core::tone::ToneCurve;

use super::highlights::SATURATED_PART;
use super::tiles::ALIGNMENT;

/// The side of the window that is looked at: large enough for a lamp with its flare, and a thirtieth of a full frame.
pub const SEARCH_WINDOW_PX: usize = 512;

/// What the search found.
#[derive(Clone, Debug, PartialEq)]
pub struct AngleSearch {
    /// How badly each kernel of the bank explains the capture: root mean square of the tone-mapped difference.
    pub residuals: Vec<f64>,
    /// The kernel with the smallest residual.
    pub best: usize,
    /// The angle of the smallest residual between the kernels, in degrees.
    pub angle_deg: f64,
}

/// Searches the angle of the panel behind which `capture` was taken.
///
/// # Method
/// For each kernel k of the bank a window of the capture is restored under its code to x (`restore`, given the index of
/// the kernel and the window), and degraded again to φ(C(x∗k)) (the paper's Eq. 1). The residual is the root mean square
/// difference from the capture over what is not saturated. The parabola through the smallest residual and its
/// neighbours in angle gives the angle between them.
///
/// The window is the one with the most light short of saturation, for flares tell the angle.
///
/// # Errors
/// [`Error::Unsupported`] when the bank knows no angles, or nothing of the capture is unsaturated; those of `restore`;
/// [`Error::Interrupted`] between kernels.
pub fn search_angle(
    capture: &ToneMappedImage,
    bank: &KernelBank,
    curve: ToneCurve,
    restore: &dyn Fn(usize, &ToneMappedImage) -> Result<ToneMappedImage>,
    progress: &Progress,
) -> Result<AngleSearch> {
    let Some(angles) = &bank.angles_deg else {
        return Err(Error::Unsupported(
            "the kernel bank was not made by rotating one PSF and knows no angles; give a code or a PSF instead"
                .to_owned(),
        ));
    };
    let window = brightest_window(capture, curve);
    let size = [window.height(), window.width()];
    let convolver = Convolver::new(size, [bank.psfs[0].height(), bank.psfs[0].width()], Boundary::Zero)?;
    let mut residuals = Vec::with_capacity(bank.len());
    for (kernel, psf) in bank.psfs.iter().enumerate() {
        progress.check()?;
        let scene: LinearImage = curve.inverse_tone_map(&restore(kernel, &window)?);
        let degraded = convolver.convolve(&convolver.spectrum(&scene)?, &convolver.otf(psf)?);
        residuals.push(residual(&degraded, &window, curve)?);
    }
    let mut order: Vec<usize> = (0..angles.len()).collect();
    order.sort_by(|&a, &b| angles[a].total_cmp(&angles[b]));
    let sorted: Vec<(f64, f64)> = order.iter().map(|&k| (angles[k], residuals[k].powi(2))).collect();
    let place = (0..sorted.len()).min_by(|&a, &b| sorted[a].1.total_cmp(&sorted[b].1)).unwrap_or(0);
    Ok(AngleSearch { best: order[place], angle_deg: refined(&sorted, place), residuals })
}

/// The window of the capture with the most unsaturated light.
fn brightest_window(capture: &ToneMappedImage, curve: ToneCurve) -> ToneMappedImage {
    let (height, width) = (capture.height(), capture.width());
    let side = |whole: usize| whole.min(SEARCH_WINDOW_PX);
    let limit = saturated_from(curve);
    let starts = |whole: usize| {
        // Windows overlap by half; the network wants them aligned.
        let step = SEARCH_WINDOW_PX / 2;
        let last = (whole - side(whole)) / ALIGNMENT * ALIGNMENT;
        (0..=last).step_by(step).chain(std::iter::once(last))
    };
    let light = |top: usize, left: usize| -> f64 {
        let planes = capture.planes();
        let rows = (top..top + side(height)).step_by(4);
        let columns = || (left..left + side(width)).step_by(4);
        rows.flat_map(|y| columns().map(move |x| (y, x)))
            .flat_map(|(y, x)| (0..CHANNELS).map(move |c| planes[[c, y, x]]))
            .filter(|&v| v < limit)
            .map(f64::from)
            .sum()
    };
    let mut best = (f64::NEG_INFINITY, 0, 0);
    for top in starts(height) {
        for left in starts(width) {
            let found = light(top, left);
            if found > best.0 {
                best = (found, top, left);
            }
        }
    }
    capture.crop(best.1, best.2, side(height), side(width))
}

fn saturated_from(curve: ToneCurve) -> f32 {
    curve.compress(SATURATED_PART * curve.x_max)
}

fn residual(degraded: &Array3<f32>, window: &ToneMappedImage, curve: ToneCurve) -> Result<f64> {
    let limit = saturated_from(curve);
    let (mut sum, mut count) = (0.0, 0u32);
    for (light, &captured) in degraded.iter().zip(window.planes()) {
        if captured < limit {
            sum += f64::from(curve.compress(*light) - captured).powi(2);
            count += 1;
        }
    }
    if count == 0 {
        return Err(Error::Unsupported(
            "the capture is saturated everywhere, so that no angle can be found; give --angle a number"
                .to_owned(),
        ));
    }
    Ok((sum / f64::from(count)).sqrt())
}

/// The vertex of the parabola through a minimum of (angle, value) and its two neighbours.
fn refined(sorted: &[(f64, f64)], place: usize) -> f64 {
    let (angle, value) = sorted[place];
    let (Some(before), Some(after)) = (place.checked_sub(1).map(|i| sorted[i]), sorted.get(place + 1)) else {
        return angle;
    };
    let (left, right) = (angle - before.0, after.0 - angle);
    let (rise_left, rise_right) = ((before.1 - value) / left, (after.1 - value) / right);
    let curvature = (rise_left + rise_right) / (left + right);
    if curvature <= 0.0 || left <= 0.0 || right <= 0.0 {
        return angle;
    }
    let slope = (rise_right * left - rise_left * right) / (left + right);
    (angle - slope / (2.0 * curvature)).clamp(angle - left / 2.0, angle + right / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::kernel_code::CodeBasis;
    use crate::core::psf::Psf;
    use crate::core::rng::stream;
    use ndarray::{Array1, Array2};
    use rand::RngExt as _;

    const ANGLES: [f64; 9] = [-12.0, -9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0, 12.0];

    /// A peak and a cross of sidelobes, turned counter-clockwise as displayed.
    fn panel(angle_deg: f64) -> Psf {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let energy = Array3::from_shape_fn((3, 61, 61), |(c, y, x)| {
            let (dy, dx) = (y as f64 - 30.0, x as f64 - 30.0);
            let (u, v) = (cos * dx - sin * dy, sin * dx + cos * dy);
            let core = (-(u * u + v * v) / 3.0).exp();
            let arms = (-v * v / 2.0 - u.abs() / 9.0).exp() + 0.6 * (-u * u / 2.0 - v.abs() / 9.0).exp();
            (core + 0.004 * (1.0 + 0.2 * c as f64) * arms) as f32
        });
        Psf::from_energy(energy).unwrap()
    }

    fn bank() -> KernelBank {
        let psfs: Vec<Psf> = ANGLES.iter().map(|&angle| panel(angle)).collect();
        let length = 3 * 61 * 61;
        let basis = CodeBasis {
            mean: Array1::zeros(length),
            components: Array2::zeros((0, length)),
            explained_variance: Array1::zeros(0),
        };
        KernelBank::new(psfs, Array2::zeros((9, 0)), basis, Some(ANGLES.to_vec())).unwrap()
    }

    /// Night with lamps, some of which saturate.
    fn scene(seed: u64) -> LinearImage {
        let mut rng = stream(seed, "night");
        let mut planes = Array3::from_shape_simple_fn((3, 96, 100), || 0.05 + 0.1 * rng.random::<f32>());
        for _ in 0..6 {
            let (y, x) = (rng.random_range(10..86), rng.random_range(10..90));
            let light = 10f32.powf(rng.random_range(0.5..3.5));
            planes.slice_mut(ndarray::s![.., y..y + 3, x..x + 3]).fill(light);
        }
        LinearImage::from_planes(planes).unwrap()
    }

    fn degraded(scene: &LinearImage, psf: &Psf, curve: ToneCurve) -> ToneMappedImage {
        let convolver = Convolver::new([96, 100], [61, 61], Boundary::Zero).unwrap();
        let blurred = convolver.convolve(&convolver.spectrum(scene).unwrap(), &convolver.otf(psf).unwrap());
        curve.tone_map(&LinearImage::from_planes(blurred).unwrap())
    }

    /// As a network restores: most of the way, and clipped lamps stay clipped.
    fn search(truth: &LinearImage, capture: &ToneMappedImage) -> AngleSearch {
        let curve = ToneCurve::default();
        let clean = curve.tone_map(truth);
        let restore = |_: usize, window: &ToneMappedImage| {
            let mixed = &clean.planes() * 0.85 + &window.planes() * 0.15;
            ToneMappedImage::from_planes(mixed)
        };
        search_angle(capture, &bank(), curve, &restore, &Progress::default()).unwrap()
    }

    #[test]
    fn finds_the_kernel_of_a_triplet() {
        let curve = ToneCurve::default();
        let mut right = 0;
        for seed in 0..3 {
            let scene = scene(seed);
            for (kernel, &angle) in ANGLES.iter().enumerate() {
                let found = search(&scene, &degraded(&scene, &panel(angle), curve));
                right += usize::from(found.best.abs_diff(kernel) <= 1);
                assert_eq!(found.residuals.len(), 9);
            }
        }
        assert!(right >= 25, "{right} of 27");
    }

    #[test]
    fn angles_between_two_kernels_are_interpolated() {
        let curve = ToneCurve::default();
        let scene = scene(3);
        for angle in [-4.5, 1.0, 7.0] {
            let found = search(&scene, &degraded(&scene, &panel(angle), curve));
            assert!((found.angle_deg - angle).abs() < 1.5, "{} instead of {angle}", found.angle_deg);
        }
    }

    #[test]
    fn a_parabola_is_refined_exactly_on_unequal_steps() {
        let value = |angle: f64| (angle - 1.2).powi(2) + 0.3;
        let sorted = [-3.0, 1.0, 2.0].map(|angle| (angle, value(angle)));
        assert!((refined(&sorted, 1) - 1.2).abs() < 1e-12);
        assert!((refined(&sorted[1..], 0) - 1.0).abs() < 1e-12, "an end has no neighbour");
    }

    #[test]
    fn says_when_nothing_can_be_found() {
        let curve = ToneCurve::default();
        let white = ToneMappedImage::from_planes(Array3::ones((3, 96, 100))).unwrap();
        let keep = |_: usize, window: &ToneMappedImage| Ok(window.clone());
        let message =
            search_angle(&white, &bank(), curve, &keep, &Progress::default()).unwrap_err().to_string();
        assert!(message.contains("saturated everywhere"), "{message}");
        let nameless = KernelBank { angles_deg: None, ..bank() };
        assert!(search_angle(&white, &nameless, curve, &keep, &Progress::default()).is_err());
    }
}
