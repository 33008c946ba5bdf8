//! Turns linear irradiance into tone-mapped values and back, as the paper's Eq. 1 does.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::error::{Error, Result};
use super::image::{LinearImage, ToneMappedImage};

/// The clipping and tone mapping φ∘C of the image formation model.
///
/// # Equation
/// `C(x) = min(max(x, 0), x_max)` and `φ(x) = x / (x + α)` (paper, Eq. 1); the inverse is
/// `x = α·y / (1 − y)` with y clamped to `[0, φ(x_max)]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ToneCurve {
    /// α: the irradiance that φ maps to one half.
    pub alpha: f32,
    /// x_max: the sensor's saturation in units of irradiance.
    pub x_max: f32,
}

impl Default for ToneCurve {
    /// α = 0.25 and x_max = 500, as published.
    fn default() -> Self {
        Self { alpha: 0.25, x_max: 500.0 }
    }
}

impl ToneCurve {
    /// Makes a curve of two positive numbers.
    ///
    /// # Errors
    /// [`Error::Config`] when one of them is not positive and finite.
    pub fn new(alpha: f32, x_max: f32) -> Result<Self> {
        for (key, value) in [("alpha", alpha), ("x-max", x_max)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::config(key, format!("must be a positive number, found {value}")));
            }
        }
        Ok(Self { alpha, x_max })
    }

    /// C: limits a value to what the sensor can record.
    #[inline]
    pub fn clip(&self, x: f32) -> f32 {
        x.clamp(0.0, self.x_max)
    }

    /// φ∘C of one value.
    #[inline]
    pub fn compress(&self, x: f32) -> f32 {
        let x = self.clip(x);
        x / (x + self.alpha)
    }

    /// The inverse of [`compress`](Self::compress) on `[0, φ(x_max)]`.
    #[inline]
    pub fn expand(&self, y: f32) -> f32 {
        let y = y.clamp(0.0, self.compress(self.x_max));
        (self.alpha * y / (1.0 - y)).min(self.x_max)
    }

    /// Limits an image to what the sensor can record.
    pub fn clip_image(&self, image: &LinearImage) -> LinearImage {
        image.map_values(|x| self.clip(x))
    }

    /// Maps linear irradiance to the tone-mapped domain.
    pub fn tone_map(&self, image: &LinearImage) -> ToneMappedImage {
        image.map_values(|x| self.compress(x))
    }

    /// As [`tone_map`](Self::tone_map), in the memory of the image.
    pub fn tone_map_in_place(&self, image: LinearImage) -> ToneMappedImage {
        image.map_in_place(|x| self.compress(x))
    }

    /// Maps tone-mapped values back to linear irradiance.
    pub fn inverse_tone_map(&self, image: &ToneMappedImage) -> LinearImage {
        image.map_values(|y| self.expand(y))
    }

    /// As [`inverse_tone_map`](Self::inverse_tone_map), in the memory of the image.
    pub fn inverse_tone_map_in_place(&self, image: ToneMappedImage) -> LinearImage {
        image.map_in_place(|y| self.expand(y))
    }
}

/// What the user says of a curve, which stands above what files say.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ToneFlags {
    /// `--alpha`.
    pub alpha: Option<f32>,
    /// `--x-max`.
    pub x_max: Option<f32>,
}

impl ToneFlags {
    /// The curve with what the user says of it.
    ///
    /// # Errors
    /// As [`ToneCurve::new`].
    pub fn over(self, curve: ToneCurve) -> Result<ToneCurve> {
        ToneCurve::new(self.alpha.unwrap_or(curve.alpha), self.x_max.unwrap_or(curve.x_max))
    }

    /// What to tell where a tone-mapped file says another curve than the user: another α, or light that ends below x_max.
    #[expect(clippy::float_cmp, reason = "the file says it to the bit")]
    pub fn contradiction(self, path: &Path, of_file: ToneCurve) -> Option<String> {
        let ToneCurve { alpha, x_max } = of_file;
        let told = [
            self.alpha.filter(|told| *told != alpha).map(|told| format!("--alpha {told}")),
            self.x_max.filter(|told| *told > x_max).map(|told| format!("--x-max {told}")),
        ];
        let told: Vec<String> = told.into_iter().flatten().collect();
        (!told.is_empty()).then(|| {
            format!(
                "{} says that it is tone-mapped with alpha {alpha} and x-max {x_max}, and is mapped back with {}: leave that out to \
                 believe the file",
                path.display(),
                told.join(" and ")
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_alpha_to_one_half_and_clips_at_saturation() {
        let curve = ToneCurve::default();
        assert!((curve.compress(0.25) - 0.5).abs() < 1e-7);
        assert_eq!(curve.compress(500.0), curve.compress(1e9));
        assert_eq!(curve.compress(-3.0), 0.0);
    }

    /// φ′(x) = α/(x+α)², so that one f32 rounding of y near 1 returns as (x+α)²/α · 2⁻²⁴.
    #[test]
    fn round_trips_within_the_rounding_of_f32() {
        let curve = ToneCurve::default();
        for exponent in -20..=8 {
            let x = 2f32.powi(exponent) * 1.37;
            let bound = 3.0 * (x + 0.25).powi(2) / 0.25 * f32::EPSILON / 2.0 + 1e-7 * x;
            assert!((curve.expand(curve.compress(x)) - x).abs() <= bound, "x = {x}");
        }
    }

    #[test]
    fn what_the_user_says_stands_above_a_file_and_is_named_where_it_differs() {
        let (path, of_file) = (Path::new("a.exr"), ToneCurve { alpha: 0.1, x_max: 16.0 });
        let flags = |alpha, x_max| ToneFlags { alpha, x_max };
        assert_eq!(flags(None, None).over(of_file).unwrap(), of_file);
        assert_eq!(flags(Some(0.2), None).over(of_file).unwrap(), ToneCurve { alpha: 0.2, x_max: 16.0 });
        assert!(flags(None, Some(-1.0)).over(of_file).is_err());
        // Less than the file holds only cuts its light.
        for agreeing in [flags(None, None), flags(Some(0.1), Some(16.0)), flags(None, Some(4.0))] {
            assert_eq!(agreeing.contradiction(path, of_file), None);
        }
        let said = flags(Some(0.2), Some(500.0)).contradiction(path, of_file).unwrap();
        assert!(said.starts_with("a.exr says") && said.contains("--alpha 0.2 and --x-max 500"), "{said}");
    }

    #[test]
    fn refuses_a_curve_that_divides_by_zero() {
        assert!(ToneCurve::new(0.0, 500.0).is_err());
        assert!(ToneCurve::new(0.25, f32::NAN).is_err());
    }
}
