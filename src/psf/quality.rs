//! Turns a PSF into the numbers that tell whether it is a good one.

use serde::Serialize;

use crate::core::psf::Psf;

/// How a PSF spreads its light, for each channel.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct PsfQuality {
    /// Red, green, blue.
    pub channels: [ChannelQuality; 3],
}

/// How one channel of a PSF spreads its light.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct ChannelQuality {
    /// The share of the light in the brightest pixel.
    pub peak_share: f64,
    /// The brightest pixel over the brightest one outside of the core; none when nothing rises again.
    pub peak_to_sidelobe: Option<f64>,
    /// The radius of the core in pixels: where the mean brightness first rises again.
    pub core_radius_px: usize,
    /// Radii in pixels around the centre that hold 50, 90 and 99 % of the light.
    pub encircled_px: [f64; 3],
}

/// Measures a PSF around its centre.
pub fn assess_psf(psf: &Psf) -> PsfQuality {
    PsfQuality { channels: [0, 1, 2].map(|channel| assess_channel(psf, channel)) }
}

fn assess_channel(psf: &Psf, channel: usize) -> ChannelQuality {
    let plane = psf.channel(channel);
    let (centre_y, centre_x) = psf.centre();
    let squared = |y: usize, x: usize| y.abs_diff(centre_y).pow(2) + x.abs_diff(centre_x).pow(2);
    let mut energy_at = vec![0.0f64; squared(0, 0) + 1];
    for ((y, x), &value) in plane.indexed_iter() {
        energy_at[squared(y, x)] += f64::from(value);
    }
    let core_radius_px =
        core_radius(&plane.indexed_iter().map(|((y, x), &v)| (squared(y, x), v)).collect::<Vec<_>>());
    let peak = plane.iter().copied().fold(0.0, f32::max);
    let outside = |(y, x): (usize, usize)| squared(y, x) > core_radius_px.pow(2);
    let sidelobe =
        plane.indexed_iter().filter(|(place, _)| outside(*place)).map(|(_, &v)| v).fold(0.0, f32::max);
    ChannelQuality {
        peak_share: f64::from(peak),
        peak_to_sidelobe: (sidelobe > 0.0).then(|| f64::from(peak) / f64::from(sidelobe)),
        core_radius_px,
        encircled_px: [0.5, 0.9, 0.99].map(|share| encircling_radius(&energy_at, share)),
    }
}

/// The first radius after which the mean over rings one pixel wide grows.
fn core_radius(values: &[(usize, f32)]) -> usize {
    let ring = |squared: usize| squared.isqrt();
    let rings = values.iter().map(|(squared, _)| ring(*squared)).max().unwrap_or(0) + 1;
    let mut sums = vec![(0.0f64, 0usize); rings];
    for (squared, value) in values {
        let (sum, count) = &mut sums[ring(*squared)];
        *sum += f64::from(*value);
        *count += 1;
    }
    let mean = |index: usize| sums[index].0 / sums[index].1.max(1) as f64;
    (0..rings.saturating_sub(1)).find(|&index| mean(index + 1) > mean(index)).unwrap_or(rings)
}

/// The radius that holds `share` of the light, given the light at each squared radius.
fn encircling_radius(energy_at: &[f64], share: f64) -> f64 {
    let total: f64 = energy_at.iter().sum();
    let mut inside = 0.0;
    for (squared, energy) in energy_at.iter().enumerate() {
        inside += energy;
        if inside >= share * total {
            return (squared as f64).sqrt();
        }
    }
    (energy_at.len().saturating_sub(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn measures_a_core_with_one_sidelobe() {
        let planes = Array3::from_shape_fn((3, 65, 65), |(_, y, x)| {
            let core = (-(((y as f32 - 32.0).powi(2) + (x as f32 - 32.0).powi(2)) / 8.0)).exp();
            core + if (y, x) == (32, 52) { 0.5 } else { 0.0 }
        });
        let quality = assess_psf(&Psf::from_energy(planes).unwrap());
        let green = &quality.channels[1];
        assert!((green.peak_to_sidelobe.unwrap() - 2.0).abs() < 1e-3);
        // A Gaussian of σ = 2 holds half of its light within 1.177 σ; the sidelobe adds 2 % outside.
        assert!((green.encircled_px[0] - 2.354).abs() < 0.5, "{green:?}");
        assert_eq!(green.encircled_px[2], 20.0);
        // 1/(2πσ²), less the sidelobe's 2 %.
        assert!((green.peak_share - 0.0390).abs() < 5e-4);
    }

    #[test]
    fn a_single_point_has_no_sidelobe() {
        let mut planes = Array3::zeros((3, 5, 5));
        planes.slice_mut(ndarray::s![.., 2, 2]).fill(1.0);
        let quality = assess_psf(&Psf::from_energy(planes).unwrap());
        assert_eq!(quality.channels[0].peak_to_sidelobe, None);
        assert_eq!(quality.channels[0].encircled_px, [0.0; 3]);
    }
}
