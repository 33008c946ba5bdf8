//! Small symmetric positive definite matrices.

/// `N` rows of a symmetric matrix.
pub(super) type Symmetric<const N: usize> = [[f64; N]; N];

/// The inverse, by Cholesky's decomposition; none of a matrix that is not positive definite.
pub(super) fn inverse<const N: usize>(of: &Symmetric<N>) -> Option<Symmetric<N>> {
    let lower = cholesky(of)?;
    let mut inverse = [[0.0; N]; N];
    for column in 0..N {
        let mut solution = [0.0; N];
        for i in 0..N {
            let known: f64 = (0..i).map(|j| lower[i][j] * solution[j]).sum();
            solution[i] = (f64::from(u8::from(i == column)) - known) / lower[i][i];
        }
        for i in (0..N).rev() {
            let known: f64 = (i + 1..N).map(|j| lower[j][i] * solution[j]).sum();
            solution[i] = (solution[i] - known) / lower[i][i];
        }
        for (row, value) in inverse.iter_mut().zip(solution) {
            row[column] = value;
        }
    }
    Some(inverse)
}

/// `a·v`.
pub(super) fn apply<const N: usize>(a: &Symmetric<N>, v: &[f64; N]) -> [f64; N] {
    a.map(|row| row.iter().zip(v).map(|(a, v)| a * v).sum())
}

/// L of `L·Lᵀ`.
fn cholesky<const N: usize>(of: &Symmetric<N>) -> Option<Symmetric<N>> {
    let mut lower = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let known: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
            let left = of[i][j] - known;
            lower[i][j] = if i == j {
                // Rounding leaves this share of a diagonal that is none.
                if left <= 1e-13 * of[i][i] || !left.is_finite() {
                    return None;
                }
                left.sqrt()
            } else {
                left / lower[j][j]
            };
        }
    }
    Some(lower)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_gives_the_identity_and_a_singular_matrix_has_none() {
        let a = [[4.0, 1.0, -0.5], [1.0, 3.0, 0.25], [-0.5, 0.25, 2.0]];
        let inverse = inverse(&a).unwrap();
        for (i, row) in inverse.iter().enumerate() {
            for (j, value) in apply(&a, row).iter().enumerate() {
                assert!((value - f64::from(u8::from(i == j))).abs() < 1e-12);
            }
        }
        assert_eq!(super::inverse(&[[1.0, 2.0], [2.0, 4.0]]), None);
        assert_eq!(super::inverse(&[[1.0, f64::NAN], [f64::NAN, 4.0]]), None);
    }
}
