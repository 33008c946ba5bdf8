//! Colours of light and of the things that it falls on, as relative irradiance of red, green and blue.

use super::draw::Draw;

/// Wavelengths that stand for the three channels.
const WAVELENGTHS_NM: [f32; CHANNELS] = [600.0, 540.0, 460.0];
const CHANNELS: usize = crate::core::image::CHANNELS;

/// Second constant of radiation, h·c/k_B in nm·K.
const RADIATION_NM_K: f32 = 1.438_777e7;

/// Relative irradiance of red, green and blue.
pub(super) type Rgb = [f32; CHANNELS];

/// The Rec. 709 luminance of a linear colour.
pub(super) fn luminance([red, green, blue]: &Rgb) -> f32 {
    0.2126 * red + 0.7152 * green + 0.0722 * blue
}

/// The colour of a glowing body under a camera that is balanced for another: luminance 1.
///
/// # Equation
/// Planck's law B(λ, T) ∝ 1/(exp(c₂/(λT)) − 1) at one wavelength for each channel, divided by that of the white.
pub(super) fn glowing(temperature_k: f32, white_k: f32) -> Rgb {
    let radiance = |nm: f32, kelvin: f32| 1.0 / (RADIATION_NM_K / (nm * kelvin)).exp_m1();
    let ratio = WAVELENGTHS_NM.map(|nm| radiance(nm, temperature_k) / radiance(nm, white_k));
    scale(&ratio, 1.0 / luminance(&ratio))
}

/// Multiplies a colour by a factor.
pub(super) fn scale(colour: &Rgb, factor: f32) -> Rgb {
    colour.map(|value| value * factor)
}

/// Multiplies two colours: a light and what it falls on.
pub(super) fn tint(a: &Rgb, b: &Rgb) -> Rgb {
    std::array::from_fn(|c| a[c] * b[c])
}

/// The colour between two others.
pub(super) fn blend(a: &Rgb, b: &Rgb, share: f32) -> Rgb {
    std::array::from_fn(|c| a[c] + (b[c] - a[c]) * share)
}

/// A colour of luminance 1 at an angle of hue, 0 for red, with a saturation of 0 (grey) to 1.
pub(super) fn hue(angle: f32, saturation: f32) -> Rgb {
    let third = std::f32::consts::TAU / 3.0;
    let colour = [0.0, 1.0, 2.0].map(|k| (1.0 + saturation * (angle - k * third).cos()).max(0.03));
    scale(&colour, 1.0 / luminance(&colour))
}

/// The few colours of a scene's things, in the light that falls on them.
pub(super) struct Palette {
    tones: Vec<Rgb>,
}

impl Palette {
    /// Reflectances that are mostly dull and now and then vivid, lit by a colour.
    pub(super) fn new(draw: &mut Draw, count: usize, light: &Rgb) -> Self {
        let tones = (0..count).map(|_| tint(&reflectance(draw), light)).collect();
        Self { tones }
    }

    /// Next to one of the palette's colours.
    pub(super) fn draw(&self, draw: &mut Draw) -> Rgb {
        let tone = draw.pick(&self.tones);
        let level = (0.4 * draw.normal()).exp();
        tone.map(|value| value * level * (0.06 * draw.normal()).exp())
    }
}

/// The reflectance of some matter: 0.02 to 0.85 in each channel.
pub(super) fn reflectance(draw: &mut Draw) -> Rgb {
    let level = (0.16f32.ln() + 0.75 * draw.normal()).exp();
    let vivid = draw.uniform(0.0, 1.0).powi(2);
    // Earth, wood and skin; plants; sky and shade; paint.
    let angle = match draw.uniform(0.0, 1.0) {
        share if share < 0.5 => draw.uniform(0.0, 1.1),
        share if share < 0.72 => draw.uniform(1.1, 2.4),
        share if share < 0.9 => draw.uniform(3.5, 4.4),
        _ => draw.angle(),
    };
    let colour = hue(angle, 0.9 * vivid);
    scale(&colour, level).map(|value| value.clamp(0.02, 0.85))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::rng;

    #[test]
    fn cool_bodies_are_red_and_the_white_is_white() {
        let [red, _, blue] = glowing(2700.0, 5500.0);
        assert!(red > 1.2 && blue < 0.4, "{red} {blue}");
        assert!(glowing(5500.0, 5500.0).iter().all(|value| (value - 1.0).abs() < 1e-4));
        assert!((luminance(&glowing(9000.0, 4000.0)) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn reflectances_are_those_of_matter() {
        let mut draw = Draw(rng::stream(2, "test"));
        for _ in 0..1000 {
            assert!(reflectance(&mut draw).iter().all(|value| (0.02..=0.85).contains(value)));
        }
    }
}
