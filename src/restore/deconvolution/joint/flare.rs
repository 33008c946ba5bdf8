//! Measures the light that the sensor clipped by the flare that it throws over the rest of the frame.

use ndarray::{Array2, Zip};

use super::conjugate::inner;
use super::frame::{Blur, Frame};
use super::high_pass::HighPass;
use crate::core::error::Result;
use crate::core::progress::Progress;

/// Standard deviation of the high pass, which takes the smooth scene away, in pixels.
const HIGH_PASS_PX: f32 = 6.0;

/// Steps of the conjugate gradients.
const STEPS: usize = 12;

/// Pixels around saturated ones that are not believed either.
const GUARD_PX: usize = 2;

/// The part of the largest curvature below which a pixel's light is not told by the flare.
const LEAST_CURVATURE: f32 = 1e-12;

/// Curvatures below this part of the steepness end the iteration.
const LEAST_SLOPE: f64 = 1e-12;

/// A channel of a capture, and which of its pixels are saturated.
pub(super) struct Clipped<'a> {
    pub(super) frame: &'a Frame,
    pub(super) blur: &'a Blur<'a>,
    /// The same with the squares of the PSF.
    pub(super) squared: &'a Blur<'a>,
    pub(super) capture: &'a Array2<f32>,
    pub(super) saturated: &'a Array2<bool>,
    /// The local standard deviation, up to a factor.
    pub(super) brightness: &'a Array2<f32>,
    /// The light at which pixels are saturated.
    pub(super) level: f32,
}

/// The least squares whose solution is the light.
struct Fit<'a> {
    clipped: &'a Clipped<'a>,
    high_pass: HighPass,
}

impl Clipped<'_> {
    /// Finds the light of saturated pixels above the level at which they saturate.
    ///
    /// # Equation
    /// Minimises `|w·h(y − A(level·S + s))|²` over s ≥ 0 in S: w·h as in [`HighPass`], by conjugate gradients that the exact
    /// diagonal of AᵀW²A, which is the correlation of w² with k², makes well conditioned.
    pub(super) fn measure(&self, progress: &Progress) -> Result<Array2<f32>> {
        let fit = Fit::new(self);
        let mut diagonal = self.frame.plane();
        let weights = &fit.high_pass.weights;
        self.squared.transpose(weights, weights, &mut diagonal);
        let most = diagonal.iter().fold(0.0, |most: f32, value| most.max(*value));
        let inverse = Zip::from(&diagonal).and(self.saturated).par_map_collect(|value, saturated| {
            if *saturated { 1.0 / value.max(LEAST_CURVATURE * most) } else { 0.0 }
        });
        fit.solve(&inverse, progress)
    }
}

impl<'a> Fit<'a> {
    fn new(clipped: &'a Clipped<'a>) -> Self {
        let around = grown(clipped.saturated, GUARD_PX);
        let known = Array2::from_shape_fn(around.dim(), |(y, x)| {
            if !around[[y, x]] && clipped.frame.contains(y, x) { 1.0 } else { 0.0 }
        });
        Self { clipped, high_pass: HighPass::new(known, clipped.brightness, HIGH_PASS_PX) }
    }

    fn solve(&self, inverse: &Array2<f32>, progress: &Progress) -> Result<Array2<f32>> {
        let Clipped { frame, blur, capture, saturated, level, .. } = self.clipped;
        let base = saturated.mapv(|saturated| if saturated { *level } else { 0.0 });
        let mut residual = frame.plane();
        blur.apply(&base, &mut residual);
        Zip::from(&mut residual).and(*capture).par_for_each(|r, y| *r = y - *r);
        self.high_pass.pass(&mut residual);
        let mut gradient = frame.plane();
        self.high_pass.back(blur, &residual, &mut gradient);
        // From no light at all, only pixels that gain by some are free.
        let inverse =
            Zip::from(inverse).and(&gradient).par_map_collect(|p, g| if *g > 0.0 { *p } else { 0.0 });
        let mut light = frame.plane();
        let mut direction = &inverse * &gradient;
        let mut slope = inner(&gradient, &direction);
        let mut image = frame.plane();
        for _ in 0..STEPS {
            progress.check()?;
            blur.apply(&direction, &mut image);
            self.high_pass.pass(&mut image);
            let curvature = inner(&image, &image);
            if !(slope > LEAST_SLOPE && curvature > 0.0) {
                break;
            }
            let length = narrow(slope / curvature);
            light.scaled_add(length, &direction);
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
