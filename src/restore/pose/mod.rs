//! The pose of a panel: by how much its PSF is turned and scaled against the one that was handed over, from what captures of
//! one device tell.

mod file;

pub use file::{read_pose, write_pose};

use std::fmt;

use serde::Serialize;

use super::deconvolution::{PoseEstimate, write_pose_in_words};
use crate::codes::MeasurementErrors;
use crate::core::error::{Error, Result};
use crate::core::psf::Psf;
use crate::core::rng::stream;

/// Degrees and share by which the poses of one device may differ: what costs little, and what focusing changes.
const LEAST_APART: [f64; 2] = [0.1, 5e-3];

/// A pose of a PSF, and how well it is known.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pose {
    /// By how much the PSF is to be turned about its centre, in degrees, counter-clockwise as displayed.
    pub turn_deg: f64,
    /// The share by which it is to be larger.
    pub scale: f64,
    /// The standard deviation of the turn, in degrees.
    pub turn_sigma_deg: f64,
    /// The standard deviation of the scale.
    pub scale_sigma: f64,
    /// [`Psf::sha256`] of the PSF that was handed over.
    pub psf_sha256: String,
}

impl Pose {
    /// Combines what several captures tell of the pose of `psf`; none where there is no estimate.
    ///
    /// # Equation
    /// Means weighted by 1/σ², with the standard deviation `√(max(1, χ²/(n−1)) / Σ 1/σ²)`: captures that contradict each other
    /// (χ² of the estimates about their mean above n−1) make it larger (R. T. Birge, Phys. Rev. 40, 1932).
    pub fn of_estimates(psf: &Psf, estimates: &[PoseEstimate]) -> Option<Self> {
        let turns = estimates.iter().map(|e| (e.turn_deg, e.turn_sigma_deg)).collect::<Vec<_>>();
        let scales = estimates.iter().map(|e| (e.scale, e.scale_sigma)).collect::<Vec<_>>();
        let ((turn_deg, turn_sigma_deg), (scale, scale_sigma)) = (combined(&turns)?, combined(&scales)?);
        Some(Self { turn_deg, scale, turn_sigma_deg, scale_sigma, psf_sha256: psf.sha256() })
    }

    /// What to tell where captures contradict each other by more than they may: by five standard deviations, and by more than makes a
    /// PSF another one. They are of several devices then, or the panel moved between them.
    pub fn describe_contradiction(estimates: &[PoseEstimate]) -> Option<String> {
        const CERTAIN: f64 = 5.0;
        let apart = |of: fn(&PoseEstimate) -> (f64, f64), matters: f64| {
            let by = |a: &&PoseEstimate, b: &&PoseEstimate| of(a).0.total_cmp(&of(b).0);
            let (least, most) = (of(estimates.iter().min_by(by)?), of(estimates.iter().max_by(by)?));
            let is_apart = most.0 - least.0 > matters.max(CERTAIN * most.1.hypot(least.1));
            is_apart.then_some([least.0, most.0])
        };
        let turns = apart(|e| (e.turn_deg, e.turn_sigma_deg), LEAST_APART[0])
            .map(|[least, most]| format!("turns of {least:+.3}° and {most:+.3}°"));
        let scales = apart(|e| (e.scale, e.scale_sigma), LEAST_APART[1])
            .map(|[least, most]| format!("scales of {:+.2} % and {:+.2} %", 100.0 * least, 100.0 * most));
        let told: Vec<String> = turns.into_iter().chain(scales).collect();
        (!told.is_empty()).then(|| {
            format!(
                "the captures contradict each other: they tell {}, and their mean is of none of them; combine captures of one \
                 device with one panel, focused alike",
                told.join(", and ")
            )
        })
    }

    /// The PSF in this pose: turned and scaled in one resampling, as [`MeasurementErrors`] does.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when the pose was found for another PSF, or a channel turns dark; [`Error::Config`] when the
    /// scale is out of the range of [`MeasurementErrors`].
    pub fn apply(&self, psf: &Psf) -> Result<Psf> {
        if psf.sha256() != self.psf_sha256 {
            return Err(Error::Unsupported(
                "the pose was found for another PSF than this one: find it anew with `udc pose`, or name that PSF"
                    .to_owned(),
            ));
        }
        let Self { turn_deg, scale, .. } = *self;
        let change = MeasurementErrors { turn_deg, scale, ..MeasurementErrors::default() };
        // It adds no noise, and draws nothing.
        change.apply(psf, &mut stream(0, "pose"))
    }
}

impl fmt::Display for Pose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { turn_deg, scale, turn_sigma_deg, scale_sigma, .. } = *self;
        write_pose_in_words(f, (turn_deg, turn_sigma_deg), (scale, scale_sigma))
    }
}

/// The weighted mean of values with their standard deviations, and its own.
fn combined(values: &[(f64, f64)]) -> Option<(f64, f64)> {
    if values.is_empty() {
        return None;
    }
    let weight = |sigma: f64| sigma.powi(-2);
    let weights: f64 = values.iter().map(|(_, sigma)| weight(*sigma)).sum();
    let mean = values.iter().map(|(value, sigma)| weight(*sigma) * value).sum::<f64>() / weights;
    let chi2: f64 = values.iter().map(|(value, sigma)| weight(*sigma) * (value - mean).powi(2)).sum();
    let excess = (chi2 / (values.len().max(2) - 1) as f64).max(1.0);
    Some((mean, (excess / weights).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn estimate(turn_deg: f64, turn_sigma_deg: f64) -> PoseEstimate {
        let (scale, scale_sigma) = (turn_deg / 100.0, turn_sigma_deg / 100.0);
        let (unexplained, light_to_noise) = (0.3, 200.0);
        PoseEstimate { turn_deg, scale, turn_sigma_deg, scale_sigma, unexplained, light_to_noise }
    }

    pub(super) fn psf() -> Psf {
        let light = |y: usize, x: usize| {
            let (dy, dx) = (y as f32 - 30.0, x as f32 - 30.0);
            (-dy.hypot(dx) / 2.0).exp() + 0.02 * (-dy.hypot(dx - 20.0) / 2.0).exp()
        };
        Psf::from_energy(Array3::from_shape_fn((3, 61, 61), |(_, y, x)| light(y, x))).unwrap()
    }

    #[test]
    fn captures_count_by_the_inverse_of_their_variance() {
        let pose = Pose::of_estimates(&psf(), &[estimate(0.30, 0.01), estimate(0.31, 0.02)]).unwrap();
        assert!((pose.turn_deg - 0.302).abs() < 1e-12, "{}", pose.turn_deg);
        assert!((pose.turn_sigma_deg - 0.02 / 5f64.sqrt()).abs() < 1e-12, "{}", pose.turn_sigma_deg);
        assert!((pose.scale - 0.00302).abs() < 1e-12);
        assert_eq!(Pose::of_estimates(&psf(), &[]), None);
        let alone = Pose::of_estimates(&psf(), &[estimate(0.30, 0.01)]).unwrap();
        assert!((alone.turn_sigma_deg - 0.01).abs() < 1e-12);
    }

    #[test]
    fn captures_that_contradict_each_other_make_the_pose_uncertain() {
        let pose = Pose::of_estimates(&psf(), &[estimate(0.2, 0.01), estimate(0.4, 0.01)]).unwrap();
        // χ² = 200 of one degree of freedom: the standard deviation of a mean of two values 0.2 apart.
        assert!((pose.turn_sigma_deg - 0.1).abs() < 1e-12, "{}", pose.turn_sigma_deg);
    }

    #[test]
    fn captures_of_two_devices_are_told_of_and_those_of_one_are_not() {
        let told = |turns: &[f64]| {
            let estimates: Vec<PoseEstimate> = turns.iter().map(|turn| estimate(*turn, 0.006)).collect();
            Pose::describe_contradiction(&estimates)
        };
        let said = told(&[0.6, -0.6, 0.59]).unwrap();
        assert!(said.contains("turns of -0.600° and +0.600°, and scales of -0.60 % and +0.60 %"), "{said}");
        assert_eq!(told(&[0.30, 0.31, 0.28]), None);
        assert_eq!(told(&[0.3]), None);
        assert_eq!(told(&[]), None);
    }

    #[test]
    fn turns_and_scales_the_psf_that_it_was_found_for_and_no_other() {
        let psf = psf();
        let pose = Pose::of_estimates(&psf, &[estimate(0.4, 0.01)]).unwrap();
        let errors = MeasurementErrors { turn_deg: 0.4, scale: 0.004, ..MeasurementErrors::default() };
        assert_eq!(pose.apply(&psf).unwrap(), errors.apply(&psf, &mut stream(1, "any")).unwrap());
        let message = pose.apply(&pose.apply(&psf).unwrap()).unwrap_err().to_string();
        assert!(message.contains("another PSF"), "{message}");
    }
}
