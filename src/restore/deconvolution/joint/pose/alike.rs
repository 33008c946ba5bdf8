//! The pose in which a light that is given explains most of a capture.

use ndarray::Array2;

use super::super::sums::inner;
use super::{FIRST_STEPS, Pose2, Search};
use crate::core::error::Result;

/// Turns and scales that are tried, in all pairs.
const TURNS_DEG: [f64; 15] =
    [-1.05, -0.9, -0.75, -0.6, -0.45, -0.3, -0.15, 0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.05];
const SCALES: [f64; 5] = [-0.012, -0.006, 0.0, 0.006, 0.012];

/// How far beside a pose its neighbours are looked at: half of the grid first, then half of that.
const BESIDE: [Pose2; 2] = [[0.075, 0.003], [0.0375, 0.0015]];

/// Times that the pose and the light come closer by turns. Sharp orders, beside which the poses of the grid pass, take two or three: of
/// 120 captures of 192 to 384 pixels behind panels of five layouts, in poses of up to 0.9° and 1 %, 68 tell their pose, and in 24 of them
/// the light does not stand out in that of the grid.
const CLOSER: usize = 3;

impl Search<'_> {
    /// The pose of the grid in which the light explains most of the capture.
    pub(super) fn most_alike(&self) -> Pose2 {
        let poses = TURNS_DEG.iter().flat_map(|turn| SCALES.map(|scale| [*turn, scale]));
        best_of(poses, self.explained()).unwrap_or([0.0; 2])
    }

    /// Looks for better poses beside that of the grid, with the light that they allow, until it stands out of the scene's detail; whether
    /// it does.
    pub(super) fn comes_close(&mut self) -> Result<bool> {
        for _ in 0..CLOSER {
            if self.tells_much()? {
                return Ok(true);
            }
            self.pose = self.more_alike();
            self.improve_light(&[], FIRST_STEPS)?;
            self.weigh()?;
        }
        self.improve_light(&[], FIRST_STEPS)?;
        self.tells_much()
    }

    /// The pose beside this one in which the light explains most.
    fn more_alike(&self) -> Pose2 {
        let explained = self.explained();
        BESIDE.into_iter().fold(self.pose, |pose, [turn, scale]| {
            let beside = |(a, b): (f64, f64)| [pose[0] + a * turn, pose[1] + b * scale];
            let parts = [0.0, -1.0, 1.0];
            let poses = parts.into_iter().flat_map(|a| parts.map(|b| (a, b))).map(beside);
            best_of(poses, &explained).unwrap_or(pose)
        })
    }

    /// What the light explains of the capture in a pose.
    fn explained(&self) -> impl Fn(Pose2) -> f64 {
        let matched: Array2<f32> = self.scene.matched(&self.light, self.movable.size());
        move |pose| inner(&self.movable.at(pose), &matched)
    }
}

/// The pose of which most is explained: the first of equal ones.
fn best_of(poses: impl Iterator<Item = Pose2>, explained: impl Fn(Pose2) -> f64) -> Option<Pose2> {
    let best = poses.map(|pose| (explained(pose), pose)).reduce(|a, b| if b.0 > a.0 { b } else { a });
    best.map(|(_, pose)| pose)
}
