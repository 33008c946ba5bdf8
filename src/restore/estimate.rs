//! Times a restoration on small parts of a capture, from which follows what it takes for all of it.

use std::time::Instant;

use super::{Capture, Restoration};
use crate::core::error::Result;
use crate::core::estimate::LinearTime;
use crate::core::progress::Progress;
use crate::io::AnyImage;

/// The sides of the parts that are restored.
const SIDES: [usize; 2] = [128, 256];

impl Restoration {
    /// The time of a restoration by the number of pixels, from two parts in the middle of a capture, or from all of a
    /// smaller one.
    ///
    /// # Errors
    /// Those of [`Restoration::restore`].
    pub fn time(&self, capture: &Capture, progress: &Progress) -> Result<LinearTime> {
        self.prepare();
        let mut measured: Vec<(f64, f64)> = Vec::new();
        for side in SIDES {
            let part = Capture { image: middle(&capture.image, side), info: capture.info.clone() };
            let [height, width] = part.image.size();
            let pixels = (height * width) as f64;
            if measured.last().is_some_and(|(less, _)| *less >= pixels) {
                break;
            }
            let started = Instant::now();
            self.restore(part, &progress.without_bars())?;
            measured.push((pixels, started.elapsed().as_secs_f64()));
        }
        Ok(match measured[..] {
            [less, more] => LinearTime::through(less, more),
            [(pixels, seconds), ..] => LinearTime { fixed: 0.0, each: seconds / pixels },
            [] => LinearTime::default(),
        })
    }
}

/// The middle of an image, of this side where it has as much.
fn middle(image: &AnyImage, side: usize) -> AnyImage {
    let [height, width] = image.size();
    let [rows, columns] = [height.min(side), width.min(side)];
    // On even places, where mosaics begin and networks halve.
    let [top, left] = [(height - rows) / 4 * 2, (width - columns) / 4 * 2];
    match image {
        AnyImage::Linear(image) => AnyImage::Linear(image.crop(top, left, rows, columns)),
        AnyImage::ToneMapped(image) => AnyImage::ToneMapped(image.crop(top, left, rows, columns)),
    }
}
