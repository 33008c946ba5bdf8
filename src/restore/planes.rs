//! Makes of a capture and its PSF the planes that a network reads beside the image.

use ndarray::{Array3, Axis, Zip};

use super::deconvolution::{Border, DeconvolutionConfig, Method, NoiseCurve, Solution, solve};
use super::outside::light_from_outside;
use crate::core::error::Result;
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;
use crate::dataset::FormationConfig;
use crate::network::{Plane, Planes};

/// What is known of a capture besides its PSF.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneConfig {
    /// φ∘C.
    pub curve: ToneCurve,
    /// What lies beyond the border.
    pub border: Border,
    /// The value of a full photosite in each channel.
    pub saturation: [f32; CHANNELS],
    /// The capture's noise, where it is told and need not be estimated.
    pub noise: Option<NoiseCurve>,
    /// What the coding of a JPEG makes wrong in its encoded values.
    pub coding_error: Option<[f32; CHANNELS]>,
}

impl PlaneConfig {
    /// That of images which were formed so.
    ///
    /// # Errors
    /// [`Error::Config`](crate::core::error::Error::Config) when the formation has no tone curve.
    pub fn of_formation(formation: &FormationConfig) -> Result<Self> {
        let curve = formation.curve()?;
        let saturation = [curve.x_max; CHANNELS];
        Ok(Self { curve, border: formation.into(), saturation, noise: None, coding_error: None })
    }

    pub(super) fn deconvolution(&self) -> DeconvolutionConfig {
        DeconvolutionConfig {
            border: self.border,
            alpha: self.curve.alpha,
            saturation: self.saturation,
            noise: self.noise,
            coding_error: self.coding_error,
            ..DeconvolutionConfig::of_method(Method::Joint)
        }
    }
}

/// Makes the wanted planes of a linear capture; nothing is computed for those that are not wanted.
///
/// The scene is solved for together with the light of saturated pixels, and the noise is that of the result: as much of it as
/// [`solve`] can tell, in the tone-mapped domain.
///
/// # Errors
/// Those of [`solve`].
pub fn make_planes(
    wanted: &[Plane],
    capture: &LinearImage,
    psf: &Psf,
    config: &PlaneConfig,
    progress: &Progress,
) -> Result<Planes> {
    let is_solved = |plane: &Plane| matches!(plane, Plane::Deconvolved | Plane::Noise);
    let solution = if wanted.iter().any(is_solved) {
        Some(solve(capture, psf, &config.deconvolution(), progress)?)
    } else {
        None
    };
    planes_of(wanted, (capture, psf), solution, config)
}

/// The planes of a capture whose scene has been solved for, where that is needed.
pub(super) fn planes_of(
    wanted: &[Plane],
    (capture, psf): (&LinearImage, &Psf),
    solution: Option<Solution>,
    config: &PlaneConfig,
) -> Result<Planes> {
    let mut planes: Vec<(Plane, ToneMappedImage)> = Vec::new();
    if let Some(Solution { scene, deviation, .. }) = solution {
        if wanted.contains(&Plane::Noise) {
            planes.push((Plane::Noise, noise(&scene, deviation, config.curve)?));
        }
        if wanted.contains(&Plane::Deconvolved) {
            planes.push((Plane::Deconvolved, config.curve.tone_map_in_place(scene)));
        }
    }
    if wanted.contains(&Plane::Saturated) {
        planes.push((Plane::Saturated, saturated(capture, config.saturation)?));
    }
    if wanted.contains(&Plane::Outside) {
        planes.push((Plane::Outside, light_from_outside(capture, psf, config.border, config.curve)?));
    }
    Ok(planes.into_iter().collect())
}

/// Turns the deviation of a scene's light to that of φ.
///
/// # Equation
/// `σ·φ′(x)`, `φ′(x) = α/(x + α)²`, at most 1.
fn noise(scene: &LinearImage, mut deviation: Array3<f32>, curve: ToneCurve) -> Result<ToneMappedImage> {
    Zip::from(&mut deviation).and(&scene.planes()).par_for_each(|deviation, &x| {
        let light = x.clamp(0.0, curve.x_max);
        *deviation = (*deviation * curve.alpha / (light + curve.alpha).powi(2)).min(1.0);
    });
    ToneMappedImage::from_planes(deviation)
}

fn saturated(capture: &LinearImage, saturation: [f32; CHANNELS]) -> Result<ToneMappedImage> {
    let from = saturation.map(saturated_from);
    per_channel(capture, |channel, value| if value >= from[channel] { 1.0 } else { 0.0 })
}

fn per_channel(
    capture: &LinearImage,
    value: impl Fn(usize, f32) -> f32 + Sync + Send,
) -> Result<ToneMappedImage> {
    let mut planes = Array3::zeros(capture.planes().dim());
    for (channel, plane) in planes.axis_iter_mut(Axis(0)).enumerate() {
        Zip::from(plane).and(capture.channel(channel)).par_for_each(|to, &from| *to = value(channel, from));
    }
    ToneMappedImage::from_planes(planes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng;
    use rand_distr::{Distribution, Normal};

    const SIDE: usize = 64;

    fn config() -> PlaneConfig {
        let curve = ToneCurve { alpha: 0.25, x_max: 4.0 };
        let (border, saturation) = (Border::Periodic, [4.0, 4.0, 2.0]);
        PlaneConfig { curve, border, saturation, noise: None, coding_error: None }
    }

    fn point() -> Psf {
        let mut energy = Array3::zeros((CHANNELS, 3, 3));
        energy.slice_mut(ndarray::s![.., 1, 1]).fill(1.0);
        Psf::from_energy(energy).unwrap()
    }

    fn made(plane: Plane, capture: &LinearImage) -> ToneMappedImage {
        let planes = make_planes(&[plane], capture, &point(), &config(), &Progress::default()).unwrap();
        planes.get(plane).unwrap().clone()
    }

    /// A point of a PSF in an even scene: what the solver leaves of the noise is what it says, within a factor of two, and
    /// less than there was.
    #[test]
    fn noise_is_the_deviation_of_tone_mapped_values() {
        let (mean, deviation) = (0.5, 0.01);
        let normal = Normal::new(mean, deviation).unwrap();
        let values = normal.sample_iter(rng::stream(3, "noise")).take(CHANNELS * SIDE * SIDE).collect();
        let values = Array3::from_shape_vec((CHANNELS, SIDE, SIDE), values).unwrap();
        let capture = LinearImage::from_planes(values).unwrap();
        let curve = config().curve;
        let deconvolved = made(Plane::Deconvolved, &capture);
        let truth = curve.compress(mean);
        let squares: f32 = deconvolved.as_slice().iter().map(|value| (value - truth).powi(2)).sum();
        let left = (squares / deconvolved.as_slice().len() as f32).sqrt();
        let told: f32 =
            made(Plane::Noise, &capture).as_slice().iter().sum::<f32>() / (CHANNELS * SIDE * SIDE) as f32;
        assert!((0.5..2.0).contains(&(told / left)), "told {told}, left {left}");
        assert!(told < deviation * curve.alpha / (mean + curve.alpha).powi(2), "{told}");
    }

    #[test]
    fn saturated_is_what_reaches_its_channels_own_level() {
        let capture = LinearImage::from_planes(Array3::from_elem((CHANNELS, 4, 5), 1.99)).unwrap();
        let saturated = made(Plane::Saturated, &capture);
        for (channel, expected) in [0.0, 0.0, 1.0].into_iter().enumerate() {
            assert!(saturated.channel(channel).iter().all(|&value| value == expected));
        }
    }

    #[test]
    fn deconvolved_is_the_tone_mapped_scene() {
        let value = |(c, y, x)| 0.2 + ((c * 31 + y * 17 + x * 5) % 13) as f32 / 13.0;
        let capture = LinearImage::from_planes(Array3::from_shape_fn((CHANNELS, 20, 24), value)).unwrap();
        let made = made(Plane::Deconvolved, &capture);
        let config = config().deconvolution();
        let scene = solve(&capture, &point(), &config, &Progress::default()).unwrap().scene;
        assert_eq!(made, self::config().curve.tone_map(&scene));
    }

    #[test]
    fn nothing_is_made_that_is_not_wanted() {
        let capture = LinearImage::from_planes(Array3::zeros((CHANNELS, 4, 5))).unwrap();
        let planes = make_planes(&[], &capture, &point(), &config(), &Progress::default()).unwrap();
        assert!(planes.is_empty());
    }
}
