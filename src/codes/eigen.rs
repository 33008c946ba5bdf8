//! Turns a small symmetric matrix into its eigenvalues and eigenvectors.

use ndarray::{Array1, Array2, ArrayView2};

/// Sweeps after which the iteration stops in any case; convergence is quadratic and takes fewer than ten.
const MOST_SWEEPS: usize = 60;

/// Eigenvalues, largest first, and the eigenvectors as columns in the same order.
#[derive(Clone, Debug)]
pub(super) struct Eigen {
    /// The eigenvalues, `[n]`.
    pub(super) values: Array1<f64>,
    /// Orthonormal eigenvectors, `[n, n]`, one a column.
    pub(super) vectors: Array2<f64>,
}

/// Decomposes a symmetric matrix by cyclic Jacobi rotations (Golub and Van Loan, section 8.5).
///
/// # Accuracy
/// Absolute errors of the eigenvalues are a few times 1e-16 of the largest.
pub(super) fn decompose(symmetric: ArrayView2<'_, f64>) -> Eigen {
    let n = symmetric.nrows();
    let mut matrix = symmetric.to_owned();
    let mut vectors = Array2::eye(n);
    for _ in 0..MOST_SWEEPS {
        let mut rotated = false;
        for p in 0..n {
            for q in p + 1..n {
                rotated |= annihilate(&mut matrix, &mut vectors, p, q);
            }
        }
        if !rotated {
            break;
        }
    }
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&a, &b| matrix[[b, b]].total_cmp(&matrix[[a, a]]));
    Eigen {
        values: order.iter().map(|&i| matrix[[i, i]]).collect(),
        vectors: Array2::from_shape_fn((n, n), |(row, column)| vectors[[row, order[column]]]),
    }
}

/// Rotates the (p, q) plane so that the element there vanishes; says whether there was anything to do.
fn annihilate(matrix: &mut Array2<f64>, vectors: &mut Array2<f64>, p: usize, q: usize) -> bool {
    let (app, aqq, apq) = (matrix[[p, p]], matrix[[q, q]], matrix[[p, q]]);
    // Below this the element no longer changes the diagonal in f64.
    if apq.abs() <= f64::EPSILON * 0.5 * (app.abs() * aqq.abs()).sqrt() || apq == 0.0 {
        return false;
    }
    let tau = (aqq - app) / (2.0 * apq);
    let t = tau.signum() / (tau.abs() + tau.hypot(1.0));
    let cos = 1.0 / t.hypot(1.0);
    let sin = t * cos;
    for k in 0..matrix.nrows() {
        let (akp, akq) = (matrix[[k, p]], matrix[[k, q]]);
        matrix[[k, p]] = cos * akp - sin * akq;
        matrix[[k, q]] = sin * akp + cos * akq;
    }
    for k in 0..matrix.nrows() {
        let (apk, aqk) = (matrix[[p, k]], matrix[[q, k]]);
        matrix[[p, k]] = cos * apk - sin * aqk;
        matrix[[q, k]] = sin * apk + cos * aqk;
        let (vkp, vkq) = (vectors[[k, p]], vectors[[k, q]]);
        vectors[[k, p]] = cos * vkp - sin * vkq;
        vectors[[k, q]] = sin * vkp + cos * vkq;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rebuilds_the_matrix_from_orthonormal_vectors() {
        let n = 9;
        let matrix = Array2::from_shape_fn((n, n), |(i, j)| ((i * j) as f64).cos() + (i + j) as f64 * 0.1);
        let Eigen { values, vectors } = decompose(matrix.view());
        let rebuilt = vectors.dot(&Array2::from_diag(&values)).dot(&vectors.t());
        let gram = vectors.t().dot(&vectors);
        for ((i, j), &value) in matrix.indexed_iter() {
            assert!((rebuilt[[i, j]] - value).abs() < 1e-13 * 20.0);
            assert!((gram[[i, j]] - f64::from(u8::from(i == j))).abs() < 1e-14 * 10.0);
        }
        assert!(values.iter().zip(values.iter().skip(1)).all(|(a, b)| a >= b));
    }

    #[test]
    fn solves_a_two_by_two_matrix_by_hand() {
        let matrix = Array2::from_shape_vec((2, 2), vec![2.0, 1.0, 1.0, 2.0]).unwrap();
        let Eigen { values, vectors } = decompose(matrix.view());
        assert!((values[0] - 3.0).abs() < 1e-15 && (values[1] - 1.0).abs() < 1e-15);
        assert!((vectors[[0, 0]] - vectors[[1, 0]]).abs() < 1e-15);
    }

    #[test]
    fn leaves_equal_eigenvalues_alone() {
        let Eigen { values, vectors } = decompose(Array2::eye(3).view());
        assert_eq!(values, Array1::<f64>::ones(3));
        assert_eq!(vectors, Array2::<f64>::eye(3));
    }
}
