//! The flags that decide how every picture looks.

use anyhow::Result;
use clap::{Args, ValueEnum};

use udc::finish::{ClaheConfig, Curve, FinishConfig};

use crate::commands::misuse;

#[derive(Args, Debug)]
pub(super) struct StyleArgs {
    /// Light above which the image is clipped before the colour matrix [default: 16; none with an automatic exposure]
    #[arg(long, value_name = "X")]
    clip: Option<f32>,
    /// Do not clip
    #[arg(long, conflicts_with = "clip")]
    no_clip: bool,
    /// How light becomes display values [default: gamma with a --reference or another flag of the curve, else photographic:
    /// an exposure chosen from the picture, with a shoulder where its range asks for one]
    #[arg(long, value_enum, value_name = "CURVE")]
    curve: Option<CurveArg>,
    /// Exponent's inverse of --curve gamma [default: 2.8]
    #[arg(long, value_name = "G")]
    gamma: Option<f32>,
    /// Light that is shown as white [default: 6 for gamma, else 1]
    #[arg(long, value_name = "X")]
    max: Option<f32>,
    /// Height to which CLAHE cuts the histograms [default: 1]
    #[arg(long, value_name = "L")]
    clip_limit: Option<f64>,
    /// Tiles of CLAHE on each side [default: 8, fewer in pictures that are smaller than 128 × 128]
    #[arg(long, value_name = "N")]
    grid: Option<usize>,
    /// Leave out CLAHE
    #[arg(long, conflicts_with_all = ["clip_limit", "grid"])]
    no_clahe: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum CurveArg {
    /// A power, as the published pictures have
    Gamma,
    /// The sRGB curve
    Srgb,
    /// A filmic curve with a soft shoulder
    Aces,
    /// Light as it is
    None,
}

impl StyleArgs {
    /// Refuses settings of another curve than the chosen one.
    pub(super) fn check_curve(&self) -> Result<()> {
        match (self.curve(), self.gamma, self.max) {
            (CurveArg::Gamma, ..) | (_, None, None) | (CurveArg::Srgb | CurveArg::Aces, None, _) => Ok(()),
            (CurveArg::None, _, Some(_)) => {
                Err(misuse("finish", "--curve none has no --max: light stays as it is"))
            }
            (_, Some(_), _) => Err(misuse("finish", "--gamma belongs to --curve gamma")),
        }
    }

    /// The settings, every default resolved.
    pub(super) fn config(&self) -> FinishConfig {
        let default = FinishConfig::default();
        let default_clahe = ClaheConfig::default();
        let clahe = ClaheConfig {
            clip_limit: self.clip_limit.unwrap_or(default_clahe.clip_limit),
            grid: self.grid.map(|side| [side; 2]).or(default_clahe.grid),
        };
        FinishConfig {
            clip: if self.no_clip { None } else { self.clip.or(default.clip) },
            curve: self.resolved_curve(),
            clahe: (!self.no_clahe).then_some(clahe),
            ..default
        }
    }

    /// The clip of a flag.
    pub(super) fn clip_given(&self) -> Option<f32> {
        self.clip
    }

    /// Whether a flag says how light becomes display values.
    pub(super) fn says_curve(&self) -> bool {
        self.curve.is_some() || self.gamma.is_some() || self.max.is_some()
    }

    fn curve(&self) -> CurveArg {
        self.curve.unwrap_or(CurveArg::Gamma)
    }

    fn resolved_curve(&self) -> Curve {
        let Curve::Gamma { gamma, max } = Curve::default() else {
            unreachable!("the default is a gamma curve")
        };
        match self.curve() {
            CurveArg::Gamma => {
                Curve::Gamma { gamma: self.gamma.unwrap_or(gamma), max: self.max.unwrap_or(max) }
            }
            CurveArg::Srgb => Curve::Srgb { max: self.max.unwrap_or(1.0) },
            CurveArg::Aces => Curve::Aces { max: self.max.unwrap_or(1.0) },
            CurveArg::None => Curve::None,
        }
    }
}
