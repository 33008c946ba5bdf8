//! Turns one channel of a PSF by an angle: values between pixels, all of them light.
//!
//! # Equation
//! A sharp PSF has details between its pixels that a cubic spline s through them rings at: around each peak the spline
//! turns negative, and clipping that leaves dark dots and too much light elsewhere. The spline r of the square roots
//! rings far less, since the roots of peak and sidelobes differ less, and its square is light everywhere. What squaring
//! does to the light is taken back by its own neighbourhood: with ⟨·⟩ the mean of 11 × 11 pixels,
//! `q = r² · ⟨s⟩/⟨r²⟩` has the light of the spline, which neither clipping nor squaring has touched, around each pixel;
//! and so has the clipped spline `e = max(s, 0) · ⟨s⟩/⟨max(s, 0)⟩`. The result is `e + w·(q − e)` with the largest w, at most
//! 1, whose sum of absolute differences from `max(s, 0)`, both of unit sum, is no more than 5 %: what other software
//! makes of the PSF stays comparable. A peak that its pixels do not resolve is another matter: clipping alone moves the
//! spline of a pixel with 60 % of the light by 20 % at 12°, takes 7 % off the peak and leaves black dots. So the bound is
//! `max(5 %, 2c − 7.5 %)`, c being what clipping changes: where c is above 6 %, the clipped spline is no standard.
//!
//! # Accuracy
//! Against the PSFs of the turned panels themselves (`configs/display/pentile.toml` and `stripe.toml`, 400 × 400 pixels,
//! ±3° to ±12°, sum of absolute differences, mean over angles and channels): 5.7 % and 7.3 %, where the clipped spline has
//! 9.3 % and 11.2 %; the light of the peak's pixel within 0.5 % (spline: 2.3 %), that within 3 pixels of it within 0.5 %
//! (1.5 %), that of the haze from 60 to 190 pixels within 0.3 % (7.2 %). q alone, 9 % from the spline in the mean and
//! 16 % at most, comes to 3.5 % and 4.3 %. Of a PSF that its pixels resolve, all of them are the same. A pixel with 60 %
//! of the light in a halo of e^(−r/6), at 12°: the peak is 0.601 for 0.602 (clipped spline: 0.557), 2.6 % in all are wrong
//! (20 %); at 45° still 14 %.

use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

use super::spline::CubicSpline;

/// The largest sum of absolute differences from the clipped spline, less the rounding of the result.
const FARTHEST: f64 = 0.05 * 0.98;

/// How much farther the result may be for each bit that clipping itself changes beyond [`CHANGED_LITTLE`]: of the shipped
/// panels it changes 5 % at most.
const FARTHER: f64 = 2.0;

/// What clipping changes of a spline that still is a standard.
const CHANGED_LITTLE: f64 = 0.0625;

/// Pixels on each side whose light is kept together.
const REACH: usize = 5;

/// The most by which light of a neighbourhood is scaled; more is asked for only where there is next to none.
const LARGEST_SCALE: f64 = 2.0;

/// Halvings of the interval that w is found in: to 10⁻³ of it.
const HALVINGS: usize = 10;

/// A channel that can be turned by any angle.
pub(super) struct Interpolation {
    plain: CubicSpline,
    roots: CubicSpline,
}

impl Interpolation {
    /// Fits the splines through a channel, `[height, width]`, which is nowhere negative.
    pub(super) fn new(channel: ArrayView2<'_, f32>) -> Self {
        Self { plain: CubicSpline::fit(channel), roots: CubicSpline::fit(channel.mapv(f32::sqrt).view()) }
    }

    /// The values at the places (row, column) that `place` gives for the pixels of a plane of `[height, width]`.
    pub(super) fn sample(
        &self,
        (height, width): (usize, usize),
        place: impl Fn(usize, usize) -> (f64, f64) + Sync,
    ) -> Array2<f32> {
        let mut plain = Array2::zeros((height, width));
        let mut squares = Array2::zeros((height, width));
        let rows = plain.axis_iter_mut(Axis(0)).into_par_iter().zip(squares.axis_iter_mut(Axis(0)));
        rows.enumerate().for_each(|(y, (mut plain, mut squares))| {
            for (x, (plain, square)) in plain.iter_mut().zip(&mut squares).enumerate() {
                let (from_y, from_x) = place(y, x);
                *plain = self.plain.sample(from_y, from_x);
                *square = self.roots.sample(from_y, from_x).powi(2);
            }
        });
        combine(&plain, squares)
    }
}

/// Mixes the spline and the square of the roots' spline; see the head of the file.
#[expect(clippy::cast_possible_truncation, reason = "PSF values are f32")]
fn combine(plain: &Array2<f64>, squares: Array2<f64>) -> Array2<f32> {
    let light = neighbourhoods(plain);
    let clipped = plain.mapv(|value| value.max(0.0));
    let squares = with_light(squares, &light);
    let restored = with_light(clipped.clone(), &light);
    let clipped = of_unit_sum(clipped);
    let mixed = |share: f64| move |(e, q): (&f64, &f64)| e + share * (q - e);
    let distance = |share: f64| {
        sum_rows(plain.nrows(), |y| {
            let pairs = restored.row(y).into_iter().zip(squares.row(y)).map(mixed(share));
            pairs.zip(clipped.row(y)).map(|(value, clipped)| (value - clipped).abs()).sum()
        })
    };
    let farthest = farthest_from(&clipped, plain);
    let share = largest_share(distance, farthest);
    // Where even e is too far, because clipping itself adds much light: from the spline towards q, which has no dark dots.
    let keep = (farthest / distance(share)).min(1.0);
    let mut result = Array2::zeros(plain.dim());
    for (y, mut row) in result.axis_iter_mut(Axis(0)).enumerate() {
        let pairs = restored.row(y).into_iter().zip(squares.row(y)).map(mixed(share));
        for ((result, value), clipped) in row.iter_mut().zip(pairs).zip(clipped.row(y)) {
            *result = (clipped + keep * (value - clipped)) as f32;
        }
    }
    result
}

/// How far from the clipped spline, of unit sum, the result may be; see the head of the file.
fn farthest_from(clipped: &Array2<f64>, plain: &Array2<f64>) -> f64 {
    let sum = sum_rows(plain.nrows(), |y| plain.row(y).sum());
    let changed = sum_rows(plain.nrows(), |y| {
        plain
            .row(y)
            .into_iter()
            .zip(clipped.row(y))
            .map(|(plain, clipped)| (plain / sum - clipped).abs())
            .sum()
    });
    if changed > CHANGED_LITTLE { FARTHEST + FARTHER * (changed - CHANGED_LITTLE) } else { FARTHEST }
}

/// The largest share from 0 to 1 whose distance, which has one minimum, is allowed; 1 where that of 0 is not.
fn largest_share(distance: impl Fn(f64) -> f64, farthest: f64) -> f64 {
    if distance(1.0) <= farthest || distance(0.0) > farthest {
        return 1.0;
    }
    let (mut allowed, mut refused) = (0.0, 1.0);
    for _ in 0..HALVINGS {
        let middle = f64::midpoint(allowed, refused);
        if distance(middle) <= farthest { allowed = middle } else { refused = middle }
    }
    allowed
}

/// Scales values so that each neighbourhood has about the light given for it, and their sum is 1.
fn with_light(mut values: Array2<f64>, light: &Array2<f64>) -> Array2<f64> {
    let found = neighbourhoods(&values);
    let scaled = values.axis_iter_mut(Axis(0)).into_par_iter().zip(light.axis_iter(Axis(0)));
    scaled.zip(found.axis_iter(Axis(0))).for_each(|((mut values, light), found)| {
        for ((value, light), found) in values.iter_mut().zip(light).zip(found) {
            if *found > 0.0 {
                *value *= (light / found).clamp(1.0 / LARGEST_SCALE, LARGEST_SCALE);
            }
        }
    });
    of_unit_sum(values)
}

fn of_unit_sum(mut values: Array2<f64>) -> Array2<f64> {
    let sum = sum_rows(values.nrows(), |y| values.row(y).sum());
    if sum > 0.0 {
        values.mapv_inplace(|value| value / sum);
    }
    values
}

/// The sum over the square of pixels around each one, of those that there are.
fn neighbourhoods(values: &Array2<f64>) -> Array2<f64> {
    let (height, width) = values.dim();
    let mut down = Array2::<f64>::zeros((height, width));
    down.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(y, mut sums)| {
        for row in y.saturating_sub(REACH)..(y + REACH + 1).min(height) {
            sums += &values.row(row);
        }
    });
    let mut around = Array2::<f64>::zeros((height, width));
    around.axis_iter_mut(Axis(0)).into_par_iter().zip(down.axis_iter(Axis(0))).for_each(|(mut sums, row)| {
        // Sums up to each pixel: their differences are those between.
        let mut up_to = vec![0.0; width + 1];
        for (x, value) in row.iter().enumerate() {
            up_to[x + 1] = up_to[x] + value;
        }
        for (x, sum) in sums.iter_mut().enumerate() {
            *sum = up_to[(x + REACH + 1).min(width)] - up_to[x.saturating_sub(REACH)];
        }
    });
    around
}

/// Adds up rows one after another, whatever the number of threads that they are computed on.
fn sum_rows(rows: usize, of_row: impl Fn(usize) -> f64 + Sync + Send) -> f64 {
    let sums: Vec<f64> = (0..rows).into_par_iter().map(of_row).collect();
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbourhoods_end_at_the_border() {
        let sums = neighbourhoods(&Array2::ones((20, 14)));
        assert_eq!((sums[[0, 0]], sums[[10, 7]], sums[[19, 3]]), (36.0, 121.0, 54.0));
    }

    #[test]
    fn on_the_pixels_themselves_values_stay_as_they_are() {
        let plane = Array2::from_shape_fn((31, 33), |(y, x)| ((y * 37 + x * 101) % 23) as f32);
        let sum: f32 = plane.sum();
        let found = Interpolation::new(plane.view()).sample((31, 33), |y, x| (y as f64, x as f64));
        for (found, expected) in found.iter().zip(&plane) {
            assert!((found * sum - expected).abs() < 1e-4, "{found} for {expected}");
        }
    }

    /// A lamp of one pixel, half a pixel off: the spline's ringing is −9 % of it beside the peak.
    #[test]
    fn a_sharp_peak_leaves_no_dark_dots_around_it() {
        let mut plane = Array2::from_elem((41, 41), 1e-4f32);
        plane[[20, 20]] = 1.0;
        let interpolation = Interpolation::new(plane.view());
        let dark = |y: usize, x: usize| interpolation.plain.sample(y as f64 + 0.5, x as f64 + 0.5) < 0.0;
        let found = interpolation.sample((40, 40), |y, x| (y as f64 + 0.5, x as f64 + 0.5));
        assert!((0..40).any(|y| (0..40).any(|x| dark(y, x))), "the spline does ring");
        assert!(found.iter().all(|value| *value > 0.0));
    }

    /// A pixel with 60 % of the light in an isotropic halo, turned by 12° about itself: it should stay as it is.
    #[test]
    fn a_peak_of_one_pixel_keeps_its_light_and_its_halo() {
        let halo = |y: usize, x: usize| (-(y as f64 - 32.0).hypot(x as f64 - 32.0) / 6.0).exp();
        let mut plane = Array2::from_shape_fn((65, 65), |(y, x)| halo(y, x));
        let around = plane.sum();
        plane *= 0.4 / around;
        plane[[32, 32]] += 0.6;
        #[expect(clippy::cast_possible_truncation, reason = "PSF values are f32")]
        let interpolation = Interpolation::new(plane.mapv(|value| value as f32).view());
        let (sin, cos) = 12f64.to_radians().sin_cos();
        let found = interpolation.sample((65, 65), |y, x| {
            let (dy, dx) = (y as f64 - 32.0, x as f64 - 32.0);
            (32.0 + dy * cos + dx * sin, 32.0 + dx * cos - dy * sin)
        });
        let peak = f64::from(found[[32, 32]]) / plane[[32, 32]];
        assert!((peak - 1.0).abs() < 0.01, "the clipped spline has 0.93: {peak}");
        let wrong: f64 =
            found.iter().zip(&plane).map(|(found, true_)| (f64::from(*found) - true_).abs()).sum();
        assert!(wrong < 0.05, "the clipped spline has 0.2: {wrong}");
        for ((y, x), found) in
            found.indexed_iter().filter(|((y, x), _)| y.abs_diff(32).max(x.abs_diff(32)) < 5)
        {
            let share = f64::from(*found) / plane[[y, x]];
            assert!(share > 0.2, "{share} of the light at {y}, {x}: a dark dot");
        }
    }

    #[test]
    fn takes_the_largest_share_that_is_allowed() {
        assert_eq!(largest_share(|share| share * 0.04, FARTHEST), 1.0);
        assert_eq!(largest_share(|share| 0.06 + share, FARTHEST), 1.0);
        let found = largest_share(|share| 0.02 + 0.1 * share, FARTHEST);
        assert!(((0.02 + 0.1 * found) / FARTHEST - 1.0).abs() < 1e-2, "{found}");
    }
}
