//! From what a camera stores to linear light: exposure times, alignment, mosaics, dark frames, fusion of brackets.

pub mod alignment;
pub mod bayer;
pub mod bracket;
mod darks;
mod exposure_times;
mod frames;
pub mod fuse;
pub mod inpaint;

pub use alignment::Motion;
pub use bracket::{Bracket, show_time};
pub use exposure_times::{SAME_TIME, relative_times};
pub use frames::Uneven;
pub use fuse::{FuseConfig, Fused, MergeRule, fuse};
