//! Encodes linear light for displays and back: the transfer curve of sRGB (IEC 61966-2-1), and what its colours have of luminance.

/// Weights of linear red, green and blue in luminance (ITU-R BT.709, of which sRGB has the primaries).
pub const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

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
    /// 8-bit values and their linear light, computed by hand from the standard: 10/255/12.92 below the threshold, and
    /// ((v + 0.055)/1.055)^2.4 above.
    #[test]
    fn decodes_the_known_values_of_the_standard() {
        for (value, light) in [
            (0, 0.0),
            (10, 0.003_035_27),
            (64, 0.051_269_46),
            (128, 0.215_860_5),
            (200, 0.577_580_44),
            (255, 1.0),
        ] {
            let found = srgb_decode(f64::from(value) / 255.0);
            assert!((found - light).abs() < 1e-7, "{value}: {found}");
        }
        // Either side of the threshold.
        assert!((srgb_decode(0.040_45) - 0.040_45 / 12.92).abs() < 1e-15);
        assert!((srgb_decode(0.040_451) - 0.003_130_9).abs() < 1e-7);
    }
}
