//! Turns a seed into HDR scenes: [`natural`] ones, and the recordings of a point source.

pub mod natural;
pub mod point_source;
mod set;

pub use set::{MOST_PIXELS, MOST_SCENES, SceneSet, scene_seed};
