//! Adam, the clipping of gradients, and the running mean of weights, on weights in main memory.
//!
//! Every number is computed by itself or summed in a fixed order, so that steps do not depend on the number
//! of threads; states are plain arrays, so that they can be saved and read back exactly.

use rayon::prelude::*;

use super::config::OptimizerConfig;
use crate::network::Parameters;

/// Gradients in the order of the weights.
pub(super) type Gradients = Vec<Vec<f32>>;

/// What Adam remembers of all gradients so far, in the order of the weights.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Moments {
    /// Decaying mean of the gradients.
    pub(super) first: Vec<Vec<f32>>,
    /// Decaying mean of their squares.
    pub(super) second: Vec<Vec<f32>>,
}

impl Moments {
    /// No memory yet.
    pub(super) fn zeros(parameters: &Parameters) -> Self {
        let zeros: Vec<Vec<f32>> = parameters.iter().map(|p| vec![0.0; p.values.len()]).collect();
        Self { first: zeros.clone(), second: zeros }
    }

    /// Changes the weights by one step of Adam; `step` counts from 1.
    ///
    /// # Equation
    /// `m ← β₁m + (1−β₁)g`, `v ← β₂v + (1−β₂)g²`, `w ← w − η/(1−β₁ᵗ) · m / (√v/√(1−β₂ᵗ) + ε)` (Kingma and
    /// Ba 2015, in PyTorch's order of operations).
    pub(super) fn step(
        &mut self,
        parameters: &mut Parameters,
        gradients: &Gradients,
        config: &OptimizerConfig,
        (step, learning_rate): (u64, f64),
    ) {
        let constants = Constants::new(config, step, learning_rate);
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((parameter, gradient), (first, second)) in parameters.iter_mut().zip(gradients).zip(moments) {
            let moments = first.par_iter_mut().zip(second);
            parameter.values.par_iter_mut().zip(gradient).zip(moments).for_each(|((w, g), (m, v))| {
                constants.apply(w, *g, m, v);
            });
        }
    }
}

/// The numbers of one step that all weights share, computed in double precision.
#[derive(Clone, Copy, Debug)]
pub(super) struct Constants {
    pub(super) first_keep: f32,
    pub(super) first_take: f32,
    pub(super) second_keep: f32,
    pub(super) second_take: f32,
    pub(super) second_correction: f32,
    pub(super) step_size: f32,
    pub(super) epsilon: f32,
}

impl Constants {
    #[expect(clippy::cast_possible_truncation, reason = "weights are 32-bit floats")]
    pub(super) fn new(config: &OptimizerConfig, step: u64, learning_rate: f64) -> Self {
        let power = |beta: f64| beta.powi(i32::try_from(step).unwrap_or(i32::MAX));
        Self {
            first_keep: config.beta1 as f32,
            first_take: (1.0 - config.beta1) as f32,
            second_keep: config.beta2 as f32,
            second_take: (1.0 - config.beta2) as f32,
            second_correction: (1.0 - power(config.beta2)).sqrt() as f32,
            step_size: (learning_rate / (1.0 - power(config.beta1))) as f32,
            epsilon: config.epsilon as f32,
        }
    }

    fn apply(&self, w: &mut f32, g: f32, m: &mut f32, v: &mut f32) {
        *m = self.first_keep * *m + self.first_take * g;
        *v = self.second_keep * *v + self.second_take * g * g;
        *w -= self.step_size * *m / (v.sqrt() / self.second_correction + self.epsilon);
    }
}

/// The Euclidean norm of all gradients together.
pub(super) fn global_norm(gradients: &Gradients) -> f64 {
    /// Gradients whose sum is one task's, and sums side by side: one alone would wait for each addition.
    const SHARE: usize = 1 << 14;
    const TOGETHER: usize = 16;
    let squares = |share: &[f32]| {
        let mut sums = [0.0_f64; TOGETHER];
        for values in share.chunks(TOGETHER) {
            for (sum, &g) in sums.iter_mut().zip(values) {
                *sum += f64::from(g) * f64::from(g);
            }
        }
        sums.iter().sum::<f64>()
    };
    let shares: Vec<&[f32]> = gradients.iter().flat_map(|values| values.chunks(SHARE)).collect();
    let sums: Vec<f64> = shares.into_par_iter().map(squares).collect();
    sums.into_iter().sum::<f64>().sqrt()
}

/// Scales gradients of a larger norm down to `limit`.
pub(super) fn clip(gradients: &mut Gradients, norm: f64, limit: f64) {
    if norm <= limit {
        return;
    }
    #[expect(clippy::cast_possible_truncation, reason = "gradients are 32-bit floats")]
    let scale = (limit / norm) as f32;
    gradients.par_iter_mut().flatten().for_each(|g| *g *= scale);
}

/// Moves a running mean of weights towards them: `mean ← decay·mean + (1 − decay)·weights`.
pub(super) fn average(mean: &mut Parameters, parameters: &Parameters, decay: f64) {
    #[expect(clippy::cast_possible_truncation, reason = "weights are 32-bit floats")]
    let take = (1.0 - decay) as f32;
    for (mean, parameter) in mean.iter_mut().zip(parameters.iter()) {
        for (mean, value) in mean.values.iter_mut().zip(&parameter.values) {
            *mean += take * (value - *mean);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::{Architecture, Initialisation};

    fn parameters() -> Parameters {
        let architecture = Architecture { features: 1, filter_size: 3, ..Architecture::default() };
        Parameters::random(&architecture, Initialisation::Released, 1)
    }

    fn constant_gradients(parameters: &Parameters, value: f32) -> Gradients {
        parameters.iter().map(|p| vec![value; p.values.len()]).collect()
    }

    /// With a constant gradient both moments are exact after their corrections: each step is η·sign(g).
    #[test]
    fn adam_steps_by_the_learning_rate_along_a_constant_gradient() {
        let mut weights = parameters();
        let before = weights.clone();
        let mut moments = Moments::zeros(&weights);
        let gradients = constant_gradients(&weights, -3.0);
        for step in 1..=4 {
            moments.step(&mut weights, &gradients, &OptimizerConfig::default(), (step, 0.01));
        }
        for (before, after) in before.iter().zip(weights.iter()) {
            for (before, after) in before.values.iter().zip(&after.values) {
                assert!((after - before - 0.04).abs() < 1e-5, "{before} {after}");
            }
        }
    }

    #[test]
    fn clipping_limits_the_norm_and_keeps_the_direction() {
        let mut gradients = vec![vec![3.0, 0.0], vec![0.0, -4.0]];
        let norm = global_norm(&gradients);
        assert!((norm - 5.0).abs() < 1e-12);
        clip(&mut gradients, norm, 10.0);
        assert_eq!(gradients, vec![vec![3.0, 0.0], vec![0.0, -4.0]]);
        clip(&mut gradients, norm, 0.5);
        assert!((global_norm(&gradients) - 0.5).abs() < 1e-7);
        assert!((gradients[0][0] - 0.3).abs() < 1e-7);
    }

    #[test]
    fn a_running_mean_covers_its_share_of_the_way() {
        let (mut mean, target) = (parameters(), parameters());
        mean.iter_mut().for_each(|p| p.values.fill(0.0));
        average(&mut mean, &target, 0.75);
        let (mean, target) = (mean.iter().next().unwrap(), target.iter().next().unwrap());
        assert!((mean.values[0] - 0.25 * target.values[0]).abs() < 1e-7);
    }
}
