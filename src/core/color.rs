//! Encodes linear light for displays and back: the transfer curve of sRGB (IEC 61966-2-1).

/// Encodes linear light.
///
/// # Equation
/// `12.92·v` up to 0.0031308, `1.055·v^(1/2.4) − 0.055` above.
///
/// # Range
/// `[0, 1]` to `[0, 1]`; values outside are clipped.
pub fn srgb_encode(linear: f64) -> f64 {
    let v = linear.clamp(0.0, 1.0);
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// Decodes to linear light; the inverse of [`srgb_encode`].
///
/// # Range
/// `[0, 1]` to `[0, 1]`; values outside are clipped.
pub fn srgb_decode(encoded: f64) -> f64 {
    let v = encoded.clamp(0.0, 1.0);
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The standard rounds its thresholds, so that the pieces meet to about 3e-8.
    #[test]
    fn encoding_and_decoding_are_inverse() {
        for step in 0..=1000 {
            let v = f64::from(step) / 1000.0;
            assert!((srgb_decode(srgb_encode(v)) - v).abs() < 1e-7, "{v}");
        }
        assert!((srgb_encode(0.214_041) - 0.5).abs() < 1e-5, "middle grey of the standard");
    }
}
