//! Turns two tone-mapped images into numbers that say how far they are apart, each with its definition.

mod psnr;
mod ssim;

pub use psnr::psnr;
pub use ssim::ssim;

use serde::{Deserialize, Serialize};

use super::error::{Error, Result};
use super::image::ToneMappedImage;

/// What PSNR and SSIM are computed of; written beside every number.
///
/// Images are tone-mapped and clamped to `[0, 1]`, which is also the peak. PSNR is taken over all pixels and
/// channels; SSIM is the mean over the three channels and over the pixels whose whole window lies within the
/// image, so that half a window, 5 pixels, falls away at each border.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct MetricDefinition {
    /// Whether images are rounded to 8 bits first, as the published evaluation does.
    pub quantise: bool,
    /// Pixels cut from each side of both images before anything else.
    pub border: usize,
    /// Side of the SSIM's Gaussian window in pixels, odd.
    pub ssim_window: usize,
    /// Standard deviation of that Gaussian in pixels.
    pub ssim_sigma: f64,
}

impl Default for MetricDefinition {
    /// The published evaluation: [`released`](Self::released).
    fn default() -> Self {
        Self::released()
    }
}

impl MetricDefinition {
    /// As the published evaluation computes them: on images rounded to 8 bits.
    pub fn released() -> Self {
        Self { quantise: true, border: 0, ssim_window: 11, ssim_sigma: 1.5 }
    }

    /// The same without rounding.
    pub fn float() -> Self {
        Self { quantise: false, ..Self::released() }
    }

    /// The values that are compared: clamped, and rounded if so defined.
    fn values_of(&self, image: &ToneMappedImage) -> Planes {
        let quantise = self.quantise;
        let values = image.map_values(|value| {
            let value = value.clamp(0.0, 1.0);
            // Ties go to even, as NumPy's rounding of the published evaluation has it.
            if quantise { (value * 255.0).round_ties_even() / 255.0 } else { value }
        });
        let border = self.border;
        Planes { values, border, height: image.height() - 2 * border, width: image.width() - 2 * border }
    }

    fn check(&self, a: &ToneMappedImage, b: &ToneMappedImage, least: usize) -> Result<()> {
        let size = |image: &ToneMappedImage| format!("{} × {}", image.height(), image.width());
        if (a.height(), a.width()) != (b.height(), b.width()) {
            return Err(Error::shape("size of the compared image", size(b), size(a)));
        }
        let least = least + 2 * self.border;
        if a.height().min(a.width()) < least {
            return Err(Error::shape("image to measure", format!("at least {least} × {least}"), size(a)));
        }
        Ok(())
    }
}

/// What a metric sees of an image: `height` × `width` values inside of the border.
struct Planes {
    values: ToneMappedImage,
    border: usize,
    height: usize,
    width: usize,
}

impl Planes {
    fn row(&self, channel: usize, y: usize) -> &[f32] {
        let row = channel * self.values.height() + self.border + y;
        let start = row * self.values.width() + self.border;
        &self.values.as_slice()[start..start + self.width]
    }
}

/// A metric that compares an image with its ground truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Metric {
    /// Peak signal-to-noise ratio in decibels.
    Psnr,
    /// Structural similarity.
    Ssim,
}

impl Metric {
    /// All metrics, in the order of tables.
    pub const ALL: [Self; 2] = [Self::Psnr, Self::Ssim];

    /// The name in files and flags.
    pub fn name(self) -> &'static str {
        match self {
            Self::Psnr => "psnr",
            Self::Ssim => "ssim",
        }
    }

    /// The heading in tables, with the unit.
    pub fn heading(self) -> &'static str {
        match self {
            Self::Psnr => "PSNR (dB)",
            Self::Ssim => "SSIM",
        }
    }

    /// Decimals that tables show.
    pub fn decimals(self) -> usize {
        match self {
            Self::Psnr => 2,
            Self::Ssim => 4,
        }
    }

    /// Compares `image` with `ground_truth`.
    ///
    /// # Errors
    /// [`Error::Shape`] when the images differ in size or are too small.
    pub fn measure(
        self,
        image: &ToneMappedImage,
        ground_truth: &ToneMappedImage,
        definition: &MetricDefinition,
    ) -> Result<f64> {
        match self {
            Self::Psnr => psnr(image, ground_truth, definition),
            Self::Ssim => ssim(image, ground_truth, definition),
        }
    }
}
