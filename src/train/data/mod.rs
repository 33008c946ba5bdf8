//! Where a training's samples come from: anything that can cut a crop out of an item.

mod cache;
mod examples;
mod on_the_fly;
mod stored;

use std::path::PathBuf;

use rayon::prelude::*;

use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, Domain, Image, Linear, ToneMappedImage};
use crate::core::kernel_code::KernelCode;
use crate::core::rng::Rng;
use crate::io;
use crate::network::Planes;

pub use examples::ExampleData;
pub use on_the_fly::{Degrade, OnTheFlyData};
pub use stored::StoredData;

/// One sample: a crop as the display shows it, as it should be, and the code of the kernel between them.
#[derive(Clone, Debug, PartialEq)]
pub struct Patch {
    /// The degraded crop.
    pub degraded: ToneMappedImage,
    /// The clean crop, of the same sides.
    pub ground_truth: ToneMappedImage,
    /// The kernel's code, where the data have codes.
    pub code: Option<KernelCode>,
    /// The planes of the degraded crop that the network reads.
    pub planes: Planes,
}

/// Items that samples can be cut from.
///
/// A sample must depend on its arguments alone, so that trainings repeat and resume exactly.
pub trait TrainingData: Sync {
    /// Number of items.
    fn len(&self) -> usize;

    /// Whether there are no items.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Cuts a square of `side` pixels out of item `item`, with its place and all else that is random drawn
    /// from `rng`.
    ///
    /// # Errors
    /// When the item cannot be read, or is smaller than the square.
    fn patch(&self, item: usize, side: usize, rng: &mut Rng) -> Result<Patch>;

    /// Refuses, before the work, items that are smaller than squares of `side` pixels, as far as files say it at their beginning.
    ///
    /// # Errors
    /// As [`patch`](Self::patch), naming the first such item.
    fn check_size(&self, side: usize) -> Result<()>;

    /// Bytes of all that the data would keep in memory, were there room for it.
    ///
    /// # Errors
    /// When a file cannot be read.
    fn kept_bytes(&self) -> Result<u64>;

    /// What a validation scores item `item` by, beside all items together.
    fn tags(&self, _item: usize) -> &[String] {
        &[]
    }
}

/// A square within an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Its first row.
    pub top: usize,
    /// Its first column.
    pub left: usize,
    /// Its side.
    pub side: usize,
}

impl Window {
    /// Draws the place of a square of `side` pixels in an image of `height` × `width`, every place being
    /// equally likely.
    ///
    /// # Errors
    /// [`Error::Config`] when the image is smaller than the square.
    pub fn draw(side: usize, height: usize, width: usize, rng: &mut Rng) -> Result<Self> {
        use rand::RngExt as _;
        Self::check_fits(side, [height, width])?;
        let top = rng.random_range(0..=height - side);
        let left = rng.random_range(0..=width - side);
        Ok(Self { top, left, side })
    }

    /// Refuses an image of `[height, width]` that is smaller than squares of `side` pixels.
    fn check_fits(side: usize, [height, width]: [usize; 2]) -> Result<()> {
        if side <= height.min(width) {
            return Ok(());
        }
        let reason = format!("{side} pixels do not fit an image of {height} × {width}; make it smaller");
        Err(Error::config("data.crop or validation.crop", reason))
    }

    /// Cuts the square out of an image.
    ///
    /// # Panics
    /// When the square reaches outside of the image.
    pub fn of<D: Domain>(&self, image: &Image<D>) -> Image<D> {
        image.crop(self.top, self.left, self.side, self.side)
    }
}

/// Samples in memory.
#[derive(Clone, Debug, Default)]
pub struct InMemory(pub Vec<Patch>);

impl TrainingData for InMemory {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn patch(&self, item: usize, side: usize, rng: &mut Rng) -> Result<Patch> {
        let whole = &self.0[item];
        let window = Window::draw(side, whole.degraded.height(), whole.degraded.width(), rng)?;
        Ok(Patch {
            degraded: window.of(&whole.degraded),
            ground_truth: window.of(&whole.ground_truth),
            code: whole.code.clone(),
            planes: whole.planes.crop(window.top, window.left, side, side),
        })
    }

    /// Of nothing but what is there.
    fn kept_bytes(&self) -> Result<u64> {
        Ok(0)
    }

    fn check_size(&self, side: usize) -> Result<()> {
        let size = |patch: &Patch| [patch.degraded.height(), patch.degraded.width()];
        self.0.iter().try_for_each(|patch| Window::check_fits(side, size(patch)))
    }
}

/// Bytes of the pixels of files' images, in memory.
fn pixel_bytes(files: &[PathBuf]) -> Result<u64> {
    let bytes = |path: &PathBuf| -> Result<u64> {
        let [height, width] = io::read_image_size::<Linear>(path, None)?;
        Ok((CHANNELS * height * width * size_of::<f32>()) as u64)
    };
    files.par_iter().map(bytes).sum()
}

/// Refuses files whose images, without a margin on each side, are smaller than squares of `side` pixels.
fn check_files(files: &[PathBuf], margin: usize, side: usize) -> Result<()> {
    let check = |path: &PathBuf| {
        let frame = io::read_image_size::<Linear>(path, None)?.map(|side| side.saturating_sub(2 * margin));
        Window::check_fits(side, frame)
            .map_err(|error| error.while_doing(format!("checking {}", path.display())))
    };
    files.par_iter().find_map_first(|path| check(path).err()).map_or(Ok(()), Err)
}
