//! Turns the text of `--angles` into angles.

use crate::core::error::{Error, Result};
use crate::core::kernel_code::round_angle;

/// More rotations than anybody needs; a larger number is a mistyped step.
const MOST_ANGLES: usize = 361;

/// Reads `start:stop:step` (the stop included when the steps reach it) or a comma-separated list, in degrees.
///
/// # Errors
/// [`Error::Config`] when the text is neither, when an angle is not finite or comes twice, or when there
/// are more than 361.
pub fn parse_angles(text: &str) -> Result<Vec<f64>> {
    let angles = if text.contains(':') { parse_range(text)? } else { parse_list(text, ',')? };
    for (i, angle) in angles.iter().enumerate() {
        if angles[..i].iter().any(|earlier| (earlier - angle).abs() < 1e-9) {
            return Err(refuse(text, &format!("holds {angle} twice")));
        }
    }
    Ok(angles)
}

fn parse_range(text: &str) -> Result<Vec<f64>> {
    let [start, stop, step] = parse_list(text, ':')?[..] else {
        return Err(refuse(text, "needs three numbers"));
    };
    // The slack keeps a stop that the steps reach up to rounding, as in 0:1:0.1.
    let steps = (stop - start) / step + 1e-9;
    if !steps.is_finite() || steps < 0.0 {
        return Err(refuse(text, "has a step that never reaches the stop"));
    }
    if steps >= MOST_ANGLES as f64 {
        return Err(refuse(text, "makes more than 361 angles"));
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked to lie in 0..361")]
    let last = steps as usize;
    Ok((0..=last).map(|i| round_angle(start + i as f64 * step)).collect())
}

fn parse_list(text: &str, separator: char) -> Result<Vec<f64>> {
    let numbers: Vec<f64> = text
        .split(separator)
        .map(|part| part.trim().parse().ok().filter(|angle: &f64| angle.is_finite()))
        .collect::<Option<_>>()
        .ok_or_else(|| refuse(text, "holds something that is no number"))?;
    if numbers.len() > MOST_ANGLES {
        return Err(refuse(text, "holds more than 361 angles"));
    }
    Ok(numbers)
}

fn refuse(text: &str, fault: &str) -> Error {
    let reason =
        format!("\"{text}\" {fault}; write start:stop:step, such as -12:12:3, or a list, such as -5,0,5");
    Error::config("angles", reason)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_a_range_with_its_stop() {
        let angles = parse_angles("-12:12:3").unwrap();
        assert_eq!(angles, [-12.0, -9.0, -6.0, -3.0, 0.0, 3.0, 6.0, 9.0, 12.0]);
        assert_eq!(parse_angles("0:1:0.1").unwrap(), [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]);
        assert_eq!(parse_angles("4:0:-3").unwrap(), [4.0, 1.0]);
    }

    #[test]
    fn reads_a_list() {
        assert_eq!(parse_angles("-5, 0,7.5").unwrap(), [-5.0, 0.0, 7.5]);
    }

    #[test]
    fn refuses_what_makes_no_set() {
        for text in ["", "1:2", "0:10:0", "0:10:-1", "0:1e9:1e-3", "1,2,1", "nan", "0:inf:1", "ten"] {
            let message = parse_angles(text).unwrap_err().to_string();
            assert!(message.contains("start:stop:step"), "{text}: {message}");
        }
    }
}
