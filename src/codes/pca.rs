//! Turns a set of PSFs into the principal components of their differences and one code for each.

use ndarray::{Array1, Array2, ArrayView2};
use rayon::prelude::*;

use super::eigen::{Eigen, decompose};
use crate::core::error::{Error, Result};
use crate::core::kernel_code::{CodeBasis, KernelBank};
use crate::core::psf::Psf;

/// Length of a kernel code, b, as published.
pub const CODE_DIM: usize = 5;

/// Values that one thread sums at a time; fixed, so that sums do not depend on the number of threads.
pub(super) const CHUNK: usize = 1 << 14;

/// A first coefficient below this share of its component's largest one is zero up to the rounding of f32.
const TIE: f64 = 1e-6;

/// Makes a bank of a kernel set: mean-centred PCA with `dim` components, one code a kernel.
///
/// # Equation
/// With the centred set X, `[K, n]`, and X = U·S·Vᵀ: codes U·S, components Vᵀ. U and S² are the
/// eigenvectors and eigenvalues of the K × K Gram matrix X·Xᵀ, all in f64. The signs of the components are
/// free; they are chosen so that the first kernel of the set has non-negative coefficients. Where that
/// coefficient is zero up to rounding (as for the middle of a symmetric set), the largest coefficient of
/// the component, the earliest of equals, is the positive one, and the first kernel's is stored as zero if
/// rounding made it negative.
///
/// # Errors
/// [`Error::Shape`] when the PSFs differ in size; [`Error::Config`] when `dim` is zero or more than the set
/// has directions: K − 1, or fewer when PSFs of the set repeat or combine to one another.
///
/// # Panics
/// Never: the arrays are made contiguous here.
pub fn make_bank(psfs: Vec<Psf>, angles_deg: Option<Vec<f64>>, dim: usize) -> Result<KernelBank> {
    check_sizes(&psfs)?;
    let mean = mean_of(&psfs);
    let gram = centred_gram(&psfs, &mean);
    let Eigen { values, vectors } = decompose(gram.view());
    check_dim(dim, &psfs, values.as_slice().expect("eigenvalues are contiguous"))?;

    let singular: Vec<f64> = values.iter().take(dim).map(|value| value.sqrt()).collect();
    let mut left = vectors.slice_move(ndarray::s![.., ..dim]);
    for mut column in left.columns_mut() {
        if negative_by_sign_rule(column.as_standard_layout().as_slice().expect("just made contiguous")) {
            column.mapv_inplace(|v| -v);
        }
    }
    let basis = CodeBasis {
        components: components_of(&psfs, &mean, &left, &singular),
        explained_variance: singular.iter().map(|s| to_f32(s * s / (psfs.len() - 1) as f64)).collect(),
        mean: mean.iter().map(|&v| to_f32(v)).collect(),
    };
    let mut codes = Array2::from_shape_fn((psfs.len(), dim), |(k, j)| to_f32(left[[k, j]] * singular[j]));
    codes.row_mut(0).mapv_inplace(|code| code.max(0.0));
    KernelBank::new(psfs, codes, basis, angles_deg)
}

/// The share of the set's variance that the codes of a bank hold.
pub fn explained_share(bank: &KernelBank) -> f64 {
    let mean: Vec<f64> = bank.basis.mean.iter().map(|&v| f64::from(v)).collect();
    let total: f64 = centred_gram(&bank.psfs, &mean).diag().sum();
    let held: f64 = bank.codes.iter().map(|&code| f64::from(code).powi(2)).sum();
    if total > 0.0 { (held / total).min(1.0) } else { 1.0 }
}

#[expect(clippy::cast_possible_truncation, reason = "banks are kept in f32")]
pub(super) fn to_f32(value: f64) -> f32 {
    value as f32
}

fn check_sizes(psfs: &[Psf]) -> Result<()> {
    let Some((first, rest)) = psfs.split_first() else {
        return Err(Error::shape("kernel set", "at least two PSFs", "none"));
    };
    match rest.iter().position(|psf| psf.planes().dim() != first.planes().dim()) {
        None => Ok(()),
        Some(i) => Err(Error::shape(
            format!("size of PSF {} of the set", i + 2),
            format!("{} × {} like the first", first.height(), first.width()),
            format!("{} × {}", rest[i].height(), rest[i].width()),
        )),
    }
}

/// Refuses more components than the set has directions.
///
/// Each value of a PSF carries a rounding error of up to 2⁻²⁴ of itself; a singular value below that share
/// of the set's norm is such rounding and no direction.
fn check_dim(dim: usize, psfs: &[Psf], eigenvalues: &[f64]) -> Result<()> {
    let energy: f64 = psfs.iter().flat_map(Psf::as_slice).map(|&v| f64::from(v).powi(2)).sum();
    let floor = energy * 2f64.powi(-48);
    let directions = eigenvalues.iter().take(psfs.len() - 1).filter(|&&value| value > floor).count();
    if (1..=directions).contains(&dim) {
        return Ok(());
    }
    let reason = match directions {
        0 => "the PSFs of the set are all the same, so that no code can tell them apart; give PSFs that differ, \
              or other angles"
            .to_owned(),
        _ if dim == 0 => format!("0 numbers make no code; choose 1 to {directions}"),
        _ => format!(
            "{dim} is out of range: {} PSFs that vary in {directions} directions allow 1 to {directions}; \
             choose fewer, or give more kernels",
            psfs.len()
        ),
    };
    Err(Error::config("dim", reason))
}

fn mean_of(psfs: &[Psf]) -> Vec<f64> {
    let mut mean = vec![0.0; psfs[0].as_slice().len()];
    mean.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, mean)| {
        let start = chunk * CHUNK;
        for psf in psfs {
            let values = &psf.as_slice()[start..start + mean.len()];
            mean.iter_mut().zip(values).for_each(|(sum, &value)| *sum += f64::from(value));
        }
        mean.iter_mut().for_each(|sum| *sum /= psfs.len() as f64);
    });
    mean
}

/// The inner products of the PSFs after the subtraction of `mean`, `[K, K]`.
pub(super) fn centred_gram(psfs: &[Psf], mean: &[f64]) -> Array2<f64> {
    let count = psfs.len();
    let partial_grams: Vec<Array2<f64>> = mean
        .par_chunks(CHUNK)
        .enumerate()
        .map(|(chunk, mean)| {
            let start = chunk * CHUNK;
            let centred = Array2::from_shape_fn((count, mean.len()), |(k, i)| {
                f64::from(psfs[k].as_slice()[start + i]) - mean[i]
            });
            centred.dot(&centred.t())
        })
        .collect();
    partial_grams.into_iter().fold(Array2::zeros((count, count)), |sum, part| sum + part)
}

fn negative_by_sign_rule(column: &[f64]) -> bool {
    let largest = column.iter().fold(0f64, |m, v| m.max(v.abs()));
    if column[0].abs() > TIE * largest {
        return column[0] < 0.0;
    }
    column.iter().find(|v| v.abs() >= (1.0 - TIE) * largest).is_some_and(|&v| v < 0.0)
}

/// V = Xᵀ·U·S⁻¹, one component a row.
fn components_of(psfs: &[Psf], mean: &[f64], left: &Array2<f64>, singular: &[f64]) -> Array2<f32> {
    let mut components = Array2::zeros((singular.len(), mean.len()));
    for (j, mut component) in components.rows_mut().into_iter().enumerate() {
        let weights: Array1<f64> = left.column(j).mapv(|u| u / singular[j]);
        let values = component.as_slice_mut().expect("rows of a new array are slices");
        values.par_iter_mut().enumerate().for_each(|(i, value)| {
            let sum: f64 =
                psfs.iter().zip(&weights).map(|(psf, w)| w * (f64::from(psf.as_slice()[i]) - mean[i])).sum();
            *value = to_f32(sum);
        });
    }
    components
}

/// The Gram matrix of points about their own centre, from their Gram matrix about another.
pub(super) fn recentre(gram: ArrayView2<'_, f64>) -> Array2<f64> {
    let count = gram.nrows() as f64;
    let rows: Array1<f64> = gram.sum_axis(ndarray::Axis(1)) / count;
    let all = rows.sum() / count;
    Array2::from_shape_fn(gram.dim(), |(i, j)| gram[[i, j]] - rows[i] - rows[j] + all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn spot(centre: f32) -> Psf {
        let energy = Array3::from_shape_fn((3, 15, 15), |(c, y, x)| {
            let (dy, dx) = (y as f32 - 7.0, x as f32 - 7.0 - centre * (1.0 + c as f32));
            (-0.2 * (dy * dy + dx * dx)).exp()
        });
        Psf::from_energy(energy).unwrap()
    }

    fn set() -> Vec<Psf> {
        [0.1, 0.7, 1.1, -0.9, -0.2, 1.6].map(spot).to_vec()
    }

    #[test]
    fn codes_and_components_rebuild_the_set_when_all_directions_are_kept() {
        let bank = make_bank(set(), None, 5).unwrap();
        for (k, psf) in bank.psfs.iter().enumerate() {
            let rebuilt = &bank.basis.mean + &bank.basis.components.t().dot(&bank.code(k));
            let largest = psf.as_slice().iter().fold(0f32, |m, &v| m.max(v));
            for (found, &expected) in rebuilt.iter().zip(psf.as_slice()) {
                assert!((found - expected).abs() < 8.0 * f32::EPSILON * largest);
            }
        }
        let gram = bank.basis.components.dot(&bank.basis.components.t());
        for ((i, j), &value) in gram.indexed_iter() {
            assert!((value - f32::from(u8::from(i == j))).abs() < 1e-5, "{i}, {j}: {value}");
        }
    }

    #[test]
    fn all_directions_hold_all_of_the_variance() {
        let share = |dim| explained_share(&make_bank(set(), None, dim).unwrap());
        assert!((share(5) - 1.0).abs() < 1e-6, "{}", share(5));
        assert!(share(1) > 0.3 && share(1) < share(2) && share(2) < share(5));
    }

    #[test]
    fn gives_the_first_kernel_non_negative_coefficients() {
        let bank = make_bank(set(), None, 4).unwrap();
        assert!(bank.code(0).iter().all(|&c| c >= 0.0), "{}", bank.code(0));
    }

    /// Every one of these sets leaves some first coefficients to rounding.
    #[test]
    fn rounding_makes_no_first_coefficient_negative() {
        for width in [0.3, 0.5, 0.8, 1.1, 1.3] {
            let set = [0.0, width, -width, 2.0 * width, -2.0 * width].map(spot).to_vec();
            let bank = make_bank(set, None, 4).unwrap();
            assert!(bank.code(0).iter().all(|&c| c >= 0.0), "{width}: {}", bank.code(0));
        }
    }

    /// The first kernel lies exactly between the two others: its first coefficient is rounding only.
    #[test]
    fn decides_a_tie_by_the_largest_coefficient() {
        assert!(!negative_by_sign_rule(&[-1e-12, 0.5, -0.5]));
        assert!(negative_by_sign_rule(&[1e-12, -0.5, 0.5]));
        assert!(negative_by_sign_rule(&[-1e-3, 0.5, -0.5]));
    }

    #[test]
    fn refuses_more_components_than_directions() {
        for dim in [0, 6] {
            let message = make_bank(set(), None, dim).unwrap_err().to_string();
            assert!(message.contains("1 to 5"), "{message}");
        }
        let repeated = vec![spot(0.0), spot(0.5), spot(0.0), spot(0.5)];
        assert!(make_bank(repeated, None, 2).unwrap_err().to_string().contains("1 to 1"));
        let same = vec![spot(0.0); 3];
        assert!(make_bank(same, None, 1).unwrap_err().to_string().contains("all the same"));
    }

    #[test]
    fn names_the_psf_of_another_size() {
        let small = Psf::from_energy(Array3::ones((3, 5, 5))).unwrap();
        let message = make_bank(vec![spot(0.0), spot(1.0), small], None, 1).unwrap_err().to_string();
        assert!(message.contains("PSF 3"), "{message}");
    }

    #[test]
    fn recentring_a_gram_matrix_equals_centring_the_points() {
        let points = Array2::from_shape_fn((4, 6), |(i, j)| ((i * 5 + j * j) % 7) as f64);
        let centred = &points - &points.mean_axis(ndarray::Axis(0)).unwrap();
        let found = recentre(points.dot(&points.t()).view());
        let expected = centred.dot(&centred.t());
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12));
    }
}
