//! What may be a lamp beyond the border: light that explains much of a colour.

use ndarray::{Array2, ArrayView2};

use super::super::fit::{Fit, Places};
use super::super::frame::Blur;
use super::brightest;
use crate::core::error::Result;
use crate::core::progress::Progress;

/// Steps in which light spreads over the surroundings, and the rounds in which it gathers with the steps of each.
const FIRST_STEPS: usize = 6;
pub(super) const ROUNDS: usize = 3;
pub(super) const STEPS: usize = 8;

/// The part of the misfit of a colour that spread light leaves at most where it is worth to go on.
const PROMISING: f64 = 0.85;

/// Pixels that light which explains much of a colour has at most: suns have 4 to 30.
pub(super) const MOST_PX: usize = 100;

/// The same of a single colour that sees more than the lamp of the others, and the part of its misfit that is left at most. What is no
/// lamp has so many pixels in all colours; believed, it would cost three of 350 captures 5 to 9 dB.
const MOST_PX_OF_ONE: usize = 400;
const LEFT_OF_ONE: f64 = 0.7;

/// The part of the most visible pixel's flare that others need to be kept.
const VISIBLE: f32 = 0.2;

/// Pixels of a frame for each of a lamp beyond it, at least. Of a frame of 5 × 3 pixels a lamp explains all, and leaves darkness.
pub(super) const FRAME_PX: usize = 10;

/// A channel of a capture.
pub(super) struct Known<'a> {
    pub(super) capture: ArrayView2<'a, f32>,
    pub(super) saturated: &'a Array2<bool>,
    pub(super) blur: Blur<'a>,
    /// A with the squares of the PSF.
    pub(super) squared: Blur<'a>,
    pub(super) brightness: Array2<f32>,
    /// The misfit of darkness.
    pub(super) before: f64,
}

impl Known<'_> {
    pub(super) fn fit<'s>(&'s self, places: Places<'s>) -> Fit<'s> {
        Fit::new(&self.blur, (self.capture, self.saturated, self.brightness.view()), places)
    }

    /// The light of the surroundings that explains most, if it explains much.
    pub(super) fn suspect(
        &self,
        surroundings: &Array2<bool>,
        seed: f32,
        progress: &Progress,
    ) -> Result<Option<Suspect>> {
        let fit = self.fit(Places { may_shine: surroundings, at_least: 0.0, seed });
        let mut light = Array2::zeros(surroundings.dim());
        fit.spread(&mut light, (FIRST_STEPS, &self.squared), progress)?;
        if fit.misfit(&light) > PROMISING * self.before {
            return Ok(None);
        }
        fit.gather_in_rounds(&mut light, (ROUNDS, STEPS, 0.0), progress)?;
        let visibility = fit.visibility(&self.squared);
        keep_visible(&mut light, &visibility);
        let left = fit.misfit(&light) / self.before;
        let flare = &light * &visibility;
        Ok(Some(Suspect { light, flare, left }))
    }
}

/// Light that may be that of a lamp.
pub(super) struct Suspect {
    pub(super) light: Array2<f32>,
    /// How well it is seen.
    pub(super) flare: Array2<f32>,
    /// The part of the misfit that it leaves.
    pub(super) left: f64,
}

impl Suspect {
    fn pixels(&self) -> usize {
        self.light.iter().filter(|light| **light > 0.0).count()
    }

    /// Whether few pixels shine in all of them, of a frame of so many, or in all but one that they explain well.
    pub(super) fn are_small(suspects: &[Self], frame_px: usize) -> bool {
        let large: Vec<_> = suspects.iter().filter(|suspect| suspect.pixels() > MOST_PX).collect();
        match large[..] {
            [] => true,
            [one] => {
                let has_place = one.pixels() <= MOST_PX_OF_ONE && FRAME_PX * one.pixels() <= frame_px;
                has_place && one.left <= LEFT_OF_ONE
            }
            _ => false,
        }
    }

    /// The part of the misfit that they leave, the geometric mean.
    pub(super) fn left_by(suspects: &[Self]) -> f64 {
        let product: f64 = suspects.iter().map(|suspect| suspect.left).product();
        product.powf(1.0 / suspects.len() as f64)
    }
}

/// Takes away light that is seen much less than the rest.
pub(super) fn keep_visible(light: &mut Array2<f32>, visibility: &Array2<f32>) {
    let flare = &*light * visibility;
    let least = VISIBLE * brightest(&flare);
    light.zip_mut_with(&flare, |light, flare| {
        if *flare <= least {
            *light = 0.0;
        }
    });
}
