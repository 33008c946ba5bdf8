//! Turns two tone-mapped images into numbers that say how far they are apart, each with its definition.

mod measure;
mod pool;
mod psnr;
mod ssim;

pub use measure::Measure;
pub use pool::Pool;
pub use psnr::{psnr, squared_error};
pub use ssim::{ssim, structural_index};

use ndarray::Array2;
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

    /// The image that is compared: clamped, rounded if so defined, without the border.
    ///
    /// # Errors
    /// [`Error::Shape`] when nothing is left of it.
    pub fn apply(&self, image: &ToneMappedImage) -> Result<ToneMappedImage> {
        self.check(image, image, 1)?;
        let Planes { values, border, height, width } = self.values_of(image);
        Ok(values.crop(border, border, height, width))
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

/// The pixels of an image that count, `[height, width]`.
pub type Mask = Array2<bool>;

/// Whether pixel (y, x) of the image counts; all do without a mask.
fn counts(mask: Option<&Mask>, y: usize, x: usize) -> bool {
    mask.is_none_or(|mask| mask[[y, x]])
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
    /// Distance of AlexNet's features; computed with weights that the user brings along.
    Lpips,
}

impl Metric {
    /// All metrics, in the order of tables.
    pub const ALL: [Self; 3] = [Self::Psnr, Self::Ssim, Self::Lpips];

    /// The metrics that are computed of a value a pixel, so that they can be taken over some of the pixels.
    pub const PIXELWISE: [Self; 2] = [Self::Psnr, Self::Ssim];

    /// The name in files and flags.
    pub fn name(self) -> &'static str {
        match self {
            Self::Psnr => "psnr",
            Self::Ssim => "ssim",
            Self::Lpips => "lpips",
        }
    }

    /// The heading in tables, with the unit.
    pub fn heading(self) -> &'static str {
        match self {
            Self::Psnr => "PSNR (dB)",
            Self::Ssim => "SSIM",
            Self::Lpips => "LPIPS",
        }
    }

    /// Decimals that tables show.
    pub fn decimals(self) -> usize {
        match self {
            Self::Psnr => 2,
            Self::Ssim | Self::Lpips => 4,
        }
    }

    /// Whether a value is better than another.
    pub fn is_better(self, value: f64, than: f64) -> bool {
        match self {
            Self::Psnr | Self::Ssim => value > than,
            Self::Lpips => value < than,
        }
    }

    /// What is averaged over pixels to get the metric: squared errors for PSNR, the index for SSIM; over the
    /// pixels of a mask (of the image's sides), or all.
    ///
    /// # Errors
    /// [`Error::Shape`] when the images differ in size or are too small; [`Error::Unsupported`] for a metric that
    /// is not [`PIXELWISE`](Self::PIXELWISE).
    pub fn pool(
        self,
        image: &ToneMappedImage,
        ground_truth: &ToneMappedImage,
        definition: &MetricDefinition,
        mask: Option<&Mask>,
    ) -> Result<Pool> {
        match self {
            Self::Psnr => squared_error(image, ground_truth, definition, mask),
            Self::Ssim => structural_index(image, ground_truth, definition, mask),
            Self::Lpips => {
                let reason = "LPIPS is no mean over pixels; it is measured of whole images, with its weights";
                Err(Error::Unsupported(reason.to_owned()))
            }
        }
    }

    /// The metric of a mean over pixels.
    pub fn of_mean(self, mean: f64) -> f64 {
        match self {
            Self::Psnr => psnr::decibels(mean),
            Self::Ssim | Self::Lpips => mean,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn image(value: impl Fn(usize, usize, usize) -> f32) -> ToneMappedImage {
        ToneMappedImage::from_planes(Array3::from_shape_fn((3, 24, 30), |(c, y, x)| value(c, y, x))).unwrap()
    }

    /// Two masks that share no pixel and leave none out add up to the whole image, for every metric.
    #[test]
    fn parts_of_an_image_pool_to_the_whole() {
        let a = image(|c, y, x| ((c + y * 7 + x * 3) % 11) as f32 / 11.0);
        let b = image(|c, y, x| ((c + y * 5 + x * 2) % 13) as f32 / 13.0);
        let definition = MetricDefinition { border: 1, ..MetricDefinition::float() };
        let left = Mask::from_shape_fn((24, 30), |(y, x)| x < 11 + y % 3);
        let right = left.mapv(|is_left| !is_left);
        for metric in Metric::PIXELWISE {
            let pool = |mask| metric.pool(&a, &b, &definition, mask).unwrap();
            let (whole, mut parts) = (pool(None), pool(Some(&left)));
            assert!(parts.count > 0 && parts.count < whole.count);
            parts += pool(Some(&right));
            assert_eq!(parts.count, whole.count);
            assert!((parts.sum - whole.sum).abs() < 1e-9 * whole.sum.abs(), "{metric:?}");
            let value = Measure::of(metric).compare(&a, &b, &definition).unwrap();
            assert!((metric.of_mean(parts.mean().unwrap()) - value).abs() < 1e-9, "{metric:?}");
        }
    }

    /// The error lies under the mask alone, in one column of 30: the rest is equal.
    #[test]
    fn a_mask_sees_its_own_pixels_only() {
        let (a, b) = (image(|_, _, x| if x == 4 { 0.6 } else { 0.5 }), image(|_, _, _| 0.5));
        let definition = MetricDefinition::float();
        let column = Mask::from_shape_fn((24, 30), |(_, x)| x == 4);
        let psnr = |mask: &Mask| {
            let pool = Metric::Psnr.pool(&a, &b, &definition, Some(mask)).unwrap();
            pool.mean().map(|mean| Metric::Psnr.of_mean(mean))
        };
        assert!((psnr(&column).unwrap() - 20.0).abs() < 1e-4);
        assert_eq!(psnr(&column.mapv(|is_there| !is_there)), Some(f64::INFINITY));
        assert_eq!(psnr(&Mask::from_elem((24, 30), false)), None);
    }
}
