//! Says from which value on a photosite counts as saturated: the one definition that every stage uses.

/// The share of the white level above black from which on a value counts as saturated: read noise and half floats
/// leave some of a full photosite's values below the white level itself.
pub const SATURATED_SHARE: f64 = 0.99;

/// The light from which on a value counts as saturated, where a full photosite stands for `white`.
///
/// Levels are carried as white levels, so that the share is taken once: here.
pub fn saturated_from(white: f32) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    const SHARE: f32 = SATURATED_SHARE as f32;
    white * SHARE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_a_percent_below_white_is_saturated() {
        assert!(495.0 >= saturated_from(500.0) && 494.9 < saturated_from(500.0));
    }
}
