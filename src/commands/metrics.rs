//! `--metrics`, `--definition` and the weights of LPIPS: what is measured, made ready to measure.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Args, ValueEnum};

use udc::core::metrics::{Metric, MetricDefinition};
use udc::experiment::{EvalConfig, measures};

/// What is measured and how it is defined.
#[derive(Args, Debug)]
pub(super) struct MetricArgs {
    /// Metrics to compute
    #[arg(long, value_enum, value_delimiter = ',', default_value = "psnr,ssim")]
    metrics: Vec<MetricArg>,
    /// Round images to 8 bits first, as the published evaluation does, or not
    #[arg(long, value_enum, default_value_t = DefinitionArg::Released)]
    definition: DefinitionArg,
    /// AlexNet's weights for lpips: torchvision's alexnet-owt-7be5be79.pth, or its tensors as .safetensors
    #[arg(long, value_name = "FILE", requires = "lpips_linear")]
    lpips_alexnet: Option<PathBuf>,
    /// Weights of the linear layers for lpips: lpips/weights/v0.1/alex.pth of PerceptualSimilarity
    #[arg(long, value_name = "FILE", requires = "lpips_alexnet")]
    lpips_linear: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MetricArg {
    Psnr,
    Ssim,
    Lpips,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DefinitionArg {
    Released,
    Float,
}

impl MetricArgs {
    /// The metrics that were asked for, in the order of tables.
    pub(super) fn config(&self, allow_missing: bool) -> Result<EvalConfig> {
        let definition = match self.definition {
            DefinitionArg::Released => MetricDefinition::released(),
            DefinitionArg::Float => MetricDefinition::float(),
        };
        let is_asked = |metric: &Metric| self.metrics.iter().any(|&asked| Metric::from(asked) == *metric);
        let metrics: Vec<Metric> = Metric::ALL.into_iter().filter(is_asked).collect();
        let lpips = self.lpips_alexnet.as_deref().zip(self.lpips_linear.as_deref());
        Ok(EvalConfig { metrics: measures(&metrics, lpips)?, definition, allow_missing })
    }
}

impl From<MetricArg> for Metric {
    fn from(metric: MetricArg) -> Self {
        match metric {
            MetricArg::Psnr => Self::Psnr,
            MetricArg::Ssim => Self::Ssim,
            MetricArg::Lpips => Self::Lpips,
        }
    }
}
