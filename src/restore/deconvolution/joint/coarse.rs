//! A capture at half the resolution, where steps cost a quarter and fewer of them tell the light of one place from another's.

use ndarray::{Array2, Array3, ArrayView2, ArrayView3, Axis, Zip, s};

use crate::core::error::Result;
use crate::core::image::{LinearImage, row_of};
use crate::core::psf::Psf;

/// The side from which captures are halved: below, hardly a pixel is left that would tell lamps from their flare.
const LEAST_SIDE: usize = 64;

/// A capture at half the resolution.
pub(super) struct Half {
    /// The means of blocks of 2 × 2 pixels; at the end of odd sides, of smaller ones.
    pub(super) image: LinearImage,
    pub(super) psf: Psf,
    /// Blocks with a saturated pixel, of each channel: their means are lower bounds.
    pub(super) saturated: Vec<Array2<bool>>,
}

impl Half {
    /// Halves a capture, unless it is small.
    pub(super) fn of(image: &LinearImage, psf: &Psf, saturated: &[Array2<bool>]) -> Result<Option<Self>> {
        if image.height().min(image.width()) < LEAST_SIDE {
            return Ok(None);
        }
        let mean = |plane: ArrayView2<'_, f32>| of_blocks(plane, mean);
        let any = |set: &Array2<bool>| of_blocks(set.view(), |block| block.contains(&true));
        Ok(Some(Self {
            image: LinearImage::from_planes(of_channels(image.planes(), mean))?,
            psf: Psf::from_energy(of_channels(psf.planes(), between_blocks))?,
            saturated: saturated.iter().map(any).collect(),
        }))
    }
}

/// The means of blocks of 2 × 2 pixels; at the end of odd sides, of smaller ones.
pub(super) fn mean_of_blocks(plane: ArrayView2<'_, f32>) -> Array2<f32> {
    of_blocks(plane, mean)
}

fn mean(block: &[f32]) -> f32 {
    block.iter().sum::<f32>() / block.len() as f32
}

fn of_channels(
    planes: ArrayView3<'_, f32>,
    half: impl Fn(ArrayView2<'_, f32>) -> Array2<f32>,
) -> Array3<f32> {
    let halves: Vec<_> = planes.outer_iter().map(half).collect();
    let views: Vec<_> = halves.iter().map(|half| half.view()).collect();
    ndarray::stack(Axis(0), &views).expect("channels are of one size")
}

/// What there is of each block of 2 × 2 pixels; at the end of odd sides, of smaller ones.
fn of_blocks<T: Copy + Sync, U: Clone + Default + Send>(
    plane: ArrayView2<'_, T>,
    of_block: impl Fn(&[T]) -> U + Sync + Send,
) -> Array2<U> {
    let (height, width) = plane.dim();
    let mut halved = Array2::default((height.div_ceil(2), width.div_ceil(2)));
    Zip::indexed(halved.rows_mut()).par_for_each(|y, mut out| {
        let row = |y: usize| row_of(plane, y);
        let pairs = row(2 * y).chunks(2);
        match 2 * y + 1 < height {
            true => out.iter_mut().zip(pairs.zip(row(2 * y + 1).chunks(2))).for_each(|(out, pairs)| {
                *out = match pairs {
                    ([a, b], [c, d]) => of_block(&[*a, *b, *c, *d]),
                    (above, below) => of_block(&[above[0], below[0]]),
                };
            }),
            false => out.iter_mut().zip(pairs).for_each(|(out, pair)| *out = of_block(pair)),
        }
    });
    halved
}

/// The PSF between blocks whose pixels are alike, about the centre N // 2.
///
/// # Equation
/// `k'[m] = Σ w(t)·k[2m + t]` along both axes, of offsets from the centre, with w = ½, 1, ½ for t = −1, 0, 1.
pub(super) fn between_blocks(psf: ArrayView2<'_, f32>) -> Array2<f32> {
    const SHARES: [f32; 3] = [0.5, 1.0, 0.5];
    let (height, width) = psf.dim();
    let reach = |length: usize| (length / 2).div_ceil(2);
    let [reach_y, reach_x] = [reach(height), reach(width)];
    // Index m of the half is offset m − reach, of which 2(m − reach) + t is at index 2m + t + length/2 − 2·reach.
    let place = |index: usize, tap: usize, length: usize| {
        (2 * index + tap + length / 2).checked_sub(2 * reach(length) + 1).filter(|place| *place < length)
    };
    let mut half = Array2::zeros((2 * reach_y + 1, 2 * reach_x + 1));
    Zip::indexed(&mut half).par_for_each(|(my, mx), out| {
        for (ty, of_y) in SHARES.iter().enumerate() {
            for (tx, of_x) in SHARES.iter().enumerate() {
                if let (Some(y), Some(x)) = (place(my, ty, height), place(mx, tx, width)) {
                    *out += of_y * of_x * psf[[y, x]];
                }
            }
        }
    });
    half
}

/// The light of saturated pixels after a `scene` at half the resolution: what its blocks have beyond the other pixels of each,
/// whose light is that of the capture.
pub(super) fn light(
    scene: ArrayView2<'_, f32>,
    saturated: &Array2<bool>,
    capture: ArrayView2<'_, f32>,
) -> Array2<f32> {
    Zip::indexed(saturated).par_map_collect(|(y, x), is_saturated| {
        if !*is_saturated {
            return 0.0;
        }
        let block = block(y / 2, x / 2, saturated.dim());
        let (saturated, capture) = (saturated.slice(block), capture.slice(block));
        let (mut light, mut sharers) = (scene[[y / 2, x / 2]] * capture.len() as f32, 0.0);
        for (is_saturated, y) in saturated.iter().zip(&capture) {
            match is_saturated {
                true => sharers += 1.0,
                false => light -= y.max(0.0),
            }
        }
        (light / sharers).max(0.0)
    })
}

/// The pixels of a block; those at the end of odd sides are smaller.
fn block(
    y: usize,
    x: usize,
    (height, width): (usize, usize),
) -> ndarray::SliceInfo<[ndarray::SliceInfoElem; 2], ndarray::Ix2, ndarray::Ix2> {
    s![2 * y..(2 * y + 2).min(height), 2 * x..(2 * x + 2).min(width)]
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::super::frame::Frame;
    use super::super::tests::panel_psf;
    use super::*;
    use crate::core::fft::TransformPrecision;
    use crate::restore::deconvolution::Border;

    #[test]
    fn blocks_see_what_pixels_see_that_are_alike_in_each() {
        for side in [64, 65] {
            let psf = panel_psf(side);
            let frame =
                |size, side| Frame::new([size; 2], [side; 2], Border::Zero, TransformPrecision::Double);
            let fine = Array2::from_shape_fn((96, 96), |(y, x)| ((y / 2 * 7 + x / 2 * 3) % 11) as f32);
            let coarse = Array2::from_shape_fn((48, 48), |(y, x)| fine[[2 * y, 2 * x]]);
            let half = between_blocks(psf.view());
            assert_eq!(half.dim(), (65 - 32, 65 - 32));
            assert!((half.sum() - 1.0).abs() < 1e-6);
            let (frame, frame_of_half) = (frame(96, side), frame(48, half.dim().0));
            let [mut seen, mut seen_by_half] = [Array2::zeros((96, 96)), Array2::zeros((48, 48))];
            frame.blur(psf.view()).unwrap().apply(&fine, &mut seen);
            frame_of_half.blur(half.view()).unwrap().apply(&coarse, &mut seen_by_half);
            let means = of_blocks(seen.view(), mean);
            for (mean, seen) in means.iter().zip(&seen_by_half) {
                assert!((mean - seen).abs() < 1e-4 * mean.max(1.0), "{mean} {seen}");
            }
        }
    }

    #[test]
    fn saturated_pixels_share_what_their_block_has_beyond_the_others() {
        let saturated = array![[true, false, true], [true, false, false], [false, false, true]];
        let capture = array![[16.0, 1.0, 16.0], [16.0, 3.0, 2.0], [0.0, 0.0, 16.0]];
        // Blocks have 4 × 51 = 200 + 4, 2 × 30 = 58 + 2, and 20; what is not saturated is nothing to them.
        let light = light(array![[51.0, 30.0], [7.0, 20.0]].view(), &saturated, capture.view());
        assert_eq!(light, array![[100.0, 0.0, 58.0], [100.0, 0.0, 0.0], [0.0, 0.0, 20.0]]);
    }

    #[test]
    fn small_captures_are_not_halved() {
        let psf = Psf::from_energy(Array3::ones((3, 5, 5))).unwrap();
        let half = |height, width| {
            let image = LinearImage::from_planes(Array3::ones((3, height, width))).unwrap();
            let saturated = vec![Array2::from_elem((height, width), true); 3];
            Half::of(&image, &psf, &saturated).unwrap()
        };
        assert!(half(63, 200).is_none());
        let half = half(65, 64).unwrap();
        assert_eq!((half.image.height(), half.image.width()), (33, 32));
        assert_eq!(half.image.channel(1)[[32, 31]], 1.0);
        assert_eq!(half.saturated[2].dim(), (33, 32));
    }
}
