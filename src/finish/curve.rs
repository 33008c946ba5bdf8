//! Turns linear light into display values.

use serde::Serialize;

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
            Self::None => light.min(1.0),
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
fn encoded(light: f32) -> f32 {
    srgb_encode(f64::from(light)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const CURVES: [Curve; 4] = [
        Curve::Gamma { gamma: 2.8, max: 6.0 },
        Curve::Srgb { max: 1.0 },
        Curve::Aces { max: 1.0 },
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
    fn gamma_shows_its_maximum_as_white() {
        let curve = Curve::Gamma { gamma: 2.0, max: 4.0 };
        assert!((curve.apply(1.0) - 0.5).abs() < 1e-6);
        assert_eq!(curve.apply(4.0), 1.0);
    }
}
