//! What there is where a capture is saturated: the light that its flare tells, and how far pixels are believed.

use ndarray::{Array2, ArrayView2, ArrayViewMut2, Zip};

use super::coarse;
use super::diagonal::diagonal;
use super::fit::{grown, high_pass_reach};
use super::flare::{Clipped, Measured, seen_pixels};
use super::frame::{Blur, Frame, row};
use super::members::{OfMembers, members};
use super::prior::Modest;
use super::smooth::{local_mean, local_mean_into, paint};
use super::window::Window;
use crate::core::error::Result;
use crate::core::progress::Progress;

/// Pixels around saturated ones whose values are not believed: interpolation mixes clipped values in. Where none were interpolated,
/// leaving them out costs 3 dB in computed captures, 0.3 at reduced resolutions, and up to 4 in photographs of a 10-bit sensor.
const GUARD_PX: usize = 1;

/// The share of a channel's pixels that may be saturated for their light to be measured by the spikes of their flare, which large
/// areas do not throw: beyond, the level is what the steps begin with, unless the light is convincing. Halls with 1 % lose 2 dB by that, streets at night with 4 %
/// lose 1.5; windows with 5 % gain 1, and those with 18 % 15 dB.
const MOST_MEASURED: f64 = 0.042;

/// The same at reduced resolutions, where skies whose sun has set gain 3 dB by it: a block counts if one of its pixels does.
const MOST_MEASURED_REDUCED: f64 = 0.03;

/// The share up to which their light is looked for, and believed if what it explains is convincing, as a sun's is whose glare saturates
/// much of a small frame.
const MOST_LOOKED_AT: f64 = 0.2;

/// The share up to which it is looked for as that of a sun, which is small and whose flare is surely seen.
const MOST_GLARE: f64 = 0.5;

/// How many times the level light is at most where another colour is not saturated: skies and coloured windows are two or three times
/// as bright in one colour as in the next. The mean over that light, so that some of its pixels may be brighter.
const BRIGHTEST_ALONE: f64 = 4.0;

/// Pixels beside those that are saturated in all colours where light may be of a lamp that is: colours are found apart by as many.
const BESIDE_ALL_PX: usize = 2;

/// How much more of the misfit light found at half the resolution may leave than light that was spread at full: the fit clings to the
/// scene's detail, and what it makes of that needs more steps. A workshop gains 7 dB by it.
const SPREAD_CREDIT: f64 = 1.03;

/// Samples of transforms beyond which the light of lamps is always found at half the resolution first, and corrected at the full one,
/// rather than measured at the full one from nothing. Sixteen photographs of 800 × 800 pixels are restored 0.1 dB better so in 0.6 of the
/// time, four of 8 megapixels 0.6 dB in 0.8 of it; views of 224 × 224 pixels up to 0.1 dB worse.
const LARGE_SAMPLES: usize = 700_000;

/// The part of a PSF's light that is flare at least.
const LEAST_FLARE: f32 = 1e-4;

/// The part of the largest curvature that a lamp's pixel has at least; 10⁻¹² restores the same.
const LEAST_CURVATURE: f32 = 1e-9;

/// How much less differences of neighbouring saturated pixels count, as a part of their brightness, than those of others: edges
/// are taken for such from twice as much on, and count a quarter. A lamp is no surface, but where nothing tells how its light
/// lies, as within a window, holes and peaks are the last guess.
const LIKENESS: f32 = 0.5;

/// How far the steps of lamps go beside those of other pixels: 0.3 converges more slowly, 1 misleads where there is noise
/// (0.1 dB each).
const LAMP_STEP: f32 = 0.6;

/// The part of the flare that was taken away that may be wrong: PSFs are measured to some percent.
const FLARE_DOUBT: f32 = 0.03;

/// The part of a lamp's light that may be wrong: where it is bright, its neighbours share it by little more than a guess.
const LAMP_DOUBT: f32 = 0.2;

/// The saturated pixels of a channel; planes are of the frame's size unless told.
pub(super) struct Lamps {
    saturated: Array2<bool>,
    /// 1/n: the inverse of the brightness of the scene without its lamps, at saturated pixels a part of that of lamps; a whole
    /// plane.
    pub(super) inverse_brightness: Array2<f32>,
    /// Saturated pixels and those next to them that may have been interpolated from them, where there are such.
    guarded: Option<Array2<bool>>,
    /// 1/D² of saturated pixels, which are lower bounds.
    certainty: OfMembers,
    level: f32,
    /// Whether their light can be measured.
    is_measured: bool,
    /// Whether it was found at half the resolution.
    has_coarse_light: bool,
}

/// A channel of a capture with saturated pixels; planes are of the frame's size.
pub(super) struct Saturated<'a> {
    pub(super) frame: &'a Frame,
    pub(super) capture: ArrayView2<'a, f32>,
    pub(super) psf: ArrayView2<'a, f32>,
    pub(super) pixels: &'a Array2<bool>,
    /// The light at which pixels are saturated.
    pub(super) level: f32,
}

/// What is presumed of a scene with lamps.
pub(super) struct Presumed {
    /// What is added to the scene's brightness that differences of neighbours are relative to.
    pub(super) darkness: f32,
    /// Whether pixels next to saturated ones may have been interpolated from them.
    pub(super) is_guarded: bool,
    /// The smoothness of an inverse of what is left without the flare, where the first scene is to be that.
    pub(super) smoothness: Option<f32>,
}

/// Whether a PSF throws light beyond the pixels next to its peak, by which lamps could be measured: of rounding's the light of a lamp would
/// be 10⁵ times what saturates.
fn throws_flare(psf: ArrayView2<'_, f32>) -> bool {
    let peak = psf
        .indexed_iter()
        .fold(((0, 0), 0.0f32), |most, (at, value)| if *value > most.1 { (at, *value) } else { most })
        .0;
    let beyond = |((y, x), value): ((usize, usize), &f32)| {
        if y.abs_diff(peak.0) > 1 || x.abs_diff(peak.1) > 1 { *value } else { 0.0 }
    };
    psf.indexed_iter().map(beyond).sum::<f32>() > LEAST_FLARE * psf.sum()
}

/// How far the light of saturated pixels that flare tells is believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Belief {
    Always,
    IfConvincing,
    IfOfSuns,
    Never,
}

impl Belief {
    /// Of that of a share of the pixels of a frame, of which so many may be saturated for it to be believed always.
    fn of(share: f64, most: f64) -> Self {
        match share {
            share if share <= most => Self::Always,
            share if share <= MOST_LOOKED_AT => Self::IfConvincing,
            share if share <= MOST_GLARE => Self::IfOfSuns,
            _ => Self::Never,
        }
    }
}

/// What the light in a window is, and whence.
struct Found {
    light: Array2<f32>,
    is_measured: bool,
    /// Whether half the resolution tells it.
    is_coarse: bool,
}

/// The light of saturated pixels, which is all that is kept of them until that of all channels is found.
pub(super) struct Light {
    of_pixels: OfMembers,
    is_measured: bool,
    is_coarse: bool,
}

impl Light {
    /// Whether it was found at half the resolution.
    pub(super) fn is_coarse(&self) -> bool {
        self.is_coarse
    }
}

impl Saturated<'_> {
    /// Finds the light of saturated pixels: what half the resolution tells or what is measured, whichever explains the spikes
    /// of the flare better; those whose flares do not meet are looked at apart. `coarse` is the scene at half the resolution, if it is
    /// known, and `brightness` D; where pixels are the means of blocks, the capture `is_reduced`. Of colours, this one among them, all
    /// saturated pixels are `of_colors`.
    pub(super) fn light(
        &self,
        (brightness, of_colors): (ArrayView2<'_, f32>, &[Array2<bool>]),
        (coarse, is_reduced): (Option<ArrayView2<'_, f32>>, bool),
        progress: &Progress,
    ) -> Result<Light> {
        let Self { frame, capture, psf, pixels, .. } = *self;
        let count = pixels.iter().filter(|saturated| **saturated).count();
        let most = if is_reduced { MOST_MEASURED_REDUCED } else { MOST_MEASURED };
        let belief = match throws_flare(psf) {
            true => Belief::of(count as f64 / pixels.len() as f64, most),
            false => Belief::Never,
        };
        let coarse = coarse.map(|scene| coarse::light(scene, pixels, capture));
        let windows = match frame.repeats() {
            true => vec![Window::whole(frame.size())],
            false => {
                let reach = [psf.nrows(), psf.ncols()].map(|length| length / 2 + high_pass_reach());
                Window::apart(pixels, reach)
            }
        };
        let told = (brightness, of_colors);
        if let [whole] = &windows[..]
            && whole.size() == frame.size()
        {
            let Found { light, is_measured, is_coarse } =
                self.light_in(whole, told, (coarse, belief), progress)?;
            return Ok(Light {
                of_pixels: OfMembers::new(pixels, |place| light[place]),
                is_measured,
                is_coarse,
            });
        }
        let (mut light, mut is_coarse, mut is_measured) = (Array2::zeros(frame.size()), false, true);
        for window in &windows {
            let coarse = coarse.as_ref().map(|light| window.cut(light.view()).to_owned());
            let found = self.light_in(window, told, (coarse, belief), progress)?;
            light.slice_mut(window.slices()).assign(&found.light);
            is_coarse |= found.is_coarse;
            is_measured &= found.is_measured;
        }
        Ok(Light { of_pixels: OfMembers::new(pixels, |place| light[place]), is_measured, is_coarse })
    }

    /// The light in a window, where half the resolution tells `coarse` of it.
    fn light_in(
        &self,
        window: &Window,
        (brightness, of_colors): (ArrayView2<'_, f32>, &[Array2<bool>]),
        (coarse, belief): (Option<Array2<f32>>, Belief),
        progress: &Progress,
    ) -> Result<Found> {
        let Self { frame, psf, level, .. } = *self;
        let of_window = &frame.like(window.size(), [psf.nrows(), psf.ncols()]);
        let saturated = &window.cut(self.pixels.view()).to_owned();
        let [capture, brightness] = [self.capture, brightness].map(|plane| window.cut(plane));
        let blur = of_window.blur(psf)?;
        let seen = &seen_pixels(&blur, saturated);
        let clipped = Clipped::new(&blur, capture, [saturated, seen], (brightness, level));
        let is_believed = |light: &Array2<f32>| match belief {
            Belief::Always => true,
            Belief::IfConvincing => {
                clipped.is_convincing(light) && self.suits_colors(light, (window, of_colors))
            }
            Belief::IfOfSuns => clipped.is_of_suns(light) && self.suits_colors(light, (window, of_colors)),
            Belief::Never => false,
        };
        let unknown = |coarse: Option<Array2<f32>>| match throws_flare(psf) {
            true => Found { is_coarse: coarse.is_some(), light: clipped.shared(coarse), is_measured: false },
            false => Found { is_coarse: false, light: clipped.at_level(), is_measured: false },
        };
        if belief == Belief::Never {
            return Ok(unknown(coarse));
        }
        match coarse {
            Some(light) if is_large(frame) && is_believed(&light) => {
                let light = clipped.without_glare(clipped.corrected(light, progress)?);
                Ok(Found { light, is_measured: true, is_coarse: true })
            }
            Some(light) if is_large(frame) => Ok(unknown(Some(light))),
            coarse => {
                let Measured { light, is_gathered } =
                    clipped.measure(&of_window.squared_blur(psf)?, progress)?;
                let allowed = if is_gathered { 1.0 } else { SPREAD_CREDIT };
                let of_light = clipped.misfit(&light);
                let better = |coarse: &Array2<f32>| clipped.misfit(coarse) < allowed * of_light;
                let best = match &coarse {
                    Some(coarse) if better(coarse) => Some(coarse),
                    _ => None,
                };
                if !is_believed(best.unwrap_or(&light)) {
                    return Ok(unknown(coarse));
                }
                let is_coarse = best.is_some();
                let light = clipped.without_glare(if is_coarse { coarse.unwrap_or(light) } else { light });
                Ok(Found { light, is_measured: true, is_coarse })
            }
        }
    }

    /// Whether light in a window suits what there is of other colours, which is known where they are not saturated: a sun saturates all,
    /// and where one colour of a sky clips, noise and detail may look like the flare of a sun of that colour.
    fn suits_colors(&self, light: &Array2<f32>, (window, of_colors): (&Window, &[Array2<bool>])) -> bool {
        let mut in_all = Array2::from_elem(light.dim(), true);
        for saturated in of_colors {
            Zip::from(&mut in_all).and(window.cut(saturated.view())).par_for_each(|all, this| *all &= this);
        }
        let in_all = grown(&in_all, BESIDE_ALL_PX);
        let (mut more, mut alone, mut squares_alone) = (0.0, 0.0, 0.0);
        for (light, in_all) in light.iter().zip(&in_all) {
            let of_pixel = f64::from(light / self.level - 1.0).max(0.0);
            more += of_pixel;
            if !in_all {
                alone += of_pixel;
                squares_alone += of_pixel * of_pixel;
            }
        }
        2.0 * alone <= more || squares_alone <= (BRIGHTEST_ALONE - 1.0) * alone
    }

    /// The first scene with the light of saturated pixels in it, a whole plane. `brightness` is D, also a plane, and becomes zero at
    /// saturated pixels.
    pub(super) fn start(
        &self,
        light: Light,
        brightness: &mut Array2<f32>,
        Presumed { darkness, is_guarded, smoothness }: Presumed,
    ) -> Result<(Lamps, Array2<f32>)> {
        let Self { frame, capture, psf, pixels: saturated, level } = *self;
        let Light { of_pixels, is_measured, is_coarse: has_coarse_light } = light;
        let guarded = is_guarded.then(|| grown(saturated, GUARD_PX));
        let hidden = guarded.as_ref().unwrap_or(saturated);
        let blur = frame.blur(psf)?;
        let mut scene = {
            let [mut light, mut flare] = [Array2::zeros(frame.size()), Array2::zeros(frame.size())];
            of_pixels.write(saturated, &mut light);
            blur.apply(&light, &mut flare);
            rest(frame, capture, flare, hidden)
        };
        let mut inverse_brightness = local_mean(&scene, super::known::NEAR_PX);
        inverse_brightness.par_mapv_inplace(|mean| 1.0 / (mean + darkness));
        let certainty = OfMembers::new(saturated, |place| 1.0 / (brightness[place] * brightness[place]));
        if let Some(smoothness) = smoothness {
            let mut sharp = blur.first_inverse(&scene, brightness, smoothness);
            let painted = Zip::from(frame.cut_mut(&mut sharp)).and(frame.cut(&scene)).and(hidden);
            painted.par_for_each(|sharp, painted, hidden| *sharp = if *hidden { *painted } else { *sharp });
            scene = sharp;
        }
        drop(blur);
        // Where the glare of suns saturates what is there, it stays as it is painted.
        let or_painted = |place: [usize; 2], light: f32| if light > 0.0 { light } else { scene[place] };
        let light = of_pixels.map(saturated, or_painted);
        light.write(saturated, &mut scene);
        for plane in [&mut inverse_brightness, brightness] {
            let pixels = Zip::from(frame.cut_mut(plane)).and(saturated);
            pixels.par_for_each(|value, saturated| *value = if *saturated { 0.0 } else { *value });
        }
        let saturated = saturated.clone();
        let lamps =
            Lamps { saturated, inverse_brightness, guarded, certainty, level, is_measured, has_coarse_light };
        Ok((lamps, scene))
    }
}

/// Whether a frame is so large that the light of its lamps is found at half the resolution first.
pub(super) fn is_large(frame: &Frame) -> bool {
    frame.transform_samples() > LARGE_SAMPLES
}

/// The capture without the flare, painted over where that hid it, on a whole plane.
fn rest(
    frame: &Frame,
    capture: ArrayView2<'_, f32>,
    flare: Array2<f32>,
    hidden: &Array2<bool>,
) -> Array2<f32> {
    let mut rest = flare;
    Zip::from(&mut rest).and(capture).par_for_each(|rest, y| *rest = (y - *rest).max(0.0));
    paint(&mut rest, &Zip::from(hidden).par_map_collect(|hidden| if *hidden { 0.0 } else { 1.0 }));
    frame.surround(rest.view())
}

impl Lamps {
    /// Whether the light was found at half the resolution.
    pub(super) fn has_coarse_light(&self) -> bool {
        self.has_coarse_light
    }

    /// W: 1/D² where the capture is known; where a saturated pixel is brighter than what the scene explains, `image`, no more is known
    /// of it. `brightness` is D.
    pub(super) fn weights(
        &self,
        (image, brightness): (&Array2<f32>, ArrayView2<'_, f32>),
        capture: ArrayView2<'_, f32>,
        weights: &mut Array2<f32>,
    ) {
        let hidden = self.guarded.as_ref().unwrap_or(&self.saturated);
        Zip::from(&mut *weights).and(hidden).and(brightness).par_for_each(|weight, hidden, n| {
            *weight = if *hidden { 0.0 } else { 1.0 / (n * n) };
        });
        Zip::indexed(weights.rows_mut()).par_for_each(|y, mut weights| {
            for (x, certainty) in members(row(&self.saturated, y)).zip(self.certainty.row(y)) {
                if image[[y, x]] < capture[[y, x]] {
                    weights[x] = *certainty;
                }
            }
        });
    }

    /// What the level tells of saturated pixels whose light was not measured, `brightness` being D.
    pub(super) fn modest<'a>(&self, brightness: &'a Array2<f32>) -> Option<Modest<'a>> {
        (!self.is_measured).then_some(Modest { brightness, level: self.level })
    }

    /// Presumes saturated pixels to be alike relative to their brightness in `scene`.
    pub(super) fn presume(&mut self, scene: &Array2<f32>) {
        let Self { inverse_brightness, saturated, level, .. } = self;
        local_mean_into(scene, super::known::NEAR_PX, inverse_brightness.view_mut(), |y, mean, inverse| {
            if y < saturated.nrows() {
                members(row(saturated, y)).for_each(|x| inverse[x] = LIKENESS / (mean[x] + *level));
            }
        });
    }

    /// The inverse of the diagonal of the normal matrix at saturated pixels, `presumed` times 1/n² of it the prior's.
    pub(super) fn preconditioner(
        &self,
        (frame, psf): (&Frame, ArrayView2<'_, f32>),
        weights: &Array2<f32>,
        presumed: f32,
    ) -> Result<(&Array2<bool>, OfMembers)> {
        let curvatures = diagonal(frame, psf, weights, &self.saturated)?;
        let least = (LEAST_CURVATURE * curvatures.largest()).max(f32::MIN_POSITIVE);
        let with_prior = |place: [usize; 2], curvature: f32| {
            let v = self.inverse_brightness[place];
            1.0 / (curvature.max(least) / LAMP_STEP + presumed * v * v)
        };
        Ok((&self.saturated, curvatures.map(&self.saturated, with_prior)))
    }

    /// Gives back what only the search for the scene needs.
    pub(super) fn settle(&mut self) {
        self.inverse_brightness = Array2::default((0, 0));
        (self.certainty, self.guarded) = Default::default();
    }

    /// Adds the doubt about the flare that `blur` makes of a scene's lamps to that of noise, and replaces it by that about their light.
    pub(super) fn doubt(
        &self,
        blur: &Blur<'_>,
        scene: ArrayView2<'_, f32>,
        deviation: ArrayViewMut2<'_, f32>,
    ) {
        let of_lamps = |saturated: &bool, light: &f32| if *saturated { *light } else { 0.0 };
        let light = Zip::from(&self.saturated).and(scene).par_map_collect(of_lamps);
        let mut flare = Array2::zeros(light.dim());
        blur.apply(&light, &mut flare);
        let parts = Zip::from(deviation).and(&flare).and(&self.saturated).and(scene);
        parts.par_for_each(|deviation, flare, saturated, scene| {
            let of_flare = FLARE_DOUBT * flare;
            let both = (*deviation * *deviation + of_flare * of_flare).sqrt();
            *deviation = if *saturated { LAMP_DOUBT * scene } else { both };
        });
    }
}

#[cfg(test)]
mod tests;
