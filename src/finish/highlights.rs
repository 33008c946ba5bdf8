//! Gives clipped light the colour that it most likely had, so that clipped lamps are white.

use crate::core::saturation::saturated_from;

/// The share of the white level from which on a channel is doubted more and more, until at the saturated share nothing of
/// it is believed: wide enough that no contour shows where light comes near the level.
const DOUBTED_SHARE: f32 = 0.9;

/// Rounds of the fixed point: each brings it nearer by a factor of four.
const ROUNDS: usize = 12;

/// Replaces what is clipped of a pixel by what the other channels let expect.
///
/// # Equation
/// A clipped channel c is at least as bright as what is recorded of it and as its white level, `l = max(v, s)`, and is
/// taken to be no darker than the mean of the other two, as the channels of white-balanced lamps are (their green lies
/// between red and blue): the smallest x with `x_c = (1 − w_c)·v_c + w_c·max(l_c, (x_a + x_b)/2)`. w rises smoothly from 0
/// at 0.9 of the white level to 1 at the saturated share. A pixel of which everything is clipped becomes neutral at the
/// highest level; a red lamp keeps its colour, since the mean of its green and blue lies below red's own level.
///
/// Estimating clipped channels from the others is the field's usual highlight reconstruction: dcraw's and LibRaw's
/// "blend", darktable's "inpaint opposed", whose estimate is a mean of the opposed channels too.
pub(super) fn unclipped(pixel: [f32; 3], white: [f32; 3]) -> [f32; 3] {
    let doubt = [0, 1, 2].map(|c| {
        let (from, to) = (white[c] * DOUBTED_SHARE, saturated_from(white[c]));
        let rise = ((pixel[c] - from) / (to - from)).clamp(0.0, 1.0);
        rise * rise * (3.0 - 2.0 * rise)
    });
    if doubt.iter().all(|doubt| *doubt <= 0.0) {
        return pixel;
    }
    let least = [0, 1, 2].map(|c| pixel[c].max(white[c]));
    let mut light = pixel;
    for _ in 0..ROUNDS {
        for c in 0..3 {
            let others = 0.5 * (light[(c + 1) % 3] + light[(c + 2) % 3]);
            light[c] = (1.0 - doubt[c]) * pixel[c] + doubt[c] * least[c].max(others);
        }
    }
    light
}

/// Whether a channel of a pixel is clipped.
pub(super) fn is_clipped(pixel: [f32; 3], white: [f32; 3]) -> bool {
    pixel.iter().zip(white).any(|(value, white)| *value >= saturated_from(white))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// White levels after a white balance of daylight.
    const WHITE: [f32; 3] = [1.9, 1.0, 1.6];

    fn captured(light: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|c| light[c].min(WHITE[c]))
    }

    fn spread(pixel: [f32; 3]) -> f32 {
        pixel.iter().fold(0.0f32, |m, v| m.max(*v)) - pixel.iter().fold(f32::MAX, |m, v| m.min(*v))
    }

    #[test]
    fn clipped_neutral_light_is_neutral() {
        for light in [1.0, 1.3, 1.59, 1.7, 1.9, 2.0, 50.0] {
            let found = unclipped(captured([light; 3]), WHITE);
            // The last percent of a level is not told from the level.
            let tolerance = 0.01 * light.min(1.9) + 1e-4;
            assert!(spread(found) < tolerance, "{light}: {found:?}");
            assert!((found[0] - light.min(1.9)).abs() < tolerance, "{light}: {found:?}");
        }
    }

    #[test]
    fn a_red_lamp_stays_red_and_unclipped_light_stays_as_it_is() {
        let red = unclipped(captured([5.0, 0.5, 0.1]), WHITE);
        assert_eq!(red, [1.9, 0.5, 0.1]);
        for pixel in [[0.3, 0.5, 0.1], [1.7, 0.89, 1.43], [-0.1, 0.0, 0.2]] {
            assert_eq!(unclipped(pixel, WHITE), pixel);
        }
    }

    /// A lamp of 3000 K seen by a camera balanced for daylight is orange, not pink, where only blue is still recorded.
    #[test]
    fn a_warm_lamp_turns_neither_pink_nor_green() {
        let [red, green, blue] = unclipped(captured([3.0, 2.0, 1.2]), WHITE);
        assert!(red > green && green > blue, "{red} {green} {blue}");
        assert!((green - 0.5 * (red + blue)).abs() < 1e-4);
    }

    /// From dark to beyond every level in steps of a thousandth, no channel jumps, nor does it fall.
    #[test]
    fn no_contour_shows_where_light_reaches_a_level() {
        for color in [[1.0; 3], [1.0, 0.8, 0.5], [0.6, 0.7, 1.0], [1.0, 0.1, 0.9]] {
            let mut before = [0.0; 3];
            for step in 0..4000 {
                let light = step as f32 / 1000.0;
                let found = unclipped(captured(color.map(|c| c * light)), WHITE);
                for (found, before) in found.into_iter().zip(before) {
                    // The rise of a doubted channel to the mean of the others, at most 1.5/0.09 as steep as light.
                    assert!((-1e-4..0.02).contains(&(found - before)), "{color:?} {light}: {before} {found}");
                }
                before = found;
            }
        }
    }

    /// Restored light may lie above the level that the capture was clipped at.
    #[test]
    fn restored_light_above_the_level_is_kept() {
        let found = unclipped([4.0, 2.5, 3.0], WHITE);
        assert!(found[0] == 4.0 && spread(found) < 1e-4, "{found:?}");
    }
}
