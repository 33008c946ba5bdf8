//! Tells of the lamps of a capture, whose light the sensor clipped: where they are and how bright.

use std::fmt;

use serde::Serialize;

use super::areas::{saturated_in_some, visit_areas};
use crate::core::image::{CHANNELS, LinearImage};
use crate::core::saturation::saturated_from;

/// A connected area of saturated pixels, and the light that its flare tells.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Lamp {
    /// Row and column of the middle of its light.
    pub position: [f64; 2],
    /// Pixels that are saturated in some channel.
    pub pixels: usize,
    /// The mean of its light in red, green and blue over those pixels, in multiples of what saturates the channel: the flare
    /// tells the sum well, and hardly how it is spread over the pixels.
    pub times_saturation: [f32; CHANNELS],
    /// The sum of its light in each channel.
    pub light: [f64; CHANNELS],
}

/// Finds the lamps of a capture in the light of its scene, brightest first.
pub(super) fn find_lamps(
    capture: &LinearImage,
    scene: &LinearImage,
    saturation: [f32; CHANNELS],
) -> Vec<Lamp> {
    let light = scene.planes();
    let mut lamps = Vec::new();
    let value = |channel: usize, (y, x): (usize, usize)| light[[channel, y, x]];
    let saturated = saturated_in_some(capture, saturation);
    visit_areas(saturated, |area| lamps.push(Lamp::of_area(area, value, saturation)));
    lamps.sort_by(|a, b| b.total().total_cmp(&a.total()));
    lamps
}

/// The sum of a scene's light above what saturates its capture, where that is saturated.
pub(super) fn light_of_lamps(capture: &LinearImage, scene: &LinearImage, saturation: [f32; CHANNELS]) -> f64 {
    let of_channel = |(channel, white): (usize, f32)| -> f64 {
        let pixels = capture.channel(channel).into_iter().zip(scene.channel(channel));
        let saturated = pixels.filter(|(captured, _)| **captured >= saturated_from(white));
        saturated.map(|(_, light)| f64::from((light - white).max(0.0))).sum()
    };
    saturation.into_iter().enumerate().map(of_channel).sum()
}

impl Lamp {
    fn of_area(
        area: &[(usize, usize)],
        value: impl Fn(usize, (usize, usize)) -> f32,
        saturation: [f32; CHANNELS],
    ) -> Self {
        let mut lamp =
            Self { position: [0.0; 2], pixels: area.len(), times_saturation: [0.0; 3], light: [0.0; 3] };
        for &place in area {
            for channel in 0..CHANNELS {
                let light = f64::from(value(channel, place));
                lamp.light[channel] += light;
                lamp.position[0] += light * place.0 as f64;
                lamp.position[1] += light * place.1 as f64;
            }
        }
        for (channel, saturation) in saturation.into_iter().enumerate() {
            let mean = lamp.light[channel] / area.len() as f64;
            #[expect(clippy::cast_possible_truncation, reason = "light of 32 bits")]
            let times = (mean / f64::from(saturation)) as f32;
            lamp.times_saturation[channel] = times;
        }
        let total = lamp.total().max(f64::MIN_POSITIVE);
        lamp.position = lamp.position.map(|moment| moment / total);
        lamp
    }

    fn total(&self) -> f64 {
        self.light.iter().sum()
    }
}

impl fmt::Display for Lamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [y, x] = self.position;
        // What is dark beside a level, or has none that is known, tells nothing.
        const LEAST: f32 = 0.05;
        let names = ["red", "green", "blue"];
        let times: Vec<String> = names
            .into_iter()
            .zip(self.times_saturation)
            .filter(|(_, times)| *times >= LEAST)
            .map(|(name, times)| format!("{times:.1} in {name}"))
            .collect();
        let pixels = if self.pixels == 1 { "pixel" } else { "pixels" };
        let saturated = format!("at row {y:.0}, column {x:.0}: {} saturated {pixels}", self.pixels);
        if self.times_saturation.iter().all(|times| *times < 1.0) {
            return write!(f, "glare {saturated}, more by the flare of lamps than by light of their own");
        }
        write!(f, "lamp {saturated}, as bright as saturation times {}", times.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn lamps_are_told_apart_and_the_brightest_comes_first() {
        let mut light = Array3::from_elem((3, 12, 20), 0.1);
        light[[1, 2, 3]] = 40.0;
        light[[0, 3, 4]] = 20.0;
        light[[2, 8, 15]] = 800.0;
        let scene = LinearImage::from_planes(light).unwrap();
        let capture = scene.map_values(|v| v.min(4.0));
        let lamps = find_lamps(&capture, &scene, [4.0; 3]);
        assert_eq!(lamps.iter().map(|lamp| lamp.pixels).collect::<Vec<_>>(), [1, 2]);
        assert_eq!(lamps[0].times_saturation[2], 200.0);
        assert!((lamps[0].position[0] - 8.0).abs() < 0.01 && (lamps[0].position[1] - 15.0).abs() < 0.01);
        let [red, green, _] = lamps[1].times_saturation;
        assert!((red - 2.5125).abs() < 1e-4 && (green - 5.0125).abs() < 1e-4, "{red} {green}");
        assert!(lamps[0].to_string().starts_with("lamp at row 8, column 15: 1 saturated pixel, as"));
        let faint = Lamp { times_saturation: [0.002, 7.25, 1.5], ..lamps[0].clone() };
        assert!(
            faint.to_string().ends_with("as bright as saturation times 7.2 in green, 1.5 in blue"),
            "{faint}"
        );
        let glare = Lamp { times_saturation: [0.02, 0.4, 0.0], ..lamps[0].clone() };
        assert!(
            glare.to_string().starts_with("glare at row 8, column 15: 1 saturated pixel, more by"),
            "{glare}"
        );
    }

    /// Their shares added up in 32 bits are off by a hundredth and more.
    #[test]
    fn the_mean_of_a_large_lamp_is_that_of_its_pixels() {
        let area: Vec<(usize, usize)> = (0..4_000_000).map(|at| (at / 2000, at % 2000)).collect();
        let lamp = Lamp::of_area(&area, |_, _| 3.3, [1.1; CHANNELS]);
        for times in lamp.times_saturation {
            assert!((times - 3.0).abs() < 1e-5, "{times}");
        }
    }

    #[test]
    fn a_capture_without_saturated_pixels_has_no_lamps() {
        let image = LinearImage::from_planes(Array3::from_elem((3, 4, 4), 0.5)).unwrap();
        assert!(find_lamps(&image, &image, [1.0; 3]).is_empty());
    }
}
