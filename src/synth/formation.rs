//! Turns a clean scene and a PSF into what the sensor records: the image formation model.

use std::borrow::Cow;

use ndarray::Array3;

use crate::core::error::Result;
use crate::core::fft::{Convolver, Otf, Spectrum};
use crate::core::image::LinearImage;
use crate::core::psf::Psf;
use crate::core::tone::ToneCurve;
use crate::dataset::FormationConfig;

use super::noise::add_noise;

/// The image formation model of one dataset, without its tone mapping.
///
/// # Equation
/// `ŷ = φ(C(x∗k + n))` (paper, Eq. 1): x the scene's irradiance, k the PSF, n the noise,
/// `C(x) = min(max(x, 0), x_max)`. What is computed and stored is `C(x∗k + n)`; φ is applied where images are
/// compared or shown.
///
/// # Shapes
/// Scenes are larger than the frame by the model's margin on each side; ground truths and degraded images are of the
/// frame, the middle of the scene.
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
    /// As [`Convolver::new`] and [`FormationConfig::frame_size`].
    pub fn convolver(&self, scene: [usize; 2], psf: [usize; 2]) -> Result<Convolver> {
        self.config.frame_size(scene)?;
        Convolver::new(scene, psf, self.config.boundary)
    }

    /// The model's parameters.
    pub fn config(&self) -> &FormationConfig {
        &self.config
    }

    /// Pixels by which scenes are larger than the frame on each side.
    pub fn margin(&self) -> usize {
        self.config.margin
    }

    /// x: the scene as it enters the convolution, clipped where the model says so.
    pub fn scene<'a>(&self, scene: &'a LinearImage) -> Cow<'a, LinearImage> {
        if self.config.clip_ground_truth {
            Cow::Owned(self.curve.clip_image(scene))
        } else {
            Cow::Borrowed(scene)
        }
    }

    /// C(x) of the frame: the scene as a display-free camera would have recorded it, which is the ground truth.
    ///
    /// # Errors
    /// As [`FormationConfig::frame_size`].
    pub fn ground_truth(&self, scene: &LinearImage) -> Result<LinearImage> {
        let [height, width] = self.config.frame_size([scene.height(), scene.width()])?;
        match self.config.margin {
            0 => Ok(self.curve.clip_image(scene)),
            margin => {
                let frame = scene.crop(margin, margin, height, width);
                Ok(frame.map_in_place(|x| self.curve.clip(x)))
            }
        }
    }

    /// x∗k on the frame, of a scene and a PSF that were transformed.
    ///
    /// # Panics
    /// When one of them is of another convolver.
    pub fn irradiance(&self, convolver: &Convolver, scene: &Spectrum, psf: &Otf) -> Array3<f32> {
        convolver.convolve_middle(scene, psf, self.config.margin)
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
        self.record(self.irradiance(&convolver, &spectrum, &convolver.otf(psf)?), label)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::fft::Boundary;
    use crate::dataset::NoiseConfig;

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

    /// A lamp 3 pixels above and 2 left of the frame: the PSF's tail enters at its corner, unchanged.
    #[test]
    fn a_lamp_outside_of_the_frame_throws_its_flare_into_it() {
        let margin = 6;
        let (height, width) = (12, 15);
        let energy =
            Array3::from_shape_fn((3, 11, 9), |(c, y, x)| 1.0 + (3 * c + 5 * y + 7 * x) as f32 % 13.0);
        let psf = Psf::from_energy(energy).unwrap();
        let mut planes = Array3::zeros((3, height + 2 * margin, width + 2 * margin));
        planes.slice_mut(ndarray::s![.., margin - 3, margin - 2]).fill(40.0);
        let scene = LinearImage::from_planes(planes).unwrap();
        for boundary in [Boundary::Zero, Boundary::Replicate, Boundary::Reflect] {
            let config = FormationConfig { margin, boundary, ..FormationConfig::default() };
            let formation = Formation::new(config, 0).unwrap();
            assert_eq!(formation.ground_truth(&scene).unwrap().max(), 0.0);
            let seen = formation.degrade(&scene, &psf, "").unwrap();
            assert_eq!((seen.height(), seen.width()), (height, width));
            for ((c, y, x), &found) in seen.planes().indexed_iter() {
                // Centre at (5, 4); the pixel lies 3 + y rows below the lamp and 2 + x columns to its right.
                let expected = psf.planes().get([c, 5 + 3 + y, 4 + 2 + x]).map_or(0.0, |k| 40.0 * k);
                // One transform in 32 bits of values up to 40 · 0.02.
                assert!((found - expected).abs() < 1e-6, "{boundary:?} {c} {y} {x}: {found}, not {expected}");
            }
        }
    }

    /// Convolving a larger scene and cutting the frame out is the definition.
    #[test]
    fn a_margin_is_convolving_all_of_the_scene_and_keeping_the_middle() {
        let planes = Array3::from_shape_fn((3, 31, 28), |(c, y, x)| {
            if (y, x) == (2, 25) { 3000.0 } else { ((c + 3 * y + 5 * x) % 11) as f32 / 10.0 }
        });
        let scene = LinearImage::from_planes(planes).unwrap();
        let psf =
            Psf::from_energy(Array3::from_shape_fn((3, 14, 14), |(c, y, x)| (1 + c + y * x) as f32)).unwrap();
        for boundary in [Boundary::Zero, Boundary::Replicate, Boundary::Reflect] {
            let config = FormationConfig { boundary, ..FormationConfig::default() };
            let whole = Formation::new(config.clone(), 0).unwrap().degrade(&scene, &psf, "").unwrap();
            let margined = Formation::new(FormationConfig { margin: 5, ..config }, 0).unwrap();
            assert_eq!(margined.degrade(&scene, &psf, "").unwrap(), whole.crop(5, 5, 21, 18), "{boundary:?}");
        }
        let nothing =
            Formation::new(FormationConfig { margin: 14, ..FormationConfig::default() }, 0).unwrap();
        assert!(nothing.degrade(&scene, &psf, "").is_err() && nothing.ground_truth(&scene).is_err());
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
