//! Counts the pixels in the picture of a point source that look hot: they become ghosts in what its PSF restores.

use ndarray::{Array3, Axis};

use super::darks::standing_out;
use super::point_source::peak;
use crate::core::lone::{is_faint_beside, stands_alone};

/// The values of one colour that stand alone in planes, or in a mosaic whose photosites of one colour are `step` pixels apart.
///
/// In a mosaic the neighbours are of all colours: an order may be as narrow as a photosite, and its counterpart tells it then.
pub(super) fn count_lone(planes: &Array3<f32>, step: usize) -> usize {
    let centre = peak(planes.sum_axis(Axis(0)).view());
    let in_channel = |channel: usize| {
        let plane = planes.index_axis(Axis(0), channel);
        let is_of_one_colour = |at: (usize, usize)| {
            let mut others = planes.axis_iter(Axis(0)).enumerate().filter(|(other, _)| *other != channel);
            others.all(|(_, other)| is_faint_beside(other, at, plane[at]))
        };
        let standing_out = standing_out(plane, step);
        let bright = standing_out.indexed_iter().filter(|(_, stands_out)| **stands_out).map(|(at, _)| at);
        bright.filter(|&at| stands_alone(plane, at, centre, step) && is_of_one_colour(at)).count()
    };
    (0..planes.len_of(Axis(0))).map(in_channel).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng::stream;
    use rand_distr::{Distribution as _, Normal};

    /// A core, eight narrow orders, noise, and hot pixels.
    fn planes(channels: usize, hot: &[(usize, usize, usize)]) -> Array3<f32> {
        let mut rng = stream(4, "hot pixels of a point source");
        let noise = Normal::new(0.0, 3e-4).unwrap();
        let mut planes = Array3::from_shape_fn((channels, 96, 101), |(_, y, x)| {
            let [dy, dx] = [y as f64 - 40.0, x as f64 - 52.0];
            let core = 600.0 * (-(dy * dy + dx * dx) / 2.0).exp() + 0.3 * (-dy.hypot(dx) / 6.0).exp();
            let is_order = dy.abs().max(dx.abs()) == 20.0 && dy % 20.0 == 0.0 && dx % 20.0 == 0.0;
            (core + if is_order { 3.0 } else { 0.0 } + noise.sample(&mut rng)) as f32
        });
        hot.iter().for_each(|&place| planes[place] += 0.2);
        planes
    }

    #[test]
    fn hot_pixels_are_counted_and_orders_are_not() {
        for (channels, step) in [(3, 1), (1, 2)] {
            assert_eq!(count_lone(&planes(channels, &[]), step), 0);
            let hot = [(0, 5, 7), (channels - 1, 70, 80), (0, 60, 3)];
            assert_eq!(count_lone(&planes(channels, &hot), step), 3, "{channels} channels");
        }
    }

    /// What all colours show is light; of what lies where the other side of the source is not in the picture, nothing is known.
    #[test]
    fn a_spot_of_all_colours_and_one_without_opposite_are_left() {
        assert_eq!(count_lone(&planes(3, &[(0, 70, 80), (1, 70, 80), (2, 70, 80)]), 1), 0);
        assert_eq!(count_lone(&planes(3, &[(0, 90, 80)]), 1), 0);
    }
}
