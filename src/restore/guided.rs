//! Restores a capture by a network that corrects what a deconvolution with the PSF makes of it.

use std::borrow::Cow;

use serde::Serialize;

use super::angle::FoundAngle;
use super::capture::{Capture, Restored};
use super::censored::with_darkness;
use super::deconvolution::{Border, CaptureNoise, LampOutside, Solution, doubt_told_noise};
use super::guard::{Gentle, Guard, Left};
use super::highlights::{blend_highlights, cut_off, most_light, with_light};
use super::lamps::{Lamp, find_lamps};
use super::lateral::{Lateral, LateralColour};
use super::levels::{
    corrected_levels, doubted_levels, find_levels_below, info_of, is_surpassed, reached_levels,
};
use super::memory::MemoryPlan;
use super::peaks::peaks;
use super::planes::{PlaneConfig, planes_of};
use super::restoration::Restoration;
use super::shining::shining;
use super::solved::Solved;
use super::starved::without_dots;
use super::unexplained::Unexplained;
use super::{FromOutside, Pose, PoseConfig, PoseEstimate, find_pose, find_pose_by_lamp_outside};
use crate::core::coded::with_whole_areas;
use crate::core::error::Result;
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;
use crate::io::AnyImage;
use crate::network::{Model, Plane};

/// What a restoration by the network for any panel does beside the network.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(super) struct GuidedOptions {
    /// The part of the network's corrections that is taken.
    pub(super) refine: f32,
    /// Whether lamps keep the light that their flare tells, far above what saturates.
    pub(super) true_highlights: bool,
    /// Whether the light at which captures saturate is looked for in them, unless they say it.
    pub(super) finds_levels: bool,
    /// Whether the PSF's pose is looked for in each capture.
    pub(super) finds_pose: bool,
}

/// The turn, in degrees, and the change of scale that a capture has to tell before its PSF is moved: what resampling costs is
/// then less than what it gains.
const LEAST_MOVE: [f64; 2] = [0.02, 1e-3];

/// Standard deviations that a move has to be above.
const SURE: f64 = 3.0;

/// The same of a pose that a lamp outside of the frame tells: what is seen of the PSF is its faintest part, where its own noise is most,
/// and one with noise of 10⁻⁵ of its peak was taken for turned by 3.1 deviations.
const SURER: f64 = 5.0;

impl Default for GuidedOptions {
    fn default() -> Self {
        Self { refine: 1.0, true_highlights: false, finds_levels: true, finds_pose: true }
    }
}

/// What a network is given to correct.
struct Given<'a> {
    image: &'a LinearImage,
    psf: &'a Psf,
    planes: &'a PlaneConfig,
    /// Whether it is a part of a capture: in some hundred pixels, tiles of three colours beside each other seem to lie apart by a lens.
    is_part: bool,
    /// Whether lamps throw much light over the frame, from in it or beyond.
    has_flare: bool,
}

/// What saturates the channels of a capture.
pub(super) struct Levels {
    pub(super) saturation: [f32; CHANNELS],
    /// As far as that was found in the capture itself.
    found: Option<[f32; CHANNELS]>,
    /// What the capture shows against what the user told.
    doubted: Option<[Option<f32>; CHANNELS]>,
}

/// What was found and done as a network corrected.
#[derive(Default)]
struct Corrected {
    angle: Option<FoundAngle>,
    lateral_colour: Option<LateralColour>,
    smaller_windows: Option<[usize; 2]>,
}

/// A PSF as the panel stands in a capture, and its pose where the capture tells another than that of the PSF.
pub(super) struct Posed<'a> {
    pub(super) psf: Cow<'a, Psf>,
    pub(super) pose: Option<PoseEstimate>,
    /// Whether lamps outside of the frame were looked for by this PSF, and there are none.
    pub(super) has_none_outside: bool,
}

/// What holds of all of a capture.
pub(super) struct Whole<'a> {
    pub(super) model: &'a Model,
    pub(super) planes: PlaneConfig,
    /// φ∘C of the result.
    pub(super) told: ToneCurve,
    /// The light that each channel of the result has at most, where lamps are not given their own.
    pub(super) most: [f32; CHANNELS],
    /// Where it is restored in parts.
    pub(super) parted: Option<Parted>,
}

/// What is known of all of a capture that is restored in parts.
pub(super) struct Parted {
    pub(super) noise: CaptureNoise,
    pub(super) has_lamps: bool,
}

/// What a capture, or a part of it, was restored to.
pub(super) struct Part {
    pub(super) image: AnyImage,
    /// The standard deviation of the noise of `log(capture + α)`.
    pub(super) relative_noise: [f32; CHANNELS],
    /// How the scene explains the capture.
    pub(super) unexplained: Unexplained,
    /// Whether light above what saturates is in it.
    pub(super) shines_above: bool,
    pub(super) lamps: Vec<Lamp>,
    pub(super) lamps_outside: Vec<LampOutside>,
    pub(super) angle: Option<FoundAngle>,
    pub(super) lateral_colour: Option<LateralColour>,
    pub(super) smaller_windows: Option<[usize; 2]>,
}

impl Restoration {
    /// Restores a capture by a network that reads planes, which are made of its PSF.
    pub(super) fn restore_by_planes(
        &self,
        model: &Model,
        plan: &MemoryPlan,
        capture: Capture,
        progress: &Progress,
    ) -> Result<Restored> {
        let Capture { image, info } = capture;
        let of_file = info.as_ref().and_then(|info| info.saturation);
        let coding_error = info.as_ref().and_then(|info| info.coding_error);
        let own = image.curve();
        let image: LinearImage = image.into_linear(self.curve());
        let Levels { saturation, found, doubted } = self.levels(&image, own, of_file);
        let told = ToneCurve { x_max: saturation.into_iter().fold(0.0, f32::max), ..self.curve() };
        let curve = self.curve_of(told, &image, of_file.is_some());
        let levels = found.map(|levels| reached_levels(&image, levels));
        let is_coded = coding_error.is_some() && self.guided_options().is_some();
        let image = if is_coded { with_whole_areas(image, saturation)? } else { image };
        let image = if self.guided_options().is_some() { with_darkness(image)? } else { image };
        let (border, noise) = (self.border(), self.noise_curve());
        let planes = PlaneConfig { curve, border, saturation, noise, coding_error };
        let mut posed = self.posed_psf(&image, &planes, progress)?;
        let window =
            plan.parts.as_ref().map_or([image.height(), image.width()], |parts| parts.window().into());
        let doubted_noise = doubt_told_noise(&image, &posed.psf, &planes.deconvolution(), window)?;
        let most = most_light(&image, saturation, told.x_max);
        let whole = Whole { model, planes, told, most, parted: None };
        let part = match &plan.parts {
            Some(parts) => self.restore_in_parts((whole, parts), &image, &mut posed, progress)?,
            None => {
                let solved = self.solved(&image, &mut posed, &whole, progress)?;
                self.restore_part((&whole, plan), (image, &posed.psf), solved, progress)?
            }
        };
        let Part {
            image,
            relative_noise,
            unexplained,
            shines_above,
            lamps,
            lamps_outside,
            angle,
            lateral_colour,
            smaller_windows,
        } = part;
        let info = info_of(info, found, shines_above);
        let restored = Restored::new(image, info, told).with_alpha(curve.alpha);
        Ok(Restored {
            angle,
            relative_noise: Some(relative_noise),
            lamps,
            lamps_outside,
            levels,
            doubted_levels: doubted,
            doubted_noise,
            contradiction: unexplained.contradiction(),
            pose: posed.pose,
            lateral_colour,
            smaller_windows,
            ..restored
        })
    }

    /// Restores a capture, or a part of one, of which the scene has been solved for.
    pub(super) fn restore_part(
        &self,
        (whole, plan): (&Whole<'_>, &MemoryPlan),
        (image, psf): (LinearImage, &Psf),
        solved: Solved,
        progress: &Progress,
    ) -> Result<Part> {
        let Whole { model, planes, told, most, parted } = whole;
        let PlaneConfig { curve, saturation, .. } = *planes;
        let Solved { relieved, lamps_outside, has_flare, solution } = solved;
        let image = relieved.unwrap_or(image);
        let unexplained = Unexplained::of(&image, &solution, (saturation, curve.alpha));
        let lamps = find_lamps(&image, &solution.scene, saturation);
        let (options, relative_noise) = (self.guided_options(), solution.relative_noise);
        let light = options.filter(|options| options.true_highlights).map(|_| solution.scene.clone());
        let are_elsewhere = parted.as_ref().is_some_and(|parted| parted.has_lamps);
        let has_lamps = are_elsewhere || !(lamps.is_empty() && lamps_outside.is_empty());
        let is_told = !has_lamps && self.border() != Border::Smooth;
        let (restored, Corrected { angle, lateral_colour, smaller_windows }) =
            if is_told && solution.is_clean() && options.is_some() {
                // Nothing hides the scene: what is told to 70 dB would lose up to 4 by a correction.
                (curve.tone_map_in_place(solution.scene), Corrected::default())
            } else {
                let given = Given { image: &image, psf, planes, is_part: parted.is_some(), has_flare };
                self.correct((model, plan), given, solution, progress)?
            };
        let level = saturation.map(|white| curve.compress(saturated_from(white)));
        let restored = blend_highlights(restored, &curve.tone_map(&image), level, self.highlights())?;
        let mut shines_above = false;
        let image = match light {
            Some(light) => {
                let light = with_light(curve.inverse_tone_map(&restored), &image, &light, saturation)?;
                shines_above = is_surpassed(saturation, &light);
                AnyImage::Linear(light)
            }
            None if options.is_some() => {
                // There is no other light, whatever the network makes of what saturates.
                let cut = cut_off(restored, most.map(|light| curve.compress(light)))?;
                match curve == *told {
                    true => AnyImage::ToneMapped(cut, Some(*told)),
                    false => AnyImage::Linear(curve.inverse_tone_map(&cut)),
                }
            }
            None if curve != *told => AnyImage::Linear(curve.inverse_tone_map(&restored)),
            None => AnyImage::ToneMapped(restored, Some(*told)),
        };
        Ok(Part {
            image,
            relative_noise,
            unexplained,
            shines_above,
            lamps,
            lamps_outside,
            angle,
            lateral_colour,
            smaller_windows,
        })
    }

    /// What a network makes of a capture whose scene has been solved for, as far as the capture allows.
    fn correct(
        &self,
        (model, plan): (&Model, &MemoryPlan),
        Given { image, psf, planes: config, is_part, has_flare }: Given<'_>,
        solution: Solution,
        progress: &Progress,
    ) -> Result<(ToneMappedImage, Corrected)> {
        let PlaneConfig { curve, border, saturation, .. } = *config;
        let (left, is_clean) = (Left::of(solution.residual.view()), solution.is_clean());
        let relative_noise = solution.relative_noise;
        // What lamps leave is more than is told.
        let is_told = solution.is_told && !has_flare;
        let gentle = Gentle::of(image, &solution.scene, saturation);
        let peaks = self.guided_options().and_then(|_| peaks(image, &solution.scene, saturation));
        let mut planes = planes_of(model.architecture().planes(), (image, psf), Some(solution), config)?;
        let mut shown = curve.tone_map(image);
        let (conditioning, angle) = self.conditioning(model, &shown, saturation, progress)?;
        let lateral = self.guided_options().and(planes.get(Plane::Deconvolved)).filter(|_| !is_part);
        let lateral = lateral.and_then(|deconvolved| Lateral::find(deconvolved, image, saturation));
        let lateral_colour = lateral.as_ref().map(Lateral::furthest);
        let mut aligned = None;
        if let Some(lateral) = lateral {
            let (image, how) = lateral.align(shown, &mut planes)?;
            (shown, aligned) = (image, Some(how));
        }
        let (mut restored, smaller_windows) =
            self.restore_mirrored((model, plan), (&shown, &mut planes), conditioning, progress)?;
        drop(shown);
        // What lies a few pixels beside is as good for limits of neighbourhoods.
        let [deconvolved, outside, deviation] =
            [Plane::Deconvolved, Plane::Outside, Plane::Noise].map(|plane| planes.take(plane));
        drop(planes);
        if let (Some(options), Some(mut deconvolved)) = (self.guided_options(), deconvolved) {
            if let Some(aligned) = aligned {
                [restored, deconvolved] = aligned.bring_back(restored, deconvolved)?;
            }
            let deviation = deviation.as_ref().filter(|_| is_told);
            // A capture without noise tells the scene better than a network that takes light from around the frame out of it: 24 views
            // of panoramas have 0.8 dB more so, and 24 painted ones 0.3.
            let outside = outside.as_ref().filter(|_| !is_clean);
            let guard = Guard {
                capture: image,
                psf,
                outside,
                deviation,
                left: &left,
                gentle,
                border,
                curve,
                saturation,
            };
            restored = shining(restored, &deconvolved, (image, peaks.as_ref()), (saturation, curve))?;
            restored = guard.refine(&deconvolved, restored, options.refine)?;
            restored = without_dots(restored, (image, &deconvolved), (relative_noise, curve))?;
        }
        Ok((restored, Corrected { angle, lateral_colour, smaller_windows }))
    }

    /// The PSF as the panel stands in a capture.
    fn posed_psf(&self, image: &LinearImage, planes: &PlaneConfig, progress: &Progress) -> Result<Posed<'_>> {
        let psf = self.kernel().needed_psf()?;
        let mut own = Posed { psf: Cow::Borrowed(psf), pose: None, has_none_outside: false };
        if !self.guided_options().is_some_and(|options| options.finds_pose) {
            return Ok(own);
        }
        let config =
            PoseConfig { alpha: planes.curve.alpha, saturation: planes.saturation, least_move: LEAST_MOVE };
        let progress = &progress.without_bars();
        let found = match find_pose(image, psf, &config, progress)?.ok().filter(|found| is_sure(found, SURE))
        {
            None if self.border() == Border::Smooth => {
                let found = find_pose_by_lamp_outside(image, psf, &config, progress)?;
                own.has_none_outside = found == FromOutside::NoLamp;
                found.pose().filter(|found| is_sure(found, SURER))
            }
            found => found,
        };
        Ok(match found {
            Some(estimate) => {
                let pose = Pose::of_estimates(psf, &[estimate]).expect("one estimate makes a pose");
                Posed { psf: Cow::Owned(pose.apply(psf)?), pose: Some(estimate), has_none_outside: false }
            }
            None => own,
        })
    }

    /// What saturates each channel of a capture: what is `known` of it, or what its light shows, of a file in a curve of its own.
    pub(super) fn levels(
        &self,
        image: &LinearImage,
        own: Option<ToneCurve>,
        known: Option<[f32; CHANNELS]>,
    ) -> Levels {
        let (most, usual) = (own.map(|own| own.x_max), self.curve().x_max);
        let finds_levels = self.guided_options().is_some_and(|options| options.finds_levels);
        let (saturation, found, doubted) = match known {
            Some(told) if finds_levels => {
                let (levels, is_found) = corrected_levels(image, told);
                (levels, is_found.then_some(levels), None)
            }
            None if finds_levels => {
                let (levels, count) = find_levels_below(image, self.curve(), most);
                (levels, (count > 0).then_some(levels), None)
            }
            told => {
                let told = told.map_or([usual; CHANNELS], |levels| levels.map(|level| level.min(usual)));
                (told, None, doubted_levels(image, told))
            }
        };
        Levels { saturation, found, doubted }
    }
}

/// Whether a pose is further than the least move, and than so many standard deviations.
fn is_sure(estimate: &PoseEstimate, deviations: f64) -> bool {
    let PoseEstimate { turn_deg, turn_sigma_deg, scale, scale_sigma, .. } = *estimate;
    turn_deg.abs() > LEAST_MOVE[0].max(deviations * turn_sigma_deg)
        || scale.abs() > LEAST_MOVE[1].max(deviations * scale_sigma)
}
