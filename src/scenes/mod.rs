//! Turns a seed into HDR scenes: for the demo of three kinds, a street at night, a room with a bright window, and a board
//! of text and fine texture; for training, [`natural`] ones.
//!
//! The demo's are painted back to front with shapes that shine, in units in which a mid-grey wall in the shade is
//! about 0.2. Lamps exceed the scene's median by factors of 10³ to 10⁵, as real ones do.

mod board;
mod canvas;
pub mod natural;
pub mod point_source;
mod room;
mod script;
mod set;
mod street;
mod values;

pub use set::{MOST_PIXELS, SceneSet, scene_seed};

use rayon::prelude::*;

use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::core::rng;

/// What a scene shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneKind {
    /// A street at night: facades with lit windows, street lamps, head lights.
    Street,
    /// A room seen against a bright window.
    Room,
    /// A board with text, line patterns and colour patches under a spot light.
    Board,
}

impl SceneKind {
    /// All kinds, in the order in which [`scenes`] cycles through them.
    pub const ALL: [Self; 3] = [Self::Street, Self::Room, Self::Board];

    /// The name used in file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Street => "street",
            Self::Room => "room",
            Self::Board => "board",
        }
    }
}

/// A painted scene and its name, which is unique within a set.
#[derive(Clone, Debug)]
pub struct PaintedScene {
    /// `street-00`, `room-01`, …; of a natural scene, its kind and seed.
    pub name: String,
    /// The scene's light.
    pub image: LinearImage,
}

/// Paints scene `index` of `kind`: the same seed and index give the same scene.
///
/// # Errors
/// [`Error::Shape`](crate::core::error::Error::Shape) when `size_px` is zero.
pub fn paint(kind: SceneKind, index: usize, size_px: usize, seed: u64) -> Result<PaintedScene> {
    let name = format!("{}-{index:02}", kind.name());
    let mut rng = rng::stream(seed, &format!("scene/{name}"));
    let shapes = match kind {
        SceneKind::Street => street::shapes(&mut rng),
        SceneKind::Room => room::shapes(&mut rng),
        SceneKind::Board => board::shapes(&mut rng),
    };
    Ok(PaintedScene { name, image: canvas::render(&shapes, size_px)? })
}

/// Paints `count` scenes, cycling through the kinds, starting with scene `first` of the endless sequence.
///
/// # Errors
/// As [`paint`].
pub fn scenes(first: usize, count: usize, size_px: usize, seed: u64) -> Result<Vec<PaintedScene>> {
    let kinds = SceneKind::ALL;
    (first..first + count)
        .into_par_iter()
        .map(|i| paint(kinds[i % kinds.len()], i / kinds.len(), size_px, seed))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn median(image: &LinearImage) -> f32 {
        let mut values = image.as_slice().to_vec();
        values.sort_by(f32::total_cmp);
        values[values.len() / 2]
    }

    #[test]
    fn peaks_exceed_the_median_as_lamps_do() {
        for scene in scenes(0, 6, 128, 7).unwrap() {
            let ratio = scene.image.max() / median(&scene.image);
            assert!((1e3..=1e5).contains(&ratio), "{}: {ratio}", scene.name);
        }
    }

    #[test]
    fn the_same_seed_paints_the_same_scene() {
        let paint_street = |seed| paint(SceneKind::Street, 3, 48, seed).unwrap().image;
        assert_eq!(paint_street(1), paint_street(1));
        assert_ne!(paint_street(1), paint_street(2));
    }
}
