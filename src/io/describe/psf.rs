//! Describes a PSF: where its peak is and how far its energy reaches.

use std::path::Path;

use ndarray::ArrayView2;
use serde::Serialize;

use super::FileDescription;
use crate::core::error::Result;
use crate::io::{PsfOptions, inspect_psf};

/// A PSF file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PsfDescription {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Row and column that stand for no displacement.
    pub centre: (usize, usize),
    /// One entry a channel.
    pub channels: Vec<PsfChannel>,
    /// What is wrong with the file as a PSF, and what mends it.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// The PSF's identity across files.
    pub sha256: String,
}

/// One channel of a PSF.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PsfChannel {
    /// Row and column of the largest value.
    pub peak_at: (usize, usize),
    /// The largest value; the channel sums to one.
    pub peak: f32,
    /// Radius around the centre that holds half of the energy, in pixels.
    pub radius_50_px: f64,
    /// Radius around the centre that holds 90 % of the energy, in pixels.
    pub radius_90_px: f64,
}

/// Describes an image file as the PSF that it holds.
///
/// # Errors
/// As [`inspect_psf`].
pub fn describe_psf(path: &Path, options: PsfOptions) -> Result<FileDescription> {
    let reading = inspect_psf(path, options)?;
    let (warnings, psf) = (reading.warnings(), reading.psf);
    let channels = (0..3).map(|channel| describe_psf_channel(&psf.channel(channel), psf.centre())).collect();
    Ok(FileDescription::Psf(PsfDescription {
        width: psf.width(),
        height: psf.height(),
        centre: psf.centre(),
        channels,
        warnings,
        sha256: psf.sha256(),
    }))
}

fn describe_psf_channel(plane: &ArrayView2<'_, f32>, (centre_y, centre_x): (usize, usize)) -> PsfChannel {
    let (peak_at, peak) = plane
        .indexed_iter()
        .fold(((0, 0), f32::MIN), |best, (at, &value)| if value > best.1 { (at, value) } else { best });
    let mut rings: Vec<(f64, f64)> = plane
        .indexed_iter()
        .map(|((y, x), &value)| {
            let (dy, dx) = (y.abs_diff(centre_y) as f64, x.abs_diff(centre_x) as f64);
            (dy.hypot(dx), f64::from(value))
        })
        .collect();
    rings.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let radius = |share: f64| {
        let mut sum = 0.0;
        let reached = rings.iter().find(|(_, value)| {
            sum += value;
            sum >= share
        });
        reached.map_or(f64::NAN, |(radius, _)| *radius)
    };
    PsfChannel { peak_at, peak, radius_50_px: radius(0.5), radius_90_px: radius(0.9) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::psf::Psf;
    use ndarray::Array3;

    #[test]
    fn radii_hold_the_energy_that_they_name() {
        let mut energy = Array3::zeros((3, 9, 9));
        for channel in 0..3 {
            energy[[channel, 4, 4]] = 6.0;
            energy[[channel, 4, 7]] = 3.0;
            energy[[channel, 0, 4]] = 1.0;
        }
        let psf = Psf::from_energy(energy).unwrap();
        let channel = describe_psf_channel(&psf.channel(0), psf.centre());
        assert_eq!(channel.peak_at, (4, 4));
        assert!((channel.radius_50_px - 0.0).abs() < 1e-12);
        assert!((channel.radius_90_px - 3.0).abs() < 1e-12 || (channel.radius_90_px - 4.0).abs() < 1e-12);
    }
}
