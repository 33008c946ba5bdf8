//! The flags that decide how every picture looks.

use anyhow::Result;
use clap::Args;

use udc::core::primaries::ColorSpace;
use udc::finish::{ClaheConfig, Clip, Curve, CurveKind, NoiseFloor, RollOff, Style};

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
    /// How highlights roll off [default: hue with an automatic exposure, else channels]
    #[arg(long, value_parser = ROLL_OFFS, value_name = "HOW")]
    roll_off: Option<RollOff>,
    /// Colours of the picture, whose profile is embedded in PNG, JPEG and TIFF
    #[arg(long, value_parser = COLOR_SPACES, value_name = "SPACE", default_value = "srgb")]
    color_space: ColorSpace,
    /// Let displays with headroom show highlights brighter than white, by up to this many stops: a JPEG with a gain map (Ultra
    /// HDR), which other displays show as without
    #[arg(long, value_name = "STOPS", num_args = 0..=1, require_equals = true, default_missing_value = "3")]
    hdr: Option<f32>,
    /// Height to which CLAHE cuts the histograms [default: 1]
    #[arg(long, value_name = "L")]
    clip_limit: Option<f64>,
    /// Tiles of CLAHE on each side [default: 8, fewer in pictures that are smaller than 128 × 128]
    #[arg(long, value_name = "N")]
    grid: Option<usize>,
    /// Noise whose local contrast is not raised: its standard deviation in 8-bit codes of lightness, `auto` to estimate it, 0
    /// for none [default: auto with an automatic exposure, else 0]
    #[arg(long, value_name = "auto|CODES", value_parser = parse_noise)]
    noise: Option<NoiseFloor>,
    /// Leave out CLAHE
    #[arg(long, conflicts_with_all = ["clip_limit", "grid", "noise"])]
    no_clahe: bool,
}

const CURVES: Choices<CurveKind> = Choices(&[
    ("gamma", CurveKind::Gamma, "A power, as the published pictures have"),
    ("srgb", CurveKind::Srgb, "The sRGB curve"),
    ("aces", CurveKind::Aces, "A filmic curve with a soft shoulder"),
    ("none", CurveKind::None, "Light as it is"),
]);

const ROLL_OFFS: Choices<RollOff> = Choices(&[
    ("hue", RollOff::Hue, "The hue stays, and what is brighter than white becomes white"),
    ("channels", RollOff::Channels, "Each channel by itself, as the published pictures have"),
]);

const COLOR_SPACES: Choices<ColorSpace> = Choices(&[
    ("srgb", ColorSpace::Srgb, "What any display shows"),
    (
        "display-p3",
        ColorSpace::DisplayP3,
        "More saturated red and green, for displays of phones and newer computers",
    ),
]);

fn parse_noise(text: &str) -> Result<NoiseFloor, String> {
    if text == "auto" {
        return Ok(NoiseFloor::Estimated);
    }
    let codes = text.parse().ok().filter(|codes| (0.0..=255.0).contains(codes));
    let codes: f32 = codes.ok_or_else(|| "write `auto`, or a number of codes from 0 to 255".to_owned())?;
    Ok(if codes > 0.0 { NoiseFloor::Told(codes) } else { NoiseFloor::Ignored })
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
            ..default
        };
        let curve = || Curve::of_kind(self.curve.unwrap_or_default(), self.gamma, self.max);
        let curve = self.says_curve().then(curve).transpose().map_err(|reason| misuse("finish", reason))?;
        Ok(Style {
            clip,
            curve,
            roll_off: self.roll_off,
            color_space: self.color_space,
            clahe: (!self.no_clahe).then_some(clahe),
            noise: self.noise,
            hdr_stops: self.hdr,
        })
    }

    /// Whether a flag says how light becomes display values.
    pub(super) fn says_curve(&self) -> bool {
        self.curve.is_some() || self.gamma.is_some() || self.max.is_some()
    }
}
