//! Rearranges samples between the orders of files and the planes of images.

use ndarray::{Array3, ArrayView3};
use rayon::prelude::*;

/// Gathers planes from samples in any order: the sample of channel c, row y, column x is at
/// `c·strides[0] + y·strides[1] + x·strides[2]`.
///
/// # Panics
/// When a position lies beyond the samples: a broken invariant of the caller.
pub(super) fn gather<T: Copy + Sync>(
    samples: &[T],
    strides: [usize; 3],
    shape: (usize, usize, usize),
    convert: impl Fn(T) -> f32 + Sync,
) -> Array3<f32> {
    let (_, height, width) = shape;
    let mut planes = Array3::zeros(shape);
    let rows = planes.as_slice_mut().expect("a new array is contiguous").par_chunks_mut(width.max(1));
    rows.enumerate().for_each(|(row, target)| {
        let start = row / height * strides[0] + row % height * strides[1];
        let line = samples[start..].iter().step_by(strides[2]);
        for (value, &sample) in target.iter_mut().zip(line) {
            *value = convert(sample);
        }
    });
    planes
}

/// Gathers planes from samples that keep the channels of a pixel together.
pub(super) fn from_interleaved<T: Copy + Sync>(
    samples: &[T],
    shape: (usize, usize, usize),
    convert: impl Fn(T) -> f32 + Sync,
) -> Array3<f32> {
    let (channels, _, width) = shape;
    gather(samples, [1, width * channels, channels], shape, convert)
}

/// Lays planes out with the channels of a pixel together, N bytes a sample.
pub(super) fn to_interleaved<const N: usize>(
    planes: &ArrayView3<'_, f32>,
    convert: impl Fn(f32) -> [u8; N] + Sync,
) -> Vec<u8> {
    let (channels, height, width) = planes.dim();
    let mut bytes = vec![0; channels * height * width * N];
    bytes.par_chunks_mut((channels * width * N).max(1)).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.chunks_exact_mut(channels * N).enumerate() {
            for (c, sample) in pixel.as_chunks_mut::<N>().0.iter_mut().enumerate() {
                *sample = convert(planes[[c, y, x]]);
            }
        }
    });
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gathers_what_was_interleaved() {
        let planes = Array3::from_shape_fn((3, 5, 7), |(c, y, x)| (c * 100 + y * 10 + x) as f32);
        let bytes = to_interleaved(&planes.view(), f32::to_le_bytes);
        let samples = bytes.as_chunks::<4>().0;
        assert_eq!(from_interleaved(samples, planes.dim(), f32::from_le_bytes), planes);
    }
}
