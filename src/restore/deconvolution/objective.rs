//! What the constrained deconvolution minimises: value and slope of the weighted least squares.

use ndarray::{Array2, Axis, Zip};
use rayon::prelude::*;

use super::operator::Blur;

/// The part of a seen pixel's curvature that a pixel in the surrounding has at least, whose light hardly reaches the
/// frame: it keeps its first guess rather than take what is left of others' misfit.
pub(super) const UNSEEN: f32 = 1e-3;

/// The weighted least squares of one plane.
///
/// # Equation
/// `J(x) = Σ w²·r² + λ·Σ w²·|∇x|²` with `r = A x − y` and `w = 1/(y + α)`, α of the tone mapping; at
/// saturated pixels r counts only where it is negative, since the capture bounds the light from below. In the
/// surrounding of the frame r = 0, and y is the continuation that w and the majoriser need.
///
/// The slope of the tone mapping is `φ′(y) = α/(y + α)²`, so that w is its square root up to a factor. φ′
/// itself would be the metric of the result, but spans the square of the scene's dynamic range: the
/// iteration would not see bright pixels, whose flare is what it has to remove. w is also the inverse of the
/// noise of a bracketed capture, which grows with the light.
pub(super) struct Objective<'a> {
    blur: &'a Blur,
    /// y.
    capture: Array2<f32>,
    saturation: f32,
    /// w².
    weights: Array2<f32>,
    /// λ.
    roughness: f32,
}

impl<'a> Objective<'a> {
    /// Sets up J for a capture that is continued into the surrounding of the frame.
    pub(super) fn new(blur: &'a Blur, capture: Array2<f32>, alpha: f32, saturation: f32) -> Self {
        let weights = capture.mapv(|y| (y.max(0.0) + alpha).powi(-2));
        Self { blur, capture, saturation, weights, roughness: 0.0 }
    }

    /// Sets λ.
    pub(super) fn penalise_roughness(&mut self, roughness: f32) {
        self.roughness = roughness;
    }

    pub(super) fn blur(&self) -> &Blur {
        self.blur
    }

    pub(super) fn capture(&self) -> &Array2<f32> {
        &self.capture
    }

    /// r, zero at saturated pixels that `predicted` = A x explains and in the surrounding.
    pub(super) fn residual(&self, predicted: &Array2<f32>) -> Array2<f32> {
        let mut residual = predicted.clone();
        Zip::from(&mut residual).and(&self.capture).par_for_each(|r, &y| {
            let explained = y >= self.saturation && *r >= y;
            *r = if explained { 0.0 } else { *r - y };
        });
        self.blur.clear_surrounding(&mut residual);
        residual
    }

    /// Σ w²·r² and the whole of J.
    pub(super) fn value(&self, x: &Array2<f32>, residual: &Array2<f32>) -> (f64, f64) {
        let misfit = self.weighted_sum(residual, residual);
        (misfit, misfit + f64::from(self.roughness) * self.roughness_of(x, x))
    }

    /// Half the slope of J.
    pub(super) fn gradient(&self, x: &Array2<f32>, mut residual: Array2<f32>) -> Array2<f32> {
        residual *= &self.weights;
        let mut gradient = self.blur.transpose(&residual);
        if self.roughness > 0.0 {
            self.add_roughness_gradient(x, &mut gradient);
        }
        gradient
    }

    /// Half the curvature of J along `direction`, whose blur is `blurred`, where the saturated pixels that are
    /// explained at `predicted` stay so.
    pub(super) fn curvature(
        &self,
        direction: &Array2<f32>,
        blurred: &Array2<f32>,
        predicted: &Array2<f32>,
    ) -> f64 {
        let mut counted = blurred.clone();
        Zip::from(&mut counted).and(predicted).and(&self.capture).par_for_each(|d, &p, &y| {
            if y >= self.saturation && p >= y {
                *d = 0.0;
            }
        });
        self.blur.clear_surrounding(&mut counted);
        let misfit = self.weighted_sum(&counted, &counted);
        misfit + f64::from(self.roughness) * self.roughness_of(direction, direction)
    }

    /// A diagonal matrix M that is nowhere less curved than J: `M = AᵀW²A x̂ / x̂` for any x̂ > 0 (De Pierro
    /// 1995); x̂ = the capture makes it follow the scene's dynamic range.
    pub(super) fn majoriser(&self, darkness: f32) -> Array2<f32> {
        let reference = self.capture.mapv(|y| y.max(0.0) + darkness);
        let mut blurred = self.blur.apply(&reference);
        blurred *= &self.weights;
        self.blur.clear_surrounding(&mut blurred);
        let mut majoriser = self.blur.transpose(&blurred);
        // Each difference ∇ couples two pixels: 4 · 2 bounds its square.
        Zip::from(&mut majoriser).and(&reference).and(&self.weights).par_for_each(|m, &x, &w| {
            *m = (*m / x).max(UNSEEN * w) + 8.0 * self.roughness * w;
        });
        majoriser
    }

    fn weighted_sum(&self, a: &Array2<f32>, b: &Array2<f32>) -> f64 {
        sum_of_rows(a.nrows(), |row| {
            let (a, b, w) = (a.row(row), b.row(row), self.weights.row(row));
            a.iter().zip(b).zip(w).map(|((a, b), w)| f64::from(a * b * w)).sum()
        })
    }

    /// Σ w²·∇a·∇b, forward differences.
    fn roughness_of(&self, a: &Array2<f32>, b: &Array2<f32>) -> f64 {
        if self.roughness <= 0.0 {
            return 0.0;
        }
        let (height, width) = a.dim();
        sum_of_rows(height, |y| {
            let mut sum = 0.0;
            for x in 0..width {
                let mut product = 0.0;
                if x + 1 < width {
                    product += (a[[y, x + 1]] - a[[y, x]]) * (b[[y, x + 1]] - b[[y, x]]);
                }
                if y + 1 < height {
                    product += (a[[y + 1, x]] - a[[y, x]]) * (b[[y + 1, x]] - b[[y, x]]);
                }
                sum += f64::from(product * self.weights[[y, x]]);
            }
            sum
        })
    }

    fn add_roughness_gradient(&self, x: &Array2<f32>, gradient: &mut Array2<f32>) {
        let (height, width) = x.dim();
        let weights = &self.weights;
        gradient.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(row, mut out)| {
            for column in 0..width {
                let here = x[[row, column]];
                let mut slope = 0.0;
                if column + 1 < width {
                    slope += weights[[row, column]] * (here - x[[row, column + 1]]);
                }
                if row + 1 < height {
                    slope += weights[[row, column]] * (here - x[[row + 1, column]]);
                }
                if column > 0 {
                    slope += weights[[row, column - 1]] * (here - x[[row, column - 1]]);
                }
                if row > 0 {
                    slope += weights[[row - 1, column]] * (here - x[[row - 1, column]]);
                }
                out[column] += self.roughness * slope;
            }
        });
    }
}

/// Adds up what `of_row` gives for each row, rows in parallel, in an order that does not depend on the
/// threads.
pub(super) fn sum_of_rows(rows: usize, of_row: impl Fn(usize) -> f64 + Sync + Send) -> f64 {
    (0..rows).into_par_iter().map(of_row).collect::<Vec<f64>>().into_iter().sum()
}
