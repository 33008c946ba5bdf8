//! Turns a PSF about its centre, as a panel turned in front of the lens would.

use ndarray::{Array3, Axis};

use super::resample::Interpolation;
use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;
use crate::core::psf::Psf;

/// Rotates a PSF about its centre, index N//2; positive angles turn counter-clockwise as displayed.
///
/// Values between pixels come from cubic splines of the light and of its square root, mixed so that no value is negative
/// and that the light around each pixel is kept (the file `resample.rs` has the equation and what it achieves);
/// light from beyond the border is zero and each channel's unit sum is restored. Multiples of 90° move pixels without touching their
/// values; where N is even, index 0 has no counterpart on the other side of the centre: what turns out of
/// the grid is lost and what turns in is zero.
///
/// # Errors
/// [`Error::Config`] when the angle is not finite; [`Error::Unsupported`] when a channel turns dark.
pub fn rotate(psf: &Psf, angle_deg: f64) -> Result<Psf> {
    let mut rotated = rotate_each(psf, &[angle_deg])?;
    Ok(rotated.remove(0))
}

/// Rotates a PSF to each of `angles_deg`, as [`rotate`] does, sharing the splines.
///
/// # Errors
/// As [`rotate`].
pub fn rotate_each(psf: &Psf, angles_deg: &[f64]) -> Result<Vec<Psf>> {
    let mut channels = None;
    angles_deg
        .iter()
        .map(|&angle_deg| {
            if !angle_deg.is_finite() {
                return Err(Error::config(
                    "angle",
                    format!("must be a number of degrees, found {angle_deg}"),
                ));
            }
            let planes = match quarter_turns(angle_deg) {
                Some(0) => return Ok(psf.clone()),
                Some(turns) => turn_quarters(psf, turns),
                None => turn(psf, channels.get_or_insert_with(|| fit(psf)), angle_deg),
            };
            Psf::from_energy(planes)
        })
        .collect()
}

fn fit(psf: &Psf) -> Vec<Interpolation> {
    (0..CHANNELS).map(|channel| Interpolation::new(psf.channel(channel))).collect()
}

/// How many quarter turns (0 to 3) an angle is, when it is a whole number of them.
fn quarter_turns(angle_deg: f64) -> Option<u8> {
    let quarters = angle_deg.rem_euclid(360.0) / 90.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and 4")]
    let turns = quarters.round() as u8;
    ((quarters - f64::from(turns)).abs() == 0.0).then_some(turns % 4)
}

/// # Equation
/// With row offsets pointing down, the pixel at offset (dy, dx) from the centre takes the light from
/// (dy·cos θ + dx·sin θ, dx·cos θ − dy·sin θ).
fn turn(psf: &Psf, channels: &[Interpolation], angle_deg: f64) -> Array3<f32> {
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let (centre_y, centre_x) = (psf.centre().0 as f64, psf.centre().1 as f64);
    let mut planes = Array3::zeros(psf.planes().dim());
    for (mut plane, channel) in planes.axis_iter_mut(Axis(0)).zip(channels) {
        plane.assign(&channel.sample((psf.height(), psf.width()), |y, x| {
            let (dy, dx) = (y as f64 - centre_y, x as f64 - centre_x);
            (centre_y + dy * cos + dx * sin, centre_x + dx * cos - dy * sin)
        }));
    }
    planes
}

#[expect(clippy::cast_possible_wrap, reason = "sides of an image are far below 2⁶³")]
fn turn_quarters(psf: &Psf, turns: u8) -> Array3<f32> {
    let (sin, cos) = [(0, 1), (1, 0), (0, -1), (-1, 0)][usize::from(turns)];
    let (centre_y, centre_x) = (psf.centre().0 as i64, psf.centre().1 as i64);
    let source = psf.planes();
    Array3::from_shape_fn(source.dim(), |(channel, y, x)| {
        let (dy, dx) = (y as i64 - centre_y, x as i64 - centre_x);
        let from = (centre_y + dy * cos + dx * sin, centre_x + dx * cos - dy * sin);
        let (Ok(from_y), Ok(from_x)) = (usize::try_from(from.0), usize::try_from(from.1)) else {
            return 0.0;
        };
        source.get((channel, from_y, from_x)).copied().unwrap_or(0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn psf(size: usize) -> Psf {
        let energy =
            Array3::from_shape_fn((3, size, size), |(c, y, x)| 1.0 + ((c * 5 + y * 7 + x * 3) % 11) as f32);
        Psf::from_energy(energy).unwrap()
    }

    #[test]
    fn moves_pixels_unchanged_by_quarter_turns_of_an_odd_psf() {
        let psf = psf(9);
        let turned = rotate(&psf, 90.0).unwrap();
        for ((c, y, x), &value) in psf.planes().indexed_iter() {
            // Counter-clockwise: the right-hand column becomes the top row.
            assert_eq!(turned.planes()[[c, 8 - x, y]].to_bits(), value.to_bits());
        }
        assert_eq!(rotate(&turned, -90.0).unwrap(), psf);
        assert_eq!(rotate(&rotate(&psf, 180.0).unwrap(), 540.0).unwrap(), psf);
        assert_eq!(rotate(&psf, -360.0).unwrap(), psf);
    }

    #[test]
    fn loses_what_turns_out_of_an_even_grid() {
        let psf = psf(8);
        let turned = rotate(&psf, 90.0).unwrap();
        // Row 0 of the source lies 4 above the centre and would land 4 to the left: column 0 is its place.
        // Column 0 of the source would land 4 below the centre, where the grid has no row.
        assert!(turned.planes().index_axis(Axis(1), 0).iter().all(|&v| v == 0.0));
        assert!(turned.planes().index_axis(Axis(2), 0).iter().skip(1).any(|&v| v > 0.0));
        assert_eq!(turned.centre(), psf.centre());
        let kept: f64 =
            psf.channel(0).indexed_iter().filter(|((_, x), _)| *x > 0).map(|(_, &v)| f64::from(v)).sum();
        let expected = f64::from(psf.planes()[[0, 2, 5]]) / kept;
        // (2, 5) is 2 above and 1 right of the centre: it turns to 1 above and 2 left.
        assert!((f64::from(turned.planes()[[0, 3, 2]]) - expected).abs() < 1e-8);
    }

    #[test]
    fn refuses_an_angle_that_is_no_number() {
        assert!(rotate(&psf(5), f64::NAN).is_err());
    }
}
