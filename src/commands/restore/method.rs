//! `--method`: a deconvolution with its flags.

use anyhow::Result;
use clap::Args;

use udc::restore::deconvolution::{Border, DeconvolutionConfig, Method};

use crate::commands::choices::{Choices, METHODS};
use crate::commands::misuse;

/// What lies beyond the frame.
const BORDERS: Choices<Border> = Choices(&[
    (
        "smooth",
        Border::Smooth,
        "A scene that goes on: smoothly (wiener, wiener-orieux), or estimated (all others)",
    ),
    ("periodic", Border::Periodic, "The frame again"),
    ("zero", Border::Zero, "Darkness, as in `udc synth --border zero`"),
]);

#[derive(Args, Debug)]
pub(super) struct MethodArgs {
    /// Deconvolution to restore with
    #[arg(long, value_name = "METHOD", value_parser = METHODS, requires = "psf")]
    method: Option<Method>,
    /// Weight of smoothness against fidelity (wiener) [default: 0.01]
    #[arg(long, value_name = "B", requires = "method", conflicts_with = "model")]
    balance: Option<f32>,
    /// What lies beyond the frame [default: smooth]
    #[arg(long, value_name = "BORDER", value_parser = BORDERS)]
    border: Option<Border>,
    /// Largest number of iterations (richardson-lucy, constrained) [default: 30]
    #[arg(long, value_name = "N", requires = "method", conflicts_with = "model")]
    iterations: Option<usize>,
    /// Treat saturated pixels as unknown (wiener, wiener-orieux; the others always do)
    #[arg(long, requires = "method", conflicts_with = "model")]
    mask_saturated: bool,
    /// Seed of the random numbers (wiener-orieux) [default: 0]
    #[arg(long, value_name = "S", requires = "method", conflicts_with = "model")]
    seed: Option<u64>,
}

impl MethodArgs {
    /// What lies beyond the frame.
    pub(super) fn border(&self) -> Border {
        self.border.unwrap_or_default()
    }

    /// Whether a deconvolution was asked for.
    pub(super) fn is_given(&self) -> bool {
        self.method.is_some()
    }

    /// Refuses what belongs to a deconvolution where a model restores.
    pub(super) fn check_beside_model(&self) -> Result<()> {
        if self.border.is_some() {
            let reason = "--border belongs to a deconvolution and to the guided restoration, and --model would ignore it: leave \
                          it out";
            return Err(misuse("restore", reason));
        }
        Ok(())
    }

    /// Refuses flags that the method would ignore.
    pub(super) fn check(&self) -> Result<()> {
        use Method::{Constrained, RichardsonLucy, Wiener, WienerOrieux};
        let Some(method) = self.method else { return Ok(()) };
        let belongings: [(&str, bool, &[Method]); 4] = [
            ("balance", self.balance.is_some(), &[Wiener]),
            ("iterations", self.iterations.is_some(), &[RichardsonLucy, Constrained]),
            ("mask-saturated", self.mask_saturated, &[Wiener, WienerOrieux]),
            ("seed", self.seed.is_some(), &[WienerOrieux]),
        ];
        let ignored =
            belongings.iter().find(|(_, is_given, methods)| *is_given && !methods.contains(&method));
        let Some((flag, _, methods)) = ignored else { return Ok(()) };
        let names: Vec<_> = methods.iter().map(|method| method.name()).collect();
        let reason = format!(
            "--{flag} belongs to --method {}, and --method {} would ignore it: leave it out",
            names.join(" and "),
            method.name()
        );
        Err(misuse("restore", &reason))
    }

    /// The deconvolution, if one was asked for.
    pub(super) fn config(&self) -> Option<DeconvolutionConfig> {
        let default = DeconvolutionConfig::of_method(self.method?);
        Some(DeconvolutionConfig {
            balance: self.balance.unwrap_or(default.balance),
            border: self.border.unwrap_or(default.border),
            iterations: self.iterations.unwrap_or(default.iterations),
            mask_saturated: self.mask_saturated,
            seed: self.seed.unwrap_or(default.seed),
            ..default
        })
    }
}
