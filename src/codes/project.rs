//! Turns a new PSF into its code in an existing bank, and says how well the bank describes it.

use ndarray::{Array2, Axis};
use rayon::prelude::*;

use super::eigen::{Eigen, decompose};
use super::pca::{CHUNK, centred_gram, recentre, to_f32};
use super::summary::show_code;
use crate::core::error::{Error, Result};
use crate::core::kernel_code::{KernelBank, KernelCode};
use crate::core::psf::Psf;

/// The code of a PSF and what the code leaves out.
#[derive(Clone, Debug, PartialEq)]
pub struct Projection {
    /// The coefficients, `[b]`.
    pub code: KernelCode,
    /// ‖psf − rebuilt‖₂ / ‖psf‖₂ over all pixels and channels.
    pub residual_l2: f64,
    /// ‖psf − rebuilt‖₁ / ‖psf‖₁ over all pixels and channels.
    pub residual_l1: f64,
    /// The largest `residual_l2` that the bank's own spread explains; see [`project`].
    pub limit_l2: f64,
    /// Index of the kernel of the bank that is nearest to the PSF.
    pub nearest: usize,
    /// ‖psf − nearest kernel‖₂ / ‖psf‖₂.
    pub nearest_l2: f64,
}

impl Projection {
    /// Whether the bank can describe the PSF.
    pub fn fits(&self) -> bool {
        self.residual_l2 <= self.limit_l2
    }

    /// The code, what it leaves out and the nearest kernel of `bank`, in lines of text.
    pub fn summary(&self, bank: &KernelBank) -> [String; 3] {
        let percent = |share: f64| format!("{:.3} %", 100.0 * share);
        [
            format!("code      {}", show_code(&self.code)),
            format!(
                "residual  {} (L2), {} (L1); the bank's own spread explains {} (L2)",
                percent(self.residual_l2),
                percent(self.residual_l1),
                percent(self.limit_l2)
            ),
            format!("nearest   {}, {} away (L2)", bank.kernel_name(self.nearest), percent(self.nearest_l2)),
        ]
    }
}

/// Finds the code of `psf` in the basis of `bank`.
///
/// # Equation
/// `code = V·(psf − mean)` and `rebuilt = mean + Vᵀ·code` with the components V. The limit of the residual
/// is the largest that a kernel of the bank itself would have, were the bank made without it: a PSF further
/// off than that is no relative of the set.
///
/// # Errors
/// [`Error::Shape`] when the PSF has another size than the kernels of the bank.
///
/// # Panics
/// Never: a bank holds a kernel, and its mean is contiguous.
pub fn project(bank: &KernelBank, psf: &Psf) -> Result<Projection> {
    let kernel = &bank.psfs[0];
    if kernel.planes().dim() != psf.planes().dim() {
        let size = |psf: &Psf| format!("{} × {}", psf.height(), psf.width());
        return Err(Error::shape("size of the PSF", format!("{} like the bank's", size(kernel)), size(psf)));
    }
    let code = coefficients(bank, psf);
    let norm = Deviation::sum(psf, |_| 0.0);
    let residual = Deviation::sum(psf, |i| rebuilt(bank, &code, i));
    let distances = bank.psfs.iter().map(|kernel| {
        let values = kernel.as_slice();
        Deviation::sum(psf, |i| f64::from(values[i])).l2 / norm.l2
    });
    let (nearest, nearest_l2) =
        distances.enumerate().min_by(|(_, a), (_, b)| a.total_cmp(b)).expect("a bank holds a kernel");
    Ok(Projection {
        code: code.iter().map(|&c| to_f32(c)).collect(),
        residual_l2: residual.l2 / norm.l2,
        residual_l1: residual.l1 / norm.l1,
        limit_l2: own_spread(bank),
        nearest,
        nearest_l2,
    })
}

fn coefficients(bank: &KernelBank, psf: &Psf) -> Vec<f64> {
    let mean = bank.basis.mean.as_slice().expect("means are contiguous");
    let coefficient = |component: ndarray::ArrayView1<'_, f32>| {
        let component = component.to_slice().expect("components are contiguous rows");
        sum_in_chunks(mean.len(), |i| {
            f64::from(component[i]) * (f64::from(psf.as_slice()[i]) - f64::from(mean[i]))
        })
    };
    bank.basis.components.axis_iter(Axis(0)).map(coefficient).collect()
}

fn rebuilt(bank: &KernelBank, code: &[f64], i: usize) -> f64 {
    let detail: f64 = code.iter().zip(bank.basis.components.column(i)).map(|(c, &v)| c * f64::from(v)).sum();
    f64::from(bank.basis.mean[i]) + detail
}

/// The norms of a difference from a PSF.
struct Deviation {
    l2: f64,
    l1: f64,
}

impl Deviation {
    fn sum(psf: &Psf, other: impl Fn(usize) -> f64 + Sync) -> Self {
        let values = psf.as_slice();
        let difference = |i: usize| f64::from(values[i]) - other(i);
        Self {
            l2: sum_in_chunks(values.len(), |i| difference(i).powi(2)).sqrt(),
            l1: sum_in_chunks(values.len(), |i| difference(i).abs()),
        }
    }
}

fn sum_in_chunks(length: usize, term: impl Fn(usize) -> f64 + Sync) -> f64 {
    let starts: Vec<usize> = (0..length).step_by(CHUNK).collect();
    let parts: Vec<f64> =
        starts.into_par_iter().map(|start| (start..length.min(start + CHUNK)).map(&term).sum()).collect();
    parts.iter().sum()
}

/// The largest relative residual of a kernel in the basis (of as many components) of all the others.
fn own_spread(bank: &KernelBank) -> f64 {
    let mean: Vec<f64> = bank.basis.mean.iter().map(|&v| f64::from(v)).collect();
    let gram = centred_gram(&bank.psfs, &mean);
    let residual = |left_out: usize| {
        let norm = Deviation::sum(&bank.psfs[left_out], |_| 0.0).l2;
        residual_without(&gram, left_out, bank.code_dim()).sqrt() / norm
    };
    (0..bank.len()).map(residual).fold(0.0, f64::max)
}

/// The squared residual of point `left_out` in the `dim` leading components of the other points, from
/// inner products alone.
///
/// # Equation
/// About the centre of the others, let G be their Gram matrix with eigenpairs (λⱼ, uⱼ), g the inner products
/// of the left-out point with them and q its squared norm: the residual is `q − Σⱼ (uⱼ·g)² / λⱼ`.
fn residual_without(gram: &Array2<f64>, left_out: usize, dim: usize) -> f64 {
    let others: Vec<usize> = (0..gram.nrows()).filter(|&k| k != left_out).collect();
    let count = others.len() as f64;
    if others.is_empty() {
        return 0.0;
    }
    let inner = Array2::from_shape_fn((others.len(), others.len()), |(i, j)| gram[[others[i], others[j]]]);
    let to_centre = |k: usize| others.iter().map(|&j| gram[[k, j]]).sum::<f64>() / count;
    let centre_norm = others.iter().map(|&j| to_centre(j)).sum::<f64>() / count;
    let own_to_centre = to_centre(left_out);
    let norm = gram[[left_out, left_out]] - 2.0 * own_to_centre + centre_norm;
    let to_others: Vec<f64> =
        others.iter().map(|&j| gram[[left_out, j]] - own_to_centre - to_centre(j) + centre_norm).collect();

    let Eigen { values, vectors } = decompose(recentre(inner.view()).view());
    let floor = values[0] * 1e-12;
    let explained: f64 = (0..dim.min(values.len()))
        .filter(|&j| values[j] > floor)
        .map(|j| {
            let along: f64 = vectors.column(j).iter().zip(&to_others).map(|(u, g)| u * g).sum();
            along * along / values[j]
        })
        .sum();
    (norm - explained).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codes::{make_bank, make_rotated_bank, rotate};
    use ndarray::Array3;

    /// A bright core with a cross of sidelobes, fainter in blue.
    fn panel(size: usize, arm: f32) -> Psf {
        let centre = (size / 2) as f32;
        let energy = Array3::from_shape_fn((3, size, size), |(c, y, x)| {
            let (dy, dx) = (y as f32 - centre, x as f32 - centre);
            let core = (-(dy * dy + dx * dx) / 4.0).exp();
            let cross =
                (-dy * dy / 3.0 - dx.abs() / arm).exp() + 0.5 * (-dx * dx / 3.0 - dy.abs() / arm).exp();
            core + 0.1 / (1.0 + c as f32) * cross
        });
        Psf::from_energy(energy).unwrap()
    }

    fn bank() -> KernelBank {
        let angles: Vec<f64> = (-4..=4).map(|i| f64::from(i) * 3.0).collect();
        make_rotated_bank(&panel(41, 6.0), &angles, 5).unwrap()
    }

    /// Rounding of the stored f32 basis: 2⁻²⁴ of each PSF, whose norm is far above the codes'.
    #[test]
    fn gives_a_member_its_own_code() {
        let bank = bank();
        for k in 0..bank.len() {
            let projection = project(&bank, &bank.psfs[k]).unwrap();
            let norm = Deviation::sum(&bank.psfs[k], |_| 0.0).l2;
            for (found, expected) in projection.code.iter().zip(bank.code(k)) {
                assert!(f64::from((found - expected).abs()) < 4.0 * f64::from(f32::EPSILON) * norm);
            }
            assert_eq!((projection.nearest, projection.nearest_l2), (k, 0.0));
            assert!(projection.fits(), "{projection:?}");
        }
    }

    #[test]
    fn describes_a_rotation_between_two_members() {
        let projection = project(&bank(), &rotate(&panel(41, 6.0), 4.5).unwrap()).unwrap();
        assert!(projection.fits(), "{projection:?}");
        assert!(projection.residual_l2 > 0.0 && projection.nearest_l2 > projection.residual_l2);
    }

    #[test]
    fn rejects_a_psf_of_another_panel() {
        let projection = project(&bank(), &panel(41, 1.5)).unwrap();
        assert!(!projection.fits(), "{projection:?}");
        let projection = project(&bank(), &rotate(&panel(41, 6.0), 45.0).unwrap()).unwrap();
        assert!(!projection.fits(), "{projection:?}");
    }

    #[test]
    fn says_both_sizes_when_they_differ() {
        let message = project(&bank(), &panel(21, 6.0)).unwrap_err().to_string();
        assert!(message.contains("41 × 41") && message.contains("21 × 21"), "{message}");
    }

    /// The limit from inner products equals the residual in a bank that is really made without the kernel.
    #[test]
    fn knows_the_residual_of_a_kernel_that_was_left_out() {
        let full = bank();
        for left_out in [0, 3] {
            let mut others = full.psfs.clone();
            let psf = others.remove(left_out);
            let expected = project(&make_bank(others, None, 5).unwrap(), &psf).unwrap().residual_l2;
            let mean: Vec<f64> = full.basis.mean.iter().map(|&v| f64::from(v)).collect();
            let gram = centred_gram(&full.psfs, &mean);
            let norm = Deviation::sum(&psf, |_| 0.0).l2;
            let found = residual_without(&gram, left_out, 5).sqrt() / norm;
            assert!((found / expected - 1.0).abs() < 1e-4, "{found} {expected}");
        }
    }
}
