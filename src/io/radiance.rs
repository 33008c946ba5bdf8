//! Reads what the header of a Radiance HDR file says of its values: by what they were multiplied, and of which primaries they are.
//!
//! After Ward's description of the format ("The RADIANCE Picture File Format", and `color.h` of Radiance): a program that changes all
//! pixels by a factor writes it as `EXPOSURE`, or channel by channel as `COLORCORR`; of several lines the product counts. The
//! light of the scene is the pixels divided by both.

use ndarray::{Array3, Axis};

use super::ColorTag;
use crate::core::image::CHANNELS;
use crate::core::primaries::Primaries;

/// What a header says beside the size.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Header {
    /// What red, green and blue were multiplied by.
    factors: [f64; CHANNELS],
    /// The primaries, where they are said and others than those of sRGB.
    pub(super) primaries: Option<Primaries>,
    /// The lines, to be shown.
    pub(super) tags: Vec<ColorTag>,
}

impl Header {
    /// Reads the header of a file.
    ///
    /// # Errors
    /// What is wrong with which line.
    pub(super) fn read(bytes: &[u8]) -> Result<Self, String> {
        let mut header = Self { factors: [1.0; CHANNELS], primaries: None, tags: Vec::new() };
        let lines = bytes.split(|byte| *byte == b'\n').skip(1).take_while(|line| !line.is_empty());
        for line in lines {
            let line = String::from_utf8_lossy(line);
            let Some((key, value)) = line.split_once('=') else { continue };
            // Indented lines are of the pictures that this one was made of.
            let value = value.trim();
            let place = match key {
                "EXPOSURE" => {
                    let [factor] = positive(key, value)?;
                    header.multiply([factor; CHANNELS]);
                    "EXPOSURE line"
                }
                "COLORCORR" => {
                    header.multiply(positive(key, value)?);
                    "COLORCORR line"
                }
                "PRIMARIES" => {
                    header.primaries = other_primaries(numbers(key, value)?)?;
                    "PRIMARIES line"
                }
                _ => continue,
            };
            header.tags.push(ColorTag::of_line(place, value));
        }
        match header.factors.iter().all(|factor| factor.is_normal() && factor.recip().is_normal()) {
            true => Ok(header),
            false => Err("its EXPOSURE and COLORCORR lines multiply to what is no factor".to_owned()),
        }
    }

    fn multiply(&mut self, by: [f64; CHANNELS]) {
        self.factors.iter_mut().zip(by).for_each(|(factor, by)| *factor *= by);
    }

    /// Divides pixels by what they were multiplied by.
    ///
    /// # Errors
    /// What to tell where light becomes larger than floats are.
    pub(super) fn undo(&self, planes: &mut Array3<f32>) -> Result<(), String> {
        for (mut plane, factor) in planes.axis_iter_mut(Axis(0)).zip(self.factors) {
            if factor.total_cmp(&1.0).is_eq() {
                continue;
            }
            #[expect(clippy::cast_possible_truncation, reason = "images are f32")]
            plane.mapv_inplace(|value| (f64::from(value) / factor) as f32);
            if plane.iter().any(|value| value.is_infinite()) {
                return Err(format!(
                    "its light, pixels divided by {factor} as its header says, is beyond floats"
                ));
            }
        }
        Ok(())
    }
}

/// The primaries of a line, if they are others than those of sRGB; zeros alone, which image editors write, tell none.
fn other_primaries(numbers: [f64; 8]) -> Result<Option<Primaries>, String> {
    if numbers.iter().all(|number| number.abs() < f64::MIN_POSITIVE) {
        return Ok(None);
    }
    let [rx, ry, gx, gy, bx, by, wx, wy] = numbers;
    let found = Primaries { red: [rx, ry], green: [gx, gy], blue: [bx, by], white: [wx, wy] };
    if found.matrix_to(&Primaries::SRGB).is_none() {
        return Err("its PRIMARIES line holds what are no primaries".to_owned());
    }
    Ok((!found.is_near(&Primaries::SRGB)).then_some(found))
}

fn positive<const N: usize>(key: &str, value: &str) -> Result<[f64; N], String> {
    let found: [f64; N] = numbers(key, value)?;
    match found.iter().all(|factor| *factor > 0.0) {
        true => Ok(found),
        false => Err(format!("its {key} line holds `{value}`, and what multiplies light is above zero")),
    }
}

fn numbers<const N: usize>(key: &str, value: &str) -> Result<[f64; N], String> {
    let found: Option<Vec<f64>> = value
        .split_whitespace()
        .map(|word| word.parse().ok().filter(|number: &f64| number.is_finite()))
        .collect();
    found
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| format!("its {key} line holds `{value}` where {N} numbers are needed"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(lines: &str) -> Result<Header, String> {
        Header::read(format!("#?RADIANCE\n{lines}\n-Y 1 +X 1\nEXPOSURE=9\n").as_bytes())
    }

    #[test]
    fn factors_of_several_lines_multiply() {
        let header = read(
            "# made by nobody\nEXPOSURE=2\nFORMAT=32-bit_rle_rgbe\n\tEXPOSURE=7\nEXPOSURE= 0.25\nCOLORCORR=1 2 4\n",
        );
        let header = header.unwrap();
        assert_eq!(header.factors, [0.5, 1.0, 2.0]);
        assert_eq!(header.tags.len(), 3);
        let mut planes = Array3::from_elem((3, 1, 1), 3.0);
        header.undo(&mut planes).unwrap();
        assert_eq!(planes.into_raw_vec_and_offset().0, [6.0, 3.0, 1.5]);
        let tiny = read("EXPOSURE=1e-30\n").unwrap();
        assert!(tiny.undo(&mut Array3::from_elem((3, 1, 1), 1e10)).unwrap_err().contains("beyond floats"));
    }

    #[test]
    fn only_other_primaries_are_told() {
        assert_eq!(read("PRIMARIES=0.64 0.33 0.3 0.6 0.15 0.06 0.3127 0.329\n").unwrap().primaries, None);
        let wide = read("PRIMARIES=0.708 0.292 0.17 0.797 0.131 0.046 0.3127 0.329\n").unwrap();
        assert_eq!(wide.primaries, Some(Primaries::BT2020));
        assert_eq!(read("PRIMARIES=0 0 0 0 0 0 0 0\n").unwrap().primaries, None);
    }

    #[test]
    fn what_is_no_number_is_named() {
        for line in [
            "EXPOSURE=",
            "EXPOSURE=bright",
            "EXPOSURE=0",
            "EXPOSURE=-1",
            "EXPOSURE=inf",
            "COLORCORR=1 2",
            "PRIMARIES=0 0 0 0 0 0 0 1",
        ] {
            let (key, _) = line.split_once('=').unwrap();
            assert!(read(&format!("{line}\n")).unwrap_err().contains(key), "{line}");
        }
        let twice = "EXPOSURE=1e-200\nEXPOSURE=1e-200\n";
        assert!(read(twice).unwrap_err().contains("no factor"));
    }
}
