//! Finds the core of a point source in a mosaic, and tells whether its photosites sample it.

use ndarray::{ArrayView2, s};
use rayon::prelude::*;

/// Photosites of one place of the pattern lie so many pixels apart.
const STEP: usize = 2;
/// How far around a photosite the others of its place are looked at, in such steps: a core that counts as narrow ends there.
const REACH: usize = 2;

/// The share of the light of one place of the pattern from which on a core is too narrow for the distance of its photosites.
///
/// # Derivation
/// A Gaussian of standard deviation σ gives the photosite in its middle 4/(2πσ²) of what all of its place receive, and one that
/// is half a pixel off on both axes exp(−1/4σ²) times that. At σ = 1.5 pixels these are 0.28 and 0.25, at σ = 1 pixel 0.64 and
/// 0.5. What lies under 1.2 is always told, what lies above 1.35 never.
pub const NARROW: f64 = 0.35;

/// The middle of the brightest spot: of all places of a pattern alike, so that a lone photosite does not pass for one.
pub(super) fn peak(mosaic: ArrayView2<'_, f32>) -> [usize; 2] {
    let (height, width) = mosaic.dim();
    let sum = |y: usize, x: usize| -> f64 {
        let weight = |(row, column): (usize, usize)| [1.0, 2.0, 1.0][row] * [1.0, 2.0, 1.0][column];
        let around = mosaic.slice(s![y - 1..y + 2, x - 1..x + 2]);
        around.indexed_iter().map(|(place, value)| weight(place) * f64::from(*value)).sum()
    };
    let best = |a: ([usize; 2], f64), b: ([usize; 2], f64)| if b.1 > a.1 { b } else { a };
    let of_row = |y: usize| {
        let sums = (1..width.saturating_sub(1)).map(|x| ([y, x], sum(y, x)));
        sums.fold(([0, 0], f64::NEG_INFINITY), best)
    };
    let rows: Vec<_> = (1..height.saturating_sub(1)).into_par_iter().map(of_row).collect();
    rows.into_iter().fold(([0, 0], f64::NEG_INFINITY), best).0
}

/// The largest share that a photosite of the core has of the light of all photosites around it that stand at the same place of
/// the pattern; zero where there is no light.
///
/// Near one, the photosites of one colour see a core that those of the others miss, and none of them how it is shaped.
pub fn core_share(mosaic: ArrayView2<'_, f32>) -> f64 {
    let [y, x] = peak(mosaic);
    let near = |place: usize, length: usize| place.saturating_sub(1)..(place + 2).min(length);
    let (height, width) = mosaic.dim();
    let places = near(y, height).flat_map(|y| near(x, width).map(move |x| [y, x]));
    places.map(|place| share_of(mosaic, place)).fold(0.0, f64::max)
}

fn share_of(mosaic: ArrayView2<'_, f32>, [y, x]: [usize; 2]) -> f64 {
    let (height, width) = mosaic.dim();
    let along = |place: usize, length: usize| {
        (place % STEP..length).step_by(STEP).filter(move |other| other.abs_diff(place) <= REACH * STEP)
    };
    let sites = || along(y, height).flat_map(|y| along(x, width).map(move |x| f64::from(mosaic[[y, x]])));
    let darkest = sites().fold(f64::INFINITY, f64::min);
    let sum: f64 = sites().map(|value| value - darkest).sum();
    if sum > 0.0 { (f64::from(mosaic[[y, x]]) - darkest) / sum } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    fn spot(sigma: f64, [cy, cx]: [f64; 2]) -> Array2<f32> {
        Array2::from_shape_fn((48, 40), |(y, x)| {
            let squared = (y as f64 - cy).powi(2) + (x as f64 - cx).powi(2);
            // Colours are not equally bright.
            let gain = [0.8, 1.0, 1.0, 0.7][y % 2 * 2 + x % 2];
            (gain * (0.01 + (-squared / (2.0 * sigma * sigma)).exp())) as f32
        })
    }

    /// Wherever on the pattern it lies.
    #[test]
    fn a_core_of_a_pixel_is_narrow_and_one_of_three_is_not() {
        for (dy, dx) in [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0), (0.5, 0.5), (0.0, 0.5), (1.3, 0.7)] {
            let at = [24.0 + dy, 20.0 + dx];
            for sigma in [0.4, 0.5, 0.7, 1.0, 1.15] {
                assert!(core_share(spot(sigma, at).view()) > NARROW, "{sigma} at {dy}, {dx}");
            }
            for sigma in [1.4, 1.5, 2.0, 4.0] {
                assert!(core_share(spot(sigma, at).view()) < NARROW, "{sigma} at {dy}, {dx}");
            }
        }
    }

    #[test]
    fn the_peak_is_the_middle_of_the_spot_and_no_lone_photosite() {
        let mut mosaic = spot(0.5, [24.0, 21.0]);
        mosaic[[5, 5]] = 0.9;
        assert_eq!(peak(mosaic.view()), [24, 21]);
        assert_eq!(core_share(Array2::zeros((9, 9)).view()), 0.0);
    }
}
