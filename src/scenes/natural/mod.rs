//! Turns a seed into an HDR scene with the statistics of natural images, in any number, to train restoration on.
//!
//! Things of power-law sizes that cover each other give the power spectrum of natural images, f⁻² with some spread, and
//! the sparse derivatives that smooth noise lacks; skies, foliage, streets, rooms, pages and glints give their lights:
//! the median is a mid-tone of 0.04 to 0.5, and lamps and suns reach up to 10⁶. Edges are those of outlines sampled finer
//! than the pixels and averaged, as a lens and the pixels' areas do.

mod blur;
mod draw;
mod easel;
mod film;
mod foliage;
mod glints;
mod grain;
mod indoor;
mod leaves;
mod lettering;
mod light;
mod night;
mod outline;
mod overlay;
mod page;
mod sky;
mod surface;
#[cfg(test)]
mod tests;
mod texture;

use rand::RngExt as _;
use serde::{Deserialize, Serialize};

use self::easel::Easel;
use crate::core::error::{Error, Result};
use crate::core::image::LinearImage;
use crate::core::rng;

/// A painted scene and its name, which is unique among those of its size.
#[derive(Clone, Debug)]
pub struct PaintedScene {
    /// Its kind and its seed.
    pub name: String,
    /// The scene's light.
    pub image: LinearImage,
}

/// What a natural scene shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NaturalKind {
    /// Dead leaves: discs, blobs and polygons of power-law sizes, evenly lit.
    Leaves,
    /// The same, dark below and light above, with soft shadows.
    LitLeaves,
    /// Leaves of trees with gaps of bright sky.
    Foliage,
    /// A landscape under a sky, mostly with a sun.
    Sky,
    /// A street at night.
    Night,
    /// A room with windows and lamps.
    Indoor,
    /// Pages of text and line patterns.
    Page,
    /// Many small highlights on gravel or water.
    Glints,
    /// Stone, cloth, clouds: surfaces without outlines, of which the images of nature have many. Painted where it is asked for.
    Texture,
}

impl NaturalKind {
    /// The kinds that seeds draw, each with its share of them in percent.
    pub const SHARES: [(Self, u32); 8] = [
        (Self::Leaves, 16),
        (Self::LitLeaves, 12),
        (Self::Foliage, 18),
        (Self::Sky, 13),
        (Self::Night, 13),
        (Self::Indoor, 12),
        (Self::Page, 8),
        (Self::Glints, 8),
    ];

    /// The kind of scene that [`natural`] paints of a seed.
    ///
    /// # Panics
    /// Never: the shares add up to 100.
    pub fn of_seed(seed: u64) -> Self {
        let mut drawn = rng::stream(seed, "natural/kind").random_range(0..100);
        for (kind, share) in Self::SHARES {
            if drawn < share {
                return kind;
            }
            drawn -= share;
        }
        unreachable!("the shares add up to 100")
    }

    /// The name used in file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Leaves => "leaves",
            Self::LitLeaves => "lit-leaves",
            Self::Foliage => "foliage",
            Self::Sky => "sky",
            Self::Night => "night",
            Self::Indoor => "indoor",
            Self::Page => "page",
            Self::Glints => "glints",
            Self::Texture => "texture",
        }
    }
}

/// Paints the scene of a seed, `size` being its height and width in pixels: the same seed and size give the same scene.
///
/// The kind follows from the seed alone; another size gives another scene of this kind.
///
/// # Range
/// Linear irradiance from 0 to 10⁶, a fifth of the values at most above 16.
///
/// # Errors
/// [`Error::Shape`] when a side is zero.
pub fn natural(seed: u64, size: [usize; 2]) -> Result<PaintedScene> {
    paint_natural(NaturalKind::of_seed(seed), seed, size)
}

/// As [`natural`], of a given kind.
///
/// # Errors
/// As [`natural`].
pub fn paint_natural(kind: NaturalKind, seed: u64, size: [usize; 2]) -> Result<PaintedScene> {
    if size.contains(&0) {
        let found = format!("{} × {}", size[0], size[1]);
        return Err(Error::shape("scene", "at least 1 × 1", found));
    }
    let mut easel = Easel::new(size, rng::stream(seed, &format!("natural/{}", kind.name())));
    match kind {
        NaturalKind::Leaves => leaves::flat(&mut easel),
        NaturalKind::LitLeaves => leaves::lit(&mut easel),
        NaturalKind::Foliage => foliage::paint(&mut easel),
        NaturalKind::Sky => sky::landscape(&mut easel),
        NaturalKind::Night => night::paint(&mut easel),
        NaturalKind::Indoor => indoor::paint(&mut easel),
        NaturalKind::Page => page::paint(&mut easel),
        NaturalKind::Glints => glints::paint(&mut easel),
        NaturalKind::Texture => texture::paint(&mut easel),
    }
    overlay::add(&mut easel);
    Ok(PaintedScene { name: format!("{}-{seed:016x}", kind.name()), image: easel.develop()? })
}
