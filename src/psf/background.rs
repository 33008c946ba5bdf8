//! Finds the level and the noise under the light of a source, in the border of its picture.

use ndarray::{Array2, ArrayView2, ArrayViewMut2};
use serde::Serialize;

use super::slope::{Square, slope_of};
use crate::core::haze::Noise;

/// The level under the light of the source.
///
/// It is taken for stray light. Haze of the PSF that reaches the border is part of it, and is lost: the frame must be
/// larger than what is to be measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Background {
    /// The mean of the frame's border, without what lies more than four spreads off its median: sidelobes and lamps. Of a level
    /// that slopes it is that at the frame's centre.
    pub level: f64,
    /// Where the level plainly slopes, its rise from the frame's centre to its lower and to its right edge; the other values are of
    /// what is left without it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slope: Option<[f64; 2]>,
    /// The standard deviation of the same values.
    pub spread: f64,
    /// How many values these are.
    pub pixels: usize,
    /// The noise of a pixel: the standard deviation within the quieter squares of 4 × 4 pixels, since haze and orders at
    /// the border make the spread larger than noise.
    pub noise: f64,
    /// The spread of the means of such squares, times 4, up to three times `noise`: more than that where neighbours have
    /// noise in common.
    pub noise_of_means: f64,
}

/// The frame's border, as a share of the shorter side.
const BORDER: f64 = 0.05;
/// What lies further off the median, in spreads, is no background; 6 of 10⁵ values of noise do.
const FURTHEST: f64 = 4.0;
/// The side of the squares whose means are compared, and how many squares there must be.
const SQUARE: usize = 4;
pub(super) const ENOUGH_SQUARES: usize = 64;
/// The standard deviation of 16 values of Gaussian noise that a quarter of such sets stays below: √(χ²₁₅ / 15).
const QUIET: f64 = 0.858;
/// Demosaicing correlates noise up to this factor: red and blue have one value of four.
const LARGEST_EXCESS: f64 = 3.0;

impl Background {
    /// Measures a plane's border; `valid` marks the pixels that were measured.
    pub(super) fn of_border(plane: ArrayView2<'_, f32>, valid: Option<&Array2<bool>>) -> Self {
        let (even, squares) = Self::of_even(plane, valid);
        let Some(slope) = slope_of(&squares, even.noise / SQUARE as f64) else { return even };
        #[expect(clippy::cast_possible_truncation, reason = "images are kept in 32 bit")]
        let flat = Array2::from_shape_fn(plane.dim(), |place| {
            (f64::from(plane[place]) - rise(slope, place, plane.dim())) as f32
        });
        Self { slope: Some(slope), ..Self::of_even(flat.view(), valid).0 }
    }

    /// Measures the border of a plane whose background is even, and what squares it has.
    fn of_even(plane: ArrayView2<'_, f32>, valid: Option<&Array2<bool>>) -> (Self, Vec<Square>) {
        let (height, width) = plane.dim();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a small share of a length"
        )]
        let border = ((height.min(width) as f64 * BORDER) as usize).max(1);
        let is_used = |(y, x): (usize, usize)| {
            let is_at_border = y.min(x).min(height - 1 - y).min(width - 1 - x) < border;
            is_at_border && valid.is_none_or(|valid| valid[[y, x]])
        };
        let used = plane.indexed_iter().filter(|(place, _)| is_used(*place));
        let mut values: Vec<f64> = used.map(|(_, &value)| f64::from(value)).collect();
        let Moments { mean: level, deviation: spread, count: pixels } = robust_moments(&mut values);
        let squares = squares_of(plane, is_used);
        let even = Self { level, slope: None, spread, pixels, noise: spread, noise_of_means: spread };
        if squares.len() < ENOUGH_SQUARES {
            return (even, squares);
        }
        let (mut means, mut deviations): (Vec<f64>, Vec<f64>) =
            squares.iter().map(|square| (square.mean, square.deviation)).unzip();
        let quarter = deviations.len() / 4;
        let quiet = *deviations.select_nth_unstable_by(quarter, f64::total_cmp).1;
        let noise = spread.min(quiet / QUIET);
        let of_means = SQUARE as f64 * robust_moments(&mut means).deviation;
        let noise_of_means = of_means.clamp(noise, LARGEST_EXCESS * noise);
        (Self { noise, noise_of_means, ..even }, squares)
    }

    /// Takes it off the light.
    pub(super) fn subtract_from(&self, mut light: ArrayViewMut2<'_, f64>) {
        light -= self.level;
        if let Some(slope) = self.slope {
            let size = light.dim();
            light.indexed_iter_mut().for_each(|(place, value)| *value -= rise(slope, place, size));
        }
    }

    /// What its slope adds to or takes from the light of so many rows and columns in the middle of a frame of `size`.
    pub(super) fn light_of_slope(&self, [rows, columns]: [usize; 2], [height, width]: [usize; 2]) -> f64 {
        let Some([down, right]) = self.slope else { return 0.0 };
        let [tall, wide] = [rows as f64 / height as f64, columns as f64 / width as f64];
        // The mean of the rise along an axis is half of that to the window's edge.
        (rows * columns) as f64 * (down.abs() * tall + right.abs() * wide) / 2.0
    }

    pub(super) fn levels_of_noise(&self) -> Noise {
        Noise { of_pixel: self.noise, of_means: self.noise_of_means }
    }

    /// The standard deviation of the light of so many pixels: that of their noise, and that of the level under them.
    pub(super) fn deviation_of_sum(&self, pixels: f64) -> f64 {
        let of_level = self.spread.max(self.noise_of_means) * pixels / (self.pixels.max(1) as f64).sqrt();
        (self.noise_of_means * pixels.sqrt()).hypot(of_level)
    }
}

/// The squares of 4 × 4 pixels that are used as a whole.
fn squares_of(plane: ArrayView2<'_, f32>, is_used: impl Fn((usize, usize)) -> bool) -> Vec<Square> {
    let (height, width) = plane.dim();
    let square_at = |[row, column]: [usize; 2]| {
        let places = (0..SQUARE * SQUARE)
            .map(|index| (SQUARE * row + index / SQUARE, SQUARE * column + index % SQUARE));
        let values: Option<Vec<f64>> =
            places.map(|place| is_used(place).then(|| f64::from(plane[place]))).collect();
        let (mean, deviation) = mean_and_deviation(&values?);
        let [top, left] = [SQUARE * row, SQUARE * column];
        let middle = (SQUARE - 1) as f64 / 2.0;
        let place = [(top, height), (left, width)]
            .map(|(first, length)| place_between_edges(first as f64 + middle, length));
        let distances = [top, left, height - SQUARE - top, width - SQUARE - left];
        let side = (0..4).min_by_key(|&side| distances[side]).unwrap_or_default();
        Some(Square { place, side, mean, deviation })
    };
    let places = (0..height / SQUARE).flat_map(|row| (0..width / SQUARE).map(move |column| [row, column]));
    places.filter_map(square_at).collect()
}

/// Where a pixel lies between the frame's edges, −1 to 1.
fn place_between_edges(index: f64, length: usize) -> f64 {
    let half = (length as f64 - 1.0) / 2.0;
    (index - half) / half.max(0.5)
}

/// What a slope adds to the level at a pixel.
fn rise([down, right]: [f64; 2], (y, x): (usize, usize), (height, width): (usize, usize)) -> f64 {
    down * place_between_edges(y as f64, height) + right * place_between_edges(x as f64, width)
}

/// Mean and standard deviation of a few values.
fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, (squares / (count - 1.0)).sqrt())
}

struct Moments {
    mean: f64,
    deviation: f64,
    count: usize,
}

/// Mean and standard deviation of the values that lie no further than four spreads off the median.
///
/// The mean, since a median of digital numbers is one of them, half a step off, and lies below the mean of photons. A
/// spread is 1.4826 times the median deviation, a standard deviation of Gaussian noise; where it is zero, for lack of
/// noise or of steps, the median stands for the mean.
fn robust_moments(values: &mut [f64]) -> Moments {
    if values.is_empty() {
        return Moments { mean: 0.0, deviation: 0.0, count: 0 };
    }
    let (level, furthest) = bounds(values);
    let (mut count, mut sum, mut squares) = (0, 0.0, 0.0);
    for offset in values.iter().map(|value| value - level).filter(|offset| offset.abs() <= furthest) {
        (count, sum, squares) = (count + 1, sum + offset, squares + offset * offset);
    }
    let mean = sum / count as f64;
    Moments { mean: level + mean, deviation: (squares / count as f64 - mean * mean).max(0.0).sqrt(), count }
}

/// The median of values, and how far off it, four spreads, a value is no outlier.
pub(super) fn bounds(values: &mut [f64]) -> (f64, f64) {
    let level = median(values);
    let mut deviations: Vec<f64> = values.iter().map(|value| (value - level).abs()).collect();
    (level, FURTHEST * 1.4826 * median(&mut deviations))
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng::stream;
    use rand_distr::{Distribution as _, Normal};

    /// Steps of two thirds of the noise: the median would miss by up to a third of it.
    #[test]
    fn steps_of_digital_numbers_do_not_shift_the_level() {
        let mut rng = stream(1, "background");
        for level in [10.0, 10.2, 10.4] {
            let normal = Normal::new(level, 1.5).unwrap();
            let plane =
                Array2::from_shape_simple_fn((400, 400), || f64::round(normal.sample(&mut rng)) as f32);
            let found = Background::of_border(plane.view(), None);
            // 30 400 values of σ = √(1.5² + 1/12): five standard deviations of their mean.
            assert!((found.level - level).abs() < 5.0 * 1.53 / 174.0, "{found:?} instead of {level}");
            assert!((found.spread / 1.53 - 1.0).abs() < 0.03, "{found:?}");
            // Of some 1900 squares, the spread of means is known to 1.6 %, the quartile of deviations to 0.6 %.
            assert!((found.noise_of_means / 1.53 - 1.0).abs() < 0.1, "{found:?}");
            assert!((found.noise / 1.53 - 1.0).abs() < 0.04, "{found:?}");
        }
    }

    #[test]
    fn lobes_that_cross_the_border_are_left_out() {
        let plane = Array2::from_shape_fn((200, 200), |(y, x)| {
            let lobe = if (90..110).contains(&y) { 5.0 } else { 0.0 };
            lobe + 0.001 * ((y * 37 + x * 101) % 11) as f32
        });
        let found = Background::of_border(plane.view(), None);
        assert!((found.level - 0.005).abs() < 1e-4 && found.spread < 0.004, "{found:?}");
    }

    #[test]
    fn noise_that_neighbours_share_is_seen() {
        let mut rng = stream(2, "background");
        let normal = Normal::new(0.0, 1.0).unwrap();
        let fine = Array2::from_shape_simple_fn((201, 201), || normal.sample(&mut rng));
        let plane = Array2::from_shape_fn((400, 400), |(y, x)| fine[[y / 2, x / 2]] as f32);
        let found = Background::of_border(plane.view(), None);
        assert!((found.noise_of_means / found.spread - 2.0).abs() < 0.15, "{found:?}");
    }

    /// Waves of ten times the noise along the border: lobes, for which noise must not be taken.
    #[test]
    fn structure_at_the_border_is_no_noise() {
        let mut rng = stream(3, "background");
        let normal = Normal::new(0.0, 1.0).unwrap();
        let plane = Array2::from_shape_fn((400, 400), |(y, x)| {
            let wave = 10.0 * ((y as f64 / 9.0).sin() * (x as f64 / 9.0).sin()).powi(2);
            (wave + normal.sample(&mut rng)) as f32
        });
        let found = Background::of_border(plane.view(), None);
        assert!(found.noise < 1.3 && found.noise > 0.9, "{found:?}");
    }
}
