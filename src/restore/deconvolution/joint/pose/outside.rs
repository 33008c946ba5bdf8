//! Finds the pose of a PSF by the flare of a lamp beyond the border of a capture.

use ndarray::Array2;

use super::super::beyond::{View, brightest, has_room, shining};
use super::super::fit::grown;
use super::moved::{LARGEST_PX, Movable};
use super::scene::Scene;
use super::{FIRST_STEPS, FoundPose, Pose2, PoseConfig, PoseEstimate, Search, UntoldPose};
use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::core::progress::Progress;
use crate::core::psf::Psf;

/// Samples of a transform up to which the pose is looked for: larger captures are halved.
const MOST_SAMPLES: usize = 700_000;

/// Pixels around the light of the lamp where it may shine in another pose.
const AROUND_PX: usize = 6;

/// Turns and scales that are tried, in all pairs.
const TURNS_DEG: [f64; 7] = [-0.9, -0.6, -0.3, 0.0, 0.3, 0.6, 0.9];
const SCALES: [f64; 5] = [-0.012, -0.006, 0.0, 0.006, 0.012];

/// The light of a lamp's pixels at least as it gathers, over the brightest.
const LEAST_LIGHT: f32 = 1e-3;

/// What a lamp outside of the frame tells of the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FromOutside {
    /// There is no such lamp.
    NoLamp,
    /// There is, and it may tell the pose.
    Lamp(FoundPose),
}

impl FromOutside {
    /// The pose, where it is told.
    pub fn pose(self) -> Option<PoseEstimate> {
        match self {
            Self::NoLamp => None,
            Self::Lamp(found) => found.ok(),
        }
    }
}

/// As [`find_pose`](super::find_pose), by a lamp outside of the frame, whose light beyond the border is unknown.
///
/// # Method
/// The lamp is found by the PSF as it is. A light that was fitted in a wrong pose lies where it makes up for it, and would follow the
/// pose slowly; so the first pose is that of a grid in which a single point explains most, and light and pose are fitted together from
/// there.
///
/// # Errors
/// Those of [`find_pose`](super::find_pose).
pub fn find_pose_by_lamp_outside(
    capture: &LinearImage,
    psf: &Psf,
    config: &PoseConfig,
    progress: &Progress,
) -> Result<FromOutside> {
    config.check()?;
    if !has_room(capture) {
        return Ok(FromOutside::NoLamp);
    }
    let is_large = |view: &View<'_>| {
        view.samples() > MOST_SAMPLES || view.psf.height().max(view.psf.width()) > LARGEST_PX
    };
    let mut view = View::new(capture, psf, config.saturation);
    while is_large(&view) {
        match view.half()? {
            Some(half) => view = half,
            // So small an image has no such PSF.
            None => return Ok(FromOutside::Lamp(Err(UntoldPose::WeakFlare))),
        }
    }
    // Of all colours green has most photosites.
    let channel = 1;
    let measured = view.measure((config.alpha, &[channel]), progress)?;
    let Some(mut light) = measured else { return Ok(FromOutside::NoLamp) };
    let mut may_shine = grown(&shining(&light), AROUND_PX);
    may_shine.zip_mut_with(&view.surroundings(), |may_shine, is_outside| *may_shine &= *is_outside);
    let light = light.swap_remove(channel);
    let movable = Movable::new(view.psf.channel(channel));
    let lamp = (may_shine, LEAST_LIGHT * brightest(&light));
    let seen = (view.image.channel(channel), &view.saturated[channel]);
    let scene = Scene::of_lamp_outside(seen, movable.size(), lamp, config.alpha);
    Search::new(scene, &movable, progress)?.run_from(light, config.least_move).map(FromOutside::Lamp)
}

impl Search<'_> {
    /// As [`run`](Self::run), from a light that explains the capture in the pose of the PSF.
    fn run_from(mut self, light: Array2<f32>, least_move: Pose2) -> Result<FoundPose> {
        self.light = light;
        self.weigh()?;
        self.pose = self.pose_of_best_point()?;
        let mut light = self.scene.frame.plane();
        let blur = self.blur(self.pose)?;
        self.fit.spread((&self.scene, &blur), &mut light, FIRST_STEPS)?;
        self.fit.gather((&self.scene, &blur), &[], &mut light, FIRST_STEPS)?;
        drop(blur);
        self.light = light;
        self.settle_and_judge(least_move)
    }

    /// The pose in which a single point explains most of the capture.
    ///
    /// # Equation
    /// Light s at a point q, seen as a = w h A(p) q, leaves `|b − s a|²`, least for `s = ⟨a, b⟩/|a|²`, which explains `⟨a, b⟩²/|a|²` of the
    /// target b. All points' ⟨a, b⟩ are Aᵀ(p) hᵀ(w b); |a|² hardly depends on the pose.
    fn pose_of_best_point(&self) -> Result<Pose2> {
        let Scene { frame, lamps, high_pass, target, .. } = &self.scene;
        let mut squares = frame.plane();
        let weights = &high_pass.weights;
        let squared = frame.squared_blur(self.movable.at([0.0; 2]).view())?;
        squared.transpose(&(weights * weights), &mut squares);
        drop(squared);
        let back = high_pass.back_unblurred(target);
        let mut along = frame.plane();
        let (mut most, mut best) = (0.0, [0.0; 2]);
        for pose in TURNS_DEG.iter().flat_map(|turn| SCALES.map(|scale| [*turn, scale])) {
            self.blur(pose)?.transpose(&back, &mut along);
            for (place, _) in lamps.indexed_iter().filter(|(_, may_shine)| **may_shine) {
                let explained = along[place].max(0.0).powi(2) / squares[place].max(f32::MIN_POSITIVE);
                if explained > most {
                    (most, best) = (explained, pose);
                }
            }
        }
        Ok(best)
    }
}
