//! `--metrics` and `--definition`: what is measured, and made ready to measure.

use clap::{Args, ValueEnum};

use udc::core::metrics::{Measure, Metric, MetricDefinition};
use udc::eval::EvalConfig;

/// What is measured and how it is defined.
#[derive(Args, Debug)]
pub(super) struct MetricArgs {
    /// Metrics to compute
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [MetricArg::Psnr, MetricArg::Ssim])]
    metrics: Vec<MetricArg>,
    /// Round images to 8 bits first, as the published evaluation does, or not
    #[arg(long, value_enum, default_value_t = DefinitionArg::Released)]
    definition: DefinitionArg,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MetricArg {
    Psnr,
    Ssim,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DefinitionArg {
    Released,
    Float,
}

impl MetricArgs {
    /// The metrics that were asked for, in the order of tables.
    pub(super) fn config(&self, allow_missing: bool) -> EvalConfig {
        let definition = match self.definition {
            DefinitionArg::Released => MetricDefinition::released(),
            DefinitionArg::Float => MetricDefinition::float(),
        };
        let is_asked = |metric: &Metric| self.metrics.iter().any(|&asked| Metric::from(asked) == *metric);
        let metrics: Vec<Metric> = Metric::ALL.into_iter().filter(is_asked).collect();
        EvalConfig { metrics: measures(&metrics), definition, allow_missing }
    }
}

/// Makes metrics ready to measure.
pub(super) fn measures(metrics: &[Metric]) -> Vec<Measure> {
    metrics.iter().map(|&metric| Measure::of(metric)).collect()
}

impl From<MetricArg> for Metric {
    fn from(metric: MetricArg) -> Self {
        match metric {
            MetricArg::Psnr => Self::Psnr,
            MetricArg::Ssim => Self::Ssim,
        }
    }
}
