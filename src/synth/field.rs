//! Convolves a scene with a PSF that changes over the frame.

use std::borrow::Cow;

use ndarray::{Array3, Axis};

use crate::core::error::Result;
use crate::core::fft::{Boundary, Convolver, Otf};
use crate::core::field::{FieldGrid, PsfField};
use crate::core::image::{CHANNELS, LinearImage};

/// Convolves a scene with the PSFs at the nodes of a grid, interpolated between them.
///
/// # Equation
/// `Σᵢ (wᵢ·x) ∗ kᵢ` with the bilinear weights wᵢ of the nodes, which sum to one: every point of the scene spreads its
/// light by the interpolated PSF `Σᵢ wᵢ·kᵢ` of its own place. The parts overlap by whole cells of the grid and fade
/// linearly, so that there is no seam.
///
/// # Errors
/// As [`Convolver::new`].
pub fn convolve_field(scene: &LinearImage, field: &PsfField, boundary: Boundary) -> Result<Array3<f32>> {
    let [first, ..] = field.psfs() else { unreachable!("a field has a PSF") };
    let size = [scene.height(), scene.width()];
    let convolver = Convolver::new(size, [first.height(), first.width()], boundary)?;
    let otf = |node: usize| convolver.otf(&field.psfs()[node]).map(Cow::Owned);
    convolve_nodes(&convolver, (scene, 0), field.grid(), otf)
}

/// As [`convolve_field`], with the OTFs of the nodes, of a scene that is larger than the frame by a margin on each side:
/// the grid lies over the frame, and the frame is what is returned.
pub(super) fn convolve_nodes<'a>(
    convolver: &Convolver,
    (scene, margin): (&LinearImage, usize),
    grid: &FieldGrid,
    otf: impl Fn(usize) -> Result<Cow<'a, Otf>>,
) -> Result<Array3<f32>> {
    let frame = [scene.height() - 2 * margin, scene.width() - 2 * margin];
    let mut sum = Array3::zeros((CHANNELS, frame[0], frame[1]));
    for node in 0..grid.len() {
        let weights = grid.weights_with_margin(node, frame, margin);
        let part = &scene.planes() * &weights.insert_axis(Axis(0));
        let spectrum = convolver.spectrum(&LinearImage::from_planes(part)?)?;
        sum += &convolver.convolve_middle(&spectrum, &*otf(node)?, margin);
        convolver.reuse(spectrum);
    }
    Ok(sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::psf::Psf;

    /// A Gaussian displaced by (down, right) pixels.
    fn psf(down: f32, right: f32, width: f32) -> Psf {
        let energy = Array3::from_shape_fn((3, 15, 15), |(_, y, x)| {
            let (dy, dx) = (y as f32 - 7.0 - down, x as f32 - 7.0 - right);
            (-(dy * dy + dx * dx) / (2.0 * width * width)).exp()
        });
        Psf::from_energy(energy).unwrap()
    }

    fn field() -> PsfField {
        let psfs = vec![psf(0.0, -2.0, 1.0), psf(0.0, 2.0, 1.5), psf(1.0, 0.0, 0.8), psf(-1.0, 0.5, 2.0)];
        PsfField::new(FieldGrid::new(2, 2).unwrap(), psfs).unwrap()
    }

    /// The light of a point is the PSF interpolated to its place: rounding of f32 only.
    #[test]
    fn a_point_spreads_by_the_interpolated_psf() {
        let field = field();
        for (y, x) in [(20, 24), (9, 33), (31, 12)] {
            let mut planes = Array3::zeros((3, 41, 49));
            planes.slice_mut(ndarray::s![.., y, x]).fill(10.0);
            let point = LinearImage::from_planes(planes).unwrap();
            let found = convolve_field(&point, &field, Boundary::Zero).unwrap();
            let (v, u) = (y as f32 / 40.0, x as f32 / 48.0);
            let weights = [(1.0 - v) * (1.0 - u), (1.0 - v) * u, v * (1.0 - u), v * u];
            for ((c, row, column), value) in found.indexed_iter() {
                let place = (row + 7).checked_sub(y).zip((column + 7).checked_sub(x));
                let expected: f32 =
                    place.filter(|&(row, column)| row < 15 && column < 15).map_or(0.0, |(row, column)| {
                        weights
                            .iter()
                            .zip(field.psfs())
                            .map(|(w, k)| 10.0 * w * k.planes()[[c, row, column]])
                            .sum()
                    });
                assert!((value - expected).abs() < 1e-5, "{value} instead of {expected}");
            }
        }
    }

    /// The PSF of a lamp outside of the frame is that of the nearest place within.
    #[test]
    fn a_lamp_in_the_margin_spreads_by_the_psf_of_the_border() {
        let field = field();
        let (margin, height, width) = (7, 21, 19);
        let mut planes = Array3::zeros((3, height + 2 * margin, width + 2 * margin));
        planes.slice_mut(ndarray::s![.., margin - 2, margin - 3]).fill(10.0);
        let scene = LinearImage::from_planes(planes).unwrap();
        let convolver =
            Convolver::new([height + 2 * margin, width + 2 * margin], [15, 15], Boundary::Zero).unwrap();
        let otf = |node: usize| convolver.otf(&field.psfs()[node]).map(Cow::Owned);
        let found = convolve_nodes(&convolver, (&scene, margin), field.grid(), otf).unwrap();
        assert_eq!(found.dim(), (3, height, width));
        for ((c, y, x), value) in found.indexed_iter() {
            let corner = &field.psfs()[0];
            let expected = corner.planes().get([c, 7 + 2 + y, 7 + 3 + x]).map_or(0.0, |k| 10.0 * k);
            assert!((value - expected).abs() < 1e-5, "{c} {y} {x}: {value} instead of {expected}");
        }
    }

    /// With the same PSF everywhere the field is a convolution, which a flat scene shows without a seam.
    #[test]
    fn equal_psfs_are_one_convolution() {
        let field = PsfField::new(FieldGrid::new(2, 3).unwrap(), vec![psf(0.5, 1.0, 1.2); 6]).unwrap();
        let planes = Array3::from_shape_fn((3, 30, 37), |(c, y, x)| 1.0 + ((c + 3 * y + 5 * x) % 11) as f32);
        let scene = LinearImage::from_planes(planes).unwrap();
        for boundary in [Boundary::Zero, Boundary::Replicate] {
            let found = convolve_field(&scene, &field, boundary).unwrap();
            let convolver = Convolver::new([30, 37], [15, 15], boundary).unwrap();
            let otf = convolver.otf(&field.psfs()[0]).unwrap();
            let expected = convolver.convolve(&convolver.spectrum(&scene).unwrap(), &otf);
            assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-4));
        }
    }
}
