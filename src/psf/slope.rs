//! Finds whether the background of a point source rises over the frame, of squares in the border of its picture.

use super::background::{ENOUGH_SQUARES, bounds};

/// A small square of the border.
#[derive(Clone, Copy, Debug)]
pub(super) struct Square {
    /// Its middle, from −1 to 1 between the frame's edges: down and right.
    pub(super) place: [f64; 2],
    /// Which of the frame's four sides is nearest.
    pub(super) side: usize,
    pub(super) mean: f64,
    pub(super) deviation: f64,
}

/// How many times the variance of a mean the plane must explain: of noise, whose two squared coordinates have a χ² of two degrees of
/// freedom, one in 10¹¹ does, and where demosaicing doubled the variance one in 10⁵.
const SIGNIFICANT: f64 = 50.0;
/// How many times what is left beside noise the plane must explain: haze of a source that is off the centre is steeper on one side, but
/// no plane. Of a simulated PSF 90 pixels off in 401 it is 0.7 times, of stray light with a slope of 5 % 90 times.
const EXPLAINS: f64 = 4.0;
/// How far the slope may change, as a share of it, when one side of the frame is left out: one side's order or haze is no slope.
const AGREES: f64 = 0.5;
/// How often what does not fit is left out anew, where that does not come to rest.
const ROUNDS: usize = 12;

/// The rise from the frame's centre to its lower and to its right edge; none where the squares, whose means have this `noise`, show no
/// plane.
///
/// # Method
/// 1. A plane is put through the means of the squares by least squares. Those more than four spreads off it are left out, first those
///    that far off the median, until as many are left: orders and streaks that cross the border.
/// 2. It counts where it explains far more than noise does, and most of what noise does not.
/// 3. It must be as steep without any one of the four sides.
pub(super) fn slope_of(squares: &[Square], noise: f64) -> Option<[f64; 2]> {
    let kept = fitting(squares)?;
    let fit = Plane::through(&kept)?;
    let count = kept.len() as f64;
    let mean = kept.iter().map(|square| square.mean).sum::<f64>() / count;
    let before = kept.iter().map(|square| (square.mean - mean).powi(2)).sum::<f64>() / count;
    let after = kept.iter().map(|square| fit.residual(square).powi(2)).sum::<f64>() / count;
    let (explained, structure) = (before - after, (after - noise * noise).max(0.0));
    let is_plane = explained * count > SIGNIFICANT * after && explained > EXPLAINS * structure;
    let holds_without = |side: usize| {
        let others: Vec<Square> = kept.iter().copied().filter(|square| square.side != side).collect();
        let [down, right] = fit.slope;
        Plane::through(&others).is_some_and(|other| {
            (other.slope[0] - down).hypot(other.slope[1] - right) <= AGREES * down.hypot(right)
        })
    };
    (is_plane && (0..4).all(holds_without)).then_some(fit.slope)
}

/// The squares that lie near the plane through them; none where these are too few.
fn fitting(squares: &[Square]) -> Option<Vec<Square>> {
    let mut kept = near(squares, |square| square.mean);
    for _ in 0..ROUNDS {
        let plane = Plane::through(&kept)?;
        let next = near(squares, |square| plane.residual(square));
        let is_at_rest = next.len() == kept.len();
        kept = next;
        if is_at_rest {
            break;
        }
    }
    (kept.len() >= ENOUGH_SQUARES).then_some(kept)
}

/// The squares whose value is no outlier.
fn near(squares: &[Square], value: impl Fn(&Square) -> f64) -> Vec<Square> {
    if squares.is_empty() {
        return Vec::new();
    }
    let mut values: Vec<f64> = squares.iter().map(&value).collect();
    let (median, furthest) = bounds(&mut values);
    squares.iter().copied().filter(|square| (value(square) - median).abs() <= furthest).collect()
}

struct Plane {
    slope: [f64; 2],
    level: f64,
}

impl Plane {
    /// By least squares; none through squares that lie in a line.
    fn through(squares: &[Square]) -> Option<Self> {
        let count = squares.len() as f64;
        let sum = |of: &dyn Fn(&Square) -> f64| squares.iter().map(of).sum::<f64>();
        let [y, x, mean] =
            [sum(&|s| s.place[0]) / count, sum(&|s| s.place[1]) / count, sum(&|s| s.mean) / count];
        let [yy, xx, yx] = [
            sum(&|s| (s.place[0] - y).powi(2)),
            sum(&|s| (s.place[1] - x).powi(2)),
            sum(&|s| (s.place[0] - y) * (s.place[1] - x)),
        ];
        let [ym, xm] =
            [sum(&|s| (s.place[0] - y) * (s.mean - mean)), sum(&|s| (s.place[1] - x) * (s.mean - mean))];
        let determinant = yy * xx - yx * yx;
        let slope = [(xx * ym - yx * xm) / determinant, (yy * xm - yx * ym) / determinant];
        // In a line, rounding alone is left of the determinant.
        (determinant > 1e-9 * yy * xx).then(|| Self { slope, level: mean - slope[0] * y - slope[1] * x })
    }

    fn residual(&self, square: &Square) -> f64 {
        square.mean - self.level - self.slope[0] * square.place[0] - self.slope[1] * square.place[1]
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;
    use rand_distr::{Distribution as _, Normal};

    use crate::core::rng::stream;
    use crate::psf::Background;

    const SIZE: (usize, usize) = (360, 400);

    /// Noise of deviation 1 on a slope, and light of a PSF.
    fn border(seed: u64, [down, right]: [f64; 2], light: impl Fn([f64; 2]) -> f64) -> Background {
        let mut rng = stream(seed, "slope");
        let normal = Normal::new(10.0, 1.0).unwrap();
        let plane = Array2::from_shape_fn(SIZE, |(y, x)| {
            let [v, u] =
                [(y, SIZE.0), (x, SIZE.1)].map(|(at, side)| 2.0 * at as f64 / (side - 1) as f64 - 1.0);
            (normal.sample(&mut rng) + down * v + right * u + light([v, u])) as f32
        });
        Background::of_border(plane.view(), None)
    }

    /// A streak of some width down and one to the right, as bright towards each side as told: top, left, bottom, right.
    fn cross(bright: [f64; 4], width: f64) -> impl Fn([f64; 2]) -> f64 {
        move |[v, u]| {
            let along = |across: f64, along: f64, [first, last]: [f64; 2]| match across.abs() < width {
                true if along < 0.0 => first,
                true => last,
                false => 0.0,
            };
            along(u, v, [bright[0], bright[2]]) + along(v, u, [bright[1], bright[3]])
        }
    }

    /// Some 18 000 values of deviation 1, at places whose mean square is 0.66: five standard deviations are 0.046. Of
    /// streaks of three deviations a part counts in level and spread.
    #[test]
    fn a_slope_is_found_under_light_that_crosses_the_border() {
        let order = cross([0.0, 0.0, 0.0, 30.0], 0.1);
        let all = cross([3.0; 4], 0.1);
        for (seed, slope) in [(1, [-2.0, 5.0]), (2, [0.0, 0.4]), (3, [20.0, 0.0])] {
            for found in
                [border(seed, slope, |_| 0.0), border(seed, slope, &order), border(seed, slope, &all)]
            {
                let [down, right] = found.slope.expect("a slope");
                assert!((down - slope[0]).abs() < 0.046 && (right - slope[1]).abs() < 0.046, "{found:?}");
                assert!((found.level - 10.0).abs() < 0.5 && (found.spread - 1.0).abs() < 0.5, "{found:?}");
            }
        }
    }

    #[test]
    fn an_even_background_has_none() {
        for seed in 0..20 {
            assert_eq!(border(seed, [0.0; 2], |_| 0.0).slope, None, "{seed}");
        }
    }

    /// Of streaks and orders, bright or below the noise, broad and narrow, on all sides or one; and of haze off the centre.
    #[test]
    fn light_of_the_psf_at_the_border_is_no_slope() {
        for width in [0.05, 0.15, 0.5] {
            for light in [0.3, 1.0, 4.0, 30.0] {
                for sides in [
                    [1.0; 4],
                    [0.0, 0.0, 0.0, 1.0],
                    [0.0, 1.0, 0.0, 0.0],
                    [0.0, 0.0, 1.0, 1.0],
                    [1.0, 0.5, 1.0, 1.0],
                ] {
                    let found = border(5, [0.0; 2], cross(sides.map(|side| side * light), width));
                    assert_eq!(found.slope, None, "{sides:?} of {light}, {width} wide: {found:?}");
                }
            }
        }
        for light in [0.1, 1.0, 10.0] {
            let haze = |[v, u]: [f64; 2]| light / ((v - 0.2).powi(2) + (u + 0.15).powi(2)).powf(1.5);
            assert_eq!(border(6, [0.0; 2], haze).slope, None, "{light}");
        }
    }
}
