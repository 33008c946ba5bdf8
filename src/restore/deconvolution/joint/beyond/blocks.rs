//! Where in a frame light explains what is seen there.

use ndarray::Array2;

/// Pixels along a side of a block.
const BLOCK_PX: usize = 8;

/// Shares of the blocks that are left out, those first in which light explains most, and the part of the misfit of the others that it
/// leaves at most. The dots of a lamp are all over the frame, and where they do not show they do no harm: of 21 captures with lamps outside,
/// by exact PSFs and by such that are turned by 0.3° and larger by 0.5 %, these leave 0.15 to 0.995, 0.21 to 1.002 and 0.4 to 1.009. What imitates the
/// edge of a window that the frame cuts in two, as the cut edge of a PSF's file does, explains that in few blocks and is wrong in others:
/// 37 captures that came to 24.4 dB so, for 38.5 without, leave 0.94 and more of the first, and 1.005 and more of the second. The third is
/// for small frames, of which an edge is a larger part: one of 64 × 64 pixels leaves 0.67, 0.86 and 1.45.
const ELSEWHERE: [(f64, f64); 3] = [(0.05, 0.999), (0.1, 1.003), (0.2, 1.02)];

/// The misfit in each block of a frame: without a light, and with it.
pub(super) struct Blocks(Vec<[f64; 2]>);

impl Blocks {
    /// Of what is left of each pixel without a light and with it; the first's sum of squares is `before`, and becomes 1.
    pub(super) fn of([without, with]: [&Array2<f32>; 2], before: f64) -> Self {
        let (height, width) = without.dim();
        let columns = width.div_ceil(BLOCK_PX);
        let mut blocks = vec![[0.0; 2]; height.div_ceil(BLOCK_PX) * columns];
        for (of_light, left) in [without, with].into_iter().enumerate() {
            for ((y, x), left) in left.indexed_iter() {
                blocks[y / BLOCK_PX * columns + x / BLOCK_PX][of_light] += f64::from(*left).powi(2) / before;
            }
        }
        Self(blocks)
    }

    /// Those of two channels.
    pub(super) fn and(mut self, other: &Self) -> Self {
        for (block, other) in self.0.iter_mut().zip(&other.0) {
            *block = [block[0] + other[0], block[1] + other[1]];
        }
        self
    }

    /// Whether the light explains what is seen in more than few blocks, and is not wrong in the others.
    pub(super) fn are_explained(mut self) -> bool {
        let gain = |[without, with]: &[f64; 2]| without - with;
        self.0.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
        ELSEWHERE.iter().all(|(share, most)| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a length")]
            let left_out = (share * self.0.len() as f64).ceil() as usize;
            let (mut without, mut with) = (0.0, 0.0);
            for block in &self.0[left_out..] {
                (without, with) = (without + block[0], with + block[1]);
            }
            with <= most * without
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is left of 64 × 64 pixels, of those in the first `columns` of the first rows, and of others.
    fn left(columns: usize, in_few: f32, elsewhere: f32) -> Array2<f32> {
        Array2::from_shape_fn((64, 64), |(y, x)| if y < 8 && x < columns { in_few } else { elsewhere })
    }

    #[test]
    fn light_that_explains_an_edge_and_is_wrong_elsewhere_explains_nothing() {
        let is_explained = |columns: usize, in_few: f32, elsewhere: f32| {
            let before = left(columns, 20.0, 1.0);
            let sum = before.iter().map(|left| f64::from(*left).powi(2)).sum();
            let of_channel = || Blocks::of([&before, &left(columns, in_few, elsewhere)], sum);
            of_channel().and(&of_channel()).are_explained()
        };
        assert!(is_explained(8, 2.0, 0.9) && is_explained(8, 20.0, 0.9) && is_explained(64, 2.0, 1.0));
        assert!(!is_explained(8, 2.0, 1.0) && !is_explained(8, 2.0, 1.01));
        assert!(!is_explained(64, 2.0, 1.03), "an edge along the frame");
    }
}
