//! Products and inverses of 3 × 3 matrices, row by row, in double precision.

/// Three rows of three numbers.
pub type Matrix3 = [[f64; 3]; 3];

/// The matrix that changes nothing.
pub const IDENTITY: Matrix3 = diagonal([1.0; 3]);

/// A matrix of zeros but for its diagonal.
pub const fn diagonal([a, b, c]: [f64; 3]) -> Matrix3 {
    [[a, 0.0, 0.0], [0.0, b, 0.0], [0.0, 0.0, c]]
}

/// `a·v`.
pub fn apply(a: &Matrix3, v: [f64; 3]) -> [f64; 3] {
    a.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// `a·b`.
pub fn product(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    a.map(|row| [0, 1, 2].map(|j| row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]))
}

/// `(1 − share)·a + share·b`.
pub fn between(a: &Matrix3, b: &Matrix3, share: f64) -> Matrix3 {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| (1.0 - share) * a[i][j] + share * b[i][j]))
}

/// The inverse by cofactors; none of a matrix that has none, or that holds what is not finite.
pub fn inverse(a: &Matrix3) -> Option<Matrix3> {
    let cofactor = |i: usize, j: usize| {
        let [r, s] = [(i + 1) % 3, (i + 2) % 3];
        let [c, d] = [(j + 1) % 3, (j + 2) % 3];
        a[r][c] * a[s][d] - a[r][d] * a[s][c]
    };
    let determinant: f64 = (0..3).map(|j| a[0][j] * cofactor(0, j)).sum();
    // Rounding leaves this share of the largest possible determinant of a singular matrix.
    let is_regular = determinant.is_finite() && determinant.abs() > 1e-12 * size(a).powi(3);
    is_regular.then(|| [0, 1, 2].map(|i| [0, 1, 2].map(|j| cofactor(j, i) / determinant)))
}

/// Whether a matrix whose numbers were rounded to single precision has no inverse.
pub fn is_singular(a: &Matrix3) -> bool {
    // A share of the largest number; rounding leaves 1e-7 of it in each, and a few times as much in the determinant.
    const ROUNDING: f64 = 1e-6;
    let [r, s, t] = a;
    let cross = [s[1] * t[2] - s[2] * t[1], s[2] * t[0] - s[0] * t[2], s[0] * t[1] - s[1] * t[0]];
    let determinant: f64 = r.iter().zip(cross).map(|(a, b)| a * b).sum();
    !(determinant.is_finite() && determinant.abs() > ROUNDING * size(a).powi(3))
}

/// The largest magnitude of its numbers.
fn size(a: &Matrix3) -> f64 {
    a.iter().flatten().fold(0.0, |size: f64, value| size.max(value.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_times_its_inverse_changes_nothing() {
        let a = [[2.0, -1.0, 0.5], [0.3, 1.0, 4.0], [-2.0, 0.1, 1.0]];
        let found = product(&a, &inverse(&a).unwrap());
        for (found, expected) in found.iter().flatten().zip(IDENTITY.iter().flatten()) {
            assert!((found - expected).abs() < 1e-14, "{found}");
        }
        assert_eq!(inverse(&[[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [0.0, 1.0, 1.0]]), None);
        assert_eq!(inverse(&[[f64::NAN; 3]; 3]), None);
    }

    #[test]
    fn a_matrix_without_inverse_is_singular_whatever_its_size_and_rounding() {
        let third = f64::from(1.0f32 / 3.0);
        for a in [
            [[0.0; 3]; 3],
            [[third; 3]; 3],
            [[1e-3, 2e-3, 3e-3], [4e-3, 5e-3, 6e-3], [7e-3, 8e-3, 9e-3]],
            [
                [0.1, 0.2, 0.3].map(|v: f32| f64::from(v)),
                [0.7, 1.4, 2.1].map(|v: f32| f64::from(v)),
                [5.0, 0.0, 1.0],
            ],
            [[f64::NAN; 3]; 3],
        ] {
            assert!(is_singular(&a), "{a:?}");
        }
        for a in [
            IDENTITY,
            diagonal([1e-3; 3]),
            diagonal([900.0; 3]),
            [[2.0, -1.0, 0.5], [0.3, 1.0, 4.0], [-2.0, 0.1, 1.0]],
        ] {
            assert!(!is_singular(&a), "{a:?}");
        }
    }
}
