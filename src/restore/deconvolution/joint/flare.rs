//! Measures the light that the sensor clipped by the flare that it throws over the rest of the frame.

use std::sync::OnceLock;

use ndarray::{Array2, ArrayView2, Zip};
use rayon::prelude::*;

use super::super::objective::sum_of_rows;
use super::effort::takes_few_steps;
use super::fit::{Fit, Places, believed, grown};
use super::frame::{Blur, row};
use super::members::OfMembers;
use super::seen::{part_surely_seen, times_likely_seen};
use crate::core::error::Result;
use crate::core::progress::Progress;

/// The light above the level that pixels count as at least, over the level: it lets those shine that were dark before; a tenth
/// and ten times as much restore the same.
const LEAST_LIGHT: f32 = 1e-3;

/// Steps of the conjugate gradients that spread light: 12 fit noise, and restore frames with lamps 0.05 dB worse.
const FIRST_STEPS: usize = 6;

/// Rounds in which it gathers, and steps in each: twice as many find the same light.
const ROUNDS: usize = 3;
const STEPS: usize = 8;

/// Steps of the first round after which gathering is given up unless this part of the misfit of spread light is left at most: of 186
/// channels for which all rounds would leave more than [`GATHERED`], 185 are told so, and of 149 others eleven wrongly. By that one
/// studio has 1.3 dB less, another 2.0 and a sky 2.4 dB more.
const TRIAL_STEPS: usize = 4;
const PROMISING: f64 = 0.99;

/// The part of the misfit of spread light that is left at most where light is taken to be gathered. Of suns, street lamps and
/// softboxes 0.3 to 0.98 is left; of ceilings, shops and windows 0.98 to 1, and what the light of most of them gains by more steps is
/// the scene's own glow around them: a workshop loses 3 dB by it.
const GATHERED: f64 = 0.985;

/// Rounds in which light that is known from half the resolution is corrected, and steps in each: one round of eight restores
/// photographs of 800 × 800 pixels 0.1 dB worse, two or three of as many no better. Eleven of 2.5 and 8 megapixels are restored the same
/// by one of six.
const CORRECTION: (usize, usize) = (2, 6);

/// The part of the misfit that a step of a correction lowers it by at least, or it is the last of its round: streets and halls at
/// full resolution end after two to four steps so, skies with a sun take all. Five photographs of 8 megapixels are restored as before,
/// and 0.15 dB worse at three times as much.
const LEAST_GAIN: f64 = 3e-4;

/// How much brighter than the capture flare may be, over the local brightness, before it counts as more than noise.
const NOISE: f32 = 0.03;

/// The part of the misfit of light at the level below which light is believed though its flare outshines the capture somewhere: in 90
/// of 91 channels that leave less, the light of suns, lamps and windows is 0.96 to 1.43 times the true one.
const CONVINCING: f64 = 0.8;

/// The same for light that shines all over, as that of windows five and twelve times as bright as what saturates. Of 24 views of panoramas
/// of which 3 to 50 % is saturated, four gain 0.9 to 6.6 dB and a street loses 0.4; 0.75 restores another 0.4 dB worse, and 0.8 a third
/// by 2.4. Where more than a fifth is saturated, a hall would gain 5 dB and a sunset lose 3.5.
const SURELY_CONVINCING: f64 = 0.7;

/// The mean of what flare is brighter than the capture, over the pixels that are not saturated, of light that is plausible. A fit that
/// explains less makes 2 to 13 times the light of windows little above saturation out of the scene's own haze, and 1.1 to 1.5 times
/// that of street lamps. Beyond the first of these, as much of it is believed as leaves the second: 14 of 19 channels then have 0.5 to
/// 1.6 times the true light. Suns have up to 8e-4, and three skies lose 0.1 to 1.4 dB where 1e-4 is the most.
const PLAUSIBLE: f64 = 8e-4;
const BELIEVED: f64 = 1e-4;

/// The mean from which on light is not believed at all, if more than this share of the saturated pixels shines. Windows a little
/// above saturation have 0.003 to 0.012 in some colours, and are restored 2 to 14 dB better from the level.
const IMPLAUSIBLE: f64 = 0.002;
const WIDESPREAD: f64 = 0.1;

/// The part of a frame that suns, and lamps as small, take at most. Windows and skies take more: of a lobby and of skies 0.005 to 0.009
/// shines by the fit, and what that makes of them costs up to 8 dB.
const LARGEST_SUN: f64 = 2e-3;

/// The light of a pixel of a sun at least, over the level, and how many pixels beside what shines may be part of it.
const SUN: f32 = 200.0;
const BESIDE_SUN_PX: usize = 3;

/// The part of a pixel's light that falls on pixels which are believed, at least, for its light to be looked for: those within an area
/// that is larger than the PSF throw none there, and rounding alone would tell theirs, 10⁶ times what saturates. Of nine suns whose glare
/// clips 5 to 66 % of a frame, behind PSFs of 161 pixels, seven have 1.3e-4 and more; two are hidden, with 1.2e-5 and less.
const LEAST_SEEN: f32 = 5e-5;

/// The part of the misfit of the level that light leaves at most where all saturated pixels are taken to be alike: of PSFs that throw
/// hardly any flare, 0.995 and more is left, and what it makes of windows costs 2 dB.
const TOLD: f64 = 0.99;

/// How many times the level saturated pixels may have beyond it where all are taken to be alike.
const MOST_SHARED: f64 = 2.0;

/// Halvings that find the plausible part of a light.
const HALVINGS: usize = 8;

/// A channel of a capture, and which of its pixels are saturated. All planes are of the frame's size.
pub(super) struct Clipped<'a> {
    pub(super) blur: &'a Blur<'a>,
    pub(super) capture: ArrayView2<'a, f32>,
    pub(super) saturated: &'a Array2<bool>,
    /// The local standard deviation, up to a factor.
    pub(super) brightness: ArrayView2<'a, f32>,
    /// The light at which pixels are saturated.
    pub(super) level: f32,
    /// The saturated pixels whose flare is seen.
    seen: &'a Array2<bool>,
    /// What light is told by.
    fit: Fit<'a>,
    /// What the level leaves of the capture, and the sum of its squares, once it was asked for.
    of_level: OnceLock<(Array2<f32>, f64)>,
}

/// The saturated pixels of a capture whose flare falls on pixels that are believed.
pub(super) fn seen_pixels(blur: &Blur<'_>, saturated: &Array2<bool>) -> Array2<bool> {
    let believed =
        Zip::from(&believed(saturated)).par_map_collect(|is_believed| if *is_believed { 1.0 } else { 0.0 });
    let mut shares = Array2::zeros(saturated.dim());
    blur.transpose(&believed, &mut shares);
    let is_seen = |saturated: &bool, share: &f32| *saturated && *share >= LEAST_SEEN;
    Zip::from(saturated).and(&shares).par_map_collect(is_seen)
}

/// The light of saturated pixels, which is the level at which they saturate at least.
pub(super) struct Measured {
    pub(super) light: Array2<f32>,
    /// Whether it is where its flare tells it to be, rather than spread over all that gain by some.
    pub(super) is_gathered: bool,
}

impl<'a> Clipped<'a> {
    /// Of a capture, its saturated pixels, those of them that [are seen](seen_pixels) and its brightness, and the light at which they are
    /// saturated.
    pub(super) fn new(
        blur: &'a Blur<'a>,
        capture: ArrayView2<'a, f32>,
        [saturated, seen]: [&'a Array2<bool>; 2],
        (brightness, level): (ArrayView2<'a, f32>, f32),
    ) -> Self {
        let places = Places { may_shine: seen, at_least: level, seed: LEAST_LIGHT * level };
        let fit = Fit::new(blur, (capture, saturated, brightness), places);
        Self { blur, capture, saturated, brightness, level, seen, fit, of_level: OnceLock::new() }
    }

    /// Finds the light of saturated pixels.
    ///
    /// # Equation
    /// Minimises `|w·h(y − A(level·S + s))|²` over s ≥ 0 in S, as [`Fit`] has it.
    ///
    /// # Method
    /// Conjugate gradients with the exact diagonal of AᵀW²A spread light over all pixels that gain by some; then rounds
    /// preconditioned by `s/(AᵀW²A s)` (De Pierro 1995), s the light before each, gather it: steps are in proportion to the
    /// light, so that a sun keeps its few pixels, and the many that its glare saturates lose theirs. Steps of one size for all
    /// miss 2 to 20 dB of the flare of suns. Where gathering explains little more, the light is left spread.
    ///
    /// Flare can't be brighter than the capture. Of light that would throw such flare, and explains little of the rest, as much is
    /// believed as is plausible.
    ///
    /// `squared` is A with the squares of the PSF.
    pub(super) fn measure(&self, squared: &Blur<'_>, progress: &Progress) -> Result<Measured> {
        let Measured { light, is_gathered } = self.fitted(squared, progress)?;
        let misfit = self.misfit(&light);
        Ok(Measured { light: self.believed(light, misfit).0, is_gathered })
    }

    /// Corrects a light that was found at half the resolution by what its flare tells at the full one.
    pub(super) fn corrected(&self, coarse: Array2<f32>, progress: &Progress) -> Result<Array2<f32>> {
        let mut light = coarse;
        Zip::from(&mut light).and(self.saturated).par_for_each(|light, saturated| {
            *light = if *saturated { light.max(self.level) } else { 0.0 };
        });
        let coarse = OfMembers::new(self.saturated, |place| light[place]);
        let (rounds, steps) = CORRECTION;
        let is_large = takes_few_steps(self.blur.frame.transform_samples());
        let rounds = if is_large { 1 } else { rounds };
        let [of_coarse, after] =
            self.fit.gather_in_rounds(&mut light, (rounds, steps, LEAST_GAIN), progress)?;
        let misfit = if is_large { after } else { self.misfit(&light) };
        let (mut light, of_light) = self.believed(light, misfit);
        if of_coarse < of_light {
            coarse.write(self.saturated, &mut light);
        }
        Ok(light)
    }

    /// As much of a light and what it leaves of the sum of squares as is believed, see [`measure`](Self::measure), and what that leaves.
    fn believed(&self, light: Array2<f32>, misfit: f64) -> (Array2<f32>, f64) {
        if misfit <= CONVINCING * self.left_by_level().1 {
            return (light, misfit);
        }
        let at_level = self.at_level();
        if let Some(part) = self.part_seen(&light, &at_level) {
            // Light that is none below the level gathers some of the scene's detail.
            let light = &at_level + &(narrow(part) * &(&light - &at_level));
            let misfit = self.misfit(&light);
            return (light, misfit);
        }
        let Some(plausible) = self.plausible(&light, &at_level) else { return (light, misfit) };
        let misfit = self.misfit(&plausible);
        (plausible, misfit)
    }

    /// Whether a light explains so much of what the level does not that it is believed whatever else there is: a little less if it is that
    /// of lamps, and whatever it explains if it is that of suns whose flare is surely seen; their glare saturates what is around them. Windows
    /// shine all over.
    pub(super) fn is_convincing(&self, light: &Array2<f32>) -> bool {
        let left = self.misfit(light) / self.left_by_level().1;
        let level = self.at_level();
        left <= SURELY_CONVINCING && self.is_mostly_seen()
            || self.shining(&(light - &level)) <= WIDESPREAD
                && (left <= CONVINCING || self.part_seen(light, &level).is_some())
    }

    /// Whether a light is that of suns, or of lamps as small, whose flare is surely seen.
    pub(super) fn is_of_suns(&self, light: &Array2<f32>) -> bool {
        self.part_seen(light, &self.at_level()).is_some()
    }

    /// Whether the flare of most saturated pixels is seen: an area that is larger than the PSF is taken to be even within.
    fn is_mostly_seen(&self) -> bool {
        let count = |pixels: &Array2<bool>| pixels.iter().filter(|is_one| **is_one).count();
        2 * count(self.seen) >= count(self.saturated)
    }

    /// A light with none at pixels that the flare of suns saturates, whatever is there: that is painted over, where the level would stay
    /// as a star.
    pub(super) fn without_glare(&self, mut light: Array2<f32>) -> Array2<f32> {
        let at_level = self.at_level();
        let is_sun = |light: &f32| *light > SUN * self.level;
        if !light.iter().any(is_sun) || self.part_seen(&light, &at_level).is_none() {
            return light;
        }
        let (level, more) = (self.level, &light - &at_level);
        let mut flare = Array2::zeros(self.capture.dim());
        self.blur.apply(&more, &mut flare);
        let shines = grown(&more.mapv(|more| more >= level), BESIDE_SUN_PX);
        let pixels = Zip::from(&mut light).and(&flare).and(&shines).and(self.saturated);
        pixels.par_for_each(|light, flare, shines, saturated| {
            if *saturated && *flare >= level && !*shines {
                *light = 0.0;
            }
        });
        light
    }

    /// How much of what a light has above the level is seen in the capture, where it comes from a small part of the frame and its flare is
    /// surely seen, however little it is beside the scene's own detail.
    fn part_seen(&self, light: &Array2<f32>, at_level: &Array2<f32>) -> Option<f64> {
        let more = light - at_level;
        if shining_pixels(&more) > LARGEST_SUN * more.len() as f64 {
            return None;
        }
        part_surely_seen(&self.fit.seen(&more), &self.left_by_level().0)
    }

    /// The level at which they saturate for the light of all saturated pixels.
    pub(super) fn at_level(&self) -> Array2<f32> {
        Zip::from(self.saturated).par_map_collect(|saturated| if *saturated { self.level } else { 0.0 })
    }

    /// The light that all saturated pixels have if they are alike, where that explains more than the level and than what half the
    /// resolution tells; else this, or the level.
    ///
    /// The flare of large areas does not tell their pixels apart, but how bright they are together.
    pub(super) fn shared(&self, coarse: Option<Array2<f32>>) -> Array2<f32> {
        let at_level = self.at_level();
        let (left, of_level) = self.left_by_level();
        let seen = self.fit.seen(&at_level);
        let times = narrow(times_likely_seen(&seen, left).min(MOST_SHARED));
        let of_shared = sum_of_rows(left.nrows(), |y| {
            let pixels = row(left, y).iter().zip(row(&seen, y));
            pixels.map(|(left, seen)| f64::from(left - times * seen).powi(2)).sum()
        });
        match coarse {
            _ if of_shared > TOLD * of_level => coarse.unwrap_or(at_level),
            Some(coarse) if self.misfit(&coarse) <= of_shared => coarse,
            _ => at_level.mapv_into(|light| (1.0 + times) * light),
        }
    }

    /// The part of a light above another that is believed where all of it would throw more flare than is plausible.
    fn plausible(&self, light: &Array2<f32>, least: &Array2<f32>) -> Option<Array2<f32>> {
        let fit = &self.fit;
        let mut more = fit.lend_plane();
        Zip::from(&mut *more).and(light).and(least).par_for_each(|more, light, least| *more = light - least);
        let of = |light: &Array2<f32>| {
            let mut flare = fit.lend_frame();
            self.blur.apply(light, &mut flare);
            flare
        };
        let hidden = grown(self.saturated, 1);
        let pixels = hidden.iter().filter(|hidden| !**hidden).count().max(1) as f64;
        let brighter = self.brighter([&of(least), &of(&more)], &hidden);
        let overshoot = |part: f32| {
            brighter
                .iter()
                .flatten()
                .map(|[least, more]| f64::from((least + part * more).max(0.0)))
                .sum::<f64>()
                / pixels
        };
        let whole = overshoot(1.0);
        if whole <= PLAUSIBLE {
            return None;
        }
        if whole > IMPLAUSIBLE && self.shining(&more) > WIDESPREAD {
            return Some(least.clone());
        }
        let [mut low, mut high] = [0.0, 1.0];
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            *(if overshoot(middle) > BELIEVED { &mut high } else { &mut low }) = middle;
        }
        Some(Zip::from(&*more).and(least).par_map_collect(|more, least| low * more + least))
    }

    /// The share of the saturated pixels that a light comes from, as if all of those were alike.
    fn shining(&self, light: &Array2<f32>) -> f64 {
        let saturated = self.saturated.iter().filter(|saturated| **saturated).count();
        shining_pixels(light) / saturated as f64
    }

    /// What one flare is brighter than the capture, and another beside it, over the brightness, in pixels that are not hidden and where
    /// both are brighter, row by row.
    fn brighter(&self, [flare, more]: [&Array2<f32>; 2], hidden: &Array2<bool>) -> Vec<Vec<[f32; 2]>> {
        let of_row = |y: usize| {
            let flares = row(flare, y).iter().zip(row(more, y));
            let pixels =
                flares.zip(self.capture.row(y)).zip(row(hidden, y).iter().zip(self.brightness.row(y)));
            let brighter = pixels.filter_map(|(((flare, more), y), (hidden, n))| {
                let [flare, more] = [(flare - y) / n - NOISE, more / n];
                (!*hidden && flare + more.max(0.0) > 0.0).then_some([flare, more])
            });
            brighter.collect::<Vec<_>>()
        };
        (0..hidden.nrows()).into_par_iter().map(of_row).collect()
    }

    fn fitted(&self, squared: &Blur<'_>, progress: &Progress) -> Result<Measured> {
        let fit = &self.fit;
        let mut light = self.at_level();
        fit.spread(&mut light, (FIRST_STEPS, squared), progress)?;
        let spread = light.clone();
        let of_spread = fit.misfit(&spread);
        let mut steps = STEPS;
        for round in 0..ROUNDS {
            let gathering = fit.gathering(&light);
            if round == 0 {
                fit.gather(&mut light, (TRIAL_STEPS, &gathering), progress)?;
                if fit.misfit(&light) > PROMISING * of_spread {
                    return Ok(Measured { light: spread, is_gathered: false });
                }
                steps -= TRIAL_STEPS;
            }
            fit.gather(&mut light, (std::mem::replace(&mut steps, STEPS), &gathering), progress)?;
        }
        let is_gathered = fit.misfit(&light) < GATHERED * of_spread;
        Ok(Measured { light: if is_gathered { light } else { spread }, is_gathered })
    }

    /// What a light of saturated pixels, the level included, leaves of that sum of squares.
    pub(super) fn misfit(&self, light: &Array2<f32>) -> f64 {
        self.fit.misfit(light)
    }

    /// What the level leaves of the capture, `w·h(y − A·level·S)`, and the sum of its squares.
    fn left_by_level(&self) -> &(Array2<f32>, f64) {
        self.of_level.get_or_init(|| {
            let mut left = Array2::zeros(self.capture.dim());
            let misfit = self.fit.write_residual(&self.at_level(), &mut left);
            (left, misfit)
        })
    }
}

/// The number of pixels that a light comes from, as if all of them were alike.
pub(super) fn shining_pixels(light: &Array2<f32>) -> f64 {
    let sum_of = |of: fn(f64) -> f64| {
        sum_of_rows(light.nrows(), |y| row(light, y).iter().map(|light| of(f64::from(*light))).sum())
    };
    sum_of(|light| light).powi(2) / sum_of(|light| light * light).max(f64::MIN_POSITIVE)
}

#[expect(clippy::cast_possible_truncation, reason = "a part of light")]
fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests;
