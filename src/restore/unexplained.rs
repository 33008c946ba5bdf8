//! Tells captures that their PSF does not explain.

use std::cmp::Ordering;
use std::fmt;

use ndarray::Zip;
use serde::Serialize;

use super::deconvolution::Solution;
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::saturation::saturated_from;

/// Standard deviations of its noise by which a pixel contradicts the scene.
const DEVIATIONS: f32 = 4.5;

/// The relative noise of captures that are asked: below, it is rounding or grain of a scene, which a sun's light outshines; above, so few
/// photons are counted that their noise is nothing like a bell, and half of a scene is black.
const ASKED: std::ops::Range<f32> = 3e-3..0.5;

/// Light of a scene, over α, up to which it is black.
const BLACK: f32 = 1e-5;

/// The shares of pixels that contradict the scene, and that are black, from which on both tell a wrong PSF, in two of three colours. Of 192
/// captures of panels whose PSFs are exact four have so many, with large lights around the frame; of 97 by another simulator one has, a
/// sun. By PSFs whose core is clipped, or that are encoded for a screen, nineteen of twenty have more; by those that are mirrored, turned
/// by 5° or 90°, or have their colours exchanged, six of forty, with lamps in view.
const CONTRADICTING: f64 = 0.025;
const MUCH_BLACK: f64 = 0.02;

/// Pixels of a capture, counted by how its scene explains them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Unexplained {
    /// Pixels of each channel that are not saturated.
    known: [usize; CHANNELS],
    /// Those that contradict the scene.
    contradicting: [usize; CHANNELS],
    /// Those whose scene is black.
    black: [usize; CHANNELS],
}

impl Unexplained {
    /// Of a capture with noise, and the scene that was solved for; none of one without.
    pub(super) fn of(
        image: &LinearImage,
        solution: &Solution,
        (saturation, alpha): ([f32; CHANNELS], f32),
    ) -> Self {
        let mut counts = Self::default();
        let middle = middle(solution.relative_noise);
        if solution.is_clean() || !ASKED.contains(&middle) {
            return counts;
        }
        for (channel, left) in solution.residual.outer_iter().enumerate() {
            let from = saturated_from(saturation[channel]);
            let most = DEVIATIONS * solution.relative_noise[channel];
            let pixels = Zip::from(left).and(image.channel(channel)).and(solution.scene.channel(channel));
            let [known, contradicting, black] = pixels.par_fold(
                || [0; 3],
                |[known, contradicting, black], left, captured, scene| {
                    let is_known = *captured < from;
                    let contradicts = is_known && left.abs() > most;
                    let is_black = is_known && *scene <= BLACK * alpha;
                    [
                        known + usize::from(is_known),
                        contradicting + usize::from(contradicts),
                        black + usize::from(is_black),
                    ]
                },
                |a, b| std::array::from_fn(|i| a[i] + b[i]),
            );
            (counts.known[channel], counts.contradicting[channel], counts.black[channel]) =
                (known, contradicting, black);
        }
        counts
    }

    /// With those of another part of the capture.
    pub(super) fn and(self, other: Self) -> Self {
        let sum = |of: fn(&Self) -> [usize; CHANNELS]| {
            std::array::from_fn(|channel| of(&self)[channel] + of(&other)[channel])
        };
        Self {
            known: sum(|counts| counts.known),
            contradicting: sum(|counts| counts.contradicting),
            black: sum(|counts| counts.black),
        }
    }

    /// What is to be told of it, if it is much.
    pub(super) fn contradiction(&self) -> Option<Contradiction> {
        let share = |counts: [usize; CHANNELS]| {
            let share = |channel: usize| counts[channel] as f64 / self.known[channel].max(1) as f64;
            middle(std::array::from_fn(share))
        };
        let found = Contradiction { contradicting: share(self.contradicting), black: share(self.black) };
        (found.contradicting >= CONTRADICTING && found.black >= MUCH_BLACK).then_some(found)
    }
}

/// The middle one of three numbers.
fn middle<T: PartialOrd + Copy>(mut of: [T; CHANNELS]) -> T {
    of.sort_by(|a, b| a.partial_cmp(b).unwrap_or(Ordering::Equal));
    of[CHANNELS / 2]
}

/// How a PSF contradicts a capture: the shares of its pixels, of the middle one of the colours.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Contradiction {
    /// Pixels that differ from what the restored scene would have made them by much more than noise.
    pub contradicting: f64,
    /// Pixels of which the restored scene is black.
    pub black: f64,
}

impl fmt::Display for Contradiction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the PSF explains it badly: {:.1} % of its pixels contradict the restored scene, and {:.0} % of that is black; the PSF may be \
             of another panel, mirrored, turned, clipped in its core or encoded for a screen, unless large lights surround the frame",
            100.0 * self.contradicting,
            100.0 * self.black
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_psf_is_doubted_by_two_colours_that_contradict_it_and_are_black() {
        let of = |contradicting: [usize; 3], black: [usize; 3]| {
            Unexplained { known: [500; 3], contradicting, black }
                .and(Unexplained { known: [500; 3], ..Unexplained::default() })
                .contradiction()
        };
        let found = of([100, 30, 0], [30, 0, 100]).unwrap();
        assert_eq!(found, Contradiction { contradicting: 0.03, black: 0.03 });
        assert!(
            found.to_string().contains("3.0 % of its pixels contradict the restored scene, and 3 %"),
            "{found}"
        );
        assert_eq!(of([100, 5, 0], [30, 0, 100]), None, "one colour contradicts");
        assert_eq!(of([100, 30, 0], [30, 0, 0]), None, "hardly any is black");
        assert_eq!(Unexplained::default().contradiction(), None);
    }
}
