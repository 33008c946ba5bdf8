//! Names the colour filter mosaics of sensors.

use ndarray::ArrayView2;
use serde::{Deserialize, Serialize};

const RED: usize = 0;
const GREEN: usize = 1;
const BLUE: usize = 2;

/// The colours of a sensor's first two rows, left to right, top to bottom.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BayerPattern {
    /// Red, green / green, blue.
    Rggb,
    /// Blue, green / green, red.
    Bggr,
    /// Green, red / blue, green.
    Grbg,
    /// Green, blue / red, green.
    Gbrg,
}

impl BayerPattern {
    const ALL: [Self; 4] = [Self::Rggb, Self::Bggr, Self::Grbg, Self::Gbrg];

    /// The channels of the first two rows' photosites, in reading order.
    pub fn sites(self) -> [usize; 4] {
        match self {
            Self::Rggb => [RED, GREEN, GREEN, BLUE],
            Self::Bggr => [BLUE, GREEN, GREEN, RED],
            Self::Grbg => [GREEN, RED, BLUE, GREEN],
            Self::Gbrg => [GREEN, BLUE, RED, GREEN],
        }
    }

    /// The pattern of these channels in reading order; none for channels that are no Bayer pattern.
    pub fn of_sites(sites: [usize; 4]) -> Option<Self> {
        Self::ALL.into_iter().find(|pattern| pattern.sites() == sites)
    }

    /// The channel that the photosite at (y, x) sees.
    pub fn channel(self, y: usize, x: usize) -> usize {
        self.sites()[(y % 2) * 2 + x % 2]
    }
}

/// The least difference between the photosites of cells, over the light of a cell, that tells a mosaic; that of two greens as a part of
/// it; and how many standard errors it has to be above.
const LEAST_DIFFERENCE: f64 = 0.05;
const GREENS: f64 = 0.25;
const SURE: f64 = 6.0;

/// Cells with light without which nothing is told.
const LEAST_CELLS: f64 = 64.0;

/// Whether one plane seems to be a Bayer mosaic: its pixels differ by their place in cells of two by two, and those of one diagonal do
/// not.
pub fn looks_mosaicked(plane: ArrayView2<'_, f32>) -> bool {
    let (mut sums, mut squares, mut cells) = ([0.0f64; 4], [0.0f64; 4], 0.0f64);
    for cell in plane.exact_chunks((2, 2)) {
        let light = [cell[[0, 0]], cell[[0, 1]], cell[[1, 0]], cell[[1, 1]]].map(f64::from);
        let mean = light.iter().sum::<f64>() / 4.0;
        if !(mean.is_normal() && mean > 0.0) {
            continue;
        }
        for (site, value) in light.into_iter().enumerate() {
            let share = value / mean;
            sums[site] += share;
            squares[site] += share * share;
        }
        cells += 1.0;
    }
    if cells < LEAST_CELLS {
        return false;
    }
    let shares = sums.map(|sum| sum / cells);
    let variance =
        (0..4).map(|site| (squares[site] / cells - shares[site].powi(2)).max(0.0)).fold(0.0, f64::max);
    let error = (variance / cells).sqrt();
    let [most, least] =
        [shares.iter().copied().fold(0.0, f64::max), shares.iter().copied().fold(f64::MAX, f64::min)];
    let of_greens = (shares[0] - shares[3]).abs().min((shares[1] - shares[2]).abs());
    let difference = most - least;
    difference > LEAST_DIFFERENCE.max(SURE * error) && of_greens < GREENS * difference
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;

    /// A scene of these colours, as a mosaic of that pattern.
    fn mosaic(colors: [f32; 3], pattern: BayerPattern) -> Array2<f32> {
        Array2::from_shape_fn((61, 80), |(y, x)| {
            let detail = 1.0 + 0.5 * (0.9 * y as f32 + 0.4 * x as f32).sin();
            64.0 + 300.0 * colors[pattern.channel(y, x)] * detail
        })
    }

    #[test]
    fn mosaics_are_told_from_grey_planes() {
        for pattern in BayerPattern::ALL {
            for colors in [[0.5, 1.0, 0.6], [1.3, 1.0, 0.7], [0.8, 1.0, 1.0]] {
                assert!(looks_mosaicked(mosaic(colors, pattern).view()), "{pattern:?} {colors:?}");
            }
            assert!(!looks_mosaicked(mosaic([1.0; 3], pattern).view()));
        }
        let rows = Array2::from_shape_fn((60, 60), |(y, _)| if y % 2 == 0 { 1.0 } else { 0.5 });
        let lone = Array2::from_shape_fn((60, 60), |(y, x)| if (y, x) == (30, 30) { 1e4 } else { 0.0 });
        let none = [Array2::zeros((60, 60)), Array2::ones((1, 1)), Array2::from_elem((6, 6), f32::NAN)];
        assert!(none.iter().chain([&rows, &lone]).all(|plane| !looks_mosaicked(plane.view())));
    }

    #[test]
    fn patterns_are_found_by_their_sites() {
        for pattern in BayerPattern::ALL {
            assert_eq!(BayerPattern::of_sites(pattern.sites()), Some(pattern));
        }
        assert_eq!(BayerPattern::of_sites([0, 1, 2, 1]), None);
    }
}
