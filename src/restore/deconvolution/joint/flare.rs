//! Measures the light that the sensor clipped by the flare that it throws over the rest of the frame.

use ndarray::{Array2, ArrayView2, Zip};

use super::conjugate::inner;
use super::frame::Blur;
use super::high_pass::HighPass;
use crate::core::error::Result;
use crate::core::progress::Progress;

/// Standard deviation of the high pass, in pixels: what is smoother is taken for the scene, what is finer for the spikes of
/// flare.
const HIGH_PASS_PX: f32 = 6.0;

/// Steps of the conjugate gradients: 12 fit noise, and restore frames with lamps 0.05 dB worse.
const STEPS: usize = 6;

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

/// The least squares whose solution is the light.
struct Fit<'c, 'a> {
    clipped: &'c Clipped<'a>,
    high_pass: HighPass,
}

impl Clipped<'_> {
    /// Finds the light of saturated pixels above the level at which they saturate.
    ///
    /// # Equation
    /// Minimises `|w·h(y − A(level·S + s))|²` over s ≥ 0 in S: w relative to the brightness, h the high pass
    /// `r − G(M r)/G(M)` over the believed pixels M, by conjugate gradients that the exact diagonal of AᵀW²A, which is the
    /// correlation of w² with k², makes well conditioned. A high pass that is not normalised by M would leak the saturated core
    /// into its surroundings, and find a third of the light.
    pub(super) fn measure(&self, progress: &Progress) -> Result<Array2<f32>> {
        let fit = Fit::new(self);
        let weights = &fit.high_pass.weights;
        let inverse = inverse_diagonal(self.squared, &(weights * weights), self.saturated, LEAST_CURVATURE);
        fit.solve(&inverse, progress)
    }

    /// What a light of saturated pixels, the level included, leaves of that sum of squares.
    pub(super) fn misfit(&self, light: &Array2<f32>) -> f64 {
        let residual = Fit::new(self).residual(light);
        inner(&residual, &residual)
    }
}

impl<'c, 'a> Fit<'c, 'a> {
    fn new(clipped: &'c Clipped<'a>) -> Self {
        let around = grown(clipped.saturated, GUARD_PX);
        let known = Zip::from(&around).par_map_collect(|around| if *around { 0.0 } else { 1.0 });
        Self { clipped, high_pass: HighPass::new(known, clipped.brightness, HIGH_PASS_PX) }
    }

    /// `w·h(y − A x)` of a light x.
    fn residual(&self, light: &Array2<f32>) -> Array2<f32> {
        let mut residual = Array2::zeros(light.dim());
        self.clipped.blur.apply(light, &mut residual);
        Zip::from(&mut residual).and(self.clipped.capture).par_for_each(|r, y| *r = y.max(0.0) - *r);
        self.high_pass.pass(&mut residual);
        residual
    }

    fn solve(&self, inverse: &Array2<f32>, progress: &Progress) -> Result<Array2<f32>> {
        let Clipped { blur, saturated, level, .. } = self.clipped;
        let empty = || Array2::zeros(saturated.dim());
        let base = saturated.mapv(|saturated| if saturated { *level } else { 0.0 });
        let mut residual = self.residual(&base);
        let mut gradient = empty();
        self.high_pass.back(blur, &residual, &mut gradient);
        // From no light at all, only pixels that gain by some are free.
        let inverse =
            Zip::from(inverse).and(&gradient).par_map_collect(|p, g| if *g > 0.0 { *p } else { 0.0 });
        let mut light = empty();
        let mut direction = &inverse * &gradient;
        let mut slope = inner(&gradient, &direction);
        let mut image = empty();
        for step in 1..=STEPS {
            progress.check()?;
            blur.apply(&direction, &mut image);
            self.high_pass.pass(&mut image);
            let curvature = inner(&image, &image);
            if !(slope > LEAST_SLOPE && curvature > 0.0) {
                break;
            }
            let length = narrow(slope / curvature);
            light.scaled_add(length, &direction);
            if step == STEPS {
                break;
            }
            residual.scaled_add(-length, &image);
            self.high_pass.back(blur, &residual, &mut gradient);
            let turned = &inverse * &gradient;
            let next = inner(&gradient, &turned);
            let kept = narrow(next / slope);
            Zip::from(&mut direction).and(&turned).par_for_each(|d, z| *d = z + kept * *d);
            slope = next;
        }
        light.mapv_inplace(|light| light.max(0.0));
        Ok(light)
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

    #[test]
    fn the_light_of_a_lamp_a_thousand_times_above_saturation_is_found() {
        const LEVEL: f32 = 16.0;
        let psf = panel_psf(65);
        let frame = Frame::new([64, 64], [65, 65], Border::Zero, TransformPrecision::Single);
        let (blur, squared) = (frame.blur(psf.view()).unwrap(), frame.squared_blur(psf.view()).unwrap());
        let scene = Array2::from_shape_fn((64, 64), |(y, x)| match (y, x) {
            (30..32, 36..38) => 1000.0 * LEVEL,
            _ => 0.2 + 0.05 * (y as f32 / 9.0).sin() * (x as f32 / 7.0).cos(),
        });
        let mut capture = frame.plane();
        blur.apply(&scene, &mut capture);
        capture.mapv_inplace(|y| y.clamp(0.0, LEVEL));
        let saturated = capture.mapv(|y| y >= LEVEL);
        let known = saturated.iter().filter(|saturated| !**saturated).count();
        assert!(known > 3000, "{known} pixels of 4096 are not saturated");
        let brightness = super::super::smooth::local_mean(&capture, 4.0) + 0.25;
        let clipped = Clipped {
            blur: &blur,
            squared: &squared,
            capture: capture.view(),
            saturated: &saturated,
            brightness: brightness.view(),
            level: LEVEL,
        };
        let light = clipped.measure(&Progress::default()).unwrap();
        let of_level = saturated.mapv(|saturated| if saturated { LEVEL } else { 0.0 });
        assert!(clipped.misfit(&(&of_level + &light)) < 1e-2 * clipped.misfit(&of_level));
        let dark = light.iter().zip(&saturated).filter(|(_, saturated)| !**saturated);
        assert!(dark.map(|(light, _)| *light).all(|light| light == 0.0));
        let level: f32 = saturated.iter().map(|saturated| f32::from(u8::from(*saturated)) * LEVEL).sum();
        let part = (light.sum() + level) / (4000.0 * LEVEL);
        assert!((part - 1.0).abs() < 0.05, "{part}");
    }

    #[test]
    fn a_set_grows_by_steps_along_rows_and_columns() {
        let mut set = Array2::from_elem((5, 7), false);
        set[[0, 3]] = true;
        let found = grown(&set, 2);
        assert!(found.indexed_iter().all(|((y, x), member)| *member == (y + x.abs_diff(3) <= 2)), "{found}");
    }
}
