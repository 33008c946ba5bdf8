//! Finds by how much displays that are brighter than white may show highlights brighter.

use ndarray::{Array2, Array3, Axis, Zip};

use super::Curve;
use crate::core::error::{Error, Result};

/// Stops above white that are asked for at most: displays have four at most today.
const MOST_STOPS: f32 = 8.0;

/// The light of the picture below which nothing is brighter, and from which on highlights are as bright as they may be.
const RISE: [f64; 2] = [0.25, 0.75];

/// Checks what is asked for.
///
/// # Errors
/// [`Error::Config`] for stops that no display has, or a curve of which it is not known what it does to highlights.
pub(super) fn check(stops: f32, curve: Curve) -> Result<()> {
    if !(stops > 0.0 && stops <= MOST_STOPS) {
        let reason = format!("must be above 0 and at most {MOST_STOPS} stops, found {stops}");
        return Err(Error::config("hdr", reason));
    }
    match curve {
        Curve::Photographic { .. } | Curve::Srgb { .. } => Ok(()),
        Curve::Gamma { .. } | Curve::Aces { .. } | Curve::None => Err(Error::config(
            "hdr",
            "belongs to the automatic exposure or --curve srgb: leave out --reference and other curves",
        )),
    }
}

/// The stops by which each pixel may be shown brighter, `[height, width]`, of linear light `[3, height, width]` in the colours
/// of the display.
///
/// # Equation
/// Of the brightest channel m, the curve f to light of the display, and the light k·m that it has in the dark, where no shoulder
/// holds it back: `g = r·H·(1 − e^(−d/H))` with `d = max(0, log₂(k·m/f(m)))`, H stops at most, and r rising smoothly from 0
/// at f = ¼ to 1 at f = ¾. What the shoulder took from highlights is given back, mid-tones stay as they are.
pub(super) fn gains(light: &Array3<f32>, curve: Curve, stops: f32) -> Array2<f32> {
    let (_, height, width) = light.dim();
    let mut most = Array2::zeros((height, width));
    for plane in light.axis_iter(Axis(0)) {
        Zip::from(&mut most).and(&plane).par_for_each(|most: &mut f32, value| *most = most.max(*value));
    }
    most.par_mapv_inplace(|light| gain_of(light, curve, f64::from(stops)));
    most
}

fn gain_of(light: f32, curve: Curve, stops: f64) -> f32 {
    let shown = curve.shown_light(light);
    let share = ((shown - RISE[0]) / (RISE[1] - RISE[0])).clamp(0.0, 1.0);
    let rise = share * share * (3.0 - 2.0 * share);
    let taken = (curve.exposed(light) / shown.max(f64::MIN_POSITIVE)).log2().max(0.0);
    #[expect(clippy::cast_possible_truncation, reason = "a few stops")]
    let gain = (rise * stops * (1.0 - (-taken / stops).exp())) as f32;
    gain
}

#[cfg(test)]
mod tests {
    use super::*;

    const CURVE: Curve = Curve::Photographic { grey: 0.1, white: 4.0 };

    #[test]
    fn mid_tones_stay_and_lamps_are_as_bright_as_they_may_be() {
        assert_eq!(gain_of(0.1, CURVE, 3.0), 0.0, "middle grey");
        assert_eq!(gain_of(0.0, CURVE, 3.0), 0.0);
        let lamp = gain_of(4000.0, CURVE, 3.0);
        assert!((2.8..3.0).contains(&lamp), "{lamp}");
        // White of an sRGB curve is where it saturates; twice as bright is one stop more, but for what is kept of the limit.
        let srgb = Curve::Srgb { max: 1.0 };
        assert_eq!(gain_of(0.99, srgb, 3.0), 0.0);
        assert!((gain_of(2.0, srgb, 1e6) - 1.0).abs() < 1e-4);
    }

    /// Light is shown brighter the brighter it is, and no contour shows.
    #[test]
    fn brighter_light_is_never_shown_darker() {
        let shown_of = |light: f32| CURVE.shown_light(light) * f64::from(gain_of(light, CURVE, 3.0)).exp2();
        let mut before = shown_of(1e-3);
        for step in 1..4000 {
            let light = 1e-3 * 1.004_f32.powi(step);
            let shown = shown_of(light);
            assert!(shown >= before && shown < before * 1.02 + 1e-3, "{light}: {before} {shown}");
            before = shown;
        }
    }

    #[test]
    fn stops_that_no_display_has_and_curves_without_a_shoulder_are_refused() {
        assert!(check(3.0, CURVE).is_ok() && check(0.0, CURVE).is_err() && check(f32::NAN, CURVE).is_err());
        assert!(check(3.0, Curve::default()).unwrap_err().to_string().contains("--reference"));
    }
}
