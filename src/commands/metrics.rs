//! `--metrics`, `--definition` and the weights of LPIPS: what is measured, made ready to measure.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use udc::core::metrics::{Metric, MetricDefinition};
use udc::experiment::{EvalConfig, measures};
use udc::io;
use udc::network::Backend;

use super::choices::Choices;

/// What is measured and how it is defined.
#[derive(Args, Debug)]
pub(super) struct MetricArgs {
    /// Metrics to compute
    #[arg(long, value_parser = METRICS, value_delimiter = ',', default_value = "psnr,ssim")]
    metrics: Vec<Metric>,
    /// Round images to 8 bits first, as the published evaluation does, or not
    #[arg(long, value_parser = DEFINITIONS, default_value = "released")]
    definition: fn() -> MetricDefinition,
    /// AlexNet's weights for lpips: torchvision's alexnet-owt-7be5be79.pth, or its tensors as .safetensors
    #[arg(long, value_name = "FILE", requires = "lpips_linear")]
    lpips_alexnet: Option<PathBuf>,
    /// Weights of the linear layers for lpips: lpips/weights/v0.1/alex.pth of PerceptualSimilarity
    #[arg(long, value_name = "FILE", requires = "lpips_alexnet")]
    lpips_linear: Option<PathBuf>,
}

const METRICS: Choices<Metric> =
    Choices(&[("psnr", Metric::Psnr, ""), ("ssim", Metric::Ssim, ""), ("lpips", Metric::Lpips, "")]);

const DEFINITIONS: Choices<fn() -> MetricDefinition> =
    Choices(&[("released", MetricDefinition::released, ""), ("float", MetricDefinition::float, "")]);

impl MetricArgs {
    /// The metrics that were asked for, in the order of tables; networks among them compute on `backend`.
    pub(super) fn config(&self, allow_missing: bool, backend: Backend) -> Result<EvalConfig> {
        let is_asked = |metric: &Metric| self.metrics.contains(metric);
        let metrics: Vec<Metric> = Metric::ALL.into_iter().filter(is_asked).collect();
        let lpips = self.lpips_alexnet.as_deref().zip(self.lpips_linear.as_deref());
        let metrics = measures(&metrics, lpips, backend)?;
        Ok(EvalConfig { metrics, definition: (self.definition)(), allow_missing })
    }

    /// SHA-256 of the files of weights, by the flags that name them.
    pub(super) fn describe(&self) -> Result<BTreeMap<String, String>> {
        let files = [("lpips-alexnet", &self.lpips_alexnet), ("lpips-linear", &self.lpips_linear)];
        let given = files.into_iter().filter_map(|(flag, file)| Some((flag.to_owned(), file.as_deref()?)));
        given.map(|(flag, file)| Ok((flag, io::sha256_of_file(file)?))).collect()
    }
}
