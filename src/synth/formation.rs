//! Turns a clean scene and a PSF into what the sensor records: the image formation model.

use std::borrow::Cow;

use ndarray::Array3;

use crate::core::dataset::FormationConfig;
use crate::core::error::Result;
use crate::core::fft::Convolver;
use crate::core::image::LinearImage;
use crate::core::psf::Psf;
use crate::core::tone::ToneCurve;

use super::noise::add_noise;

/// The image formation model of one dataset, without its tone mapping.
///
/// # Equation
/// `ŷ = φ(C(x∗k + n))` (paper, Eq. 1): x the scene's irradiance, k the PSF, n the noise,
/// `C(x) = min(max(x, 0), x_max)`. What is computed and stored is `C(x∗k + n)`; φ is applied where images are
/// compared or shown.
#[derive(Clone, Debug)]
pub struct Formation {
    config: FormationConfig,
    curve: ToneCurve,
    seed: u64,
}

impl Formation {
    /// Takes parameters over; `seed` decides the noise.
    ///
    /// # Errors
    /// [`Error::Config`](crate::core::error::Error::Config) naming a parameter that is out of range.
    pub fn new(config: FormationConfig, seed: u64) -> Result<Self> {
        config.noise.validate()?;
        Ok(Self { curve: config.curve()?, config, seed })
    }

    /// Plans the convolution of scenes of `[height, width]` with PSFs of `[height, width]`.
    ///
    /// # Errors
    /// As [`Convolver::new`].
    pub fn convolver(&self, scene: [usize; 2], psf: [usize; 2]) -> Result<Convolver> {
        Convolver::new(scene, psf, self.config.boundary)
    }

    /// x: the scene as it enters the convolution, clipped where the model says so.
    pub fn scene<'a>(&self, scene: &'a LinearImage) -> Cow<'a, LinearImage> {
        if self.config.clip_ground_truth {
            Cow::Owned(self.curve.clip_image(scene))
        } else {
            Cow::Borrowed(scene)
        }
    }

    /// C(x): the scene as a display-free camera would have recorded it, which is the ground truth.
    pub fn ground_truth(&self, scene: &LinearImage) -> LinearImage {
        self.curve.clip_image(scene)
    }

    /// `C(x∗k + n)` of the irradiance `x∗k`; `label` names the noise's stream of random numbers.
    ///
    /// # Errors
    /// As [`LinearImage::from_planes`].
    pub fn record(&self, mut irradiance: Array3<f32>, label: &str) -> Result<LinearImage> {
        add_noise(&mut irradiance, &self.config.noise, self.seed, label);
        irradiance.par_mapv_inplace(|x| self.curve.clip(x));
        LinearImage::from_planes(irradiance)
    }

    /// `C(x∗k + n)` of one scene and one PSF; for several of either, keep the [`Convolver`] and its spectra.
    ///
    /// # Errors
    /// As [`record`](Self::record).
    pub fn degrade(&self, scene: &LinearImage, psf: &Psf, label: &str) -> Result<LinearImage> {
        let size = [scene.height(), scene.width()];
        let convolver = self.convolver(size, [psf.height(), psf.width()])?;
        let spectrum = convolver.spectrum(&self.scene(scene))?;
        self.record(convolver.convolve(&spectrum, &convolver.otf(psf)?), label)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::dataset::NoiseConfig;

    fn point(value: f32) -> LinearImage {
        let mut planes = Array3::zeros((3, 9, 9));
        planes[[0, 4, 4]] = value;
        LinearImage::from_planes(planes).unwrap()
    }

    fn box_psf() -> Psf {
        Psf::from_energy(Array3::ones((3, 3, 3))).unwrap()
    }

    #[test]
    fn clips_the_ground_truth_before_the_convolution_only_when_asked() {
        let (scene, psf) = (point(9000.0), box_psf());
        let printed = Formation::new(FormationConfig::default(), 0).unwrap();
        let released = Formation::new(FormationConfig::released(), 0).unwrap();
        let centre = |formation: &Formation| formation.degrade(&scene, &psf, "").unwrap().planes()[[0, 4, 4]];
        assert!((centre(&printed) - 500.0).abs() < 1e-6);
        assert!((centre(&released) - 500.0 / 9.0).abs() < 1e-3);
    }

    #[test]
    fn noise_repeats_with_its_label_and_differs_between_labels() {
        let noise = NoiseConfig::Gaussian { sigma: 0.5 };
        let formation = Formation::new(FormationConfig { noise, ..FormationConfig::default() }, 3).unwrap();
        let degrade = |label| formation.degrade(&point(40.0), &box_psf(), label).unwrap();
        assert_eq!(degrade("a"), degrade("a"));
        assert_ne!(degrade("a"), degrade("b"));
    }

    #[test]
    fn refuses_a_saturation_that_is_not_positive() {
        assert!(Formation::new(FormationConfig { x_max: 0.0, ..FormationConfig::default() }, 0).is_err());
    }
}
