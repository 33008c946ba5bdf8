//! Finds the rotation of the panel from a capture: the one whose kernel explains the capture best.

mod found;
mod turned;

use ndarray::{ArrayView3, s};

use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::core::kernel_code::KernelBank;
use crate::core::progress::Progress;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;

use super::likelihood::{WindowModel, contrast, corners};
pub use found::FoundAngle;
pub(super) use found::find_code;
pub(super) use turned::TurnedKernel;

/// The largest side of the windows that are looked at.
const WINDOW_PX: usize = 512;

/// The smallest side of a capture that tells an angle.
const SMALLEST_PX: usize = 32;

/// The largest number of windows: three megapixels tell what there is to tell, and take about a second.
const MOST_WINDOWS: usize = 12;

/// A lead of less than this, in nats, over every angle but the neighbours is weak evidence. Of 549 noisy captures of
/// 256², most of them without a lamp, 33 led to a wrong angle, 28 of them with a smaller lead; 17 % had a smaller lead.
pub const WEAK_LEAD: f64 = 20.0;

/// What the search found.
#[derive(Clone, Debug, PartialEq)]
pub struct AngleSearch {
    /// The log-likelihood of each kernel of the bank, in nats below that of the best.
    pub log_likelihoods: Vec<f64>,
    /// The most likely kernel.
    pub best: usize,
    /// The most likely angle between the kernels, in degrees.
    pub angle_deg: f64,
    /// By how much the best kernel is more likely than any but its neighbours in angle, in nats: than these, where there
    /// are no others, and infinite in a bank of one.
    pub lead: f64,
}

/// Searches the angle of the panel behind which `capture` was taken.
///
/// # Method
/// Nothing is restored. The spectra of up to twelve windows of 512 pixels, those with the greatest contrast, are
/// compared with the OTFs of each kernel of the bank by a likelihood that knows little of the scene: that its spectrum
/// is smooth, and the same in all colours but for a factor. Windows count as independent. The parabola through the
/// largest log-likelihood and its neighbours in angle gives the angle between them. `curves` says how each channel was
/// tone-mapped, x_max being the white level at which it saturates.
///
/// # Errors
/// [`Error::Unsupported`] when the bank knows no angles, or the capture is smaller than 32 pixels, saturated everywhere
/// or without contrast; [`Error::Interrupted`] between windows.
pub fn search_angle(
    capture: &ToneMappedImage,
    bank: &KernelBank,
    curves: [ToneCurve; CHANNELS],
    progress: &Progress,
) -> Result<AngleSearch> {
    let Some(angles) = &bank.angles_deg else {
        return Err(Error::Unsupported(
            "the kernel bank was not made by rotating one PSF and knows no angles; give a code or a PSF instead"
                .to_owned(),
        ));
    };
    let size = [capture.height(), capture.width()].map(|side| side.min(WINDOW_PX));
    if size.iter().any(|&side| side < SMALLEST_PX) {
        return Err(untold(&format!("has fewer than {SMALLEST_PX} pixels along a side")));
    }
    let limits = curves.map(|curve| curve.compress(saturated_from(curve.x_max)));
    if capture.planes().outer_iter().zip(limits).all(|(plane, limit)| plane.iter().all(|&v| v >= limit)) {
        return Err(untold("is saturated everywhere"));
    }
    let model = WindowModel::new(size, &bank.psfs)?;
    let mut sums = vec![0.0; bank.len()];
    let mut told = false;
    for [top, left] in windows(capture, size) {
        progress.check()?;
        let mut window = window(capture, [top, left], size).to_owned();
        for (mut plane, curve) in window.outer_iter_mut().zip(curves) {
            plane.mapv_inplace(|v| curve.expand(v));
        }
        if let Some(found) = model.log_likelihoods(window.view()) {
            told = true;
            sums.iter_mut().zip(found).for_each(|(sum, value)| *sum += value);
        }
    }
    if !told {
        return Err(untold("has no contrast"));
    }
    Ok(most_likely(&sums, angles))
}

fn untold(why: &str) -> Error {
    Error::Unsupported(format!("the capture {why}, so that no angle can be found; give --angle a number"))
}

fn window(
    capture: &ToneMappedImage,
    [top, left]: [usize; 2],
    [height, width]: [usize; 2],
) -> ArrayView3<'_, f32> {
    capture.planes().slice_move(s![.., top..top + height, left..left + width])
}

/// The corners of the windows: as many as cover the capture, or those of them with the greatest contrast.
fn windows(capture: &ToneMappedImage, size: [usize; 2]) -> Vec<[usize; 2]> {
    let mut ranked: Vec<(f64, [usize; 2])> = corners([capture.height(), capture.width()], size)
        .into_iter()
        .map(|corner| (contrast(window(capture, corner, size)), corner))
        .collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    ranked.truncate(MOST_WINDOWS);
    ranked.into_iter().map(|(_, corner)| corner).collect()
}

fn most_likely(log_likelihoods: &[f64], angles: &[f64]) -> AngleSearch {
    let mut order: Vec<usize> = (0..angles.len()).collect();
    order.sort_by(|&a, &b| angles[a].total_cmp(&angles[b]));
    let highest = log_likelihoods.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let below: Vec<f64> = log_likelihoods.iter().map(|value| value - highest).collect();
    let sorted: Vec<(f64, f64)> = order.iter().map(|&k| (angles[k], -below[k])).collect();
    let place = (0..sorted.len()).min_by(|&a, &b| sorted[a].1.total_cmp(&sorted[b].1)).unwrap_or(0);
    let beyond = (0..sorted.len()).filter(|other| other.abs_diff(place) > 1);
    let lead = beyond.map(|other| sorted[other].1).reduce(f64::min);
    // In a set of few kernels all others may be neighbours: then they must tell.
    let lead = lead.unwrap_or_else(|| {
        let others = (0..sorted.len()).filter(|other| *other != place);
        others.map(|other| sorted[other].1).fold(f64::INFINITY, f64::min)
    });
    AngleSearch { best: order[place], angle_deg: refined(&sorted, place), lead, log_likelihoods: below }
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
    use crate::core::fft::{Boundary, Convolver};
    use crate::core::image::LinearImage;
    use crate::core::kernel_code::CodeBasis;
    use crate::core::psf::Psf;
    use crate::core::rng::stream;
    use ndarray::{Array1, Array2, Array3};
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

    fn search(capture: &ToneMappedImage) -> AngleSearch {
        search_angle(capture, &bank(), [ToneCurve::default(); 3], &Progress::default()).unwrap()
    }

    #[test]
    fn finds_the_kernel_of_a_triplet() {
        let curve = ToneCurve::default();
        let mut right = 0;
        for seed in 0..3 {
            let scene = scene(seed);
            for (kernel, &angle) in ANGLES.iter().enumerate() {
                let found = search(&degraded(&scene, &panel(angle), curve));
                right += usize::from(found.best == kernel);
                assert_eq!(found.log_likelihoods.len(), 9);
                assert_eq!(found.log_likelihoods[found.best], 0.0);
            }
        }
        assert!(right >= 26, "{right} of 27");
    }

    #[test]
    fn a_channel_without_light_does_not_hide_the_angle() {
        let curve = ToneCurve::default();
        let mut planes = degraded(&scene(4), &panel(6.0), curve).into_planes();
        planes.slice_mut(s![2, .., ..]).fill(0.0);
        assert_eq!(search(&ToneMappedImage::from_planes(planes).unwrap()).best, 6);
    }

    #[test]
    fn angles_between_two_kernels_are_interpolated() {
        let curve = ToneCurve::default();
        let scene = scene(3);
        for angle in [-4.5, 1.0, 7.0] {
            let found = search(&degraded(&scene, &panel(angle), curve));
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
        let flat = |value: f32, side: usize| {
            ToneMappedImage::from_planes(Array3::from_elem((3, side, 100), value)).unwrap()
        };
        for (capture, why) in [
            (flat(1.0, 96), "saturated everywhere"),
            (flat(0.5, 96), "has no contrast"),
            (flat(0.5, 20), "fewer than 32 pixels"),
        ] {
            let message =
                search_angle(&capture, &bank(), [curve; 3], &Progress::default()).unwrap_err().to_string();
            assert!(message.contains(why) && message.contains("--angle"), "{message}");
        }
        let nameless = KernelBank { angles_deg: None, ..bank() };
        assert!(search_angle(&flat(0.5, 96), &nameless, [curve; 3], &Progress::default()).is_err());
    }

    #[test]
    fn the_lead_counts_neither_the_best_nor_its_neighbours() {
        let found = most_likely(&[-50.0, -7.0, -1.0, -4.0, -31.0], &[6.0, 3.0, 0.0, -3.0, -6.0]);
        assert_eq!((found.best, found.lead), (2, 30.0));
        assert!(found.angle_deg < 0.0, "the neighbour at −3° is the likelier one");
    }

    /// Two kernels, or three of which the middle one is found, have nothing but neighbours.
    #[test]
    fn a_small_bank_that_hardly_tells_the_angle_has_no_lead() {
        assert_eq!(most_likely(&[-1.0, 0.0], &[0.0, 3.0]).lead, 1.0);
        assert_eq!(most_likely(&[-2.0, 0.0, -0.5], &[-6.0, 0.0, 6.0]).lead, 0.5);
    }

    #[test]
    fn large_captures_are_seen_through_their_windows_of_greatest_contrast() {
        let mut planes = Array3::from_elem((3, 1100, 2600), 0.3f32);
        planes[[0, 900, 2500]] = 0.9;
        let corners = windows(&ToneMappedImage::from_planes(planes).unwrap(), [512, 512]);
        assert_eq!(corners.len(), MOST_WINDOWS);
        assert_eq!(corners[0], [588, 2088]);
    }
}
