//! Why a capture does not tell the pose of its panel.

use std::fmt;

use super::{FURTHEST, LARGEST_LAMPS, MOST_SATURATED, USELESS_SIGMA};

/// Why a capture does not tell the pose of its panel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UntoldPose {
    /// There is nothing that is bright enough.
    NoLamps,
    /// So much of it is saturated that it is no lamps.
    MuchSaturated,
    /// Its light comes from so large a part of it that it is no lamps.
    Wide,
    /// What its lamps throw over their surroundings does not stand out of the scene's detail.
    WeakFlare,
    /// The best pose is beyond those that are looked for.
    Far,
    /// The pose is known to these standard deviations alone, in degrees and as a share.
    Unsure {
        /// Of the turn.
        turn_sigma_deg: f64,
        /// Of the scale.
        scale_sigma: f64,
    },
    /// A search that begins elsewhere finds another.
    Fickle,
    /// The pose is within the least move.
    InPlace,
}

impl fmt::Display for UntoldPose {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoLamps => write!(f, "there are no lamps in view"),
            Self::MuchSaturated => {
                write!(f, "{:.0} % of it and more are saturated, which are no lamps", 100.0 * MOST_SATURATED)
            }
            Self::Wide => write!(
                f,
                "its light comes from more than {} % of the frame, as from windows, which are no lamps",
                100.0 * LARGEST_LAMPS
            ),
            Self::WeakFlare => write!(f, "the flare of its lamps does not stand out of the scene"),
            Self::Far => {
                let [turn_deg, scale] = FURTHEST;
                write!(
                    f,
                    "what explains its lamps best is turned by {turn_deg}° or scaled by {} % and more",
                    100.0 * scale
                )
            }
            Self::Unsure { turn_sigma_deg, scale_sigma } => {
                let [turn, scale] = USELESS_SIGMA;
                write!(
                    f,
                    "its flare tells the turn to {turn_sigma_deg:.2}° and the scale to {:.2} %, where {turn}° and {} % are asked",
                    100.0 * scale_sigma,
                    100.0 * scale
                )
            }
            Self::Fickle => {
                write!(
                    f,
                    "what explains its lamps best depends on where it is looked for, as it is not their flare"
                )
            }
            Self::InPlace => write!(f, "the PSF is in its pose"),
        }
    }
}
