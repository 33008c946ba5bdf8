//! `--method`: a deconvolution with its flags.

use clap::error::ErrorKind;
use clap::{ArgMatches, Args, Command, FromArgMatches, ValueEnum};

use udc::restore::deconvolution::{Border, DeconvolutionConfig};

use crate::commands::method::MethodArg;

/// `--method` with its flags, which have been checked to belong to it.
#[derive(Debug)]
pub(super) struct MethodArgs(MethodFlags);

#[derive(Args, Debug)]
struct MethodFlags {
    /// Deconvolution to restore with
    #[arg(long, value_enum, value_name = "METHOD", requires = "psf")]
    method: Option<MethodArg>,
    /// Weight of smoothness against fidelity (wiener) [default: 0.01]
    #[arg(long, value_name = "B", requires = "method", conflicts_with = "model")]
    balance: Option<f32>,
    /// What lies beyond the frame [default: smooth]
    #[arg(long, value_enum, value_name = "BORDER", requires = "method", conflicts_with = "model")]
    border: Option<BorderArg>,
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

#[derive(Clone, Copy, Debug, ValueEnum)]
enum BorderArg {
    /// A scene that goes on: smoothly (wiener, wiener-orieux), or estimated (richardson-lucy, constrained)
    Smooth,
    /// The frame again
    Periodic,
    /// Darkness, as in `udc synth --boundary zero`
    Zero,
}

impl Args for MethodArgs {
    fn augment_args(command: Command) -> Command {
        MethodFlags::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        MethodFlags::augment_args_for_update(command)
    }
}

impl FromArgMatches for MethodArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let flags = MethodFlags::from_arg_matches(matches)?;
        flags.check()?;
        Ok(Self(flags))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.0.update_from_arg_matches(matches)?;
        self.0.check()
    }
}

impl MethodFlags {
    /// Refuses flags that the method would ignore.
    fn check(&self) -> Result<(), clap::Error> {
        use MethodArg::{Constrained, RichardsonLucy, Wiener, WienerOrieux};
        let Some(method) = self.method else { return Ok(()) };
        let belongings: [(&str, bool, &[MethodArg]); 4] = [
            ("balance", self.balance.is_some(), &[Wiener]),
            ("iterations", self.iterations.is_some(), &[RichardsonLucy, Constrained]),
            ("mask-saturated", self.mask_saturated, &[Wiener, WienerOrieux]),
            ("seed", self.seed.is_some(), &[WienerOrieux]),
        ];
        for (flag, is_given, methods) in belongings {
            if is_given && !methods.contains(&method) {
                let names: Vec<_> = methods.iter().map(|method| method.name()).collect();
                let reason = format!(
                    "--{flag} belongs to --method {}, and --method {} would ignore it: leave it out\n",
                    names.join(" and "),
                    method.name()
                );
                return Err(clap::Error::raw(ErrorKind::ArgumentConflict, reason));
            }
        }
        Ok(())
    }
}

impl MethodArgs {
    /// The deconvolution, if one was asked for.
    pub(super) fn config(&self) -> Option<DeconvolutionConfig> {
        let flags = &self.0;
        let default = DeconvolutionConfig::of_method(flags.method?.into());
        Some(DeconvolutionConfig {
            balance: flags.balance.unwrap_or(default.balance),
            border: flags.border.map_or(default.border, Border::from),
            iterations: flags.iterations.unwrap_or(default.iterations),
            mask_saturated: flags.mask_saturated,
            seed: flags.seed.unwrap_or(default.seed),
            ..default
        })
    }
}

impl From<BorderArg> for Border {
    fn from(border: BorderArg) -> Self {
        match border {
            BorderArg::Smooth => Self::Smooth,
            BorderArg::Periodic => Self::Periodic,
            BorderArg::Zero => Self::Zero,
        }
    }
}
