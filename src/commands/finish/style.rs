//! The flags that decide how every picture looks.

use anyhow::Result;
use clap::{Args, ValueEnum};

use udc::finish::{ClaheConfig, Clip, Curve, Style};

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
    /// How pictures shall look; refuses settings of another curve than the chosen one.
    pub(super) fn style(&self) -> Result<Style> {
        let clip = match self.clip {
            Some(light) => Clip::At(light),
            None if self.no_clip => Clip::Nowhere,
            None => Clip::Usual,
        };
        let default = ClaheConfig::default();
        let clahe = ClaheConfig {
            clip_limit: self.clip_limit.unwrap_or(default.clip_limit),
            grid: self.grid.map(|side| [side; 2]).or(default.grid),
        };
        let curve = if self.says_curve() { Some(self.curve()?) } else { None };
        Ok(Style { clip, curve, clahe: (!self.no_clahe).then_some(clahe) })
    }

    /// Whether a flag says how light becomes display values.
    pub(super) fn says_curve(&self) -> bool {
        self.curve.is_some() || self.gamma.is_some() || self.max.is_some()
    }

    fn curve(&self) -> Result<Curve> {
        let Curve::Gamma { gamma, max } = Curve::default() else {
            unreachable!("the default is a gamma curve")
        };
        let white = self.max.unwrap_or(1.0);
        match (self.curve.unwrap_or(CurveArg::Gamma), self.gamma) {
            (CurveArg::Gamma, given) => {
                Ok(Curve::Gamma { gamma: given.unwrap_or(gamma), max: self.max.unwrap_or(max) })
            }
            (CurveArg::None, _) if self.max.is_some() => {
                Err(misuse("finish", "--curve none has no --max: light stays as it is"))
            }
            (_, Some(_)) => Err(misuse("finish", "--gamma belongs to --curve gamma")),
            (CurveArg::Srgb, None) => Ok(Curve::Srgb { max: white }),
            (CurveArg::Aces, None) => Ok(Curve::Aces { max: white }),
            (CurveArg::None, None) => Ok(Curve::None),
        }
    }
}
