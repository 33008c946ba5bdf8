//! Inverts the convolution with a known PSF, channel by channel in the linear domain.
//!
//! [`Method::Wiener`] and [`Method::WienerOrieux`] are the linear filters of the literature,
//! [`Method::RichardsonLucy`] the multiplicative iteration; [`Method::Constrained`] solves the inverse problem
//! of an under-display camera as it is: non-negative light, the frame's border, saturated pixels.

mod border;
mod constrained;
mod noise;
mod objective;
mod operator;
mod richardson_lucy;
mod saturation;
mod spectral;
mod wiener;
mod wiener_orieux;

use ndarray::{Array2, Array3, ArrayView2, Axis};
use serde::{Deserialize, Serialize};

use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::tone::ToneCurve;

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
}

/// What the Wiener filters take to lie beyond the border of the frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Border {
    /// A continuation of the frame that fades smoothly from one side to the opposite one.
    #[default]
    Smooth,
    /// The frame again.
    Periodic,
}

/// How an image is deconvolved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct DeconvolutionConfig {
    /// The method.
    pub method: Method,
    /// The weight of the Laplacian's penalty (`wiener`).
    pub balance: f32,
    /// What lies beyond the border (`wiener`, `wiener-orieux`).
    pub border: Border,
    /// The largest number of iterations (`richardson-lucy`, `constrained`).
    pub iterations: usize,
    /// Whether the Wiener filters treat saturated pixels as unknown; the other methods always do.
    pub mask_saturated: bool,
    /// The seed of the random numbers (`wiener-orieux`).
    pub seed: u64,
    /// α of the tone mapping, which says how much dark pixels count (`constrained`).
    pub alpha: f32,
    /// The value of a saturated pixel.
    pub saturation: f32,
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
            saturation: ToneCurve::default().x_max,
        }
    }
}

impl DeconvolutionConfig {
    /// The defaults of a method.
    pub fn of_method(method: Method) -> Self {
        Self { method, ..Self::default() }
    }

    fn validate(&self) -> Result<()> {
        for (key, value) in
            [("balance", self.balance), ("alpha", self.alpha), ("saturation", self.saturation)]
        {
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
/// [`Error::Config`] when a setting is out of range; [`Error::Interrupted`] between channels.
pub fn deconvolve(
    image: &LinearImage,
    psf: &Psf,
    config: &DeconvolutionConfig,
    progress: &Progress,
) -> Result<LinearImage> {
    config.validate()?;
    let bar = progress.bar(CHANNELS as u64, "deconvolving");
    let mut restored = Array3::zeros(image.planes().dim());
    for channel in 0..CHANNELS {
        progress.check()?;
        let plane = deconvolve_plane(image.channel(channel), psf.channel(channel), config, channel)?;
        restored.index_axis_mut(Axis(0), channel).assign(&plane);
        bar.inc(1);
    }
    bar.finish_and_clear();
    LinearImage::from_planes(restored)
}

/// Bytes that [`deconvolve`] takes, the image and the result included.
pub fn deconvolution_bytes(image: [usize; 2], psf: [usize; 2], config: &DeconvolutionConfig) -> u64 {
    let pixels = (image[0] * image[1]) as u64;
    let grid = match config.method {
        Method::Wiener | Method::WienerOrieux => border::extended_size(image, psf, config.border),
        Method::RichardsonLucy | Method::Constrained => operator::grid_size(image, psf),
    };
    let samples = (grid[0] * grid[1]) as u64;
    // Planes of one channel at once; spectra: those of the PSF and the filter, of the data, and the rows between
    // the two passes of a transform. A half spectrum of doubles takes two floats a sample.
    let (planes, spectra) = match config.method {
        Method::Wiener => (4, 5),
        Method::WienerOrieux => (4, 6),
        Method::RichardsonLucy => (6, 3),
        Method::Constrained => (12, 4),
    };
    4 * (2 * CHANNELS as u64 * pixels + planes * pixels + 2 * spectra * samples)
}

fn deconvolve_plane(
    plane: ArrayView2<'_, f32>,
    psf: ArrayView2<'_, f32>,
    config: &DeconvolutionConfig,
    channel: usize,
) -> Result<Array2<f32>> {
    let saturation = saturation::level(config.saturation);
    match config.method {
        Method::Wiener => wiener::restore(plane, psf, config),
        Method::WienerOrieux => wiener_orieux::restore(plane, psf, config, channel),
        Method::RichardsonLucy => richardson_lucy::restore(plane, psf, saturation, config.iterations),
        Method::Constrained => constrained::restore(plane, psf, config),
    }
}
