//! Turns a circular lens opening into numbers on a grid.

use ndarray::Array2;

use super::sampling::Grid;

/// A circular opening on a grid.
#[derive(Clone, Debug)]
pub struct Pupil {
    /// The share of each grid square that is open: weighs energies.
    pub coverage: Array2<f64>,
    /// What multiplies the field.
    ///
    /// Covered shares blur the rim by a grid square, which dims the outer Airy rings by sinc(νΔ) on each axis. A
    /// 24th of the Laplacian undoes that to fourth order: 1 − (πνΔ)²/6 becomes 1 + O((νΔ)⁴).
    pub amplitude: Array2<f64>,
}

impl Pupil {
    /// Draws an opening around the grid's point N/2.
    pub fn new(grid: &Grid, aperture_m: f64) -> Self {
        let centre = (grid.size / 2) as f64;
        let place = |index: usize| index as f64 - centre;
        let radius = aperture_m / 2.0 / grid.pitch_m;
        let coverage = Array2::from_shape_fn((grid.size, grid.size), |(row, column)| {
            disc_coverage(place(row), place(column), 1.0, radius)
        });
        let at = |row: usize, column: usize| coverage.get((row, column)).copied().unwrap_or(0.0);
        let amplitude = Array2::from_shape_fn(coverage.dim(), |(row, column)| {
            let beside = at(row.wrapping_sub(1), column)
                + at(row + 1, column)
                + at(row, column.wrapping_sub(1))
                + at(row, column + 1);
            at(row, column) - (beside - 4.0 * at(row, column)) / 24.0
        });
        Self { coverage, amplitude }
    }
}

/// The area that a disc of radius `radius` around the origin shares with the square of side `side` around
/// (`y`, `x`), as a share of the square.
///
/// # Accuracy
/// Exact in one direction, by the midpoint rule of 64 lines in the other: 1e-4 of a square on the rim.
pub fn disc_coverage(y: f64, x: f64, side: f64, radius: f64) -> f64 {
    let (y, x) = (y.abs(), x.abs());
    let half = side / 2.0;
    if (y + half).hypot(x + half) <= radius {
        return 1.0;
    }
    if (y - half).max(0.0).hypot((x - half).max(0.0)) >= radius {
        return 0.0;
    }
    let (left, right) = (x - half, x + half);
    let lines = 64;
    let covered: f64 = (0..lines)
        .map(|line| {
            let at = y - half + side * (f64::from(line) + 0.5) / f64::from(lines);
            let reach = (radius * radius - at * at).max(0.0).sqrt();
            (right.min(reach) - left.max(-reach)).max(0.0)
        })
        .sum();
    covered / (f64::from(lines) * side)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn squares_add_up_to_the_disc() {
        for (radius, side) in [(10.3, 1.0), (0.3, 1.0), (5.0, 0.37)] {
            let area: f64 = (-30..=30)
                .flat_map(|y| (-30..=30).map(move |x| (f64::from(y), f64::from(x))))
                .map(|(y, x)| disc_coverage(y * side, x * side, side, radius) * side * side)
                .sum();
            assert!((area / (PI * radius * radius) - 1.0).abs() < 5e-4, "{area} for radius {radius}");
        }
    }
}
