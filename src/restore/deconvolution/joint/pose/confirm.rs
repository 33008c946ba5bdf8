//! Confirms a pose by a second search that begins elsewhere.

use super::{FoundPose, Pose2, PoseEstimate, UntoldPose};
use crate::core::error::Result;

/// How far from a pose that was found a second search begins, to confirm it.
const ELSEWHERE: Pose2 = [0.3, 0.004];

/// How far from that pose it ends where it confirms it, or by how many deviations of both.
const CONFIRMED: Pose2 = [0.03, 1.5e-3];
const CERTAINTY: f64 = 2.0;

/// A pose, where a search that begins beside it, on one side or on the other, finds it again or tells nothing against it.
///
/// `search` is given where to begin, and what it finds is a pose from there.
///
/// # Errors
/// Those of `search`.
pub(super) fn confirmed(
    estimate: PoseEstimate,
    mut search: impl FnMut(Pose2) -> Result<FoundPose>,
) -> Result<FoundPose> {
    let mut is_doubted = false;
    for side in [1.0, -1.0] {
        let elsewhere = [estimate.turn_deg + side * ELSEWHERE[0], estimate.scale + side * ELSEWHERE[1]];
        match search(elsewhere)? {
            Ok(again) if confirms(&estimate, &again, side) => return Ok(Ok(estimate)),
            // From there it does not come close, which tells nothing against the pose.
            Err(UntoldPose::WeakFlare) => {}
            Err(_) if side > 0.0 => is_doubted = true,
            _ => return Ok(Err(UntoldPose::Fickle)),
        }
    }
    Ok(if is_doubted { Err(UntoldPose::Fickle) } else { Ok(estimate) })
}

/// Whether a search that began elsewhere, on one `side` or on the other, found a pose again.
fn confirms(estimate: &PoseEstimate, again: &PoseEstimate, side: f64) -> bool {
    let apart = [again.turn_deg + side * ELSEWHERE[0], again.scale + side * ELSEWHERE[1]];
    let turn_sigma_deg = estimate.turn_sigma_deg.hypot(again.turn_sigma_deg);
    let sigmas = [turn_sigma_deg, estimate.scale_sigma.hypot(again.scale_sigma)];
    (0..2).all(|part| apart[part].abs() <= CONFIRMED[part].max(CERTAINTY * sigmas[part]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FOUND: PoseEstimate = PoseEstimate {
        turn_deg: 0.2,
        scale: 1e-3,
        turn_sigma_deg: 0.01,
        scale_sigma: 5e-4,
        unexplained: 0.5,
        light_to_noise: 200.0,
    };

    /// A pose from where a search begins on this side.
    fn again(turn_deg: f64, scale: f64, side: f64) -> PoseEstimate {
        PoseEstimate { turn_deg: turn_deg - side * ELSEWHERE[0], scale: scale - side * ELSEWHERE[1], ..FOUND }
    }

    /// A lamp's flare is found from wherever a search begins; what leaves in the sun are taken for follows it.
    #[test]
    fn a_pose_that_another_start_does_not_find_is_not_told() {
        assert!(confirms(&FOUND, &again(0.01, 5e-4, 1.0), 1.0));
        assert!(!confirms(&FOUND, &again(0.18, 0.0, 1.0), 1.0));
        assert!(!confirms(&FOUND, &again(0.0, 2e-3, 1.0), 1.0));
        assert!(!confirms(&FOUND, &again(0.01, 5e-4, 1.0), -1.0), "on the other side");
        // Of poses that are told to a twentieth of a degree no more is asked.
        assert!(confirms(&PoseEstimate { turn_sigma_deg: 0.05, ..FOUND }, &again(0.08, 0.0, 1.0), 1.0));
    }

    #[test]
    fn a_search_that_does_not_come_close_tells_nothing_against_a_pose() {
        const WEAK: FoundPose = Err(UntoldPose::WeakFlare);
        const FAR: FoundPose = Err(UntoldPose::Far);
        const DOUBTED: FoundPose = Err(UntoldPose::Fickle);
        let [same, other] = [0.0, 0.2].map(|apart| [1.0, -1.0].map(|side| Ok(again(apart, 0.0, side))));
        for (of_sides, expected, searches) in [
            ([same[0], WEAK], Ok(FOUND), 1),
            ([WEAK, same[1]], Ok(FOUND), 2),
            ([FAR, same[1]], Ok(FOUND), 2),
            ([WEAK, WEAK], Ok(FOUND), 2),
            ([other[0], same[1]], DOUBTED, 1),
            ([WEAK, other[1]], DOUBTED, 2),
            ([WEAK, FAR], DOUBTED, 2),
            ([FAR, WEAK], DOUBTED, 2),
        ] {
            let mut begun = Vec::new();
            let found = confirmed(FOUND, |elsewhere| {
                begun.push(elsewhere);
                Ok(of_sides[begun.len() - 1])
            });
            assert_eq!(found.unwrap(), expected, "of {of_sides:?}");
            assert_eq!(begun.len(), searches, "of {of_sides:?}");
            assert!((begun[0][0] - 0.5).abs() < 1e-12 && (begun[0][1] - 5e-3).abs() < 1e-12, "{begun:?}");
        }
    }
}
