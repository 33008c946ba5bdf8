//! Continues a frame beyond its border so that it can be repeated without a step.

use std::f32::consts::PI;

use ndarray::{Array2, ArrayView2, Axis, Zip, s};
use rayon::prelude::*;

use super::Border;
use crate::core::fft::fast_length;

/// Height and width of a frame with its continuation: half a PSF on either side together, as far as the frame
/// reaches, and no less than 16 pixels.
pub(super) fn extended_size(image: [usize; 2], psf: [usize; 2], border: Border) -> [usize; 2] {
    match border {
        Border::Periodic => image,
        Border::Smooth | Border::Zero => std::array::from_fn(|axis| {
            let reach = (psf[axis] - 1).min(2 * image[axis]).max(16);
            fast_length(image[axis] + reach)
        }),
    }
}

/// Continues `plane`, which keeps its place at the top left, to `size`: by darkness, or smoothly.
///
/// Smoothly: behind the last pixel of a row comes the row mirrored, fading into the mirrored beginning of the row,
/// which is what stands before its first pixel when the result is repeated; then the same along columns.
pub(super) fn extend(plane: ArrayView2<'_, f32>, size: [usize; 2], border: Border) -> Array2<f32> {
    let (height, width) = plane.dim();
    let mut extended = Array2::zeros(size);
    extended.slice_mut(s![..height, ..width]).assign(&plane);
    if border == Border::Zero {
        return extended;
    }
    let (mut known, mut below) = extended.view_mut().split_at(Axis(0), height);
    let around = Around::new(width, size[1] - width);
    known.axis_iter_mut(Axis(0)).into_par_iter().for_each(|row| {
        let (known, mut unknown) = row.split_at(Axis(0), width);
        for (value, (weight, behind, before)) in unknown.iter_mut().zip(&around.0) {
            *value = (1.0 - weight) * known[*behind] + weight * known[*before];
        }
    });
    let around = Around::new(height, size[0] - height);
    below.axis_iter_mut(Axis(0)).into_par_iter().zip(&around.0).for_each(
        |(row, (weight, behind, before))| {
            Zip::from(row).and(known.row(*behind)).and(known.row(*before)).for_each(
                |value, behind, before| {
                    *value = (1.0 - weight) * behind + weight * before;
                },
            );
        },
    );
    extended
}

/// Of each place behind a line: how far it has faded, the place of the line that is mirrored there from behind, and that
/// from before.
struct Around(Vec<(f32, usize, usize)>);

impl Around {
    #[expect(clippy::cast_precision_loss, reason = "borders are short")]
    fn new(len: usize, gap: usize) -> Self {
        let of_place = |i: usize| {
            let weight = 0.5 - 0.5 * (PI * (i as f32 + 0.5) / gap as f32).cos();
            (weight, len - 1 - mirrored(i, len), mirrored(gap - 1 - i, len))
        };
        Self((0..gap).map(of_place).collect())
    }
}

/// The `index`-th pixel from the border on, turning back at the far end.
fn mirrored(index: usize, len: usize) -> usize {
    let phase = index % (2 * len);
    if phase < len { phase } else { 2 * len - 1 - phase }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn continues_a_ramp_without_a_step() {
        let ramp = Array2::from_shape_fn((20, 30), |(y, x)| (y + x) as f32);
        let extended = extend(ramp.view(), [48, 64], Border::Smooth);
        assert_eq!(extended.slice(s![..20, ..30]), ramp);
        let (height, width) = extended.dim();
        for y in 0..height {
            for x in 0..width {
                let step = (extended[[y, x]] - extended[[y, (x + 1) % width]]).abs();
                // A ramp of 29 that falls over 34 pixels along half a cosine, plus the mirrored slopes.
                assert!(step < 4.0, "a step of {step} at {y}, {x}");
            }
        }
    }

    #[test]
    fn a_border_longer_than_the_frame_is_filled() {
        let extended = extend(Array2::from_elem((2, 3), 7.0).view(), [32, 20], Border::Smooth);
        assert!(extended.iter().all(|&v| (v - 7.0_f32).abs() < 1e-5));
    }
}
