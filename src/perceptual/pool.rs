//! Maximum pooling and its gradient.

use rayon::prelude::*;

use super::features::Features;
use crate::kernels::Shape;

/// Takes the largest value of every `side` × `side` window, windows `stride` apart; what is left over at the
/// bottom and on the right belongs to none.
///
/// # Panics
/// When the image is smaller than a window.
pub(super) fn max_pool(x: &Features, side: usize, stride: usize) -> Features {
    let from = x.shape;
    let shape = pooled(from, side, stride);
    let mut values = vec![f32::NEG_INFINITY; shape.len()];
    values.par_chunks_mut(shape.row_len()).enumerate().for_each(|(row, to)| {
        let (image, y) = (row / shape.height, row % shape.height);
        for dy in 0..side {
            let at = image * from.image_len() + (y * stride + dy) * from.row_len();
            let line = &x.values[at..at + from.row_len()];
            for (column, to) in to.chunks_exact_mut(shape.channels).enumerate() {
                let window = &line[column * stride * from.channels..][..side * from.channels];
                for pixel in window.chunks_exact(from.channels) {
                    to.iter_mut().zip(pixel).for_each(|(to, value)| *to = to.max(*value));
                }
            }
        }
    });
    Features { values, shape }
}

fn pooled(from: Shape, side: usize, stride: usize) -> Shape {
    assert!(from.height.min(from.width) >= side, "windows of {side} in {from:?}");
    let extent = |extent: usize| (extent - side) / stride + 1;
    Shape { height: extent(from.height), width: extent(from.width), ..from }
}

/// Takes the gradient of a 2 × 2 pooling of stride 2 back to what was pooled, which a ReLU gave: it goes to the
/// first of the largest values of each window, and nowhere when that is not positive.
pub(super) fn rectified_pool_gradient(x: &Features, pooled: &Features, gradient: &Features) -> Features {
    let (from, to) = (gradient.shape, x.shape);
    let mut values = vec![0.0; to.len()];
    for pixel in 0..from.pixels() {
        let (row, column) = (pixel / from.width, pixel % from.width);
        let (image, y) = (row / from.height, row % from.height);
        for c in 0..from.channels {
            let at = pixel * from.channels + c;
            let largest = pooled.values[at];
            let window = (0..4).map(|tap| {
                let (y, x) = (2 * y + tap / 2, 2 * column + tap % 2);
                image * to.image_len() + (y * to.width + x) * to.channels + c
            });
            let place = window.into_iter().find(|&place| x.values[place] >= largest);
            if let (Some(place), true) = (place, largest > 0.0) {
                values[place] = gradient.values[at];
            }
        }
    }
    Features { values, shape: to }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_overlap_and_leave_a_rest() {
        let values = (0..16).map(|i| ((i * 7) % 16) as f32).collect();
        let x = Features { values, shape: Shape::new(1, 4, 4, 1) };
        // 0 7 14 5 / 12 3 10 1 / 8 15 6 13 / 4 11 2 9
        assert_eq!(max_pool(&x, 2, 2).values, [12.0, 14.0, 15.0, 13.0]);
        assert_eq!(max_pool(&x, 3, 2).values, [15.0]);
    }

    #[test]
    fn gradients_go_to_the_first_of_the_largest() {
        let x =
            Features { values: vec![1.0, 3.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0], shape: Shape::new(1, 2, 4, 1) };
        let x = Features { values: [&x.values[..2], &[0.0, 0.0], &[3.0, 1.0], &[0.0, 0.0]].concat(), ..x };
        let pooled = max_pool(&x, 2, 2);
        let gradient = Features { values: vec![5.0, 7.0], shape: pooled.shape };
        let back = rectified_pool_gradient(&x, &pooled, &gradient);
        assert_eq!(back.values, [0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
