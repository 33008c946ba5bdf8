//! Tells values of 10 to 14 bits in words of 16, which are taken for dark light.

use std::path::Path;

use super::{DomainTag, Pixels};

/// What integers of 8 and 16 bits were divided by.
const LARGEST: [f64; 2] = [255.0, 65535.0];

/// The bits of converters below 16.
const BITS: [u32; 3] = [10, 12, 14];

/// So few values at the white of fewer bits may be chance.
const FEWEST: usize = 16;

impl Pixels {
    /// What to tell of integers that `told` has for linear light, and whose white seems to be that of fewer bits than 16.
    ///
    /// Many of them have the largest value, and that is white of 10, 12 or 14 bits; or all lie within 10 bits: no capture is exposed six
    /// stops too short by mistake. Two stops are honest, so that 12 or 14 bits without a saturated value say nothing.
    pub(super) fn describe_low_bits(&self, path: &Path, told: Option<DomainTag>) -> Option<String> {
        if !(self.is_integer && self.raw.is_none() && told == Some(DomainTag::Linear)) {
            return None;
        }
        let [bytes, words] = LARGEST;
        let largest = self.planes.iter().copied().fold(0.0, f32::max);
        let value = (f64::from(largest) * words).round();
        // As of 8 bits.
        if value <= 0.0 || value % (words / bytes) == 0.0 {
            return None;
        }
        let white = |bits: u32| f64::from((1_u32 << bits) - 1);
        let on_top = || self.planes.iter().filter(|found| **found >= largest).take(FEWEST).count();
        let ends_there = |bits: &u32| (value - white(*bits)).abs() < 0.5 && on_top() == FEWEST;
        let bits = BITS.into_iter().find(ends_there).or((value <= white(BITS[0])).then_some(BITS[0]))?;
        Some(format!(
            "{}: its largest value is {value} of {words}, as of {bits} bits in words of 16, and it is taken for dark light: if so, tell \
             white, --white {} where a command has it, or multiply the values",
            path.display(),
            white(bits)
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array3, s};

    /// A picture whose brightest values, so many, are this integer.
    fn said_of(value: f32, count: usize, is_integer: bool, told: Option<DomainTag>) -> Option<String> {
        let mut planes =
            Array3::from_shape_fn((3, 20, 20), |(c, y, x)| 0.9 * value * ((c + y * x) % 97) as f32 / 97.0);
        planes.slice_mut(s![0, 0, ..count]).fill(value);
        let planes = planes.mapv(|value| value.round() / 65535.0);
        let pixels = Pixels { is_integer, ..Pixels::of_planes(planes) };
        pixels.describe_low_bits(Path::new("a.png"), told)
    }

    #[test]
    fn white_of_fewer_bits_is_told() {
        let linear = Some(DomainTag::Linear);
        for (bits, white) in [(10, 1023.0), (12, 4095.0), (14, 16383.0)] {
            let said = said_of(white, 16, true, linear).unwrap();
            assert!(said.contains(&format!("as of {bits} bits")), "{said}");
            assert!(said.contains(&format!("--white {white}")), "{said}");
            assert_eq!(said_of(white, 16, true, Some(DomainTag::Srgb)), None);
            assert_eq!(said_of(white, 16, false, linear), None, "floats");
        }
        assert!(said_of(690.0, 1, true, linear).unwrap().contains("690 of 65535, as of 10 bits"));
    }

    #[test]
    fn an_underexposed_picture_is_not_suspected() {
        for (value, count) in [(4095.0, 3), (2762.0, 1), (4000.0, 20), (16000.0, 20), (65535.0, 20)] {
            assert_eq!(said_of(value, count, true, Some(DomainTag::Linear)), None, "{value}");
        }
        // 3 of 255.
        assert_eq!(said_of(771.0, 20, true, Some(DomainTag::Linear)), None);
    }
}
