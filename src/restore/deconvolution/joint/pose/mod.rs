//! Finds by how much a PSF is turned and scaled against a capture: the pose in which the light of lamps explains most of
//! the flare around them.
//!
//! # Method
//! 1. Lamps are the saturated pixels of the channel with most of them, or very bright ones where none are. Their light x is fitted to
//!    their flare as the restoration does it, `|w h(y − A x)|²` with the high pass h and the weights w of `HighPass`, A by the mean of the
//!    PSF over all poses: it has the flare near a lamp, which a turn hardly moves, and no far orders for the light to cling to.
//!    Pixels count by how much is left unexplained around them, from here on.
//! 2. That light, in each of a grid of poses, is compared with the capture. All it takes is the product of the PSF in that pose with
//!    what the capture has around the light, found once.
//!    Sharp orders may lie between the poses of the grid: while the light does not stand out, poses beside the best are tried, and the light
//!    is improved, by turns.
//! 3. From there, Gauss–Newton steps in the pose: J are the derivatives of `w h A(p) x` by turn and scale, and light and
//!    pose are fitted together, the pose exactly in each step of the light (variable projection: Golub and Pereyra,
//!    SIAM J. Numer. Anal. 10, 1973). A light that is only fitted in one pose after the other clings to where it began.
//! 4. What is left is the scene, correlated as scenes are: the covariance of the pose is
//!    `H⁻¹ (Σ_b g_b g_bᵀ) H⁻¹` with H = JᵀP⊥J, P⊥ taking away what light explains, and g_b = Σ JᵀP⊥ r over blocks of pixels
//!    (Liang and Zeger, Biometrika 73, 1986). Where flare is weak, it is large, and the capture tells nothing.
//! 5. A second search begins beside the pose: it ends there if flare tells it, and elsewhere if the scene's own detail does, which the
//!    deviations know nothing of.

mod alike;
mod confirm;
mod evidence;
mod fit;
mod moved;
mod outside;
mod scene;
mod untold;

use std::fmt;

use ndarray::Array2;

use super::flare::shining_pixels;
use super::frame::Blur;
use super::sums::inner;
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;
use crate::restore::levels::find_levels;
use confirm::confirmed;
use evidence::{deviations, light_to_noise};
use fit::LampFit;
use moved::Movable;
pub use outside::{FromOutside, find_pose_by_lamp_outside};
use scene::{Scene, Window, window_of};
pub use untold::UntoldPose;

/// A turn in degrees, and a scale as a share.
type Pose2 = [f64; 2];

/// Turns and scales, in all pairs, over which the PSF is averaged for the first light.
const MEAN_TURNS_DEG: [f64; 5] = [-0.9, -0.45, 0.0, 0.45, 0.9];
const MEAN_SCALES: [f64; 3] = [-0.01, 0.0, 0.01];

/// The furthest pose that is believed: beyond, what is found is the edge of the search.
const FURTHEST: Pose2 = [1.0, 0.015];

/// Steps that spread the first light, and that gather it: few, so that it does not yet cling to a pose.
const FIRST_STEPS: usize = 4;

/// Gauss–Newton steps at most, and steps of the light's fit in each.
const ROUNDS: usize = 8;
const STEPS: usize = 8;

/// How far the pose may still go when the search ends, in last steps: where light and pose are hard to tell apart, each is
/// some 0.7 of the one before.
const STEPS_TO_GO: f64 = 3.0;

/// The same where it only has to be told that the pose stays within a least move: what steps of 0.7 of the one before add up to.
const LIKELY_STEPS_TO_GO: f64 = 2.0;

/// The longest Gauss–Newton step, within which derivatives hold.
const LONGEST: Pose2 = [0.15, 0.004];

/// How many steps are gone at once, at most, where steps are too short.
const FURTHER: f64 = 3.0;

/// Changes of the pose that end the search.
const SETTLED: Pose2 = [0.002, 1e-4];

/// Half of the differences that derivatives are taken by: smaller ones find a hollow about the PSF as it is, which no spline has blurred.
const DIFFERENCES: Pose2 = [0.1, 1e-3];

/// By how much errors are larger than their deviations from blocks say: light is fitted to the scene's detail too. With it the
/// errors of 37 captures of 384 × 384 pixels behind three panels, turned by a quarter to a third of a degree, are
/// 1.2 (turn) and 1.2 (scale) of their deviations, root mean square.
const OPTIMISM: f64 = 2.0;

/// Errors of the model, which no capture's noise tells: the PSF is known between its pixels by a spline.
const LEAST_SIGMA: Pose2 = [0.003, 2e-4];

/// A standard deviation from which on a capture tells nothing of the turn, or of the scale.
const USELESS_SIGMA: Pose2 = [0.05, 2e-3];

/// A light over its standard deviation below which it may be the scene's detail, in the pose that is found and in that which the search
/// begins at: of 120 captures of 192 to 384 pixels behind panels of five layouts, in poses of up to 0.9° and 1 %, 68 have more and tell
/// their pose. Root mean square, errors are 1.0 (turn) and 1.1 (scale) of their deviations. Of those that begin at
/// less light, small suns tell poses that are wrong by half a degree or 1 %.
const LEAST_LIGHT_TO_NOISE: f64 = 80.0;

/// The share of the pixels that may be saturated, of a channel and of the part of it that is looked at: of more, skies and windows, the
/// light explains the scene around it in any pose. Of 86 overexposed frames (192 × 192, six panels, PSFs in their pose) 36 tell a pose without this limit, 25 of which are wrong by more
/// than six of their deviations; eight with it, two of which are. Of 76 others, some in their pose and some turned, fifteen tell one: eleven
/// with the limit, one of which is wrong, and all of the other four are.
const MOST_SATURATED: f64 = 0.3;

/// The part of a frame that its lamps take at most, as if all of their light were alike: of ten captures that take more, most of rooms and
/// of streets by day, eight would tell poses that are wrong by 4 to 31 deviations, and of twelve that take less one does.
const LARGEST_LAMPS: f64 = 0.015;

/// How many times the saturated pixels of another colour one has that is saturated alone.
const ALONE: usize = 3;

/// How a capture was taken, for [`find_pose`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseConfig {
    /// α of the tone mapping, which says how much dark pixels count.
    pub alpha: f32,
    /// The value of a full photosite in each channel.
    pub saturation: [f32; CHANNELS],
    /// The turn in degrees and the change of scale below which nothing is to be told, which ends the search sooner; zeros look for
    /// every pose.
    pub least_move: [f64; 2],
}

impl PoseConfig {
    /// Of a capture of which `info` is known: saturated at most at `x_max`; without it, where the capture says it, else at the
    /// value that its brightest pixels share.
    pub fn of_capture(
        info: Option<&CaptureInfo>,
        image: &LinearImage,
        (alpha, x_max): (f32, Option<f32>),
    ) -> Self {
        let known = info.and_then(|info| info.saturation);
        let saturation = match (known, x_max) {
            (Some(levels), Some(x_max)) => levels.map(|white| white.min(x_max)),
            (Some(levels), None) => levels,
            (None, Some(x_max)) => [x_max; CHANNELS],
            (None, None) => find_levels(image, ToneCurve::default()).0,
        };
        Self { alpha, saturation, least_move: [0.0; 2] }
    }

    fn check(&self) -> Result<()> {
        let levels = self.saturation.map(|level| ("saturation", level));
        for (key, value) in std::iter::once(("alpha", self.alpha)).chain(levels) {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::config(key, format!("must be a positive number, found {value}")));
            }
        }
        Ok(())
    }
}

/// A pose, or why none is told.
pub type FoundPose = std::result::Result<PoseEstimate, UntoldPose>;

/// What a capture tells of the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseEstimate {
    /// By how much the PSF is to be turned about its centre, in degrees, counter-clockwise as displayed.
    pub turn_deg: f64,
    /// The share by which it is to be larger.
    pub scale: f64,
    /// The standard deviation of the turn, in degrees.
    pub turn_sigma_deg: f64,
    /// The standard deviation of the scale.
    pub scale_sigma: f64,
    /// The part of the capture's detail around lamps that stays unexplained in this pose: `|w h(y − A x)| / |w h(y)|`.
    pub unexplained: f64,
    /// The light of the lamps over its standard deviation.
    pub light_to_noise: f64,
}

impl fmt::Display for PoseEstimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { turn_deg, scale, turn_sigma_deg, scale_sigma, .. } = *self;
        write_pose_in_words(f, (turn_deg, turn_sigma_deg), (scale, scale_sigma))
    }
}

/// Writes a turn and a scale in words, each with its standard deviation.
///
/// # Errors
/// When the formatter takes no more.
pub(in crate::restore) fn write_pose_in_words(
    f: &mut fmt::Formatter<'_>,
    (turn_deg, turn_sigma_deg): (f64, f64),
    (scale, scale_sigma): (f64, f64),
) -> fmt::Result {
    let [percent, percent_sigma] = [scale, scale_sigma].map(|share| 100.0 * share);
    write!(f, "turned by {turn_deg:+.3}° ± {turn_sigma_deg:.3}°, ")?;
    write!(f, "scaled by {percent:+.3} % ± {percent_sigma:.3} %")
}

/// Searches the pose of `psf` in which it explains the flare of the lamps in `capture`.
///
/// Turns of up to 1° and scales of up to 1.5 % are found; see the head of the file. Else it says why the capture tells nothing.
///
/// # Errors
/// [`Error::Config`] when α or a saturation is no positive number; [`Error::Interrupted`] between steps.
pub fn find_pose(
    capture: &LinearImage,
    psf: &Psf,
    config: &PoseConfig,
    progress: &Progress,
) -> Result<FoundPose> {
    config.check()?;
    let (channel, saturated) = channel_of_lamps(capture, config);
    if saturated as f64 > MOST_SATURATED * capture.channel(channel).len() as f64 {
        return Ok(Err(UntoldPose::MuchSaturated));
    }
    let mut movable = Movable::new(psf.channel(channel));
    let (size, levels) = (movable.size(), (config.saturation[channel], config.alpha));
    let scene = || Scene::new(capture.channel(channel), size, levels, MOST_SATURATED);
    let Some(scene_of_lamps) = scene() else { return Ok(Err(UntoldPose::NoLamps)) };
    let of_lamps = scene_of_lamps.lamps.iter().filter(|lamp| **lamp).count();
    if of_lamps as f64 > MOST_SATURATED * scene_of_lamps.lamps.len() as f64 {
        return Ok(Err(UntoldPose::MuchSaturated));
    }
    let found = Search::new(scene_of_lamps, &movable, progress)?.run(config.least_move)?;
    let Ok(estimate) = found else { return Ok(found) };
    let from_elsewhere = |elsewhere: Pose2| {
        let Some(scene) = scene() else { return Ok(Err(UntoldPose::NoLamps)) };
        movable.begin_at(elsewhere);
        Search::new(scene, &movable, progress)?.run([0.0; 2])
    };
    confirmed(estimate, from_elsewhere)
}

/// The part of a capture by which [`find_pose`] tells a pose; none without lamps.
pub(in crate::restore) fn window_of_pose(capture: &LinearImage, config: &PoseConfig) -> Option<Window> {
    let (channel, _) = channel_of_lamps(capture, config);
    Some(window_of(capture.channel(channel), config.saturation[channel], MOST_SATURATED)?.0)
}

/// The channel with most saturated pixels, and how many those are: green, where it is as good as others. Where that is more than lamps have
/// and the others have hardly any, the middle one: a sky that one colour clips in is no lamp.
fn channel_of_lamps(capture: &LinearImage, config: &PoseConfig) -> (usize, usize) {
    let count = |channel: usize| {
        let from = saturated_from(config.saturation[channel]);
        capture.channel(channel).iter().filter(|y| **y >= from).count()
    };
    let mut counts = [0, 2, 1].map(|channel| (channel, count(channel)));
    counts.sort_by_key(|(_, count)| *count);
    let [_, middle, most] = counts;
    let is_large = most.1 as f64 > LARGEST_LAMPS * capture.channel(most.0).len() as f64;
    let is_alone = ALONE * middle.1 < most.1;
    if is_large && is_alone { middle } else { most }
}

/// How far to go from here, where `step` is the best: the last step was best to be `before`, and `taken` was gone.
///
/// Pixels count by what the light leaves, and the light follows the pose: whole steps swing around the best pose of some captures without
/// an end, and are far too short in others.
///
/// # Equation
/// The secant `step·taken/(before − step)`, to where steps become none; no further than [`FURTHER`] steps.
fn secant(step: f64, (before, taken): (f64, f64)) -> f64 {
    let further = taken / (before - step);
    let is_told = taken != 0.0 && before * taken > 0.0;
    match is_told {
        true if (0.0..FURTHER).contains(&further) => step * further,
        true if step * before > 0.0 => step * FURTHER,
        _ => step,
    }
}

/// A search in work.
struct Search<'a> {
    scene: Scene,
    movable: &'a Movable,
    fit: LampFit<'a>,
    /// x.
    light: Array2<f32>,
    pose: Pose2,
    /// The last step that the pose was to take: large where the search ends before it has settled.
    step: Pose2,
}

impl<'a> Search<'a> {
    fn new(scene: Scene, movable: &'a Movable, progress: &'a Progress) -> Result<Self> {
        let squared = scene.frame.squared_blur(movable.at([0.0; 2]).view())?;
        let fit = LampFit::new(&scene, &squared, progress);
        let light = scene.frame.plane();
        drop(squared);
        Ok(Self { scene, movable, fit, light, pose: [0.0; 2], step: [0.0; 2] })
    }

    fn run(mut self, least_move: Pose2) -> Result<FoundPose> {
        self.start()?;
        if !self.comes_close()? {
            return Ok(Err(UntoldPose::WeakFlare));
        }
        self.settle_and_judge(least_move)
    }

    /// Finds the first light, and the pose of the grid that it explains most in.
    fn start(&mut self) -> Result<()> {
        self.find_light()?;
        self.pose = self.most_alike();
        self.improve_light(&[], FIRST_STEPS)
    }

    fn settle_and_judge(&mut self, least_move: Pose2) -> Result<FoundPose> {
        match self.settle(least_move)? {
            Some(untold) => Ok(Err(untold)),
            None => self.judge(),
        }
    }

    /// Takes Gauss–Newton steps to a pose, unless it is none that is to be told.
    fn settle(&mut self, least_move: Pose2) -> Result<Option<UntoldPose>> {
        let mut taken = [0.0; 2];
        for round in 0..ROUNDS {
            self.weigh()?;
            let before = self.step;
            self.step = self.best_step()?;
            for part in 0..taken.len() {
                let longest = LONGEST[part];
                taken[part] = secant(self.step[part], (before[part], taken[part])).clamp(-longest, longest);
                self.pose[part] += taken[part];
            }
            if self.pose.iter().zip(FURTHEST).any(|(part, furthest)| part.is_nan() || part.abs() > furthest) {
                return Ok(Some(UntoldPose::Far));
            }
            // The first step's light is that of another pose still.
            if round > 0 && self.stays_within(least_move) {
                return Ok(Some(UntoldPose::InPlace));
            }
            if self.step.iter().zip(SETTLED).all(|(step, settled)| step.abs() < settled) {
                break;
            }
        }
        Ok(None)
    }

    /// Whether the pose will have moved by less than that when it has settled.
    fn stays_within(&self, least_move: Pose2) -> bool {
        let furthest = |part: usize| self.pose[part].abs() + LIKELY_STEPS_TO_GO * self.step[part].abs();
        (0..least_move.len()).all(|part| furthest(part) < least_move[part])
    }

    /// A in a pose.
    fn blur(&self, pose: Pose2) -> Result<Blur<'_>> {
        self.scene.frame.blur(self.movable.at(pose).view())
    }

    /// Finds the light as far as it can be told in any pose, and what tells it.
    fn find_light(&mut self) -> Result<()> {
        let poses = MEAN_TURNS_DEG.iter().flat_map(|turn| MEAN_SCALES.map(|scale| [*turn, scale]));
        let mut mean = Array2::zeros(self.movable.size());
        poses.for_each(|pose| mean += &self.movable.at(pose));
        mean /= mean.sum();
        let blur = self.scene.frame.blur(mean.view())?;
        self.fit.spread((&self.scene, &blur), &mut self.light, FIRST_STEPS)?;
        self.fit.gather((&self.scene, &blur), &[], &mut self.light, FIRST_STEPS)?;
        let left = self.scene.left(&blur, &self.light);
        drop(blur);
        self.scene.weigh(&left);
        Ok(())
    }

    fn improve_light(&mut self, columns: &[Array2<f32>], steps: usize) -> Result<()> {
        let mut light = std::mem::take(&mut self.light);
        self.fit.gather((&self.scene, &self.blur(self.pose)?), columns, &mut light, steps)?;
        self.light = light;
        Ok(())
    }

    /// Makes pixels count by what is left unexplained around them.
    fn weigh(&mut self) -> Result<()> {
        let left = self.scene.left(&self.blur(self.pose)?, &self.light);
        self.scene.weigh(&left);
        Ok(())
    }

    /// Whether the light stands out of the scene's detail.
    fn tells_much(&self) -> Result<bool> {
        let seen = self.scene.seen(&self.blur(self.pose)?, &self.light);
        Ok(light_to_noise(&seen, &(&self.scene.target - &seen)) >= LEAST_LIGHT_TO_NOISE)
    }

    /// The derivatives of `w·h(A x)` by turn and scale.
    fn slopes(&self) -> Result<[Array2<f32>; 2]> {
        let slope = |part: usize| {
            let slope = self.movable.slope(self.pose, part, DIFFERENCES[part]);
            Ok(self.scene.seen(&self.scene.frame.blur(slope.view())?, &self.light))
        };
        Ok([slope(0)?, slope(1)?])
    }

    /// Improves the light, and gives the step to the best pose with it.
    fn best_step(&mut self) -> Result<Pose2> {
        let [mut q, mut r] = self.slopes()?;
        // Gram and Schmidt: turn = a·q, scale = b·q + c·r.
        let a = normalize(&mut q);
        let b = inner(&q, &r);
        r.scaled_add(-narrow(b), &q);
        let c = normalize(&mut r);
        let columns = [q, r];
        self.improve_light(&columns, STEPS)?;
        let left = self.scene.left(&self.blur(self.pose)?, &self.light);
        let [of_q, of_r] = columns.each_ref().map(|column| inner(column, &left));
        let of_scale = of_r / c;
        Ok([(of_q - b * of_scale) / a, of_scale])
    }

    /// What the capture tells of the pose that was found, if anything.
    fn judge(&self) -> Result<FoundPose> {
        let blur = self.blur(self.pose)?;
        let seen = self.scene.seen(&blur, &self.light);
        let left = &self.scene.target - &seen;
        let light_to_noise = light_to_noise(&seen, &left);
        if light_to_noise < LEAST_LIGHT_TO_NOISE {
            return Ok(Err(UntoldPose::WeakFlare));
        }
        if shining_pixels(&self.light) > LARGEST_LAMPS * self.scene.target.len() as f64 {
            return Ok(Err(UntoldPose::Wide));
        }
        let [turn, scale] = self.slopes()?;
        let untold = |slope| self.fit.unexplained((&self.scene, &blur), slope, &self.light, STEPS);
        let Some(deviations) = deviations(&[untold(turn)?, untold(scale)?], &left) else {
            return Ok(Err(UntoldPose::WeakFlare));
        };
        let sigma: Pose2 = std::array::from_fn(|part| {
            let of_fit = (OPTIMISM * deviations[part]).hypot(LEAST_SIGMA[part]);
            of_fit.hypot(STEPS_TO_GO * self.step[part])
        });
        if sigma.iter().zip(USELESS_SIGMA).any(|(sigma, useless)| sigma.is_nan() || *sigma >= useless) {
            let [turn_sigma_deg, scale_sigma] = sigma;
            return Ok(Err(UntoldPose::Unsure { turn_sigma_deg, scale_sigma }));
        }
        let target = &self.scene.target;
        let unexplained = (inner(&left, &left) / inner(target, target).max(f64::MIN_POSITIVE)).sqrt();
        let ([turn_deg, scale], [turn_sigma_deg, scale_sigma]) = (self.pose, sigma);
        Ok(Ok(PoseEstimate { turn_deg, scale, turn_sigma_deg, scale_sigma, unexplained, light_to_noise }))
    }
}

/// Divides a plane by its norm, which is returned.
fn normalize(plane: &mut Array2<f32>) -> f64 {
    let norm = inner(plane, plane).sqrt().max(f64::MIN_POSITIVE);
    let factor = narrow(1.0 / norm);
    plane.mapv_inplace(|value| value * factor);
    norm
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests;
