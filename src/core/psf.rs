//! Turns measured or simulated energy maps into point spread functions: non-negative, of unit sum.

use ndarray::{Array3, ArrayView2, ArrayView3, Axis};
use sha2::{Digest, Sha256};

use super::error::{Error, Result};
use super::image::CHANNELS;

/// A sum this close to one is left alone, so that a PSF stays the same however often it is written and read:
/// each rounded value is off by at most 2⁻²⁴ of itself, and so is their sum.
const UNIT_SUM_TOLERANCE: f64 = 1.0 / (1 << 23) as f64;

/// A point spread function: where the light of one point lands on the sensor, for each colour channel.
///
/// Values are non-negative and each channel sums to one. The centre is at index `N / 2` (rounded down) on
/// both axes, whether N is even or odd.
///
/// # Shapes
/// `[3, height, width]`, C-contiguous.
#[derive(Clone, Debug, PartialEq)]
pub struct Psf {
    planes: Array3<f32>,
}

impl Psf {
    /// Makes a PSF of an energy map: negative values become zero, each channel is divided by its sum.
    ///
    /// A map that already is a PSF is kept as it is, to the bit.
    ///
    /// # Errors
    /// [`Error::Shape`] when there are not three channels; [`Error::Unsupported`] when a value is not finite
    /// or a channel holds no light.
    pub fn from_energy(mut planes: Array3<f32>) -> Result<Self> {
        let (channels, height, width) = planes.dim();
        if channels != CHANNELS || height == 0 || width == 0 {
            let found = format!("{channels} channels of {height} × {width}");
            return Err(Error::shape("PSF", "3 channels of at least 1 × 1", found));
        }
        if !planes.is_standard_layout() {
            planes = planes.as_standard_layout().into_owned();
        }
        for (channel, mut plane) in planes.axis_iter_mut(Axis(0)).enumerate() {
            plane.mapv_inplace(|v| if v < 0.0 { 0.0 } else { v });
            let sum: f64 = plane.iter().map(|&v| f64::from(v)).sum();
            if !sum.is_finite() || sum <= 0.0 {
                return Err(Error::Unsupported(format!(
                    "channel {channel} of the PSF sums to {sum}; a PSF needs finite values and some light in \
                     every channel"
                )));
            }
            if (sum - 1.0).abs() <= UNIT_SUM_TOLERANCE {
                continue;
            }
            #[expect(clippy::cast_possible_truncation, reason = "the quotient is in [0, 1]")]
            plane.mapv_inplace(|v| (f64::from(v) / sum) as f32);
        }
        Ok(Self { planes })
    }

    /// The PSF's planes, `[3, height, width]`.
    pub fn planes(&self) -> ArrayView3<'_, f32> {
        self.planes.view()
    }

    /// One channel, `[height, width]`.
    pub fn channel(&self, channel: usize) -> ArrayView2<'_, f32> {
        self.planes.index_axis(Axis(0), channel)
    }

    /// All values in `[3, height, width]` order.
    ///
    /// # Panics
    /// Never: PSFs are kept C-contiguous.
    pub fn as_slice(&self) -> &[f32] {
        self.planes.as_slice().expect("PSFs are kept C-contiguous")
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.planes.dim().1
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.planes.dim().2
    }

    /// The row and column that stand for "no displacement".
    pub fn centre(&self) -> (usize, usize) {
        (self.height() / 2, self.width() / 2)
    }

    /// SHA-256 of the shape and the values, in hexadecimal: the identity of a PSF across files.
    pub fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        for side in [self.height(), self.width()] {
            hash.update((side as u64).to_le_bytes());
        }
        for value in self.as_slice() {
            hash.update(value.to_le_bytes());
        }
        hex(&hash.finalize())
    }
}

/// Writes bytes as lower-case hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn has_unit_sum_and_no_negative_value() {
        let energy =
            Array3::from_shape_fn((3, 9, 8), |(c, y, x)| (c + 1) as f32 * ((y * 8 + x) as f32 - 5.0));
        let psf = Psf::from_energy(energy).unwrap();
        for channel in 0..3 {
            let sum: f64 = psf.channel(channel).iter().map(|&v| f64::from(v)).sum();
            assert!((sum - 1.0).abs() < 1e-6);
            assert!(psf.channel(channel).iter().all(|&v| v >= 0.0));
        }
        assert_eq!(psf.centre(), (4, 4));
    }

    #[test]
    fn stays_the_same_when_it_is_made_again() {
        let energy = Array3::from_shape_fn((3, 64, 63), |(c, y, x)| ((c + 7 * y + 13 * x) % 101) as f32);
        let psf = Psf::from_energy(energy).unwrap();
        assert_eq!(Psf::from_energy(psf.planes().to_owned()).unwrap(), psf);
    }

    #[test]
    fn refuses_a_dark_channel_and_a_nan() {
        assert!(Psf::from_energy(Array3::zeros((3, 5, 5))).is_err());
        assert!(Psf::from_energy(Array3::from_elem((3, 5, 5), f32::NAN)).is_err());
    }
}
