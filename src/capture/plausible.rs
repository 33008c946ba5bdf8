//! Refuses levels that cannot be those of the pictures.

use ndarray::Array3;

use super::levels::Unit;
use crate::core::error::{Error, Result};

/// Below this share of white, the brightest value of all pictures is suspicious.
const DARKEST_SHARE: f64 = 0.01;

/// From so many times white on, values are not those of photosites that are a little fuller than others, of which there may be some;
/// few may be hot.
const FAR_ABOVE: f64 = 1.25;
const FEWEST_ABOVE: usize = 16;

/// Refuses a level of `flag` that no value reaches: of integers, or of 32-bit floats.
pub(super) fn check_reachable(flag: &str, level: f64, unit: Unit) -> Result<()> {
    match unit {
        Unit::Integers(largest) if level > largest => Err(Error::Unsupported(format!(
            "{flag} {level} lies above {largest}, the largest value that the files' integers have: give a level in their units"
        ))),
        Unit::Planes if level > f64::from(f32::MAX) => Err(Error::Unsupported(format!(
            "{flag} {level} lies above the largest value that the files' floats have: give a level in their units"
        ))),
        _ => Ok(()),
    }
}

/// Refuses pictures of floats mostly above the white 1 that nobody gave; warns of a white, `given`, far above all of them.
pub(super) fn check_floats(pictures: &[Array3<f32>], given: Option<f64>) -> Result<Option<String>> {
    let values = || pictures.iter().flatten().copied().filter(|value| value.is_finite());
    let largest = values().fold(0.0, f32::max);
    let Some(white) = given else {
        let (all, above) = values().fold((0, 0), |(all, above), v| (all + 1, above + usize::from(v > 1.0)));
        if 2 * above > all {
            return Err(Error::Unsupported(format!(
                "{:.0} % of the values lie above 1, which is white unless told, up to {largest}: give the value of a full \
                 photosite by --white (and of a dark one by --black)",
                100.0 * above as f64 / all as f64
            )));
        }
        return Ok(None);
    };
    Ok((white > 1.0 && f64::from(largest) < DARKEST_SHARE * white).then(|| {
        format!(
            "the largest value of all pictures is {largest}, below 1 % of --white {white}: give --white in the units of the \
             values, such as 1 for floats whose white is 1"
        )
    }))
}

/// Warns of a `white` below what many values have, which the user `gave` so in the units of the files.
pub(super) fn check_white(pictures: &[Array3<f32>], white: f64, gave: f64) -> Option<String> {
    let above = |value: &&f32| f64::from(**value) > FAR_ABOVE * white;
    let values = pictures.iter().flatten().filter(|value| value.is_finite());
    let (count, largest) =
        values.filter(above).fold((0, 0.0_f32), |(count, most), v| (count + 1, most.max(*v)));
    (count >= FEWEST_ABOVE).then(|| {
        format!(
            "{count} values lie far above --white {gave}, up to {}: a photosite holds no more than white, and all of them count as \
             saturated; give the value of a full one",
            (1e3 * f64::from(largest) / white * gave).round() / 1e3
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_white_that_many_values_surpass_is_warned_of() {
        let pictures = [Array3::from_shape_fn((1, 8, 8), |(_, y, _)| if y < 4 { 0.05 } else { 0.25 })];
        let said = check_white(&pictures, 0.0625, 1023.0).unwrap();
        assert!(said.starts_with("32 values lie far above --white 1023, up to 4092:"), "{said}");
        assert_eq!(check_white(&pictures, 0.24, 3931.0), None, "a sensor's white is not one value");
        assert_eq!(check_white(&pictures, 0.25, 4095.0), None);
    }

    #[test]
    fn levels_above_all_values_are_refused_in_their_unit() {
        check_reachable("--white", 65535.0, Unit::Integers(65535.0)).unwrap();
        check_reachable("--white", 1e6, Unit::Planes).unwrap();
        let error = check_reachable("--white", 65536.0, Unit::Integers(65535.0)).unwrap_err().to_string();
        assert!(error.contains("above 65535"), "{error}");
        assert!(check_reachable("--black", 1e39, Unit::Planes).is_err());
    }

    #[test]
    fn floats_of_other_units_than_white_are_refused_or_warned_of() {
        let pictures = [Array3::from_elem((1, 2, 2), 1000.0)];
        assert!(check_floats(&pictures, None).is_err());
        assert_eq!(check_floats(&pictures, Some(16383.0)).unwrap(), None);
        assert!(check_floats(&pictures, Some(1e6)).unwrap().unwrap().contains("--white 1000000"));
    }
}
