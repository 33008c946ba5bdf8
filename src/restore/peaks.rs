//! Tells where in its saturated areas a capture has lamps, by the light that their flare tells.

use ndarray::{Array2, ArrayView2, Zip};

use super::areas::{saturated_in_some, visit_areas};
use crate::core::image::{CHANNELS, LinearImage, row_of};
use crate::core::saturation::saturated_from;

/// The mean over the colours, in multiples of what saturates, from which on light is a lamp's; and that of three by three pixels: of
/// demosaiced captures each colour is told a pixel beside the others.
const BRIGHT: f32 = 2.0;
const BRIGHT_TOGETHER: f32 = 1.5;

/// How far around a pixel its neighbourhood reaches, and the part of the brightest light there that a lamp's pixel has at least.
const REACH_PX: usize = 3;
const LEAST_NEAR: f32 = 0.5;

/// The part of the brightest light of its saturated area that a lamp's pixel has at least: what lies in the glare of a sun is told worse
/// than to some times saturation. The mean of 22 suns and nights changes by -0.01 dB so, and by -0.07 without that.
const LEAST_IN_AREA: f32 = 0.005;

/// Finds the pixels of lamps in the light of a capture's scene, if any: they shine in all colours that are saturated there.
pub(super) fn peaks(
    capture: &LinearImage,
    scene: &LinearImage,
    saturation: [f32; CHANNELS],
) -> Option<Array2<bool>> {
    let saturated = saturated_in_some(capture, saturation);
    if !saturated.iter().any(|saturated| *saturated) {
        return None;
    }
    let light = light(capture, scene, saturation);
    let together = means(light.view());
    let is_peak = |plane: &Array2<f32>, place: (usize, usize), least: f32| {
        let own = plane[place];
        own >= least && own >= LEAST_NEAR * brightest_near(plane.view(), place, REACH_PX)
    };
    let mut peaks = Zip::indexed(&saturated).par_map_collect(|place, saturated| {
        *saturated && (is_peak(&light, place, BRIGHT) || is_peak(&together, place, BRIGHT_TOGETHER))
    });
    visit_areas(saturated, |area| {
        let brightest = area.iter().map(|place| light[*place]).fold(0.0, f32::max);
        area.iter().for_each(|place| peaks[*place] &= light[*place] >= LEAST_IN_AREA * brightest);
    });
    Some(peaks)
}

/// The mean of the colours, each in multiples of what saturates it, and none above that where it is not saturated.
fn light(capture: &LinearImage, scene: &LinearImage, saturation: [f32; CHANNELS]) -> Array2<f32> {
    let mut light = Array2::zeros((capture.height(), capture.width()));
    for (channel, level) in saturation.into_iter().enumerate() {
        let from = saturated_from(level);
        let pixels = Zip::from(&mut light).and(capture.channel(channel)).and(scene.channel(channel));
        pixels.par_for_each(|light, captured, scene| {
            let times = scene / level;
            *light += if *captured >= from { times } else { times.min(1.0) } / CHANNELS as f32;
        });
    }
    light
}

/// The means of three by three pixels, of fewer at the border.
fn means(plane: ArrayView2<'_, f32>) -> Array2<f32> {
    let near = |at: usize, length: usize| at.saturating_sub(1)..(at + 2).min(length);
    let (height, width) = plane.dim();
    let mut means = Array2::zeros(plane.dim());
    Zip::indexed(means.rows_mut()).par_for_each(|y, mut means| {
        let rows: Vec<_> = near(y, height).map(|y| row_of(plane, y)).collect();
        for (x, mean) in means.iter_mut().enumerate() {
            let columns = near(x, width);
            let pixels = (rows.len() * columns.len()) as f32;
            *mean = rows.iter().flat_map(|row| &row[columns.clone()]).sum::<f32>() / pixels;
        }
    });
    means
}

/// The brightest of the pixels up to a `reach` from one along rows and columns, that itself among them.
pub(super) fn brightest_near(plane: ArrayView2<'_, f32>, (y, x): (usize, usize), reach: usize) -> f32 {
    let (height, width) = plane.dim();
    let columns = x.saturating_sub(reach)..(x + reach + 1).min(width);
    let rows = y.saturating_sub(reach)..(y + reach + 1).min(height);
    rows.flat_map(|y| &row_of(plane, y)[columns.clone()]).fold(0.0, |most, value| value.max(most))
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;

    const SIDE: usize = 40;
    const LEVELS: [f32; CHANNELS] = [2.0, 1.0, 1.5];

    /// A scene in multiples of the levels, of which a square from 8 to 32 is saturated in all colours.
    fn found(times: impl Fn(usize, usize, usize) -> f32) -> Vec<(usize, usize)> {
        let near = |at: usize| (8..32).contains(&at);
        let image = |value: &dyn Fn(usize, usize, usize) -> f32| {
            let light = |(channel, y, x): (usize, usize, usize)| LEVELS[channel] * value(channel, y, x);
            LinearImage::from_planes(Array3::from_shape_fn((CHANNELS, SIDE, SIDE), light)).unwrap()
        };
        let capture = image(&|_, y, x| if near(y) && near(x) { 1.0 } else { 0.1 });
        let peaks = peaks(&capture, &image(&times), LEVELS).unwrap();
        peaks.indexed_iter().filter(|(_, is_peak)| **is_peak).map(|(place, _)| place).collect()
    }

    #[test]
    fn lamps_of_a_pixel_are_told_and_what_is_beside_them_is_not() {
        let lamps = |_: usize, y: usize, x: usize| match (y, x) {
            (12, 12) => 40.0,
            (12, 13) => 15.0,
            (25, 20) => 3.0,
            (20, 28) => 1.2,
            // Not saturated: whatever the scene has there is no lamp's.
            (2, 2) => 40.0,
            _ => 0.1,
        };
        // The mean of three by three pixels around the brighter lamp is 6, and from a pixel beside it as much.
        let found = found(lamps);
        assert!([(12, 12), (12, 13), (25, 20)].iter().all(|lamp| found.contains(lamp)), "{found:?}");
        assert!(
            found.iter().all(|(y, x)| (11..=13).contains(y) && (11..=14).contains(x) || (*y, *x) == (25, 20))
        );
    }

    /// As demosaicing leaves them.
    #[test]
    fn colours_that_lie_beside_each_other_are_one_lamp() {
        let lamp = |channel: usize, y: usize, x: usize| {
            if (y, x) == (20, 19 + channel) { 15.0 } else { 0.1 }
        };
        assert!(found(lamp).contains(&(20, 20)));
        assert_eq!(found(|_, _, _| 0.1), []);
    }

    #[test]
    fn the_glare_of_a_sun_has_no_lamps() {
        let sun = |peak: f32| {
            found(move |_, y, x| match (y, x) {
                (20, 20) => peak,
                (12, 30) => 4.0,
                _ => 0.0,
            })
        };
        assert!(sun(300.0).contains(&(12, 30)));
        assert!(!sun(9000.0).contains(&(12, 30)));
    }

    #[test]
    fn a_capture_without_saturated_pixels_has_none() {
        let image = LinearImage::from_planes(Array3::from_elem((CHANNELS, 4, 4), 0.5)).unwrap();
        assert!(peaks(&image, &image, [1.0; CHANNELS]).is_none());
    }
}
