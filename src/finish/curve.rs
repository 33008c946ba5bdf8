//! Turns linear light into display values.

use serde::Serialize;

use super::exposure::MIDDLE_GREY;
use crate::core::color::srgb_encode;

/// A transfer curve, from light in `[0, ∞)` to display values in `[0, 1]`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Curve {
    /// `(min(x, max) / max)^(1/gamma)`.
    Gamma {
        /// The exponent's inverse.
        gamma: f32,
        /// The light that is shown as white.
        max: f32,
    },
    /// The sRGB curve of `min(x / max, 1)`.
    Srgb {
        /// The light that is shown as white.
        max: f32,
    },
    /// A filmic curve with a soft shoulder, then the sRGB curve.
    ///
    /// # Equation
    /// `f(x) = x·(2.51·x + 0.03) / (x·(2.43·x + 0.59) + 0.14)` of `x = light / max`, the rational fit to the ACES reference
    /// transform by Narkowicz (2015).
    Aces {
        /// The light that is mapped to f(1) ≈ 0.8.
        max: f32,
    },
    /// Middle grey where it is told, white where it is told, a shoulder in between; then the sRGB curve.
    ///
    /// # Equation
    /// `f(x) = x·(1 + x/w²)/(1 + x)` of `x = s·light/grey`, `w = s·white/grey` (Reinhard et al., "Photographic tone
    /// reproduction for digital images", 2002, Eq. 4), with s such that f of grey is 0.18: `s = (0.18 − (grey/white)²)/0.82`.
    /// Where grey is 0.18·white, f is linear.
    Photographic {
        /// The light that is shown as middle grey, at most 0.18 of white.
        grey: f32,
        /// The light that is shown as white.
        white: f32,
    },
    /// Light as it is, clipped to `[0, 1]`.
    None,
}

impl Default for Curve {
    /// As the published pictures are shown.
    fn default() -> Self {
        Self::Gamma { gamma: 2.8, max: 6.0 }
    }
}

impl Curve {
    /// Maps one value.
    pub fn apply(self, light: f32) -> f32 {
        let light = light.max(0.0);
        match self {
            Self::Gamma { gamma, max } => (light.min(max) / max).powf(1.0 / gamma),
            Self::Srgb { max } => encoded(light / max),
            Self::Aces { max } => {
                // Beyond this the fit is flat, and its squares would overflow.
                let x = (light / max).min(1e6);
                encoded(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14))
            }
            Self::Photographic { grey, white } => photographic(light, grey, white),
            Self::None => light.min(1.0),
        }
    }
}

fn photographic(light: f32, grey: f32, white: f32) -> f32 {
    if light >= white {
        return 1.0;
    }
    let [light, grey, white] = [light, grey, white].map(f64::from);
    let scale = (MIDDLE_GREY - (grey / white).powi(2)) / (1.0 - MIDDLE_GREY);
    let (x, w) = (scale * light / grey, scale * white / grey);
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    let shown = srgb_encode(x * (1.0 + x / (w * w)) / (1.0 + x)) as f32;
    shown
}

#[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
fn encoded(light: f32) -> f32 {
    srgb_encode(f64::from(light)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const CURVES: [Curve; 6] = [
        Curve::Gamma { gamma: 2.8, max: 6.0 },
        Curve::Srgb { max: 1.0 },
        Curve::Aces { max: 1.0 },
        Curve::Photographic { grey: 0.18, white: 1.0 },
        Curve::Photographic { grey: 0.1, white: 9.0 },
        Curve::None,
    ];

    #[test]
    fn curves_rise_from_black_to_white() {
        for curve in CURVES {
            assert!(curve.apply(-1.0) < 1e-6 && (curve.apply(1e30) - 1.0).abs() < 1e-6, "{curve:?}");
            let values: Vec<f32> = (0..400).map(|i| curve.apply(i as f32 / 40.0)).collect();
            assert!(values.windows(2).all(|pair| pair[0] <= pair[1]), "{curve:?}");
        }
    }

    #[test]
    fn grey_is_shown_as_middle_grey_and_white_as_white() {
        for (grey, white) in [(0.18, 1.0), (0.02, 1.0), (0.3, 400.0)] {
            let curve = Curve::Photographic { grey, white };
            let middle = srgb_encode(0.18) as f32;
            assert!((curve.apply(grey) - middle).abs() < 1e-6, "{grey} {white}: {}", curve.apply(grey));
            assert!((curve.apply(white * 0.999_999) - 1.0).abs() < 1e-4 && curve.apply(white) == 1.0);
        }
        // Where grey is 0.18 of white, it is the sRGB curve.
        let linear = Curve::Photographic { grey: 0.36, white: 2.0 };
        for light in [0.01, 0.5, 1.7] {
            assert!((linear.apply(light) - Curve::Srgb { max: 2.0 }.apply(light)).abs() < 1e-6);
        }
    }

    #[test]
    fn gamma_shows_its_maximum_as_white() {
        let curve = Curve::Gamma { gamma: 2.0, max: 4.0 };
        assert!((curve.apply(1.0) - 0.5).abs() < 1e-6);
        assert_eq!(curve.apply(4.0), 1.0);
    }
}
