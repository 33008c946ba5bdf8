//! Inverts the convolution with a known PSF, channel by channel in the linear domain.
//!
//! [`Method::Wiener`] and [`Method::WienerOrieux`] are the linear filters of the literature,
//! [`Method::RichardsonLucy`] the multiplicative iteration; [`Method::Constrained`] solves the inverse problem
//! of an under-display camera as it is: non-negative light, the frame's border, saturated pixels; [`Method::Joint`] the same
//! for all colours together, with the light of saturated pixels, faster.

mod border;
mod constrained;
mod joint;
mod noise;
mod noise_curve;
mod objective;
mod operator;
mod richardson_lucy;
mod saturation;
mod spectral;
mod wiener;
mod wiener_orieux;

pub use joint::beyond::{LampOutside, Relieved, without_lamps_outside};
pub use joint::pose::{
    FoundPose, FromOutside, PoseConfig, PoseEstimate, UntoldPose, find_pose, find_pose_by_lamp_outside,
};
pub(super) use joint::pose::{window_of_pose, write_pose_in_words};
pub(super) use joint::{CaptureNoise, NOISE_FREE, local_mean};
pub use joint::{DoubtedNoise, Solution};
use ndarray::{Array2, Array3, ArrayView2, Axis};
pub use noise_curve::NoiseCurve;
use serde::{Deserialize, Serialize};

use crate::core::error::{Error, Result};
use crate::core::fft::Boundary;
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;
use crate::dataset::FormationConfig;

/// A method of deconvolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Wiener–Hunt: least squares with a quadratic penalty on the Laplacian.
    Wiener,
    /// Wiener–Hunt with noise and regularisation estimated by Gibbs sampling (Orieux 2010).
    WienerOrieux,
    /// Richardson–Lucy.
    RichardsonLucy,
    /// Weighted least squares over non-negative scenes, border and saturation modelled.
    Constrained,
    /// The scene and the light of saturated pixels together, edges shared by the colours.
    Joint,
}

impl Method {
    /// The name on the command line and in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Wiener => "wiener",
            Self::WienerOrieux => "wiener-orieux",
            Self::RichardsonLucy => "richardson-lucy",
            Self::Constrained => "constrained",
            Self::Joint => "joint",
        }
    }
}

/// What is taken to lie beyond the border of the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Border {
    /// A scene that goes on, as in any real capture. The Wiener filters continue the frame so that it fades smoothly
    /// from one side to the opposite one; the other methods start from that and estimate the light around the frame
    /// too, as far as the PSF reaches.
    #[default]
    Smooth,
    /// The frame again.
    Periodic,
    /// Darkness, as in synthetic images of the [`Boundary`] of that name.
    Zero,
}

impl From<&FormationConfig> for Border {
    /// What a restoration knows of the light around a frame that was formed so: a scene that goes on in a margin is not
    /// known to be dark there, whatever lies beyond the margin.
    fn from(formation: &FormationConfig) -> Self {
        if formation.margin > 0 { Self::Smooth } else { formation.boundary.into() }
    }
}

impl From<Boundary> for Border {
    /// What a restoration knows of the light around a frame that was formed with `boundary`.
    fn from(boundary: Boundary) -> Self {
        match boundary {
            Boundary::Zero => Self::Zero,
            Boundary::Replicate | Boundary::Reflect => Self::Smooth,
            Boundary::Periodic => Self::Periodic,
        }
    }
}

/// How an image is deconvolved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct DeconvolutionConfig {
    /// The method.
    pub method: Method,
    /// The weight of the Laplacian's penalty (`wiener`).
    pub balance: f32,
    /// What lies beyond the border.
    pub border: Border,
    /// The largest number of iterations (`richardson-lucy`, `constrained`).
    pub iterations: usize,
    /// Whether the Wiener filters treat saturated pixels as unknown; the other methods always do.
    pub mask_saturated: bool,
    /// The seed of the random numbers (`wiener-orieux`).
    pub seed: u64,
    /// α of the tone mapping, which says how much dark pixels count (`constrained`, `joint`).
    pub alpha: f32,
    /// The value of a full photosite in each channel, of which [`saturated_from`] takes the saturated share.
    pub saturation: [f32; CHANNELS],
    /// The capture's noise, where it is told and need not be estimated (`joint`).
    #[serde(skip)]
    pub noise: Option<NoiseCurve>,
    /// What the coding of a JPEG makes wrong, as [`CaptureInfo`](crate::core::capture::CaptureInfo) has it: estimates of noise are no less
    /// (`joint`).
    #[serde(skip)]
    pub coding_error: Option<[f32; CHANNELS]>,
}

impl Default for DeconvolutionConfig {
    fn default() -> Self {
        Self {
            method: Method::Constrained,
            balance: 1e-2,
            border: Border::default(),
            iterations: 30,
            mask_saturated: false,
            seed: 0,
            alpha: ToneCurve::default().alpha,
            saturation: [ToneCurve::default().x_max; CHANNELS],
            noise: None,
            coding_error: None,
        }
    }
}

impl DeconvolutionConfig {
    /// Whether saturated pixels are taken for unknown.
    pub fn knows_saturated(&self) -> bool {
        self.mask_saturated || !matches!(self.method, Method::Wiener | Method::WienerOrieux)
    }

    /// The defaults of a method.
    pub fn of_method(method: Method) -> Self {
        Self { method, ..Self::default() }
    }

    /// The value from which on a pixel of a channel counts as saturated.
    fn saturated_from(&self, channel: usize) -> f32 {
        saturated_from(self.saturation[channel])
    }

    fn validate(&self) -> Result<()> {
        let saturation = self.saturation.map(|value| ("saturation", value));
        for (key, value) in [("balance", self.balance), ("alpha", self.alpha)].into_iter().chain(saturation) {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::config(key, format!("must be a positive number, found {value}")));
            }
        }
        if self.iterations == 0 {
            return Err(Error::config("iterations", "must be at least 1"));
        }
        Ok(())
    }
}

/// Estimates the scene of which `image` is the convolution with `psf`.
///
/// The Wiener filters may return negative light; the other methods never do. The PSF may be larger than the
/// image.
///
/// # Errors
/// [`Error::Config`] when a setting is out of range; [`Error::Interrupted`] between iterations.
pub fn deconvolve(
    image: &LinearImage,
    psf: &Psf,
    config: &DeconvolutionConfig,
    progress: &Progress,
) -> Result<LinearImage> {
    config.validate()?;
    let relieved = match config.method {
        Method::Joint => without_lamps_outside(image, psf, config, progress)?,
        _ => None,
    };
    invert(relieved.as_ref().map_or(image, |relieved| &relieved.image), psf, config, progress)
}

/// Estimates the scene as [`deconvolve`] does, of a capture that has no flare of lamps outside of it.
///
/// # Errors
/// As [`deconvolve`].
pub(super) fn invert(
    image: &LinearImage,
    psf: &Psf,
    config: &DeconvolutionConfig,
    progress: &Progress,
) -> Result<LinearImage> {
    config.validate()?;
    if config.method == Method::Joint {
        return joint::restore(image, psf, config, progress);
    }
    let bar = progress.bar(CHANNELS as u64, "channels deconvolved");
    let mut restored = Array3::zeros(image.planes().dim());
    for channel in 0..CHANNELS {
        progress.check()?;
        let (plane, psf) = (image.channel(channel), psf.channel(channel));
        let plane = deconvolve_plane(plane, psf, config, channel, progress)?;
        restored.index_axis_mut(Axis(0), channel).assign(&plane);
        bar.inc(1);
    }
    bar.finish_and_clear();
    LinearImage::from_planes(restored)
}

/// Estimates the scene with what is known of its errors, by [`Method::Joint`].
///
/// # Errors
/// As [`deconvolve`].
pub fn solve(
    image: &LinearImage,
    psf: &Psf,
    config: &DeconvolutionConfig,
    progress: &Progress,
) -> Result<Solution> {
    config.validate()?;
    joint::solve((image, psf), config, None, progress)
}

/// As [`solve`], of a window of a capture, whose noise is that of all of it.
///
/// # Errors
/// As [`deconvolve`].
pub(super) fn solve_window(
    (window, psf): (&LinearImage, &Psf),
    config: &DeconvolutionConfig,
    noise: &CaptureNoise,
    progress: &Progress,
) -> Result<Solution> {
    config.validate()?;
    joint::solve((window, psf), config, Some(noise), progress)
}

/// What a capture tells of its noise, which is solved for in windows of `[height, width]`.
///
/// # Errors
/// As [`deconvolve`].
pub(super) fn noise_of_capture(
    image: &LinearImage,
    psf: &Psf,
    config: &DeconvolutionConfig,
    window: [usize; 2],
) -> Result<CaptureNoise> {
    config.validate()?;
    CaptureNoise::of(image, psf, config, window)
}

/// Doubts the noise that is told of a capture, if any is, where the capture shows quite another; it is solved for in windows of
/// `[height, width]`.
///
/// # Errors
/// As [`deconvolve`].
pub(super) fn doubt_told_noise(
    image: &LinearImage,
    psf: &Psf,
    config: &DeconvolutionConfig,
    window: [usize; 2],
) -> Result<Option<DoubtedNoise>> {
    config.validate()?;
    CaptureNoise::doubt(image, psf, config, window)
}

/// What a linear filter makes of a capture that is told the true spectrum of every neighbourhood of the scene, its own noise, and the
/// scene where the capture is saturated: a bound to compare restorations with. The scene may itself be clipped where the capture is.
///
/// # Method
/// That of [`Method::Joint`] to the light around the frame and where the scene is clipped; then Wiener's filter of blocks of 8 × 8 pixels, `P²/(P² + N)` of the
/// scene's coefficients P and of the variance N that the regularised inverse makes of the noise. What such a filter can't know, as where
/// an edge goes on, a network may.
///
/// # Errors
/// Those of [`deconvolve`]; [`Error::Shape`] for a scene of another size.
pub fn filter_by_truth(
    (image, scene): (&LinearImage, &LinearImage),
    psf: &Psf,
    config: &DeconvolutionConfig,
    progress: &Progress,
) -> Result<LinearImage> {
    config.validate()?;
    let size = |image: &LinearImage| format!("{} × {}", image.height(), image.width());
    if size(scene) != size(image) {
        return Err(Error::shape("scene", size(image), size(scene)));
    }
    let relieved = without_lamps_outside(image, psf, config, progress)?;
    let image = relieved.as_ref().map_or(image, |relieved| &relieved.image);
    joint::filter_by_truth((image, scene), psf, config, progress)
}

/// Bytes that [`deconvolve`] takes, the image and the result included.
///
/// By [`Method::Joint`] those of an image with saturated pixels; without any it takes two thirds.
pub fn deconvolution_bytes(image: [usize; 2], psf: [usize; 2], config: &DeconvolutionConfig) -> u64 {
    let pixels = (image[0] * image[1]) as u64;
    let (plane, grid) = match config.method {
        Method::Wiener | Method::WienerOrieux => (image, border::extended_size(image, psf, config.border)),
        Method::RichardsonLucy | Method::Constrained | Method::Joint => {
            (operator::plane_size(image, psf, config.border), operator::grid_size(image, psf, config.border))
        }
    };
    let (of_plane, samples) = ((plane[0] * plane[1]) as u64, (grid[0] * grid[1]) as u64);
    // Planes of one channel at once; spectra: those of the PSF and the filter, of the data, and the rows between
    // the two passes of a transform. A half spectrum of doubles takes two floats a sample.
    let (planes, spectra) = match config.method {
        Method::Wiener => (4, 5),
        Method::WienerOrieux => (4, 6),
        Method::RichardsonLucy => (6, 3),
        Method::Constrained => (12, 4),
        Method::Joint => return joint::bytes(pixels, of_plane, samples),
    };
    4 * (2 * CHANNELS as u64 * pixels + planes * of_plane + 2 * spectra * samples)
}

fn deconvolve_plane(
    plane: ArrayView2<'_, f32>,
    psf: ArrayView2<'_, f32>,
    config: &DeconvolutionConfig,
    channel: usize,
    progress: &Progress,
) -> Result<Array2<f32>> {
    match config.method {
        Method::Wiener => wiener::restore(plane, psf, config, channel, progress),
        Method::WienerOrieux => wiener_orieux::restore(plane, psf, config, channel, progress),
        Method::RichardsonLucy => richardson_lucy::restore(plane, psf, config, channel, progress),
        Method::Constrained => constrained::restore(plane, psf, config, channel, progress),
        Method::Joint => unreachable!("colours are solved for together"),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;

    use super::*;

    /// Those that restore each colour for itself.
    const METHODS: [Method; 4] =
        [Method::Wiener, Method::WienerOrieux, Method::RichardsonLucy, Method::Constrained];

    /// The same light in all colours.
    fn gray(plane: &Array2<f32>) -> Array3<f32> {
        let (height, width) = plane.dim();
        plane.broadcast((CHANNELS, height, width)).unwrap().to_owned()
    }

    /// A core in a halo with half of the light.
    fn psf() -> Array2<f32> {
        let k = Array2::from_shape_fn((31, 31), |(y, x)| {
            let distance = (y as f32 - 15.0).hypot(x as f32 - 15.0);
            (-distance * distance).exp() + 0.02 * (-distance / 5.0).exp()
        });
        let sum = k.sum();
        k / sum
    }

    /// One pixel differs from the others in no capture of evenly lit paper: a percent is rounding and to spare.
    #[test]
    fn an_evenly_lit_frame_stays_even() {
        let paper = LinearImage::from_planes(Array3::from_elem((3, 40, 56), 0.5)).unwrap();
        let psf = Psf::from_energy(gray(&psf())).unwrap();
        for method in METHODS.into_iter().chain([Method::Joint]) {
            for border in [Border::Smooth, Border::Periodic] {
                let config = DeconvolutionConfig { border, ..DeconvolutionConfig::of_method(method) };
                let restored = deconvolve(&paper, &psf, &config, &Progress::default()).unwrap();
                for value in restored.planes() {
                    assert!((value - 0.5).abs() < 0.005, "{method:?}, {border:?}: {value}");
                }
            }
        }
    }

    /// Red is valid up to its own white level, however early green saturates: with green's level, the bright half of red
    /// would be taken for a lower bound.
    #[test]
    fn red_is_not_saturated_where_green_would_be() {
        let plane = Array3::from_shape_fn((3, 40, 40), |(_, _, x)| if x < 20 { 0.3 } else { 1.5 });
        let image = LinearImage::from_planes(plane).unwrap();
        let psf = Psf::from_energy(gray(&psf())).unwrap();
        let restored = |method, saturation| {
            let mask_saturated = true;
            let config =
                DeconvolutionConfig { saturation, mask_saturated, ..DeconvolutionConfig::of_method(method) };
            deconvolve(&image, &psf, &config, &Progress::default()).unwrap()
        };
        for method in METHODS {
            let [unbounded, own, greens] =
                [[500.0; 3], [1.9, 1.0, 1.6], [1.0; 3]].map(|s| restored(method, s));
            assert_eq!(own.channel(0), unbounded.channel(0), "{method:?}");
            assert_eq!(own.channel(1), greens.channel(1), "{method:?}");
            assert_ne!(greens.channel(0), unbounded.channel(0), "{method:?}");
        }
    }

    /// Even by the filter without iterations when it fills saturated pixels in round after round.
    #[test]
    fn an_interrupt_ends_every_method_inside_a_channel() {
        let progress = Progress::new(None, Arc::new(AtomicBool::new(true)));
        let frame = Array2::from_elem((24, 24), 600.0);
        for method in METHODS {
            let config =
                DeconvolutionConfig { mask_saturated: true, ..DeconvolutionConfig::of_method(method) };
            let found = deconvolve_plane(frame.view(), psf().view(), &config, 0, &progress);
            assert!(matches!(found, Err(Error::Interrupted)), "{method:?}: {found:?}");
        }
        let frame = LinearImage::from_planes(gray(&frame)).unwrap();
        let psf = Psf::from_energy(gray(&psf())).unwrap();
        let found = deconvolve(&frame, &psf, &DeconvolutionConfig::of_method(Method::Joint), &progress);
        assert!(matches!(found, Err(Error::Interrupted)), "{found:?}");
    }
}
