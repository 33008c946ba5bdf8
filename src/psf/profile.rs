//! Turns a PSF into the curves by which optics are judged: brightness and light by radius, contrast by frequency.

use std::f64::consts::TAU;

use ndarray::{ArrayView2, Axis};

use crate::core::psf::Psf;

/// The curves of one channel of a PSF, as points (x, y) by rising x.
#[derive(Clone, Debug, PartialEq)]
pub struct PsfProfile {
    /// The mean brightness of rings one pixel wide, by their radius in pixels, as a share of all light.
    pub radial: Vec<(f64, f64)>,
    /// The share of the light within a radius in pixels.
    pub encircled: Vec<(f64, f64)>,
    /// The contrast that is left of gratings across the columns, by their frequency in cycles a pixel.
    pub mtf_across: Vec<(f64, f64)>,
    /// The same of gratings down the rows.
    pub mtf_down: Vec<(f64, f64)>,
}

/// Frequencies at which the MTF is computed, from 0 to one half of a cycle a pixel.
const FREQUENCIES: u32 = 128;

impl PsfProfile {
    /// Computes the curves of a channel around the PSF's centre.
    ///
    /// # Equation
    /// `MTF(f) = |Σₓ l(x)·exp(−2πi·f·x)|` of the line spread function l, the sum of the PSF over rows or over columns:
    /// a section of the modulus of the two-dimensional OTF through its middle.
    pub fn of(psf: &Psf, channel: usize) -> Self {
        let plane = psf.channel(channel);
        let (radial, encircled) = rings(plane, psf.centre());
        let line = |axis| plane.sum_axis(Axis(axis)).mapv(f64::from).to_vec();
        Self { radial, encircled, mtf_across: mtf(&line(0)), mtf_down: mtf(&line(1)) }
    }
}

/// Points by rising radius.
type Curve = Vec<(f64, f64)>;

/// The mean brightness of rings, and the light within them; a ring holds the pixels whose radius rounds to its own.
fn rings(plane: ArrayView2<'_, f32>, (centre_y, centre_x): (usize, usize)) -> (Curve, Curve) {
    let mut sums: Vec<(f64, u32)> = Vec::new();
    for ((y, x), &value) in plane.indexed_iter() {
        let squared = y.abs_diff(centre_y).pow(2) + x.abs_diff(centre_x).pow(2);
        // Rounded without floats: r + 1/2 squared is r² + r + 1/4.
        let floor = squared.isqrt();
        let ring = if squared > floor * floor + floor { floor + 1 } else { floor };
        if sums.len() <= ring {
            sums.resize(ring + 1, (0.0, 0));
        }
        sums[ring].0 += f64::from(value);
        sums[ring].1 += 1;
    }
    let mut within = 0.0;
    let mut curves = (Vec::new(), Vec::new());
    for (ring, (sum, count)) in sums.into_iter().enumerate().filter(|(_, (_, count))| *count > 0) {
        within += sum;
        curves.0.push((ring as f64, sum / f64::from(count)));
        curves.1.push((ring as f64, within));
    }
    curves
}

fn mtf(line: &[f64]) -> Curve {
    let total: f64 = line.iter().sum();
    let modulus = |frequency: f64| {
        let (mut real, mut imaginary) = (0.0, 0.0);
        for (x, value) in line.iter().enumerate() {
            let (sine, cosine) = (TAU * frequency * x as f64).sin_cos();
            real += value * cosine;
            imaginary += value * sine;
        }
        f64::hypot(real, imaginary) / total
    };
    let frequency = |step: u32| 0.5 * f64::from(step) / f64::from(FREQUENCIES);
    (0..=FREQUENCIES).map(frequency).map(|frequency| (frequency, modulus(frequency))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    const SIGMA: f64 = 2.0;

    fn gaussian() -> Psf {
        let value = |y: usize, x: usize| (y as f64 - 32.0).powi(2) + (x as f64 - 32.0).powi(2);
        let planes = Array3::from_shape_fn((3, 65, 65), |(_, y, x)| {
            (-value(y, x) / (2.0 * SIGMA * SIGMA)).exp() as f32
        });
        Psf::from_energy(planes).unwrap()
    }

    /// The transform of a Gaussian is one: exp(−2π²σ²f²), to the rounding of f32.
    #[test]
    fn the_mtf_of_a_gaussian_is_a_gaussian() {
        let profile = PsfProfile::of(&gaussian(), 1);
        for curve in [&profile.mtf_across, &profile.mtf_down] {
            for &(frequency, found) in curve {
                let expected = (-2.0 * (std::f64::consts::PI * SIGMA * frequency).powi(2)).exp();
                assert!((found - expected).abs() < 1e-5, "{frequency}: {found} and {expected}");
            }
        }
    }

    /// 1 − exp(−r²/2σ²) of the light lies within r; rings are drawn half a pixel further. The first two are squares rather than
    /// discs.
    #[test]
    fn light_and_brightness_by_radius_are_those_of_a_gaussian() {
        let profile = PsfProfile::of(&gaussian(), 0);
        for &(radius, found) in &profile.encircled[2..10] {
            let expected = 1.0 - (-(radius + 0.5).powi(2) / (2.0 * SIGMA * SIGMA)).exp();
            assert!((found - expected).abs() < 0.03, "{radius}: {found} and {expected}");
        }
        assert!((profile.encircled.last().unwrap().1 - 1.0).abs() < 1e-5);
        assert!((profile.radial[0].1 - 1.0 / (TAU * SIGMA * SIGMA)).abs() < 1e-5);
        assert!(profile.radial[..12].windows(2).all(|pair| pair[1].1 < pair[0].1));
    }

    #[test]
    fn a_point_keeps_all_contrast() {
        let profile = PsfProfile::of(&Psf::from_energy(Array3::ones((3, 1, 1))).unwrap(), 2);
        assert_eq!(profile.encircled, [(0.0, 1.0)]);
        assert!(profile.mtf_down.iter().all(|(_, contrast)| (contrast - 1.0).abs() < 1e-9));
    }
}
