//! Refuses levels that cannot be those of the pictures.

use ndarray::Array3;

use super::levels::Unit;
use crate::core::error::{Error, Result};

/// Below this share of white, the brightest value of all pictures is suspicious.
const DARKEST_SHARE: f64 = 0.01;

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

#[cfg(test)]
mod tests {
    use super::*;

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
