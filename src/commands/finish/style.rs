//! The flags that decide how every picture looks.

use anyhow::Result;
use clap::Args;

use udc::finish::{ClaheConfig, Clip, Curve, CurveKind, Style};

use crate::commands::choices::Choices;
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
    #[arg(long, value_parser = CURVES, value_name = "CURVE")]
    curve: Option<CurveKind>,
    /// Gamma of --curve gamma: light is raised to the power of 1/G [default: 2.8]
    #[arg(long, value_name = "G")]
    gamma: Option<f32>,
    /// Light that is shown as white, and not what the capture saturates at, which is --x-max [default: 6 for gamma, else 1]
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

const CURVES: Choices<CurveKind> = Choices(&[
    ("gamma", CurveKind::Gamma, "A power, as the published pictures have"),
    ("srgb", CurveKind::Srgb, "The sRGB curve"),
    ("aces", CurveKind::Aces, "A filmic curve with a soft shoulder"),
    ("none", CurveKind::None, "Light as it is"),
]);

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
        let curve = || Curve::of_kind(self.curve.unwrap_or_default(), self.gamma, self.max);
        let curve = self.says_curve().then(curve).transpose().map_err(|reason| misuse("finish", reason))?;
        Ok(Style { clip, curve, clahe: (!self.no_clahe).then_some(clahe) })
    }

    /// Whether a flag says how light becomes display values.
    pub(super) fn says_curve(&self) -> bool {
        self.curve.is_some() || self.gamma.is_some() || self.max.is_some()
    }
}
