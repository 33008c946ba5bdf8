//! Where the middle of a blur is that has no sharp peak.

use ndarray::{Array2, ArrayView2, Zip, s};

/// Pixels together at least half as bright as the brightest from which on a peak is broad: of 6 pixels across. What is in focus has fewer.
const BROAD: usize = 30;

/// The point of balance of a broad peak, row and column, of what hangs together; none where the peak is sharp, and its brightest pixel is
/// its middle.
///
/// Out of focus a point is a disc, or a ring with bright places anywhere on it, of which none is its middle. Brightness is the mean of
/// 3 × 3 pixels, so that a lone one does not count.
pub fn broad_peak(light: ArrayView2<'_, f64>) -> Option<[f64; 2]> {
    let (height, width) = light.dim();
    let mut means = sums_around(light);
    let pixels_around = |place: usize, length: usize| (place + 2).min(length) - place.saturating_sub(1);
    for ((y, x), mean) in means.indexed_iter_mut() {
        *mean /= (pixels_around(y, height) * pixels_around(x, width)) as f64;
    }
    let highest = means.iter().copied().fold(0.0, f64::max);
    let mut bright = means.mapv(|mean| highest > 0.0 && mean >= 0.5 * highest);
    let mut largest = (0, [0, 0]);
    for first in (0..means.len()).map(|index| [index / width, index % width]) {
        if bright[first] {
            let region = take_region(&mut bright, first);
            largest = if region.0 > largest.0 { region } else { largest };
        }
    }
    let (count, sums) = largest;
    (count >= BROAD).then(|| sums.map(|sum| sum as f64 / count as f64))
}

/// The sums of the 3 × 3 pixels around each pixel, as far as they are in the plane.
pub fn sums_around(plane: ArrayView2<'_, f64>) -> Array2<f64> {
    let mut along_rows = plane.to_owned();
    if plane.ncols() > 1 {
        Zip::from(along_rows.slice_mut(s![.., 1..]))
            .and(plane.slice(s![.., ..-1]))
            .for_each(|sum, left| *sum += left);
        Zip::from(along_rows.slice_mut(s![.., ..-1]))
            .and(plane.slice(s![.., 1..]))
            .for_each(|sum, right| *sum += right);
    }
    let mut sums = along_rows.clone();
    if plane.nrows() > 1 {
        Zip::from(sums.slice_mut(s![1.., ..]))
            .and(along_rows.slice(s![..-1, ..]))
            .for_each(|sum, above| *sum += above);
        Zip::from(sums.slice_mut(s![..-1, ..]))
            .and(along_rows.slice(s![1.., ..]))
            .for_each(|sum, below| *sum += below);
    }
    sums
}

/// Clears the connected region of set pixels that holds `first`; returns how many there were, and the sums of their
/// places.
pub fn take_region(set: &mut Array2<bool>, first: [usize; 2]) -> (usize, [usize; 2]) {
    let (mut open, mut count, mut sums) = (vec![first], 0, [0, 0]);
    while let Some(place) = open.pop() {
        let Some(pixel) = set.get_mut(place).filter(|pixel| **pixel) else { continue };
        *pixel = false;
        let [y, x] = place;
        count += 1;
        sums = [sums[0] + y, sums[1] + x];
        open.extend([[y.wrapping_sub(1), x], [y + 1, x], [y, x.wrapping_sub(1)], [y, x + 1]]);
    }
    (count, sums)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring of radius 6 about row 20, column 23, brighter on one side.
    fn ring(brighter: f64) -> Array2<f64> {
        Array2::from_shape_fn((41, 45), |(y, x)| {
            let [dy, dx] = [y as f64 - 20.0, x as f64 - 23.0];
            (-(dy.hypot(dx) - 6.0).powi(2) / 2.0).exp() * (1.0 + brighter * dx.atan2(dy).cos())
        })
    }

    #[test]
    fn the_middle_of_a_ring_is_its_point_of_balance() {
        let [y, x] = broad_peak(ring(0.0).view()).unwrap();
        assert!((y - 20.0).abs() < 1e-9 && (x - 23.0).abs() < 1e-9, "{y} {x}");
        let [y, x] = broad_peak(ring(0.2).view()).unwrap();
        assert!((y - 20.0).abs() < 1.0 && (x - 23.0).abs() < 0.5, "{y} {x}");
    }

    #[test]
    fn sums_are_of_the_pixels_around() {
        for size in [(1, 1), (1, 5), (4, 1), (2, 2), (6, 7)] {
            let plane = Array2::from_shape_fn(size, |(y, x)| ((3 * y + 5 * x) % 7) as f64);
            for ((y, x), sum) in sums_around(plane.view()).indexed_iter() {
                let around =
                    plane.indexed_iter().filter(|((v, u), _)| v.abs_diff(y) < 2 && u.abs_diff(x) < 2);
                assert_eq!(around.map(|(_, value)| value).sum::<f64>(), *sum, "{size:?} {y} {x}");
            }
        }
    }

    #[test]
    fn a_sharp_peak_and_darkness_have_none() {
        let peak = |sigma: f64| {
            Array2::from_shape_fn((41, 41), |(y, x)| {
                let squared = (y as f64 - 12.0).powi(2) + (x as f64 - 30.0).powi(2);
                (-0.5 * squared / (sigma * sigma)).exp() + 0.1
            })
        };
        assert_eq!(broad_peak(peak(0.5).view()), None);
        assert_eq!(broad_peak(peak(1.5).view()), None);
        assert!(broad_peak(peak(5.0).view()).is_some());
        assert_eq!(broad_peak(Array2::zeros((41, 41)).view()), None);
    }
}
