//! The field of distances between two colours of a frame, fitted to what blocks of it tell.

use crate::restore::symmetric::{Symmetric, apply, inverse};

/// Numbers of a field: a shift by rows and columns, the four of a linear map, and one of the third order.
const PARAMETERS: usize = 7;

/// Standard deviations of these before anything is seen, in pixels at the corner of the frame, where the radius is 1. A frame may be
/// cut out beside the axis of the lens.
const USUAL_PX: [f64; PARAMETERS] = [3.0, 3.0, 1.5, 1.5, 1.5, 1.5, 1.0];

/// Rounds of weighing blocks by how well they agree.
const ROUNDS: usize = 10;

/// Distances from a fit, in standard deviations, from which on a block counts less than half.
const AGREES: f64 = 2.0;

/// The squared distance of the middle one of points in a plane whose coordinates have unit variance.
const MIDDLE_SQUARE: f64 = 2.0 * std::f64::consts::LN_2;

/// What a block of a frame tells: that the colour lies `by` pixels beyond where it was guessed.
pub(super) struct Shift {
    /// The row and column of its middle.
    pub(super) at: [f64; 2],
    pub(super) by: [f64; 2],
    /// The inverse of its covariance.
    pub(super) information: Symmetric<2>,
}

/// Where the content of pixels of one colour lies in another: at `x + u(x)`.
#[derive(Clone, Debug)]
pub(super) struct Field {
    centre: [f64; 2],
    /// From the centre to a corner.
    radius: f64,
    parameters: [f64; PARAMETERS],
    covariance: Symmetric<PARAMETERS>,
}

impl Field {
    /// One of no distances.
    pub(super) fn none([height, width]: [usize; 2]) -> Self {
        let centre = [height, width].map(|side| (side - 1) as f64 / 2.0);
        let mut covariance = [[0.0; PARAMETERS]; PARAMETERS];
        covariance.iter_mut().enumerate().for_each(|(i, row)| row[i] = USUAL_PX[i].powi(2));
        Self {
            centre,
            radius: centre[0].hypot(centre[1]).max(1.0),
            parameters: [0.0; PARAMETERS],
            covariance,
        }
    }

    /// `u` at a place of the colour.
    pub(super) fn at(&self, place: [f64; 2]) -> [f64; 2] {
        self.basis(place).map(|row| row.iter().zip(&self.parameters).map(|(a, b)| a * b).sum())
    }

    /// Where green has what the colour has at (y, x).
    pub(super) fn on_green(&self, y: f64, x: f64) -> [f64; 2] {
        let [down, along] = self.at([y, x]);
        [y + down, x + along]
    }

    /// Where the colour has what green has at (y, x).
    pub(super) fn on_colour(&self, y: f64, x: f64) -> [f64; 2] {
        // Distances change by some hundredths from pixel to pixel at most: two steps leave thousandths.
        let [down, along] = self.at([y, x]);
        let [down, along] = self.at([y - down, x - along]);
        [y - down, x - along]
    }

    /// The greatest distance in the frame, at its corners, the middles of its sides or its own, and the standard deviation of it there.
    pub(super) fn furthest(&self) -> [f64; 2] {
        let steps = [-1.0, 0.0, 1.0];
        let places = steps.into_iter().flat_map(|down| {
            steps.map(|along| [self.centre[0] * (1.0 + down), self.centre[1] * (1.0 + along)])
        });
        let distance = |place: [f64; 2]| {
            let by = self.at(place);
            let distance = by[0].hypot(by[1]);
            let towards = by.map(|by| by / distance.max(f64::MIN_POSITIVE));
            let basis = self.basis(place);
            let row = std::array::from_fn(|i| towards[0] * basis[0][i] + towards[1] * basis[1][i]);
            let variance: f64 = apply(&self.covariance, &row).iter().zip(row).map(|(a, b)| a * b).sum();
            [distance, variance.max(0.0).sqrt()]
        };
        places.map(distance).max_by(|a, b| a[0].total_cmp(&b[0])).expect("nine places")
    }

    /// Whether the colours surely lie so far apart somewhere.
    pub(super) fn is_further_than(&self, least_px: f64, deviations: f64) -> bool {
        let [distance, deviation] = self.furthest();
        distance > least_px.max(deviations * deviation)
    }

    /// The field that blocks tell of, which were measured by this one; none where they tell nothing.
    pub(super) fn moved(&self, shifts: &[Shift]) -> Option<Self> {
        let of_prior = USUAL_PX.map(|px| px.powi(-2));
        let mut step = [0.0; PARAMETERS];
        let mut covariance = self.covariance;
        let mut squares = vec![0.0; shifts.len()];
        for _ in 0..ROUNDS {
            let mut information: Symmetric<PARAMETERS> = Default::default();
            let mut sum: [f64; PARAMETERS] = std::array::from_fn(|i| -of_prior[i] * self.parameters[i]);
            information.iter_mut().enumerate().for_each(|(i, row)| row[i] = of_prior[i]);
            for (shift, square) in shifts.iter().zip(&mut squares) {
                let basis = self.basis(shift.at);
                let told = basis.map(|row| row.iter().zip(&step).map(|(a, b)| a * b).sum::<f64>());
                let left = [shift.by[0] - told[0], shift.by[1] - told[1]];
                let weighed = apply(&shift.information, &left);
                *square = weighed[0] * left[0] + weighed[1] * left[1];
                // That of Cauchy's distribution.
                let weight = 1.0 / (1.0 + *square / AGREES.powi(2));
                let told = apply(&shift.information, &shift.by);
                for i in 0..PARAMETERS {
                    let column = apply(&shift.information, &[basis[0][i], basis[1][i]]);
                    sum[i] += weight * (basis[0][i] * told[0] + basis[1][i] * told[1]);
                    for j in 0..PARAMETERS {
                        information[i][j] += weight * (basis[0][j] * column[0] + basis[1][j] * column[1]);
                    }
                }
            }
            covariance = inverse(&information)?;
            step = apply(&covariance, &sum);
        }
        // Blocks may disagree by more than they tell.
        squares.sort_by(f64::total_cmp);
        let spread = (squares.get(squares.len() / 2)? / MIDDLE_SQUARE).max(1.0);
        let covariance = covariance.map(|row| row.map(|value| spread * value));
        let parameters = std::array::from_fn(|i| self.parameters[i] + step[i]);
        Some(Self { parameters, covariance, ..*self })
    }

    /// What each parameter moves a place by, in rows and columns.
    fn basis(&self, place: [f64; 2]) -> [[f64; PARAMETERS]; 2] {
        let [y, x]: [f64; 2] = std::array::from_fn(|axis| (place[axis] - self.centre[axis]) / self.radius);
        let square = y * y + x * x;
        [[1.0, 0.0, y, x, 0.0, 0.0, y * square], [0.0, 1.0, 0.0, 0.0, y, x, x * square]]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shifts(of: impl Fn([f64; 2]) -> [f64; 2]) -> Vec<Shift> {
        let places = (0..64).map(|i| [f64::from(i / 8) * 32.0 + 16.0, f64::from(i % 8) * 32.0 + 16.0]);
        places.map(|at| Shift { at, by: of(at), information: [[400.0, 0.0], [0.0, 400.0]] }).collect()
    }

    #[test]
    fn a_magnified_colour_is_told_by_its_blocks_some_of_which_are_wrong() {
        let truth = |[y, x]: [f64; 2]| [0.4 + (y - 127.5) * 4e-3, -0.2 + (x - 127.5) * 4e-3];
        let mut told = shifts(truth);
        told.iter_mut().step_by(7).for_each(|shift| shift.by = [-1.5, 2.0]);
        let field = Field::none([256; 2]).moved(&told).unwrap();
        for at in [[0.0, 0.0], [255.0, 0.0], [127.5, 127.5], [255.0, 255.0]] {
            let [found, right] = [field.at(at), truth(at)];
            assert!(
                (0..2).all(|axis| (found[axis] - right[axis]).abs() < 0.08),
                "{at:?} {found:?} {right:?}"
            );
        }
        let [y, x] = field.on_colour(30.0, 200.0);
        let there = field.on_green(y, x);
        assert!((there[0] - 30.0).hypot(there[1] - 200.0) < 1e-3, "{there:?}");
        assert!(field.is_further_than(0.5, 6.0));
    }

    #[test]
    fn what_disagrees_is_not_sure() {
        let told = shifts(|[y, x]| [(y * 12.9 + x * 78.2).sin(), (y * 39.3 - x * 11.1).cos()]);
        let field = Field::none([256; 2]).moved(&told).unwrap();
        assert!(!field.is_further_than(0.3, 6.0), "{:?}", field.furthest());
        assert!(Field::none([256; 2]).moved(&[]).is_none());
    }
}
