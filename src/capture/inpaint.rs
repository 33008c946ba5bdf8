//! Turns discarded pixels into what their neighbours say.

use ndarray::{Array2, ArrayViewMut2, Axis};
use rayon::prelude::*;

/// Replaces every pixel that is not `valid` by the mean of the nearest valid ones.
///
/// Neighbours are looked for at multiples of `step` pixels: 1 in images, 2 in mosaics, where only these have the
/// same colour. They stand on the smallest square ring that holds any, and weigh by 1/distance². Only measured
/// pixels are used, so that the order of filling does not matter. A plane without any stays as it is.
///
/// # Panics
/// When the mask has another size than the plane.
pub fn inpaint(mut plane: ArrayViewMut2<'_, f32>, valid: &Array2<bool>, step: usize) {
    assert_eq!(plane.dim(), valid.dim(), "the mask must have the plane's size");
    let measured = plane.to_owned();
    let (height, width) = measured.dim();
    let farthest = height.max(width) / step + 1;
    plane.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(y, mut row)| {
        for (x, value) in row.iter_mut().enumerate().filter(|(x, _)| !valid[[y, *x]]) {
            let found = (1..=farthest).find_map(|ring| mean_on_ring(&measured, valid, (y, x), (ring, step)));
            *value = found.unwrap_or(*value);
        }
    });
}

fn mean_on_ring(
    plane: &Array2<f32>,
    valid: &Array2<bool>,
    (y, x): (usize, usize),
    (ring, step): (usize, usize),
) -> Option<f32> {
    let reach = ring.cast_signed();
    let offsets = (-reach..=reach).flat_map(|dy| {
        // All of the first and the last row, both ends of the others.
        let stride = if dy.abs() == reach { 1 } else { 2 * ring };
        (-reach..=reach).step_by(stride).map(move |dx| (dy, dx))
    });
    let (mut sum, mut weights) = (0.0f64, 0.0f64);
    for (dy, dx) in offsets {
        let stride = step.cast_signed();
        let place = (y.checked_add_signed(dy * stride), x.checked_add_signed(dx * stride));
        if let (Some(y), Some(x)) = place
            && valid.get((y, x)).copied().unwrap_or(false)
        {
            let weight = 1.0 / (dy * dy + dx * dx) as f64;
            sum += weight * f64::from(plane[[y, x]]);
            weights += weight;
        }
    }
    #[expect(clippy::cast_possible_truncation, reason = "a mean of 32-bit values")]
    (weights > 0.0).then(|| (sum / weights) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fills_a_ramp_by_its_neighbours() {
        let ramp = Array2::from_shape_fn((9, 11), |(y, x)| (2 * y + 3 * x) as f32);
        let mut damaged = ramp.clone();
        let mut valid = Array2::from_elem((9, 11), true);
        for place in [(4, 5), (0, 0), (3, 8)] {
            damaged[place] = 1e9;
            valid[place] = false;
        }
        inpaint(damaged.view_mut(), &valid, 1);
        assert!((damaged[[4, 5]] - ramp[[4, 5]]).abs() < 1e-5);
        assert!(damaged[[0, 0]] > 0.0 && damaged[[0, 0]] <= 5.0);
        assert!(ramp.indexed_iter().all(|(place, v)| !valid[place] || damaged[place] == *v));
    }

    #[test]
    fn a_mosaic_is_filled_by_its_own_colour() {
        let mut mosaic = Array2::from_shape_fn((8, 8), |(y, x)| (y % 2 * 2 + x % 2) as f32);
        let mut valid = Array2::from_elem((8, 8), true);
        valid[[3, 4]] = false;
        mosaic[[3, 4]] = 77.0;
        inpaint(mosaic.view_mut(), &valid, 2);
        assert_eq!(mosaic[[3, 4]], 2.0);
    }

    /// The rings as the documentation says them: of all pixels, those at the ring's distance.
    #[test]
    fn walking_a_ring_equals_looking_at_the_whole_square() {
        let plane = Array2::from_shape_fn((31, 27), |(y, x)| ((y * 31 + x * 17) % 23) as f32 * 0.37);
        for step in [1, 2] {
            let valid = Array2::from_shape_fn((31, 27), |(y, x)| {
                (y as f64 - 12.0).hypot(x as f64 - 14.0) > 9.5 && (y * 7 + x * 5) % 11 != 0
            });
            let mut filled = plane.clone();
            inpaint(filled.view_mut(), &valid, step);
            for ((y, x), &found) in filled.indexed_iter() {
                let ring_of = |(v, u): (usize, usize)| {
                    let (dy, dx) = (v.abs_diff(y), u.abs_diff(x));
                    (dy % step == 0 && dx % step == 0).then_some(dy.max(dx) / step)
                };
                let good = || valid.indexed_iter().filter(|(_, valid)| **valid).map(|(place, _)| place);
                let nearest = good().filter_map(ring_of).min().unwrap();
                let (mut sum, mut weights) = (0.0, 0.0);
                for (v, u) in good().filter(|place| ring_of(*place) == Some(nearest)) {
                    let (dy, dx) = (v.abs_diff(y) / step, u.abs_diff(x) / step);
                    let weight = 1.0 / (dy * dy + dx * dx) as f64;
                    sum += weight * f64::from(plane[[v, u]]);
                    weights += weight;
                }
                let expected = if valid[[y, x]] { plane[[y, x]] } else { (sum / weights) as f32 };
                assert_eq!(found, expected, "row {y}, column {x}, step {step}");
            }
        }
    }

    #[test]
    fn large_holes_are_filled_too() {
        let mut plane = Array2::from_elem((20, 20), 5.0);
        let valid = Array2::from_shape_fn((20, 20), |(y, x)| y == 0 || x == 0);
        plane.indexed_iter_mut().filter(|(place, _)| !valid[*place]).for_each(|(_, v)| *v = f32::MAX);
        inpaint(plane.view_mut(), &valid, 1);
        assert!(plane.iter().all(|v| (v - 5.0).abs() < 1e-5));
    }
}
