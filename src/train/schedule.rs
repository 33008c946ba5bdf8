//! Turns an iteration into its learning rate.

use std::f64::consts::PI;

use super::config::{OptimizerConfig, ScheduleConfig};

/// Computes the learning rate of an iteration, counted from 0.
///
/// # Equation
/// `η(t) = η_min + (η_max − η_min)/2 · (1 + cos(π·(t mod T)/T))`: cosine annealing, restarted every T.
pub fn learning_rate(optimizer: &OptimizerConfig, schedule: &ScheduleConfig, iteration: u64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "periods are far below 2⁵³")]
    let phase = (iteration % schedule.period) as f64 / schedule.period as f64;
    let span = optimizer.learning_rate - schedule.minimum;
    schedule.minimum + span / 2.0 * (1.0 + (PI * phase).cos())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_high_passes_the_middle_and_restarts() {
        let (optimizer, schedule) = (OptimizerConfig::default(), ScheduleConfig::default());
        let rate = |iteration| learning_rate(&optimizer, &schedule, iteration);
        assert!((rate(0) - 2e-4).abs() < 1e-18);
        assert!((rate(100_000) - (2e-4 + 1e-7) / 2.0).abs() < 1e-18);
        assert!(rate(199_999) < 1.001e-7 && rate(199_999) > 1e-7);
        assert!((rate(200_000) - rate(0)).abs() < 1e-18);
    }
}
