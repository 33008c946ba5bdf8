//! Smooths planes by a bell that costs the same whatever its width, and what is made of that: local brightness, painted
//! holes.

use ndarray::{Array2, ArrayView2, Axis, Zip};
use rayon::prelude::*;

/// Passes of a box; three are a cubic spline, within 3 % of a Gaussian.
const PASSES: usize = 3;

/// Columns that one thread smooths at a time: four cache lines.
const STRIP: usize = 64;

/// Standard deviations, in pixels, of the bells that fill holes, from the finest that reaches a pixel.
const PAINTING_PX: [f32; 6] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];

/// The part of a bell that has to lie on known pixels: fewer tell one of them rather than a mean.
const LEAST_KNOWN: f32 = 0.05;

/// Smooths with a bell of standard deviation `sigma_px`, the plane being zero outside: a symmetric matrix.
///
/// # Equation
/// Three boxes of 2r + 1 pixels have the variance `3·((2r + 1)² − 1)/12`; r is the one that is nearest to σ.
pub(super) fn smooth(plane: &mut Array2<f32>, sigma_px: f32) {
    let radius = radius_of(sigma_px);
    plane.axis_iter_mut(Axis(0)).into_par_iter().for_each_init(Vec::new, |line, mut row| {
        let row = row.as_slice_mut().expect("planes are contiguous");
        for _ in 0..PASSES {
            line.clear();
            line.extend_from_slice(row);
            smooth_row(line, row, radius);
        }
    });
    plane.axis_chunks_iter_mut(Axis(1), STRIP).into_par_iter().for_each(|mut strip| {
        let mut from = strip.to_owned();
        let mut to = from.clone();
        for _ in 0..PASSES {
            smooth_columns(from.view(), to.view_mut(), radius);
            std::mem::swap(&mut from, &mut to);
        }
        strip.assign(&from);
    });
}

/// The local mean with a bell of `sigma_px`, of those pixels alone that lie in the plane.
pub(super) fn local_mean(plane: &Array2<f32>, sigma_px: f32) -> Array2<f32> {
    let mut mean = plane.clone();
    smooth(&mut mean, sigma_px);
    let [rows, columns] = [plane.nrows(), plane.ncols()].map(|length| coverage(length, sigma_px));
    Zip::indexed(mean.rows_mut()).par_for_each(|y, mut row| {
        row.iter_mut().zip(&columns).for_each(|(value, of_column)| *value /= rows[y] * of_column);
    });
    mean
}

/// Fills what is not `known` from its surroundings, from the finest bell that reaches it.
pub(super) fn paint(plane: &mut Array2<f32>, known: &Array2<f32>) {
    let mut holes = Zip::from(known).par_map_collect(|known| *known <= 0.0);
    let seen = Zip::from(&*plane).and(known).par_map_collect(|value, known| value * known);
    for sigma_px in PAINTING_PX {
        if !holes.iter().any(|hole| *hole) {
            return;
        }
        let (mut light, mut share) = (seen.clone(), known.clone());
        smooth(&mut light, sigma_px);
        smooth(&mut share, sigma_px);
        Zip::from(&mut *plane).and(&mut holes).and(&light).and(&share).par_for_each(
            |value, hole, light, share| {
                if *hole && *share > LEAST_KNOWN {
                    (*value, *hole) = (light / share, false);
                }
            },
        );
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few pixels")]
fn radius_of(sigma_px: f32) -> usize {
    ((4.0 * sigma_px.powi(2) + 1.0).sqrt() / 2.0).round() as usize
}

/// What a line of ones is smoothed to.
fn coverage(length: usize, sigma_px: f32) -> Vec<f32> {
    let mut ones = vec![1.0; length];
    for _ in 0..PASSES {
        let before = ones.clone();
        smooth_row(&before, &mut ones, radius_of(sigma_px));
    }
    ones
}

fn smooth_row(before: &[f32], row: &mut [f32], radius: usize) {
    let length = before.len();
    let scale = scale_of(radius);
    let mut sum: f64 = before.iter().take(radius).map(|v| f64::from(*v)).sum();
    for (x, out) in row.iter_mut().enumerate() {
        if let Some(entering) = before.get(x + radius) {
            sum += f64::from(*entering);
        }
        if x > radius && x - radius <= length {
            sum -= f64::from(before[x - radius - 1]);
        }
        *out = narrow(sum * scale);
    }
}

fn smooth_columns(before: ArrayView2<'_, f32>, mut strip: ndarray::ArrayViewMut2<'_, f32>, radius: usize) {
    let height = before.nrows();
    let scale = scale_of(radius);
    let mut sums = vec![0.0; before.ncols()];
    let add = |sums: &mut [f64], y: usize, sign: f64| {
        sums.iter_mut().zip(before.row(y)).for_each(|(sum, value)| *sum += sign * f64::from(*value));
    };
    (0..radius.min(height)).for_each(|y| add(&mut sums, y, 1.0));
    for y in 0..height {
        if y + radius < height {
            add(&mut sums, y + radius, 1.0);
        }
        if y > radius {
            add(&mut sums, y - radius - 1, -1.0);
        }
        strip.row_mut(y).iter_mut().zip(&sums).for_each(|(out, sum)| *out = narrow(sum * scale));
    }
}

#[expect(clippy::cast_precision_loss, reason = "a few pixels")]
fn scale_of(radius: usize) -> f64 {
    1.0 / (2 * radius + 1) as f64
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plane(seed: usize) -> Array2<f32> {
        Array2::from_shape_fn((40, 90), |(y, x)| ((y * 31 + x * 17 + seed) % 23) as f32 / 23.0)
    }

    #[test]
    fn smoothing_is_symmetric_at_the_borders_too() {
        let (a, b) = (plane(1), plane(7));
        let (mut of_a, mut of_b) = (a.clone(), b.clone());
        smooth(&mut of_a, 6.0);
        smooth(&mut of_b, 6.0);
        let (left, right) = ((&of_a * &b).sum(), (&a * &of_b).sum());
        // Sums of 3600 products of 32 bits.
        assert!((left - right).abs() < 1e-4 * left, "{left} {right}");
    }

    #[test]
    fn a_bell_has_unit_sum_and_its_width() {
        for sigma_px in [1.0_f32, 4.0, 6.0, 16.0] {
            let mut bell = Array2::zeros((161, 161));
            bell[[80, 80]] = 1.0;
            smooth(&mut bell, sigma_px);
            let variance: f32 = bell.indexed_iter().map(|((y, _), v)| v * (y as f32 - 80.0).powi(2)).sum();
            // The boxes' widths are odd: a standard deviation is met to half a pixel at most.
            assert!((bell.sum() - 1.0).abs() < 1e-4, "{sigma_px}: {}", bell.sum());
            assert!((variance.sqrt() - sigma_px).abs() < 0.5, "{sigma_px}: {}", variance.sqrt());
        }
    }

    #[test]
    fn the_local_mean_of_a_constant_is_the_constant() {
        for size in [(1, 1), (3, 50), (70, 66)] {
            let mean = local_mean(&Array2::from_elem(size, 0.7), 4.0);
            assert!(mean.iter().all(|v| (v - 0.7).abs() < 1e-5), "{size:?}: {mean}");
        }
    }

    #[test]
    fn holes_are_painted_like_their_surroundings() {
        let truth = Array2::from_shape_fn((60, 60), |(_, x)| x as f32 / 60.0);
        let known = Array2::from_shape_fn((60, 60), |(y, x)| {
            f32::from((y as f32 - 30.0).hypot(x as f32 - 30.0) > 9.0)
        });
        let mut painted = &truth * &known;
        paint(&mut painted, &known);
        for ((place, painted), known) in painted.indexed_iter().zip(&known) {
            let error = (painted - truth[place]).abs();
            // A hole of 18 px over a ramp of 1/60 a pixel.
            assert!(if *known > 0.0 { error < 1e-6 } else { error < 0.15 }, "{place:?}: {error}");
        }
    }

    #[test]
    fn what_no_bell_reaches_stays() {
        let mut plane = Array2::from_elem((8, 8), 3.0);
        paint(&mut plane, &Array2::zeros((8, 8)));
        assert!(plane.iter().all(|v| *v == 3.0));
    }
}
