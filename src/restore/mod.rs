//! Turns degraded images into restored ones: by a network, tile by tile, or by deconvolution.

mod angle;
mod areas;
mod capture;
mod cells;
mod censored;
mod config;
pub mod deconvolution;
mod deconvolved;
mod estimate;
mod field;
mod floor;
mod gentle;
mod grey;
mod guard;
mod guided;
mod highlights;
mod kernel;
mod lamps;
mod lateral;
mod levels;
mod likelihood;
mod memory;
mod mirrored;
mod network;
mod notice;
mod outside;
mod parts;
mod peaks;
mod planes;
mod plateau;
mod pose;
mod precision;
mod resemblance;
mod restoration;
mod shaded;
mod shining;
mod solved;
mod symmetric;
mod tiles;
mod unexplained;

pub use crate::network::Precision;
pub use angle::{AngleSearch, FoundAngle, WEAK_LEAD, search_angle};
pub use capture::{Capture, CaptureReading, Restored};
pub use config::{MethodConfig, PoseSource, RestorationConfig, is_guided};
pub use deconvolution::{
    DoubtedNoise, FoundPose, FromOutside, LampOutside, PoseConfig, PoseEstimate, UntoldPose, find_pose,
    find_pose_by_lamp_outside,
};
pub use field::code_map;
pub use floor::Floor;
pub use grey::psf_seen;
pub use highlights::{Highlights, blend_highlights};
pub use kernel::{Angle, KernelFiles, KernelKnowledge};
pub use lamps::Lamp;
pub use lateral::LateralColour;
pub use levels::saturates_about;
pub use memory::{MemoryBudget, MemoryPlan};
pub use notice::Notice;
pub use planes::{PlaneConfig, make_planes};
pub use pose::{Pose, read_pose, write_pose};
pub use precision::in_precision;
pub use resemblance::{LookingLike, Unlike};
pub use restoration::Restoration;
pub use tiles::Tiling;
pub use unexplained::Contradiction;
