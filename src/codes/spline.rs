//! Turns a plane of samples into the cubic spline that passes through all of them.

use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

use crate::kernels::vectorised;

/// Taps of a cubic B-spline along one axis.
const TAPS: usize = 4;

/// The interpolating cubic spline of a plane.
///
/// # Equation
/// `f(y, x) = Σ c[i, j] · β³(y − i) · β³(x − j)` with the cubic B-spline β³ and coefficients c such that f
/// equals the samples on the grid. The coefficients come from a causal and an anti-causal recursion with the
/// pole z = √3 − 2 along each axis (Unser, Aldroubi and Eden, "B-spline signal processing", 1993). Beyond
/// its border the plane is mirrored about the outermost samples.
///
/// # Accuracy
/// Coefficients and values are f64; on the grid, f equals the samples to about 1e-15 of their range.
#[derive(Clone, Debug)]
pub struct CubicSpline {
    coefficients: Array2<f64>,
}

impl CubicSpline {
    /// Fits the spline through `plane`, `[height, width]`.
    ///
    /// # Panics
    /// When a side of the plane is zero.
    pub fn fit(plane: ArrayView2<'_, f32>) -> Self {
        assert!(!plane.is_empty(), "a spline needs at least one sample, found {:?}", plane.dim());
        let mut along_rows = plane.mapv(f64::from).as_standard_layout().into_owned();
        filter_rows(&mut along_rows);
        let mut along_columns = along_rows.reversed_axes().as_standard_layout().into_owned();
        filter_rows(&mut along_columns);
        Self { coefficients: along_columns.reversed_axes().as_standard_layout().into_owned() }
    }

    /// The value at row `y`, column `x`; zero outside of the rectangle that the samples span.
    ///
    /// # Panics
    /// Never: the coefficients are kept C-contiguous.
    pub fn sample(&self, y: f64, x: f64) -> f64 {
        let (height, width) = self.coefficients.dim();
        let (Some(rows), Some(columns)) = (Support::at(y, height), Support::at(x, width)) else {
            return 0.0;
        };
        let coefficients = self.coefficients.as_slice().expect("coefficients are C-contiguous");
        let mut value = 0.0;
        match (rows.first, columns.first) {
            (Some(top), Some(left)) => {
                for (row, row_weight) in rows.weights.into_iter().enumerate() {
                    let line = &coefficients[(top + row) * width + left..][..TAPS];
                    let [a, b, c, d] = columns.weights;
                    value += row_weight * (line[0] * a + line[1] * b + line[2] * c + line[3] * d);
                }
            }
            _ => {
                let columns_of_taps = columns.mirrored(width);
                for (row, row_weight) in rows.mirrored(height).into_iter().zip(rows.weights) {
                    let line = &coefficients[row * width..][..width];
                    let along = columns_of_taps.iter().zip(&columns.weights);
                    value += row_weight * along.map(|(column, weight)| line[*column] * weight).sum::<f64>();
                }
            }
        }
        value
    }

    /// The values at `from`, row and column, and one `step` after another; zero outside of the rectangle that the samples span.
    ///
    /// Where a step is nearly one column, as of a plane that is turned and scaled by a little, this is many times as fast as
    /// [`sample`](Self::sample) and differs by rounding only.
    ///
    /// # Panics
    /// Never: the coefficients are kept C-contiguous.
    pub fn sample_line(&self, from: [f64; 2], step: [f64; 2], values: &mut [f64]) {
        let (height, width) = self.coefficients.dim();
        let coefficients = self.coefficients.as_slice().expect("coefficients are C-contiguous");
        let mut done = 0;
        while done < values.len() {
            let [y, x] = [0, 1].map(|axis| from[axis] + done as f64 * step[axis]);
            let supports = Support::at(y, height).zip(Support::at(x, width));
            let firsts = supports.as_ref().and_then(|(rows, columns)| rows.first.zip(columns.first));
            let Some((top, left)) = firsts else {
                values[done] = self.sample(y, x);
                done += 1;
                continue;
            };
            // Within a cell of the grid: tops and, but for one column a step, lefts stay.
            let within = [y - (top + 1) as f64, x - (left + 1) as f64];
            let moved = [step[0], step[1] - 1.0];
            let stay = steps_within(within[0], moved[0]).min(steps_within(within[1], moved[1]));
            let count = stay.min(values.len() - done).min(width - TAPS - left + 1);
            let lines =
                std::array::from_fn(|row| &coefficients[(top + row) * width + left..][..count + TAPS - 1]);
            sum_taps(&mut values[done..][..count], lines, within, moved);
            done += count;
        }
    }
}

/// How many values, the first one among them, lie within the cell from 0 to 1 that a position is in and moves through.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a positive number, and casts saturate"
)]
fn steps_within(position: f64, step: f64) -> usize {
    let room = if step > 0.0 { 1.0 - position } else { position };
    if step == 0.0 { usize::MAX } else { ((room / step.abs()).max(0.0) as usize).saturating_add(1) }
}

vectorised! {
    /// The spline at positions within one row of cells, each a cell further than the one before, of the lines of their coefficients.
    fn sum_taps<'a>(values: &'a mut [f64], lines: [&'a [f64]; TAPS], within: [f64; 2], moved: [f64; 2]) -> () {
        let count = values.len();
        let [first, second, third, fourth] = lines;
        let taps = [beside(first, count), beside(second, count), beside(third, count), beside(fourth, count)];
        for index in 0..count {
            #[expect(clippy::cast_possible_truncation, reason = "lines of planes are far shorter")]
            let steps = f64::from(index as u32);
            let rows = weights(within[0] + steps * moved[0]);
            let [a, b, c, d] = weights(within[1] + steps * moved[1]);
            let mut value = 0.0;
            for row in 0..TAPS {
                let taps = &taps[row];
                value += rows[row] * (taps[0][index] * a + taps[1][index] * b + taps[2][index] * c + taps[3][index] * d);
            }
            values[index] = value;
        }
    }
}

/// So many coefficients of a line from the first on, from the second on, and so forth.
#[inline(always)]
fn beside(line: &[f64], count: usize) -> [&[f64]; TAPS] {
    [&line[..count], &line[1..][..count], &line[2..][..count], &line[3..][..count]]
}

/// The cubic B-splines of the samples around a position t after the second of them.
#[inline(always)]
fn weights(t: f64) -> [f64; TAPS] {
    let u = 1.0 - t;
    [
        u * u * u / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0,
        t * t * t / 6.0,
    ]
}

/// The coefficients that a position touches along one axis, and how much of each.
struct Support {
    /// The sample before the position.
    before: usize,
    /// The first coefficient, where all of them lie within the plane.
    first: Option<usize>,
    weights: [f64; TAPS],
}

impl Support {
    /// The support of `position` among `length` samples; none outside of `[0, length − 1]`.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the position was found to lie between 0 and the length of an array"
    )]
    #[inline]
    fn at(position: f64, length: usize) -> Option<Self> {
        if !(position >= 0.0 && position <= (length - 1) as f64) {
            return None;
        }
        let before = position as usize;
        let weights = weights(position - before as f64);
        let first = before.checked_sub(1).filter(|first| first + TAPS <= length);
        Some(Self { before, first, weights })
    }

    /// The coefficients, mirrored where they lie outside.
    fn mirrored(&self, length: usize) -> [usize; TAPS] {
        std::array::from_fn(|tap| mirror(self.before as i64 + tap as i64 - 1, length))
    }
}

/// Reflects an index about the outermost samples, which are not repeated: `c b | a b c | b a`.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_possible_wrap,
    reason = "array lengths are far below 2⁶², and the result lies within the array"
)]
fn mirror(index: i64, length: usize) -> usize {
    if length == 1 {
        return 0;
    }
    let last = length as i64 - 1;
    let folded = index.rem_euclid(2 * last);
    folded.min(2 * last - folded) as usize
}

fn filter_rows(plane: &mut Array2<f64>) {
    plane.axis_iter_mut(Axis(0)).into_par_iter().for_each(|mut row| {
        filter_line(row.as_slice_mut().expect("rows of a C-contiguous plane are slices"));
    });
}

/// Replaces samples by the coefficients of their cubic spline, mirrored at both ends.
fn filter_line(line: &mut [f64]) {
    let length = line.len();
    if length < 2 {
        return;
    }
    let pole = 3f64.sqrt() - 2.0;
    let gain = (1.0 - pole) * (1.0 - 1.0 / pole);
    line.iter_mut().for_each(|value| *value *= gain);
    line[0] = causal_start(line, pole);
    for i in 1..length {
        line[i] += pole * line[i - 1];
    }
    line[length - 1] = pole / (pole * pole - 1.0) * (line[length - 1] + pole * line[length - 2]);
    for i in (0..length - 1).rev() {
        line[i] = pole * (line[i + 1] - line[i]);
    }
}

/// The causal recursion's state after infinitely many mirrored periods.
///
/// # Equation
/// `Σ_{k ≥ 0} z^k · s[k]` over the mirrored signal of period 2(n−1), which is
/// `(Σ_{k < 2(n−1)} z^k · s[k]) / (1 − z^{2(n−1)})`.
fn causal_start(line: &[f64], pole: f64) -> f64 {
    let period = 2 * (line.len() - 1);
    let mut sum = 0.0;
    let mut power = 1.0;
    for k in 0..period {
        sum += power * line[k.min(period - k)];
        power *= pole;
        // |z|^28 < 2⁻⁵³: what follows is below the rounding of the sum.
        if k > 28 {
            return sum;
        }
    }
    sum / (1.0 - power)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texture(height: usize, width: usize) -> Array2<f32> {
        Array2::from_shape_fn((height, width), |(y, x)| ((y * 37 + x * 101) % 23) as f32 - 7.0)
    }

    #[test]
    fn passes_through_its_samples() {
        for (height, width) in [(1, 1), (1, 5), (2, 3), (7, 40), (33, 4)] {
            let plane = texture(height, width);
            let spline = CubicSpline::fit(plane.view());
            for ((y, x), &value) in plane.indexed_iter() {
                let found = spline.sample(y as f64, x as f64);
                assert!((found - f64::from(value)).abs() < 1e-12, "{height} × {width} at {y}, {x}: {found}");
            }
        }
    }

    /// Splines of degree 3 reproduce cubics; the mirrored border disturbs by |z|^k at k samples from it.
    #[test]
    fn reproduces_a_cubic_polynomial_far_from_the_border() {
        let cubic = |t: f64| ((0.02 * t - 0.3) * t + 1.0) * t - 5.0;
        #[expect(clippy::cast_possible_truncation, reason = "a test signal in f32")]
        let plane = Array2::from_shape_fn((1, 81), |(_, x)| cubic(x as f64 - 40.0) as f32);
        let spline = CubicSpline::fit(plane.view());
        let largest = plane.iter().fold(0f32, |m, v| m.max(v.abs()));
        for position in [38.25, 40.5, 41.9] {
            let error = spline.sample(0.0, position) - cubic(position - 40.0);
            assert!(error.abs() < f64::from(largest * f32::EPSILON), "{position}: {error}");
        }
    }

    /// Turned, scaled and mirrored lines, from outside to outside.
    #[test]
    fn a_line_has_the_values_of_its_places() {
        for (height, width) in [(33, 40), (3, 50), (1, 1)] {
            let spline = CubicSpline::fit(texture(height, width).view());
            for step in
                [[0.0, 1.0], [0.02, 0.99], [-0.03, 1.013], [0.7, 0.3], [0.0, -1.0], [1.0, 0.0], [0.0, 0.0]]
            {
                for from in [[-0.5, -3.0], [0.3, 0.0], [2.0, 1.0], [31.9, 4.25], [16.0, 45.0]] {
                    let mut values = [f64::NAN; 64];
                    spline.sample_line(from, step, &mut values);
                    for (index, value) in values.iter().enumerate() {
                        let [y, x] = [0, 1].map(|axis| from[axis] + index as f64 * step[axis]);
                        let expected = spline.sample(y, x);
                        assert!(
                            (value - expected).abs() < 1e-11,
                            "{step:?} from {from:?}, {index}: {value} {expected}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn is_zero_outside_of_the_samples() {
        let spline = CubicSpline::fit(Array2::ones((5, 5)).view());
        assert_eq!(spline.sample(-0.01, 2.0), 0.0);
        assert_eq!(spline.sample(2.0, 4.01), 0.0);
        assert_eq!(spline.sample(f64::NAN, 2.0), 0.0);
        assert!((spline.sample(4.0, 0.0) - 1.0).abs() < 1e-15);
    }
}
