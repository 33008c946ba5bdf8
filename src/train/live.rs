//! Says how a training goes: the numbers of its log, smoothed, with the time of a step and the wait for data.

use std::fmt::Write as _;
use std::time::Duration;

use serde_json::{Map, Value, json};

use super::checkpoint::Best;
use super::trainer::Step;
use super::validation::Validation;
use crate::core::metrics::Metric;
use crate::core::progress::Status;

/// Steps that the smoothed loss, the time of a step and the share of waiting are means over, the latest counting most.
const MEMORY_STEPS: f64 = 100.0;

/// What is shown of a training while it goes on.
#[derive(Clone, Debug)]
pub(super) struct LiveView {
    /// The metric that the best weights are told by.
    metric: Metric,
    loss: RunningMean,
    seconds: RunningMean,
    waited_s: RunningMean,
    validation: Option<Validation>,
    best: Option<Best>,
}

impl LiveView {
    /// Shows a training whose weights a metric judges, and the best of an earlier process.
    pub(super) fn new(metric: Metric, best: Option<Best>) -> Self {
        let mean = RunningMean::default;
        Self { metric, loss: mean(), seconds: mean(), waited_s: mean(), validation: None, best }
    }

    /// Notes a validation, and the best so far.
    pub(super) fn note_validation(&mut self, validation: Option<&Validation>, best: Option<Best>) {
        self.validation = validation.cloned().or(self.validation.take());
        self.best = best;
    }

    /// What is known after a step that took so long, in part to wait for data.
    pub(super) fn after(&mut self, step: &Step, taken: Duration, waited: Duration) -> Status {
        self.loss.add(step.loss);
        self.seconds.add(taken.as_secs_f64());
        self.waited_s.add(waited.as_secs_f64());
        Status { text: self.in_words(step), values: self.values(step) }
    }

    /// The share of the time that is spent waiting for data.
    fn wait_share(&self) -> f64 {
        let seconds = self.seconds.value();
        if seconds > 0.0 { (self.waited_s.value() / seconds).min(1.0) } else { 0.0 }
    }

    fn in_words(&self, step: &Step) -> String {
        let mut text = format!(
            "loss {:.5}, rate {:.1e}, {}, data wait {:.0} %",
            self.loss.value(),
            step.learning_rate,
            in_time(self.seconds.value()),
            100.0 * self.wait_share()
        );
        let (heading, decimals) = (self.metric.heading(), self.metric.decimals());
        let (name, unit) = match heading.strip_suffix(" (dB)") {
            Some(name) => (name, " dB"),
            None => (heading, ""),
        };
        if let Some(validation) = &self.validation
            && let Some(value) = validation.restored(self.metric)
        {
            let _ = write!(text, ", {name} {value:.decimals$}{unit} at {}", validation.iteration);
        }
        if let Some(Best { iteration, value }) = self.best {
            let _ = write!(text, ", best {value:.decimals$}{unit} at {iteration}");
        }
        text
    }

    fn values(&self, step: &Step) -> Map<String, Value> {
        let values = [
            ("iteration", json!(step.iteration)),
            ("loss", json!(step.loss)),
            ("loss-smoothed", json!(self.loss.value())),
            ("learning-rate", json!(step.learning_rate)),
            ("gradient-norm", json!(step.gradient_norm)),
            ("seconds-per-step", json!(self.seconds.value())),
            ("data-wait-share", json!(self.wait_share())),
        ];
        let validation = self.validation.as_ref().map(|validation| ("validation", json!(validation)));
        let of_best = |Best { iteration, value }: Best| {
            ("best", json!({ "iteration": iteration, "metric": self.metric.name(), "value": value }))
        };
        let best = self.best.map(of_best);
        values.into_iter().chain(validation).chain(best).map(|(key, value)| (key.to_owned(), value)).collect()
    }
}

/// The time of a step.
fn in_time(seconds: f64) -> String {
    if seconds < 1.0 { format!("{:.0} ms/step", seconds * 1e3) } else { format!("{seconds:.2} s/step") }
}

/// A mean in which values fade; of few values the plain mean.
#[derive(Clone, Debug, Default)]
struct RunningMean {
    sum: f64,
    weight: f64,
}

impl RunningMean {
    fn add(&mut self, value: f64) {
        let kept = 1.0 - 1.0 / MEMORY_STEPS;
        self.sum = self.sum * kept + value;
        self.weight = self.weight * kept + 1.0;
    }

    fn value(&self) -> f64 {
        self.sum / self.weight
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(iteration: u64, loss: f64) -> Step {
        Step { iteration, loss, learning_rate: 2e-4, gradient_norm: 0.5 }
    }

    #[test]
    fn a_mean_of_few_is_plain_and_of_many_follows() {
        let mut mean = RunningMean::default();
        [1.0, 3.0].into_iter().for_each(|value| mean.add(value));
        assert!((mean.value() - 2.0).abs() < 0.01);
        (0..1000).for_each(|_| mean.add(7.0));
        assert!((mean.value() - 7.0).abs() < 1e-3);
    }

    #[test]
    fn people_and_scripts_are_told_the_same_numbers() {
        let mut view = LiveView::new(Metric::Psnr, Some(Best { iteration: 4, value: 31.5 }));
        let status = view.after(&step(5, 0.25), Duration::from_millis(200), Duration::from_millis(50));
        assert_eq!(status.text, "loss 0.25000, rate 2.0e-4, 200 ms/step, data wait 25 %, best 31.50 dB at 4");
        assert_eq!(status.values["loss"], 0.25);
        assert_eq!(status.values["data-wait-share"], 0.25);
        assert_eq!(status.values["best"], json!({ "iteration": 4, "metric": "psnr", "value": 31.5 }));
        assert_eq!(status.values.get("validation"), None);
    }
}
