//! Applies a curve to coloured light: to each channel by itself, or so that the hue stays and highlights become white.

use serde::Serialize;

use super::Curve;
use crate::core::color::srgb_encode;

/// How a curve is applied to red, green and blue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RollOff {
    /// To each channel by itself, as the published pictures have it: in highlights the hue turns towards yellow, cyan or
    /// magenta, as one channel after the other becomes full.
    #[default]
    Channels,
    /// So that the hue stays, and the saturation too but near the limit of the display, where colours become white.
    ///
    /// # Equation
    /// Of linear light with `a ≥ b ≥ c` in any order of the channels and the curve f to linear light of the display:
    /// 1. `a' = f(a)`;
    /// 2. `c' = (1 − t)·a'·c/a + t·f(c)`, t rising smoothly from 0 at `a' = ½` to 1 at `a' = 1`: below, the ratios of the
    ///    channels are those of the scene; at the limit, the darkest channel has the curve as a grey of its light has;
    /// 3. `b' = c' + (a' − c')·(b − c)/(a − c)`, so that the hue of HSV stays exactly: steps 1 and 3 and `f(c)` are the tone
    ///    curve of the DNG SDK (`RefBaselineRGBTone`);
    /// 4. what is brighter than white w is mixed with white by the share `1 − 1/(1 + 0.02·(a/w − 1))`, the form of the Khronos
    ///    PBR Neutral tone mapper (2024): light of one pure colour becomes white too, and only beyond what the display can
    ///    show. With the 0.15 of that, signal lamps of several times white are pink.
    ///
    /// At last comes the curve of sRGB.
    Hue,
}

/// The light of the display from which on colours give way to white.
const NEAR_LIMIT: f64 = 0.5;

/// How fast light beyond white becomes white.
const DESATURATION: f64 = 0.02;

impl RollOff {
    /// The display values of a pixel's light.
    pub(super) fn apply(self, curve: Curve, pixel: [f32; 3]) -> [f32; 3] {
        match self {
            Self::Channels => pixel.map(|light| curve.apply(light)),
            Self::Hue => keep_hue(curve, pixel),
        }
    }
}

fn keep_hue(curve: Curve, pixel: [f32; 3]) -> [f32; 3] {
    let pixel = pixel.map(|light| light.max(0.0));
    let most = pixel.into_iter().fold(0.0, f32::max);
    let least = pixel.into_iter().fold(f32::INFINITY, f32::min);
    let [high, rolled] = [most, least].map(|light| curve.shown_light(light));
    let rise = ((high - NEAR_LIMIT) / (1.0 - NEAR_LIMIT)).clamp(0.0, 1.0);
    let near = rise * rise * (3.0 - 2.0 * rise);
    let kept = if most > 0.0 { high * f64::from(least) / f64::from(most) } else { high };
    let low = kept + (rolled - kept) * near;
    let beyond = (f64::from(most) / f64::from(curve.white()) - 1.0).max(0.0);
    let white = 1.0 - 1.0 / (1.0 + DESATURATION * beyond);
    pixel.map(|light| {
        let share = if most > least { f64::from((light - least) / (most - least)) } else { 1.0 };
        let shown = low + (high - low) * share;
        #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
        let value = srgb_encode(shown + (1.0 - shown) * white) as f32;
        value
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::color::srgb_decode;

    const CURVES: [Curve; 4] = [
        Curve::Photographic { grey: 0.1, white: 4.0 },
        Curve::Srgb { max: 1.0 },
        Curve::Gamma { gamma: 2.8, max: 6.0 },
        Curve::Aces { max: 1.0 },
    ];

    /// The hue of HSV, in sixths of the circle.
    fn hue([r, g, b]: [f64; 3]) -> f64 {
        let (most, least) = (r.max(g).max(b), r.min(g).min(b));
        let part = |x: f64, y: f64| (x - y) / (most - least);
        if r >= most {
            part(g, b).rem_euclid(6.0)
        } else if g >= most {
            2.0 + part(b, r)
        } else {
            4.0 + part(r, g)
        }
    }

    #[test]
    fn the_hue_stays_up_to_white_where_single_channels_turn_it() {
        let lamp = [1.0, 0.45, 0.08];
        for curve in CURVES {
            for step in 1..60 {
                let light = lamp.map(|c: f32| c * 0.1 * step as f32);
                let shown = |how: RollOff| how.apply(curve, light).map(|v| srgb_decode(f64::from(v)));
                let kept = shown(RollOff::Hue);
                let spread = kept[0] - kept[2];
                // Values are rounded to 32 bits.
                let error = (hue(kept) - hue(lamp.map(f64::from))).abs();
                assert!(spread < 1e-4 || error * spread < 1e-5, "{curve:?} {step}: {kept:?} off by {error}");
            }
            let bright = lamp.map(|c| 3.0 * curve.white() * c);
            let [r, g, _] = RollOff::Channels.apply(curve, bright);
            assert!(r == 1.0 && g > 0.99, "{curve:?} by channels an orange lamp is yellow: {g}");
            let [r, g, _] = RollOff::Hue.apply(curve, lamp.map(|c| 0.9 * curve.white() * c));
            assert!(g < 0.9 * r, "{curve:?} {r} {g}");
        }
    }

    #[test]
    fn grey_is_shown_alike_either_way() {
        for curve in CURVES {
            for light in [0.0, 1e-5, 0.1, 0.9, 3.0, 100.0] {
                let [by_channel, by_hue] =
                    [RollOff::Channels, RollOff::Hue].map(|how| how.apply(curve, [light; 3]));
                assert!(by_hue[0] == by_hue[1] && by_hue[1] == by_hue[2]);
                assert!(
                    (by_channel[0] - by_hue[0]).abs() < 1e-5,
                    "{curve:?} {light}: {by_channel:?} {by_hue:?}"
                );
            }
        }
    }

    /// From dark to a thousand times white: no channel falls, none jumps, and the end is white.
    #[test]
    fn every_colour_rises_smoothly_to_white() {
        let curve = Curve::Photographic { grey: 0.1, white: 4.0 };
        for color in [[1.0, 0.0, 0.0], [0.0, 0.2, 1.0], [1.0, 0.9, 0.3], [0.4, 0.4, 0.4], [1.0, -0.2, 0.1]] {
            let shown_of = |light: f32| RollOff::Hue.apply(curve, color.map(|c| c * light));
            let mut before = shown_of(1e-3);
            for step in 1..3000 {
                let light = 1e-3 * 1.0047_f32.powi(step);
                let shown = shown_of(light);
                for (shown, before) in shown.into_iter().zip(before) {
                    assert!((-1e-6..0.01).contains(&(shown - before)), "{color:?} {light}: {before} {shown}");
                }
                before = shown;
            }
            assert!(before.iter().all(|v| *v > 0.9), "{color:?} ends as {before:?}");
        }
        let dark = [0.02, 0.05, 0.03].map(|c: f32| 0.5 * c);
        let shown = RollOff::Hue.apply(curve, dark).map(|v| srgb_decode(f64::from(v)));
        for channel in [0, 2] {
            let ratio = f64::from(dark[channel] / dark[1]);
            assert!((shown[channel] / shown[1] / ratio - 1.0).abs() < 1e-4, "ratios stay: {shown:?}");
        }
        let red = RollOff::Hue.apply(curve, [4.0, 0.0, 0.0]);
        assert!(red[1] < 1e-6 && red[0] > 0.999, "at white a pure colour is still pure: {red:?}");
    }
}
