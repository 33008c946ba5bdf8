//! From what a camera stores to linear light: levels, mosaics, exposure times, alignment, dark frames, fusion of brackets.
//!
//! [`develop`] goes the whole way from files; [`fuse`](fuse()) does of pictures that somebody else has read.

pub mod alignment;
mod alike;
pub mod bayer;
pub mod bracket;
mod brightness;
mod cut_off;
mod darks;
mod develop;
mod exposure_times;
mod frames;
pub mod fuse;
mod groups;
pub mod inpaint;
mod levels;
mod lone;
mod pedestal;
mod pictures;
mod plausible;
pub mod point_source;
mod positions;
mod scaling;
mod shots;
mod summary;
mod told;
mod warnings;

pub use alignment::Motion;
pub use bracket::{Bracket, show_time};
pub use cut_off::CutOff;
pub use develop::{Developed, develop};
pub use exposure_times::{SAME_TIME, relative_times};
pub use frames::Uneven;
pub use fuse::{FuseConfig, Fused, MergeRule, fuse};
pub use groups::{CaptureFiles, CaptureGroups};
pub use pictures::{Pictures, names_of, read_mask};
pub use positions::{Interleaved, interleave};
pub use told::{PSF_BRACKET, SCENE_BRACKET, Told, ToldLevels};
pub use warnings::uncorrected;
