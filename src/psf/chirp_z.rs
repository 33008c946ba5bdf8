//! Turns samples into their spectrum at any equally spaced frequencies: the chirp-z, or zoom, transform.
//!
//! # Equation
//! `X_j = Σ_n x_n exp(2πi α (n−n₀)(j−j₀))`, j = 0…J−1, for any real step α. With 2nj = n² + j² − (j−n)² (Bluestein
//! 1970) it is a convolution with a chirp, done by Fourier transforms long enough that nothing wraps around.
//!
//! # Accuracy
//! Exact but for rounding: the phases reach π·α·n² ≈ 10⁴, which costs four of the sixteen digits.

use std::f64::consts::PI;
use std::sync::Arc;

use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

use super::orders::fast_length;

/// Equally spaced points, one of them (not necessarily among them) at zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Points {
    /// How many there are.
    pub count: usize,
    /// The index of the point at zero: n₀ or j₀.
    pub zero: usize,
}

impl Points {
    /// The points' distances from zero, one apart.
    fn offsets(self) -> impl Iterator<Item = f64> {
        (0..self.count).map(move |index| index as f64 - self.zero as f64)
    }
}

/// A planned transform from one number of samples to one number of frequencies.
pub struct ChirpZ {
    /// exp(iπα(n−n₀)²), for each sample.
    before: Vec<Complex64>,
    /// The same for each frequency, divided by the length of the transform.
    after: Vec<Complex64>,
    /// The transform of the chirp that the samples are convolved with.
    chirp: Vec<Complex64>,
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
}

impl ChirpZ {
    /// Plans the transform of `samples` to `frequencies` of step α.
    pub fn new(samples: Points, frequencies: Points, alpha: f64) -> Self {
        let length = fast_length(samples.count + frequencies.count - 1);
        let phase = |offset: f64| Complex64::cis(PI * alpha * offset * offset);
        let before = samples.offsets().map(phase).collect();
        let after = frequencies.offsets().map(|offset| phase(offset) / length as f64).collect();
        let mut planner = FftPlanner::new();
        let (forward, inverse) = (planner.plan_fft_forward(length), planner.plan_fft_inverse(length));
        // At lag j − n, negative lags at the end.
        let shift = samples.zero as f64 - frequencies.zero as f64;
        let mut chirp = vec![Complex64::default(); length];
        for (j, value) in chirp.iter_mut().take(frequencies.count).enumerate() {
            *value = phase(j as f64 + shift).conj();
        }
        for n in 1..samples.count {
            chirp[length - n] = phase(shift - n as f64).conj();
        }
        forward.process(&mut chirp);
        Self { before, after, chirp, forward, inverse }
    }

    /// Number of frequencies.
    pub fn frequencies(&self) -> usize {
        self.after.len()
    }

    /// A workspace for [`process`](Self::process).
    pub fn workspace(&self) -> Workspace {
        let scratch = self.forward.get_inplace_scratch_len().max(self.inverse.get_inplace_scratch_len());
        Workspace {
            line: vec![Complex64::default(); self.chirp.len()],
            scratch: vec![Complex64::default(); scratch],
        }
    }

    /// Transforms the samples that `samples` yields; the result lies in the returned slice.
    pub fn process<'w>(
        &self,
        samples: impl Iterator<Item = Complex64>,
        workspace: &'w mut Workspace,
    ) -> &'w [Complex64] {
        let Workspace { line, scratch } = workspace;
        line.fill(Complex64::default());
        for ((value, sample), chirp) in line.iter_mut().zip(samples).zip(&self.before) {
            *value = sample * chirp;
        }
        self.forward.process_with_scratch(line, scratch);
        line.iter_mut().zip(&self.chirp).for_each(|(value, chirp)| *value *= chirp);
        self.inverse.process_with_scratch(line, scratch);
        line.iter_mut().zip(&self.after).for_each(|(value, chirp)| *value *= chirp);
        &line[..self.after.len()]
    }
}

/// Memory that one thread's transforms share.
pub struct Workspace {
    line: Vec<Complex64>,
    scratch: Vec<Complex64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(count: usize) -> Vec<Complex64> {
        (0..count)
            .map(|n| Complex64::new((n as f64 * 0.7).sin() + 0.1, (n as f64 * n as f64).cos()))
            .collect()
    }

    fn direct(x: &[Complex64], samples: Points, frequencies: Points, alpha: f64) -> Vec<Complex64> {
        let turn = |n: f64, j: f64| Complex64::cis(2.0 * PI * alpha * n * j);
        frequencies.offsets().map(|j| samples.offsets().zip(x).map(|(n, x)| x * turn(n, j)).sum()).collect()
    }

    #[test]
    fn equals_the_sum_for_every_parity_step_and_origin() {
        for (count, frequencies, alpha) in [(16, 16, 1.0 / 16.0), (15, 8, 0.0137), (8, 31, 0.21), (1, 5, 0.4)]
        {
            let x = samples(count);
            let samples = Points { count, zero: count / 2 };
            let frequencies = Points { count: frequencies, zero: 3 };
            let plan = ChirpZ::new(samples, frequencies, alpha);
            let mut workspace = plan.workspace();
            let found = plan.process(x.iter().copied(), &mut workspace);
            for (found, expected) in found.iter().zip(direct(&x, samples, frequencies, alpha)) {
                assert!((found - expected).norm() < 1e-11, "{count} → {frequencies:?} at {alpha}");
            }
        }
    }

    #[test]
    fn conserves_energy_over_a_whole_period_of_frequencies() {
        let x = samples(45);
        let plan = ChirpZ::new(Points { count: 45, zero: 22 }, Points { count: 64, zero: 32 }, 1.0 / 64.0);
        let mut workspace = plan.workspace();
        let out: f64 = plan.process(x.iter().copied(), &mut workspace).iter().map(Complex64::norm_sqr).sum();
        let inside: f64 = x.iter().map(Complex64::norm_sqr).sum();
        assert!((out / 64.0 / inside - 1.0).abs() < 1e-12);
    }
}
