//! Turns samples of the light on the sensor into what whole pixels collect.
//!
//! # Equation
//! The light on the sensor has no spatial frequencies above `D/(λz₂)`, the width of the pupil's
//! autocorrelation. Sampled more finely than that requires, it is known everywhere, and its integral over a
//! pixel of side p is a sum over samples δ = p/s apart: `h_k = δ ∫ κ(t−k) dt` over t from −s/2 to s/2, with the
//! interpolating kernel κ(t) = sinc(t) · Kaiser(t/L).
//!
//! # Accuracy
//! s is chosen so that κ's transition band lies between the light's highest frequency and its first alias;
//! there the window leaves 90 dB: pixels are right to 3·10⁻⁵ of the light around them.

use std::f64::consts::PI;

/// L: samples on each side of a point that its interpolation uses.
const REACH: usize = 16;
/// β of the Kaiser window for 90 dB: 0.1102 · (90 − 8.7).
const KAISER_BETA: f64 = 8.96;
/// The light's highest frequency in cycles per sample, at most. The transition from it to its alias at
/// 1 − 0.4 is then 0.2 wide, of which 90 dB need (90 − 7.95) / (14.36 · 2·16) = 0.18.
const HIGHEST_FREQUENCY: f64 = 0.4;

/// The weights that integrate samples over a pixel.
#[derive(Clone, Debug)]
pub struct PixelIntegral {
    /// s: samples per pixel.
    pub samples_per_pixel: usize,
    /// h_k for k = −reach…reach, in units of the pixel's side: they sum to one.
    weights: Vec<f64>,
}

impl PixelIntegral {
    /// s for pixels of side `pitch_m` under light of frequencies up to `highest_per_m`, however many those are.
    pub fn samples_wanted(pitch_m: f64, highest_per_m: f64) -> f64 {
        (pitch_m * highest_per_m / HIGHEST_FREQUENCY).ceil()
    }

    /// Chooses the samples for pixels of side `pitch_m` under light of frequencies up to `highest_per_m`.
    pub fn new(pitch_m: f64, highest_per_m: f64) -> Self {
        let wanted = Self::samples_wanted(pitch_m, highest_per_m).clamp(1.0, 1e6);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let samples_per_pixel = wanted as usize;
        let reach = REACH + samples_per_pixel.div_ceil(2);
        let side = samples_per_pixel as f64;
        let weights = (0..=2 * reach)
            .map(|index| {
                let k = index as f64 - reach as f64;
                integrate(interpolation, -side / 2.0 - k, side / 2.0 - k) / side
            })
            .collect();
        Self { samples_per_pixel, weights }
    }

    /// Samples beyond a pixel's centre that its integral uses, on each side.
    pub fn reach(&self) -> usize {
        self.weights.len() / 2
    }

    /// How many samples `pixels` neighbouring pixels need.
    pub fn samples(&self, pixels: usize) -> usize {
        (pixels - 1) * self.samples_per_pixel + self.weights.len()
    }

    /// Integrates a line of samples over its pixels: the mean over each.
    pub fn apply(&self, samples: &[f64], pixels: &mut [f64]) {
        for (index, pixel) in pixels.iter_mut().enumerate() {
            let start = index * self.samples_per_pixel;
            let under = &samples[start..start + self.weights.len()];
            *pixel = under.iter().zip(&self.weights).map(|(sample, weight)| sample * weight).sum();
        }
    }

    /// The weights, from the first sample under a pixel to the last.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }
}

/// κ: interpolates between samples, one apart.
fn interpolation(t: f64) -> f64 {
    let z = t / REACH as f64;
    if z.abs() >= 1.0 {
        return 0.0;
    }
    let sinc = if t.abs() < 1e-9 { 1.0 } else { (PI * t).sin() / (PI * t) };
    sinc * bessel_i0(KAISER_BETA * (1.0 - z * z).sqrt()) / bessel_i0(KAISER_BETA)
}

/// I₀ by its power series, whose terms are all positive.
fn bessel_i0(x: f64) -> f64 {
    let quarter = x * x / 4.0;
    let mut term = 1.0;
    let mut sum = 1.0;
    for k in 1..60 {
        term *= quarter / f64::from(k * k);
        sum += term;
    }
    sum
}

/// Simpson's rule with 32 intervals per sample: an error below 1e-8 for functions of period 2.
fn integrate(f: impl Fn(f64) -> f64, from: f64, to: f64) -> f64 {
    let intervals = rounded(32.0 * (to - from)).max(2).next_multiple_of(2);
    let step = (to - from) / intervals as f64;
    let inner: f64 = (1..intervals)
        .map(|index| if index % 2 == 1 { 4.0 } else { 2.0 } * f(from + step * index as f64))
        .sum();
    (f(from) + inner + f(to)) * step / 3.0
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small positive count")]
fn rounded(count: f64) -> usize {
    count.round() as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ∫cos(2πνx) over a pixel is sinc(νp) cos(2πνx₀), for every frequency that the light can have.
    #[test]
    fn integrates_every_frequency_of_the_light_exactly() {
        for highest in [0.2, 0.9, 1.3] {
            let integral = PixelIntegral::new(1.0, highest);
            let spacing = 1.0 / integral.samples_per_pixel as f64;
            for step in 0..=20 {
                let frequency = highest * f64::from(step) / 20.0;
                for phase in [0.0, 1.1] {
                    let wave = |x: f64| (2.0 * PI * frequency * x + phase).cos();
                    let reach = integral.reach() as f64;
                    let samples: Vec<f64> =
                        (0..integral.samples(3)).map(|i| wave((i as f64 - reach) * spacing)).collect();
                    let mut pixels = [0.0; 3];
                    integral.apply(&samples, &mut pixels);
                    let x = PI * frequency;
                    let sinc = if x == 0.0 { 1.0 } else { x.sin() / x };
                    for (index, pixel) in pixels.iter().enumerate() {
                        let expected = sinc * wave(index as f64);
                        assert!((pixel - expected).abs() < 5e-5, "{frequency}: {pixel}, not {expected}");
                    }
                }
            }
        }
    }
}
