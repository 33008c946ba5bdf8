//! Says how what is known at a few places of the frame varies between them.

use ndarray::Array2;

use super::error::{Error, Result};

/// A regular grid of places (nodes) over the frame, the outermost on the centres of the frame's outermost pixels.
///
/// Nodes are counted row by row. Between them everything is interpolated bilinearly: the weights of all nodes at a pixel
/// are non-negative and sum to one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldGrid {
    rows: usize,
    columns: usize,
}

impl FieldGrid {
    /// Makes a grid; one row or column stands for no variation in that direction.
    ///
    /// # Errors
    /// [`Error::Config`] when a side is zero.
    pub fn new(rows: usize, columns: usize) -> Result<Self> {
        if rows == 0 || columns == 0 {
            return Err(Error::config(
                "field",
                format!("needs at least 1 × 1 places, found {rows} × {columns}"),
            ));
        }
        Ok(Self { rows, columns })
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.rows * self.columns
    }

    /// Whether there are no nodes; there always are.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The weight of one node at every pixel of a frame, `[height, width]`.
    ///
    /// # Panics
    /// When there is no such node.
    pub fn weights(&self, node: usize, [height, width]: [usize; 2]) -> Array2<f32> {
        assert!(node < self.len(), "node {node} of {}", self.len());
        let rows = hat(node / self.columns, self.rows, height);
        let columns = hat(node % self.columns, self.columns, width);
        Array2::from_shape_fn((height, width), |(y, x)| rows[y] * columns[x])
    }
}

/// The weight of node `index` of `count` along a side of `length` pixels.
fn hat(index: usize, count: usize, length: usize) -> Vec<f32> {
    let scale = if length > 1 { (count - 1) as f64 / (length - 1) as f64 } else { 0.0 };
    let weight = |pixel: usize| (1.0 - (pixel as f64 * scale - index as f64).abs()).max(0.0);
    #[expect(clippy::cast_possible_truncation, reason = "a weight in [0, 1]")]
    (0..length).map(|pixel| weight(pixel) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_sum_to_one_and_belong_to_their_nodes() {
        for (rows, columns, size) in [(3, 2, [11, 9]), (1, 4, [7, 30]), (1, 1, [3, 5]), (2, 2, [1, 8])] {
            let grid = FieldGrid::new(rows, columns).unwrap();
            let sum =
                (0..grid.len()).fold(Array2::<f32>::zeros(size), |sum, node| sum + grid.weights(node, size));
            assert!(sum.iter().all(|v| (v - 1.0).abs() < 1e-6), "{rows} × {columns}: {sum}");
        }
        let grid = FieldGrid::new(3, 3).unwrap();
        assert_eq!(grid.weights(4, [5, 7])[[2, 3]], 1.0);
        assert_eq!(grid.weights(8, [5, 7])[[4, 6]], 1.0);
        assert!(FieldGrid::new(0, 3).is_err());
    }
}
