//! Times a restoration on small parts of a capture, from which follows what it takes for all of it.

use super::{Capture, Restoration};
use crate::batch::{LinearCost, Spent, spent_on};
use crate::core::error::Result;
use crate::core::progress::Progress;
use crate::io::AnyImage;

/// The sides of the parts that are restored.
const SIDES: [usize; 2] = [128, 256];

impl Restoration {
    /// The cost of a restoration by the number of pixels, from two parts in the middle of a capture, or from all of a
    /// smaller one.
    ///
    /// # Errors
    /// Those of [`Restoration::restore`].
    pub fn cost(&self, capture: &Capture, progress: &Progress) -> Result<LinearCost> {
        self.prepare();
        let mut measured: Vec<(f64, Spent)> = Vec::new();
        for side in SIDES {
            let part = Capture { image: middle(&capture.image, side), info: capture.info.clone() };
            let [height, width] = part.image.size();
            let pixels = (height * width) as f64;
            if measured.last().is_some_and(|(less, _)| *less >= pixels) {
                break;
            }
            let spent = spent_on(|| self.restore(part.clone(), &progress.without_bars()).map(|_| ()))?;
            measured.push((pixels, spent));
        }
        Ok(match measured[..] {
            [less, more] => LinearCost::through(less, more),
            [(pixels, spent), ..] => LinearCost::of_each(spent.times(1.0 / pixels)),
            [] => LinearCost::default(),
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
        AnyImage::ToneMapped(image, curve) => {
            AnyImage::ToneMapped(image.crop(top, left, rows, columns), *curve)
        }
    }
}
