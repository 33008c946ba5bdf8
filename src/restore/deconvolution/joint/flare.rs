//! Measures the light that the sensor clipped by the flare that it throws over the rest of the frame.

use ndarray::{Array2, ArrayView2, Zip};

use super::frame::{Blur, row};
use super::high_pass::HighPass;
use super::sums::{add_scaled, dot, inner};
use crate::core::error::Result;
use crate::core::progress::Progress;
use crate::kernels::vectorised;

/// Standard deviation of the high pass, in pixels: what is smoother is taken for the scene, what is finer for the spikes of
/// flare.
const HIGH_PASS_PX: f32 = 6.0;

/// Steps of the conjugate gradients that spread light: 12 fit noise, and restore frames with lamps 0.05 dB worse.
const FIRST_STEPS: usize = 6;

/// Rounds in which it gathers, and steps in each: twice as many find the same light.
const ROUNDS: usize = 3;
const STEPS: usize = 8;

/// Steps of the first round after which gathering is given up unless this part of the misfit of spread light is left at most: of 186
/// channels for which all rounds would leave more than [`GATHERED`], 185 are told so, and of 149 others eleven wrongly. By that one
/// studio has 1.3 dB less, another 2.0 and a sky 2.4 dB more.
const TRIAL_STEPS: usize = 4;
const PROMISING: f64 = 0.99;

/// The part of the misfit of spread light that is left at most where light is taken to be gathered. Of suns, street lamps and
/// softboxes 0.3 to 0.98 is left; of ceilings, shops and windows 0.98 to 1, and what the light of most of them gains by more steps is
/// the scene's own glow around them: a workshop loses 3 dB by it.
const GATHERED: f64 = 0.985;

/// The light above the level that pixels count as at least, over the level: it lets those shine that were dark before; a tenth
/// and ten times as much restore the same.
const LEAST_LIGHT: f32 = 1e-3;

/// Pixels around saturated ones that are not believed either: interpolated values, and the steepest flare.
const GUARD_PX: usize = 2;

/// The part of the largest curvature that each pixel has at least: below, light is told by rounding alone (10⁻⁷ squared,
/// with the 10² of brightness to spare).
const LEAST_CURVATURE: f32 = 1e-12;

/// The steepness that ends the iteration: there is nothing left to explain.
const LEAST_SLOPE: f64 = 1e-12;

/// A channel of a capture, and which of its pixels are saturated. All planes are of the frame's size.
pub(super) struct Clipped<'a> {
    pub(super) blur: &'a Blur<'a>,
    /// The same with the squares of the PSF.
    pub(super) squared: &'a Blur<'a>,
    pub(super) capture: ArrayView2<'a, f32>,
    pub(super) saturated: &'a Array2<bool>,
    /// The local standard deviation, up to a factor.
    pub(super) brightness: ArrayView2<'a, f32>,
    /// The light at which pixels are saturated.
    pub(super) level: f32,
}

/// The light of saturated pixels, which is the level at which they saturate at least.
pub(super) struct Measured {
    pub(super) light: Array2<f32>,
    /// Whether it is where its flare tells it to be, rather than spread over all that gain by some.
    pub(super) is_gathered: bool,
}

/// The least squares whose solution is the light.
struct Fit<'c, 'a> {
    clipped: &'c Clipped<'a>,
    high_pass: HighPass,
}

impl Clipped<'_> {
    /// Finds the light of saturated pixels.
    ///
    /// # Equation
    /// Minimises `|w·h(y − A(level·S + s))|²` over s ≥ 0 in S: w relative to the brightness, h the high pass
    /// `r − G(M r)/G(M)` over the believed pixels M. A high pass that is not normalised by M would leak the saturated core into
    /// its surroundings, and find a third of the light.
    ///
    /// # Method
    /// Conjugate gradients with the exact diagonal of AᵀW²A spread light over all pixels that gain by some; then rounds
    /// preconditioned by `s/(AᵀW²A s)` (De Pierro 1995), s the light before each, gather it: steps are in proportion to the
    /// light, so that a sun keeps its few pixels, and the many that its glare saturates lose theirs. Steps of one size for all
    /// miss 2 to 20 dB of the flare of suns. Where gathering explains little more, the light is left spread.
    pub(super) fn measure(&self, progress: &Progress) -> Result<Measured> {
        let fit = Fit::new(self);
        let mut light = self.saturated.mapv(|saturated| if saturated { self.level } else { 0.0 });
        fit.improve(&mut light, (FIRST_STEPS, |slope| fit.inverse_curvature(slope)), progress)?;
        let spread = light.clone();
        let of_spread = fit.misfit(&spread);
        let mut steps = STEPS;
        for round in 0..ROUNDS {
            let inverse = fit.inverse_majoriser(&light);
            if round == 0 {
                fit.improve(&mut light, (TRIAL_STEPS, |_| inverse.clone()), progress)?;
                if fit.misfit(&light) > PROMISING * of_spread {
                    return Ok(Measured { light: spread, is_gathered: false });
                }
                steps -= TRIAL_STEPS;
            }
            fit.improve(&mut light, (std::mem::replace(&mut steps, STEPS), |_| inverse), progress)?;
        }
        let is_gathered = fit.misfit(&light) < GATHERED * of_spread;
        Ok(Measured { light: if is_gathered { light } else { spread }, is_gathered })
    }

    /// What a light of saturated pixels, the level included, leaves of that sum of squares.
    pub(super) fn misfit(&self, light: &Array2<f32>) -> f64 {
        Fit::new(self).misfit(light)
    }
}

impl<'c, 'a> Fit<'c, 'a> {
    fn new(clipped: &'c Clipped<'a>) -> Self {
        let around = grown(clipped.saturated, GUARD_PX);
        let known = Zip::from(&around).par_map_collect(|around| if *around { 0.0 } else { 1.0 });
        Self { clipped, high_pass: HighPass::new(known, clipped.brightness, HIGH_PASS_PX) }
    }

    /// `w·h(y − A x)` of a light x, and the sum of its squares.
    fn residual(&self, light: &Array2<f32>) -> (Array2<f32>, f64) {
        let mut residual = Array2::zeros(light.dim());
        self.clipped.blur.apply(light, &mut residual);
        Zip::from(&mut residual).and(self.clipped.capture).par_for_each(|r, y| *r = y.max(0.0) - *r);
        let misfit = self.high_pass.pass(&mut residual);
        (residual, misfit)
    }

    fn misfit(&self, light: &Array2<f32>) -> f64 {
        self.residual(light).1
    }

    /// Takes some steps with one preconditioner, which may depend on the slope at the first; light stays above the level.
    fn improve(
        &self,
        light: &mut Array2<f32>,
        (steps, preconditioner): (usize, impl FnOnce(&Array2<f32>) -> Array2<f32>),
        progress: &Progress,
    ) -> Result<()> {
        let blur = self.clipped.blur;
        let mut residual = self.residual(light).0;
        let mut turned = Array2::zeros(light.dim());
        self.high_pass.back(blur, &residual, &mut turned);
        let inverse = preconditioner(&turned);
        let mut direction = &inverse * &turned;
        let mut slope = inner(&turned, &direction);
        let mut image = Array2::zeros(light.dim());
        for step in 1..=steps {
            progress.check()?;
            blur.apply(&direction, &mut image);
            let curvature = self.high_pass.pass(&mut image);
            if !(slope > LEAST_SLOPE && curvature > 0.0) {
                break;
            }
            let length = narrow(slope / curvature);
            if step == steps {
                add_scaled(light, length, &direction);
                break;
            }
            add_scaled(&mut residual, -length, &image);
            let turn = |y: usize, gradient: &[f32], out: &mut [f32]| turn(out, gradient, row(&inverse, y));
            let next = self.high_pass.back_into(blur, &residual, (&mut turned, turn));
            let kept = narrow(next / slope);
            Zip::from(&mut *light).and(&mut direction).and(&turned).par_for_each(|light, d, z| {
                *light += length * *d;
                *d = z + kept * *d;
            });
            slope = next;
        }
        let level = self.clipped.level;
        Zip::from(light).and(self.clipped.saturated).par_for_each(|light, saturated| {
            if *saturated {
                *light = light.max(level);
            }
        });
        Ok(())
    }

    /// The inverse of the diagonal of AᵀW²A, which is the correlation of w² with k², at the pixels that gain by some light.
    fn inverse_curvature(&self, slope: &Array2<f32>) -> Array2<f32> {
        let Clipped { squared, saturated, .. } = self.clipped;
        let weights = &self.high_pass.weights;
        let mut inverse = inverse_diagonal(squared, &(weights * weights), saturated, LEAST_CURVATURE);
        Zip::from(&mut inverse).and(slope).par_for_each(|inverse, slope| {
            if *slope <= 0.0 {
                *inverse = 0.0;
            }
        });
        inverse
    }

    /// `s/(AᵀW²A s)` of the light s above the level, at saturated pixels.
    fn inverse_majoriser(&self, light: &Array2<f32>) -> Array2<f32> {
        let Clipped { blur, saturated, level, .. } = self.clipped;
        let above = Zip::from(light).and(*saturated).par_map_collect(|light, saturated| {
            if *saturated { light - level + LEAST_LIGHT * level } else { 0.0 }
        });
        let mut image = Array2::zeros(light.dim());
        blur.apply(&above, &mut image);
        Zip::from(&mut image).and(&self.high_pass.weights).par_for_each(|image, w| *image *= w * w);
        let mut curvature = Array2::zeros(light.dim());
        blur.transpose(&image, &mut curvature);
        let most = curvature.iter().fold(0.0, |most: f32, value| most.max(*value));
        let least = (LEAST_CURVATURE * most).max(f32::MIN_POSITIVE);
        Zip::from(&above).and(&curvature).par_map_collect(|above, c| above / c.max(least))
    }
}

vectorised! {
    /// Writes a row of the gradient times what is known of the inverse; returns its part of their inner product.
    fn turn<'a>(out: &'a mut [f32], gradient: &'a [f32], inverse: &'a [f32]) -> f64 {
        out.iter_mut().zip(gradient).zip(inverse).for_each(|((z, g), p)| *z = p * g);
        dot(out, gradient)
    }
}

/// The inverse of the diagonal of AᵀWA at saturated pixels, zero elsewhere; curvatures count as `least` of the largest at
/// least. `squared` is A with the squares of the PSF.
pub(super) fn inverse_diagonal(
    squared: &Blur<'_>,
    weights: &Array2<f32>,
    saturated: &Array2<bool>,
    least: f32,
) -> Array2<f32> {
    let mut diagonal = Array2::zeros(weights.dim());
    squared.transpose(weights, &mut diagonal);
    let most = diagonal.iter().fold(0.0, |most: f32, value| most.max(*value));
    let least = (least * most).max(f32::MIN_POSITIVE);
    Zip::from(&mut diagonal).and(saturated).par_for_each(|value, saturated| {
        *value = if *saturated { 1.0 / value.max(least) } else { 0.0 };
    });
    diagonal
}

/// A set with the pixels that are at most so many steps along rows and columns away.
pub(super) fn grown(set: &Array2<bool>, steps: usize) -> Array2<bool> {
    let mut grown = set.clone();
    let (height, width) = set.dim();
    for _ in 0..steps {
        let before = grown.clone();
        let has = |y: usize, x: usize| before[[y, x]];
        Zip::indexed(&mut grown).par_for_each(|(y, x), member| {
            *member = *member
                || (y > 0 && has(y - 1, x))
                || (y + 1 < height && has(y + 1, x))
                || (x > 0 && has(y, x - 1))
                || (x + 1 < width && has(y, x + 1));
        });
    }
    grown
}

#[expect(clippy::cast_possible_truncation, reason = "planes are of 32 bits")]
fn narrow(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::super::frame::Frame;
    use super::super::tests::panel_psf;
    use super::*;
    use crate::core::fft::TransformPrecision;
    use crate::restore::deconvolution::Border;

    const LEVEL: f32 = 16.0;

    /// A capture of 64 × 64 pixels with 2 × 2 that are so many times above saturation, through a panel.
    struct Lamp {
        frame: Frame,
        psf: Array2<f32>,
        capture: Array2<f32>,
        saturated: Array2<bool>,
        brightness: Array2<f32>,
    }

    impl Lamp {
        fn new(times_level: f32) -> Self {
            let psf = panel_psf(65);
            let frame = Frame::new([64, 64], [65, 65], Border::Zero, TransformPrecision::Single);
            let scene = Array2::from_shape_fn((64, 64), |(y, x)| match (y, x) {
                (30..32, 36..38) => times_level * LEVEL,
                _ => 0.2 + 0.05 * (y as f32 / 9.0).sin() * (x as f32 / 7.0).cos(),
            });
            let mut capture = frame.plane();
            frame.blur(psf.view()).unwrap().apply(&scene, &mut capture);
            capture.mapv_inplace(|y| y.clamp(0.0, LEVEL));
            let saturated = capture.mapv(|y| y >= LEVEL);
            let brightness = super::super::smooth::local_mean(&capture, 4.0) + 0.25;
            Self { frame, psf, capture, saturated, brightness }
        }

        /// Calls with the channel and how many of its pixels are saturated.
        fn with(&self, check: impl FnOnce(&Clipped<'_>, usize)) {
            let Self { frame, psf, capture, saturated, brightness } = self;
            let (blur, squared) = (frame.blur(psf.view()).unwrap(), frame.squared_blur(psf.view()).unwrap());
            let (capture, brightness) = (capture.view(), brightness.view());
            let clipped =
                Clipped { blur: &blur, squared: &squared, capture, saturated, brightness, level: LEVEL };
            check(&clipped, saturated.iter().filter(|saturated| **saturated).count());
        }
    }

    #[test]
    fn the_light_of_a_lamp_a_thousand_times_above_saturation_is_found() {
        Lamp::new(1000.0).with(|clipped, count| {
            assert!(count < 1000, "{count} pixels of 4096 are saturated");
            let light = clipped.measure(&Progress::default()).unwrap().light;
            let of_level = clipped.saturated.mapv(|saturated| if saturated { LEVEL } else { 0.0 });
            assert!(clipped.misfit(&light) < 1e-2 * clipped.misfit(&of_level));
            let dark = light.iter().zip(clipped.saturated).filter(|(_, saturated)| !**saturated);
            assert!(dark.map(|(light, _)| *light).all(|light| light == 0.0));
            let part = light.sum() / (4000.0 * LEVEL);
            assert!((part - 1.0).abs() < 0.05, "{part}");
        });
    }

    /// Its glare saturates hundreds of pixels, over which steps of one size spread its light: a three-thousandth of it is left to
    /// its own four, and fifty times as much of the flare is missed.
    #[test]
    fn the_light_of_a_sun_gathers_in_its_own_pixels() {
        Lamp::new(100_000.0).with(|clipped, count| {
            assert!((200..1000).contains(&count), "{count} pixels of 4096 are saturated");
            let light = clipped.measure(&Progress::default()).unwrap().light;
            let part = light.slice(ndarray::s![30..32, 36..38]).sum() / light.sum();
            assert!(part > 0.4, "{part}");
        });
    }

    #[test]
    fn a_set_grows_by_steps_along_rows_and_columns() {
        let mut set = Array2::from_elem((5, 7), false);
        set[[0, 3]] = true;
        let found = grown(&set, 2);
        assert!(found.indexed_iter().all(|((y, x), member)| *member == (y + x.abs_diff(3) <= 2)), "{found}");
    }
}
