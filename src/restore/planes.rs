//! Makes of a capture and its PSF the planes that a network reads beside the image.

use ndarray::{Array3, Axis, Zip};

use super::deconvolution::{Border, DeconvolutionConfig, deconvolve, relative_noise};
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
}

impl PlaneConfig {
    /// That of images which were formed so.
    ///
    /// # Errors
    /// [`Error::Config`](crate::core::error::Error::Config) when the formation has no tone curve.
    pub fn of_formation(formation: &FormationConfig) -> Result<Self> {
        let curve = formation.curve()?;
        Ok(Self { curve, border: formation.into(), saturation: [curve.x_max; CHANNELS] })
    }

    fn deconvolution(&self) -> DeconvolutionConfig {
        DeconvolutionConfig {
            border: self.border,
            alpha: self.curve.alpha,
            saturation: self.saturation,
            ..DeconvolutionConfig::default()
        }
    }
}

/// Makes a plane of a linear capture.
///
/// # Equation
/// The noise of `log(x + α)`, σ, is that of φ(x) = x/(x + α) times `φ′(x)·(x + α) = α/(x + α) = 1 − φ(x)`.
///
/// # Errors
/// Those of [`deconvolve`].
pub fn make_plane(
    plane: Plane,
    capture: &LinearImage,
    psf: &Psf,
    config: &PlaneConfig,
    progress: &Progress,
) -> Result<ToneMappedImage> {
    match plane {
        Plane::Deconvolved => {
            let scene = deconvolve(capture, psf, &config.deconvolution(), progress)?;
            Ok(config.curve.tone_map_in_place(scene))
        }
        Plane::Noise => noise(capture, psf, config),
        Plane::Saturated => saturated(capture, config.saturation),
    }
}

/// Makes the wanted planes of a linear capture; nothing is computed for those that are not wanted.
///
/// # Errors
/// Those of [`deconvolve`].
pub fn make_planes(
    wanted: &[Plane],
    capture: &LinearImage,
    psf: &Psf,
    config: &PlaneConfig,
    progress: &Progress,
) -> Result<Planes> {
    let make = |&plane| Ok((plane, make_plane(plane, capture, psf, config, progress)?));
    wanted.iter().map(make).collect()
}

fn noise(capture: &LinearImage, psf: &Psf, config: &PlaneConfig) -> Result<ToneMappedImage> {
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    let relative = relative_noise(capture, psf, &config.deconvolution())?.map(|sigma| sigma as f32);
    per_channel(capture, |channel, value| relative[channel] * (1.0 - config.curve.compress(value)))
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
        PlaneConfig { curve, border: Border::Periodic, saturation: [4.0, 4.0, 2.0] }
    }

    fn point() -> Psf {
        let mut energy = Array3::zeros((CHANNELS, 3, 3));
        energy.slice_mut(ndarray::s![.., 1, 1]).fill(1.0);
        Psf::from_energy(energy).unwrap()
    }

    fn made(plane: Plane, capture: &LinearImage) -> ToneMappedImage {
        make_plane(plane, capture, &point(), &config(), &Progress::default()).unwrap()
    }

    /// The median of 4096 moduli is known to 2 %, and other bands correct it by a few more.
    #[test]
    fn noise_is_the_deviation_of_tone_mapped_values() {
        let (mean, deviation) = (0.5, 0.01);
        let normal = Normal::new(mean, deviation).unwrap();
        let values = normal.sample_iter(rng::stream(3, "noise")).take(CHANNELS * SIDE * SIDE).collect();
        let values = Array3::from_shape_vec((CHANNELS, SIDE, SIDE), values).unwrap();
        let capture = LinearImage::from_planes(values).unwrap();
        let curve = config().curve;
        let expected = deviation * curve.alpha / (mean + curve.alpha).powi(2);
        for value in made(Plane::Noise, &capture).as_slice() {
            assert!((value / expected - 1.0).abs() < 0.2, "{value}, expected {expected}");
        }
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
        let scene = deconvolve(&capture, &point(), &config, &Progress::default()).unwrap();
        assert_eq!(made, self::config().curve.tone_map(&scene));
    }

    #[test]
    fn nothing_is_made_that_is_not_wanted() {
        let capture = LinearImage::from_planes(Array3::zeros((CHANNELS, 4, 5))).unwrap();
        let planes = make_planes(&[], &capture, &point(), &config(), &Progress::default()).unwrap();
        assert!(planes.is_empty());
    }
}
