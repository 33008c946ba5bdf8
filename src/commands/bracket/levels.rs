//! Refuses levels that cannot be those of the pictures.

use anyhow::{Result, bail};
use ndarray::Array3;
use udc::capture::Fused;

/// Below this share of white, the brightest value of all pictures is suspicious.
const DARKEST_SHARE: f64 = 0.01;
/// So many saturated values of a whole image are no lamps.
const MUCH: f64 = 0.1;

/// Refuses a level of `flag` that no value reaches: of integers up to `largest`, or of 32-bit floats.
pub(super) fn check_reachable(flag: &str, level: f64, largest: Option<f64>) -> Result<()> {
    match largest {
        Some(largest) if level > largest => {
            bail!(
                "{flag} {level} lies above {largest}, the largest value that the files' integers have: give a level in their units"
            )
        }
        None if level > f64::from(f32::MAX) => {
            bail!(
                "{flag} {level} lies above the largest value that the files' floats have: give a level in their units"
            )
        }
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
            bail!(
                "{:.0} % of the values lie above 1, which is white unless told, up to {largest}: give the value of a full \
                 photosite by --white (and of a dark one by --black)",
                100.0 * above as f64 / all as f64
            );
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

/// What is to be said of an image of which much is brighter than its values are.
pub(crate) fn much_is_saturated(fused: &Fused) -> Option<String> {
    let share = fused.saturated.iter().sum::<usize>() as f64 / fused.source.len() as f64;
    (share >= MUCH).then(|| {
        format!(
            "{:.0} % of the values are saturated in every exposure and brighter than written; add a shorter exposure, or \
             check --white",
            100.0 * share
        )
    })
}
