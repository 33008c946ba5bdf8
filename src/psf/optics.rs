//! Turns the distances of display, lens and sensor into the few numbers that the propagation needs.
//!
//! # Equation
//! The paper's Eq. 2 holds three quadratic phases that no grid could sample economically. They cancel
//! analytically. With the point source at z₁ before the display, the lens at d behind it and x a position in
//! the lens plane, completing the square gives for the field that arrives at the lens
//!
//! `U_L(x) = exp(iπx²/λ(z₁+d)) · V(x/M)`, `V = t ∗ exp(iπξ²/λd′)`, `M = (z₁+d)/z₁`, `d′ = d/M`:
//!
//! the display lit by a *plane* wave, propagated over the reduced gap d′, magnified by M, on a spherical wave
//! of the source. Lens, pupil P and the way to the sensor at z₂ turn it into
//!
//! `U_S(u) = 1/(λz₂) · ∫ P(x) · V(x/M) · exp(iπεx²/λ) · exp(∓2πi u·x/λz₂) dx`,
//! `ε = 1/(z₁+d) + 1/z₂ − 1/f`
//!
//! up to phases that |U_S|² does not see. In focus ε = 0: the PSF is the Fourier transform of the magnified,
//! propagated display field over the pupil. A layout of period p therefore has its orders at multiples of
//!
//! `λz₂/(M·p) = λz₂/p · z₁/(z₁+d)`,
//!
//! the factor z₁/(z₁+d) being the one that the finite distance of the source brings.
//!
//! The sign of the last exponent is that of the image *as a camera shows it*: light that the display bends
//! towards +x lands on the sensor's +x side, and cameras turn their picture by 180° because the lens inverts.
//! It appears at −x.

use crate::core::error::{Error, Result};

use super::display::OpticsConfig;

/// Source, display, lens and sensor on one axis; lengths in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Optics {
    /// D: the diameter of the pupil, in the lens plane.
    pub aperture_m: f64,
    /// z₂: from the lens to the sensor.
    pub sensor_distance_m: f64,
    /// M = (z₁+d)/z₁: how much larger the display's field is in the lens plane.
    pub magnification: f64,
    /// d′ = d/M: the gap over which a plane wave would diffract alike.
    pub reduced_gap_m: f64,
    /// ε: the vergence left over by focusing, in 1/m; zero in focus, negative for a sensor too far away.
    pub defocus_per_m: f64,
}

impl Optics {
    /// Resolves the distances; without an explicit sensor distance the sensor is in focus for the source.
    ///
    /// # Errors
    /// [`Error::Config`] when a length is out of range or the source cannot be focused.
    pub fn new(config: &OpticsConfig) -> Result<Self> {
        let source = config.source_distance_m;
        if source.is_nan() || source <= 0.0 {
            return Err(Error::config(
                "optics.source-distance-m",
                format!("must be positive (or inf), found {source}"),
            ));
        }
        let gap = length_m("optics.display-to-lens-mm", config.display_to_lens_mm, true)?;
        let focal = length_m("optics.focal-length-mm", config.focal_length_mm, false)?;
        let aperture_m = length_m("optics.aperture-mm", config.aperture_mm, false)?;
        let vergence = 1.0 / (source + gap);
        let sensor_distance_m = match config.sensor_distance_mm {
            Some(distance) => length_m("optics.sensor-distance-mm", distance, false)?,
            None if vergence < 1.0 / focal => 1.0 / (1.0 / focal - vergence),
            None => {
                return Err(Error::config(
                    "optics.focal-length-mm",
                    "no sensor distance focuses a source this close; move the source beyond the focal length or set \
                     optics.sensor-distance-mm",
                ));
            }
        };
        let magnification = 1.0 + gap / source;
        // In focus the difference would be rounding noise of the order of 1e-13 per metre.
        let defocus_per_m = match config.sensor_distance_mm {
            Some(_) => vergence + 1.0 / sensor_distance_m - 1.0 / focal,
            None => 0.0,
        };
        let reduced_gap_m = gap / magnification;
        Ok(Self { aperture_m, sensor_distance_m, magnification, reduced_gap_m, defocus_per_m })
    }
}

fn length_m(key: &str, length_mm: f64, zero_allowed: bool) -> Result<f64> {
    let in_range = length_mm.is_finite() && (length_mm > 0.0 || (zero_allowed && length_mm >= 0.0));
    if in_range {
        Ok(length_mm * 1e-3)
    } else {
        let kind = if zero_allowed { "zero or a positive length" } else { "a positive length" };
        Err(Error::config(key, format!("must be {kind} in millimetres, found {length_mm}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn focuses_the_source_by_the_lens_equation() {
        let optics = Optics::new(&OpticsConfig::default()).unwrap();
        let vergence = 1.0 / 1.001 + 1.0 / optics.sensor_distance_m - 1.0 / 3.8e-3;
        assert!(vergence.abs() < 1e-9);
        assert_eq!(optics.defocus_per_m, 0.0);
        assert!((optics.magnification - 1.001).abs() < 1e-12);
    }

    #[test]
    fn a_star_is_not_magnified_and_focuses_at_the_focal_length() {
        let config = OpticsConfig { source_distance_m: f64::INFINITY, ..OpticsConfig::default() };
        let optics = Optics::new(&config).unwrap();
        assert_eq!((optics.magnification, optics.reduced_gap_m), (1.0, 1e-3));
        assert!((optics.sensor_distance_m - 3.8e-3).abs() < 1e-15);
    }

    #[test]
    fn refuses_a_source_inside_the_focal_length_and_a_negative_gap() {
        let close = OpticsConfig { source_distance_m: 0.002, ..OpticsConfig::default() };
        assert!(Optics::new(&close).unwrap_err().to_string().contains("sensor-distance-mm"));
        let negative = OpticsConfig { display_to_lens_mm: -1.0, ..OpticsConfig::default() };
        assert!(Optics::new(&negative).unwrap_err().to_string().contains("display-to-lens-mm"));
    }
}
