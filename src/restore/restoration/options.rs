//! What belongs to the restoration of any panel alone.

use super::super::kernel::KernelKnowledge;
use super::super::pose::Pose;
use super::Restoration;
use crate::core::error::{Error, Result};

impl Restoration {
    /// Takes this part, from 0 to 1, of the corrections by the network for any panel: at 0, the deconvolution stays.
    ///
    /// # Errors
    /// [`Error::Config`] for another number, or another restoration than [`guided`](Self::guided).
    pub fn with_refine(mut self, refine: f32) -> Result<Self> {
        if !(0.0..=1.0).contains(&refine) {
            return Err(Error::config("refine", format!("must be between 0 and 1, found {refine}")));
        }
        let Some(options) = &mut self.guided else {
            return Err(Error::config("refine", "belongs to the guided restoration; leave it out"));
        };
        options.refine = refine;
        Ok(self)
    }

    /// Takes the PSF as it is, or as a pose that several captures told moves it, instead of looking for its pose in each.
    ///
    /// # Errors
    /// [`Error::Config`] for another restoration than [`guided`](Self::guided); those of [`Pose::apply`].
    pub fn with_pose(mut self, pose: Option<&Pose>) -> Result<Self> {
        let Some(options) = &mut self.guided else {
            return Err(Error::config("pose", "belongs to the guided restoration; leave it out"));
        };
        options.finds_pose = false;
        if let Some(pose) = pose {
            if matches!(self.kernel, KernelKnowledge::Search { .. }) {
                let reason = "says how the panel stands against one PSF, and --angle auto looks for that: leave one of them out";
                return Err(Error::config("pose", reason));
            }
            self.kernel = KernelKnowledge::of_psf(pose.apply(self.kernel.needed_psf()?)?);
        }
        Ok(self)
    }

    /// Gives lamps the light that their flare tells, far above what saturates: results are then linear.
    ///
    /// # Errors
    /// [`Error::Config`] for another restoration than [`guided`](Self::guided).
    pub fn with_true_highlights(mut self) -> Result<Self> {
        let Some(options) = &mut self.guided else {
            return Err(Error::config("true-highlights", "belongs to the guided restoration; leave it out"));
        };
        options.true_highlights = true;
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use ndarray::Array3;

    use super::*;
    use crate::core::kernel_code::KernelBank;
    use crate::core::psf::Psf;
    use crate::restore::PoseEstimate;

    #[test]
    fn a_pose_against_one_psf_is_refused_where_the_angle_is_looked_for() {
        let psf = Psf::from_energy(Array3::ones((3, 5, 5))).unwrap();
        let estimate = PoseEstimate {
            turn_deg: 0.2,
            scale: 0.0,
            turn_sigma_deg: 0.01,
            scale_sigma: 1e-3,
            unexplained: 0.5,
            light_to_noise: 100.0,
        };
        let pose = Pose::of_estimates(&psf, &[estimate]).unwrap();
        let bank = Arc::new(KernelBank::single(psf));
        let searched = Restoration::guided(KernelKnowledge::Search { bank, sha256: String::new() }).unwrap();
        assert!(searched.clone().with_pose(None).is_ok());
        let error = searched.with_pose(Some(&pose)).unwrap_err().to_string();
        assert!(error.contains("--angle auto"), "{error}");
    }
}
