//! Says how what is known at a few places of the frame varies between them.

use ndarray::{Array2, Array3};
use sha2::{Digest, Sha256};

use super::error::{Error, Result};
use super::psf::{Psf, hex};

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
    /// [`Error::Config`] when a side is zero, or there are more places than can be counted.
    pub fn new(rows: usize, columns: usize) -> Result<Self> {
        let refuse =
            |what: &str| Err(Error::config("field", format!("needs {what}, found {rows} × {columns}")));
        match rows.checked_mul(columns) {
            Some(0) => refuse("at least 1 × 1 places"),
            Some(_) => Ok(Self { rows, columns }),
            None => refuse("as many places as it names PSFs"),
        }
    }

    /// Number of rows of nodes.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns of nodes.
    pub fn columns(&self) -> usize {
        self.columns
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
    pub fn weights(&self, node: usize, frame: [usize; 2]) -> Array2<f32> {
        self.weights_with_margin(node, frame, 0)
    }

    /// The weight of one node at every pixel of a scene that is larger than the frame by `margin` pixels on each side;
    /// beyond the frame the weights are those of its border, `[height + 2·margin, width + 2·margin]`.
    ///
    /// # Panics
    /// When there is no such node.
    pub fn weights_with_margin(
        &self,
        node: usize,
        [height, width]: [usize; 2],
        margin: usize,
    ) -> Array2<f32> {
        assert!(node < self.len(), "node {node} of {}", self.len());
        let rows = hat(node / self.columns, self.rows, height);
        let columns = hat(node % self.columns, self.columns, width);
        let within = |position: usize, weights: &[f32]| {
            weights[position.saturating_sub(margin).min(weights.len() - 1)]
        };
        Array2::from_shape_fn((height + 2 * margin, width + 2 * margin), |(y, x)| {
            within(y, &rows) * within(x, &columns)
        })
    }
}

/// The weight of node `index` of `count` along a side of `length` pixels.
fn hat(index: usize, count: usize, length: usize) -> Vec<f32> {
    let scale = if length > 1 { (count - 1) as f64 / (length - 1) as f64 } else { 0.0 };
    let weight = |pixel: usize| (1.0 - (pixel as f64 * scale - index as f64).abs()).max(0.0);
    #[expect(clippy::cast_possible_truncation, reason = "a weight in [0, 1]")]
    (0..length).map(|pixel| weight(pixel) as f32).collect()
}

/// The PSFs at the nodes of a grid: a PSF that changes over the frame.
#[derive(Clone, Debug, PartialEq)]
pub struct PsfField {
    grid: FieldGrid,
    psfs: Vec<Psf>,
}

impl PsfField {
    /// Puts a grid and its PSFs, row by row, together.
    ///
    /// # Errors
    /// [`Error::Shape`] when there are not as many PSFs, all of one size, as nodes.
    pub fn new(grid: FieldGrid, psfs: Vec<Psf>) -> Result<Self> {
        let shape = |expected: String, found: String| Err(Error::shape("PSFs of the field", expected, found));
        if psfs.len() != grid.len() {
            return shape(format!("{}", grid.len()), format!("{}", psfs.len()));
        }
        let size = |psf: &Psf| format!("{} × {}", psf.height(), psf.width());
        if let Some(other) = psfs.iter().find(|psf| size(psf) != size(&psfs[0])) {
            return shape(format!("all {}", size(&psfs[0])), size(other));
        }
        Ok(Self { grid, psfs })
    }

    /// The places.
    pub fn grid(&self) -> &FieldGrid {
        &self.grid
    }

    /// The PSFs, row by row.
    pub fn psfs(&self) -> &[Psf] {
        &self.psfs
    }

    /// The PSF in the middle of the frame.
    ///
    /// # Errors
    /// As [`Psf::from_energy`].
    pub fn centre(&self) -> Result<Psf> {
        let mut sum = Array3::zeros(self.psfs[0].planes().dim());
        for (node, psf) in self.psfs.iter().enumerate() {
            // The middle of three pixels is the middle of the frame.
            sum.scaled_add(self.grid.weights(node, [3, 3])[[1, 1]], &psf.planes());
        }
        Psf::from_energy(sum)
    }

    /// SHA-256 of the grid and the PSFs, in hexadecimal.
    pub fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(format!("{} {}", self.grid.rows, self.grid.columns));
        self.psfs.iter().for_each(|psf| hash.update(psf.sha256()));
        hex(&hash.finalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_centre_of_four_corners_is_their_mean() {
        let psf = |peak: usize| {
            let energy =
                Array3::from_shape_fn((3, 2, 2), |(_, y, x)| if 2 * y + x == peak { 1.0 } else { 0.0 });
            Psf::from_energy(energy).unwrap()
        };
        let field = PsfField::new(FieldGrid::new(2, 2).unwrap(), (0..4).map(psf).collect()).unwrap();
        assert!(field.centre().unwrap().as_slice().iter().all(|v| (v - 0.25).abs() < 1e-6));
        let row = PsfField::new(FieldGrid::new(1, 3).unwrap(), (0..3).map(psf).collect()).unwrap();
        assert_eq!(row.centre().unwrap(), psf(1));
        assert_ne!(row.sha256(), field.sha256());
        assert!(PsfField::new(FieldGrid::new(1, 3).unwrap(), vec![psf(0)]).is_err());
    }

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

    /// The product of these sides is 0 in the integers of a processor.
    #[test]
    fn a_grid_of_more_places_than_can_be_counted_is_refused() {
        let side = 1 << (usize::BITS / 2);
        let message = FieldGrid::new(side, side).unwrap_err().to_string();
        assert!(message.contains("as many places as it names PSFs"), "{message}");
        assert!(FieldGrid::new(usize::MAX, 2).is_err());
    }
}
