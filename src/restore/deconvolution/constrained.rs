//! Restores a plane as the non-negative scene that explains the capture best.
//!
//! Two stages. Where nothing is unknown around the frame and no noise is found, first a fixed-point iteration with the
//! regularised inverse of the PSF, which solves the unsaturated case to many digits in a few steps and stops by itself
//! where it does not help; then conjugate gradients on the pixels that are not held at zero, which never make the
//! objective worse.

use ndarray::{Array2, ArrayView1, ArrayView2, Zip};
use rustfft::num_complex::Complex64;

use super::objective::{Objective, sum_of_rows};
use super::operator::{Blur, frame_of};
use super::{DeconvolutionConfig, noise, saturation};
use crate::core::error::Result;
use crate::core::progress::Progress;

/// Regularisation of the approximate inverse `H̄/(|H|² + ε)`: at most 1/(2√ε) ≈ 50 times a residual.
const INVERSE_EPSILON: f64 = 1e-4;

/// Steps of the fixed-point iteration at most.
const FIXED_POINT_STEPS: usize = 20;

/// Typical relative difference of neighbouring pixels in sharp scenes: the prior that noise is weighed
/// against, λ = (σ/0.1)². Chosen on panoramas with the noise of a 10-bit capture (28.4 dB on average; 0.05
/// and 0.2 lose 0.5 and 1.4 dB).
const SCENE_ROUGHNESS: f64 = 0.1;

/// The part of the noise down to which the misfit is lowered: at 1 the smooth parts of the scene are still
/// blurred, since the estimate is the noise of the median pixel.
const DISCREPANCY: f64 = 0.8;

/// λ where pixels are saturated: their light is uncertain, and its errors must not become texture.
const SATURATED_ROUGHNESS: f64 = 1e-2;

/// The part of α that is added to the capture to make it positive.
pub(super) const DARKNESS: f32 = 0.04;

/// Relative misfit, root mean square, at which a noise-free capture is explained: 80 dB.
const EXPLAINED: f64 = 1e-4;

/// The iteration ends when a step lowers the objective by less than this part.
const LEAST_DECREASE: f64 = 5e-3;

/// Halvings of a step before the iteration gives up.
const MOST_HALVINGS: usize = 8;

/// A candidate with its blur and objective.
struct State {
    x: Array2<f32>,
    predicted: Array2<f32>,
    misfit: f64,
    value: f64,
}

/// Where an iteration ends.
struct Limits<'a> {
    /// Conjugate-gradient steps.
    iterations: usize,
    /// The misfit down to which the capture is explained.
    explained: f64,
    progress: &'a Progress,
}

/// Minimises the [`Objective`] over x ≥ 0 in at most `config.iterations` conjugate-gradient steps.
pub(super) fn restore(
    capture: ArrayView2<'_, f32>,
    psf: ArrayView2<'_, f32>,
    config: &DeconvolutionConfig,
    channel: usize,
    progress: &Progress,
) -> Result<Array2<f32>> {
    Ok(frame_of(restore_surrounded(capture, psf, config, channel, progress)?, capture.dim()))
}

/// As [`restore`], with the light that was found around the frame, where any is unknown.
pub(super) fn restore_surrounded(
    capture: ArrayView2<'_, f32>,
    psf: ArrayView2<'_, f32>,
    config: &DeconvolutionConfig,
    channel: usize,
    progress: &Progress,
) -> Result<Array2<f32>> {
    let blur = Blur::new([capture.nrows(), capture.ncols()], psf, config.border)?;
    let level = config.saturated_from(channel);
    let alpha = config.alpha;
    let sigma = noise::estimate(capture, blur.otf(), alpha);
    let mut objective = Objective::new(&blur, blur.surround(capture), alpha, level);
    objective.penalise_roughness(roughness(sigma, saturation::any(capture, level)));
    let explained = capture.len() as f64 * (DISCREPANCY * sigma).max(EXPLAINED).powi(2);
    let limits = Limits { iterations: config.iterations, explained, progress };
    let mut state = State::new(&objective, objective.capture().mapv(|v| v.max(0.0)));
    if !blur.has_surrounding() && DISCREPANCY * sigma <= EXPLAINED {
        state = iterate_fixed_point(&objective, state, &limits)?;
    }
    let state = descend(&objective, state, DARKNESS * alpha, &limits)?;
    Ok(state.x)
}

#[expect(clippy::cast_possible_truncation, reason = "a weight in f32")]
fn roughness(sigma: f64, saturated: bool) -> f32 {
    let of_noise = (sigma / SCENE_ROUGHNESS).powi(2);
    of_noise.max(if saturated { SATURATED_ROUGHNESS } else { 0.0 }) as f32
}

impl State {
    fn new(objective: &Objective<'_>, x: Array2<f32>) -> Self {
        let predicted = objective.blur().apply(&x);
        Self::with_prediction(objective, x, predicted)
    }

    fn with_prediction(objective: &Objective<'_>, x: Array2<f32>, predicted: Array2<f32>) -> Self {
        let (misfit, value) = objective.value(&x, &objective.residual(&predicted));
        Self { x, predicted, misfit, value }
    }
}

/// `x ← max(0, x + B(y − A x))`, B the regularised inverse; the best state of all.
///
/// B is that of an unbounded frame, so that the step is exact but for the border, which the iteration repairs where
/// no light outside of it is unknown; else B would turn what that light leaves unexplained into ringing. Nor does it
/// suit noise, which its first step amplifies far below the misfit that noise leaves. With unexplained saturated
/// pixels it may lead away: it ends as soon as the objective rises.
fn iterate_fixed_point(objective: &Objective<'_>, mut best: State, limits: &Limits<'_>) -> Result<State> {
    let inverse = approximate_inverse(objective.blur());
    for _ in 0..FIXED_POINT_STEPS {
        limits.progress.check()?;
        if best.misfit <= limits.explained {
            break;
        }
        let correction = objective.blur().filter(&objective.residual(&best.predicted), &inverse);
        let mut x = best.x.clone();
        Zip::from(&mut x).and(&correction).par_for_each(|x, &c| *x = (*x - c).max(0.0));
        let next = State::new(objective, x);
        if next.value >= best.value {
            break;
        }
        best = next;
    }
    Ok(best)
}

fn approximate_inverse(blur: &Blur) -> Vec<Complex64> {
    let (otf, _grid) = blur.otf();
    otf.iter().map(|h| h.conj() / (h.norm_sqr() + INVERSE_EPSILON)).collect()
}

/// Preconditioned conjugate gradients on the free pixels, projected; each step lowers the objective.
///
/// # Equation
/// Free are pixels above zero and those that the slope g pushes up. Direction `d = −M⁻¹g + β·d` with
/// Polak–Ribière's β ≥ 0, step `−⟨d, g⟩/⟨d, J″d⟩`, halved while the projection to x ≥ 0 raises the objective.
fn descend(objective: &Objective<'_>, mut state: State, darkness: f32, limits: &Limits<'_>) -> Result<State> {
    let majoriser = objective.majoriser(darkness);
    let mut direction = Array2::<f32>::zeros(state.x.dim());
    let mut previous: Option<(Array2<f32>, f64)> = None;
    for _ in 0..limits.iterations {
        limits.progress.check()?;
        if state.misfit <= limits.explained {
            break;
        }
        let gradient = free_gradient(objective, &state);
        let steepness = dot(&gradient, &gradient, &majoriser);
        let beta = previous.as_ref().map_or(0.0, |(old, old_steepness)| {
            ((steepness - dot(&gradient, old, &majoriser)) / old_steepness).max(0.0)
        });
        turn(&mut direction, &state.x, &gradient, &majoriser, beta);
        let slope = sum_of_rows(gradient.nrows(), |row| inner(direction.row(row), gradient.row(row)));
        let Some(next) = step(objective, &state, &direction, slope) else { break };
        previous = Some((gradient, steepness));
        let decrease = state.value - next.value;
        let is_flat = decrease < LEAST_DECREASE * state.value;
        state = next;
        if is_flat {
            break;
        }
    }
    Ok(state)
}

/// Half the slope of the objective, zero at pixels that are held at zero.
fn free_gradient(objective: &Objective<'_>, state: &State) -> Array2<f32> {
    let mut gradient = objective.gradient(&state.x, objective.residual(&state.predicted));
    Zip::from(&mut gradient).and(&state.x).par_for_each(|g, &x| {
        if x <= 0.0 && *g > 0.0 {
            *g = 0.0;
        }
    });
    gradient
}

/// ⟨a, M⁻¹ b⟩.
fn dot(a: &Array2<f32>, b: &Array2<f32>, majoriser: &Array2<f32>) -> f64 {
    sum_of_rows(a.nrows(), |row| {
        let (a, b, m) = (a.row(row), b.row(row), majoriser.row(row));
        a.iter().zip(b).zip(m).map(|((a, b), m)| f64::from(*a) * f64::from(*b) / f64::from(*m)).sum()
    })
}

fn inner(a: ArrayView1<'_, f32>, b: ArrayView1<'_, f32>) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum()
}

/// `d ← −M⁻¹g + β·d`, zero at pixels that are held at zero; without β where that would lead upwards.
fn turn(
    direction: &mut Array2<f32>,
    x: &Array2<f32>,
    gradient: &Array2<f32>,
    majoriser: &Array2<f32>,
    beta: f64,
) {
    #[expect(clippy::cast_possible_truncation, reason = "a factor of the order of one")]
    let beta = beta as f32;
    Zip::from(&mut *direction).and(x).and(gradient).and(majoriser).par_for_each(|d, &x, &g, &m| {
        let is_held = x <= 0.0 && g >= 0.0;
        *d = if is_held { 0.0 } else { beta * *d - g / m };
    });
    let slope = sum_of_rows(x.nrows(), |row| inner(direction.row(row), gradient.row(row)));
    if slope >= 0.0 {
        Zip::from(direction).and(gradient).and(majoriser).par_for_each(|d, &g, &m| *d = -g / m);
    }
}

/// The state after the longest step along `direction` that lowers the objective; `None` when none does.
fn step(objective: &Objective<'_>, state: &State, direction: &Array2<f32>, slope: f64) -> Option<State> {
    let blurred = objective.blur().apply(direction);
    let curvature = objective.curvature(direction, &blurred, &state.predicted);
    let mut length = -slope / curvature;
    if !(length.is_finite() && length > 0.0) {
        return None;
    }
    for _ in 0..MOST_HALVINGS {
        #[expect(clippy::cast_possible_truncation, reason = "a factor of the order of one")]
        let next = move_along(objective, state, direction, &blurred, length as f32);
        if next.value < state.value {
            return Some(next);
        }
        length /= 2.0;
    }
    None
}

fn move_along(
    objective: &Objective<'_>,
    state: &State,
    direction: &Array2<f32>,
    blurred: &Array2<f32>,
    length: f32,
) -> State {
    let x = &state.x + &(direction * length);
    if x.iter().all(|&v| v >= 0.0) {
        let predicted = &state.predicted + &(blurred * length);
        return State::with_prediction(objective, x, predicted);
    }
    State::new(objective, x.mapv(|v| v.max(0.0)))
}

#[cfg(test)]
mod tests;
