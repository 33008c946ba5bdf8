//! Turns the kernel codes at a few places of the frame into a code for every pixel.

use ndarray::{Array3, Axis};

use crate::core::error::{Error, Result};
use crate::core::field::FieldGrid;
use crate::core::kernel_code::KernelCode;

/// Interpolates codes bilinearly between the nodes of a grid.
///
/// A code is linear in its PSF, so that the interpolated code is the code of the interpolated PSF.
///
/// # Shapes
/// `[b, height, width]` for the `size` `[height, width]`.
///
/// # Errors
/// [`Error::Shape`] when there are not as many codes, all of one length, as nodes.
pub fn code_map(codes: &[KernelCode], grid: &FieldGrid, size: [usize; 2]) -> Result<Array3<f32>> {
    if codes.len() != grid.len() {
        return Err(Error::shape(
            "codes of the field",
            format!("{}", grid.len()),
            format!("{}", codes.len()),
        ));
    }
    let dim = codes[0].len();
    if let Some(other) = codes.iter().find(|code| code.len() != dim) {
        return Err(Error::shape(
            "codes of the field",
            format!("all of {dim} numbers"),
            format!("{}", other.len()),
        ));
    }
    let mut map = Array3::zeros((dim, size[0], size[1]));
    for (node, code) in codes.iter().enumerate() {
        let weights = grid.weights(node, size);
        for (mut plane, &value) in map.axis_iter_mut(Axis(0)).zip(code) {
            plane.scaled_add(value, &weights);
        }
    }
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn codes_vary_linearly_between_the_places() {
        let grid = FieldGrid::new(1, 3).unwrap();
        let codes = [array![0.0, 1.0], array![2.0, 1.0], array![-2.0, 1.0]];
        let map = code_map(&codes, &grid, [4, 9]).unwrap();
        let first: Vec<f32> = map.slice(ndarray::s![0, 2, ..]).to_vec();
        assert_eq!(first, [0.0, 0.5, 1.0, 1.5, 2.0, 1.0, 0.0, -1.0, -2.0]);
        assert!(map.index_axis(Axis(0), 1).iter().all(|&v| v == 1.0));
        assert!(code_map(&codes[..2], &grid, [4, 9]).is_err());
        assert!(code_map(&[array![1.0], array![1.0, 2.0], array![1.0]], &grid, [4, 9]).is_err());
    }
}
