//! `udc scenes`.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::Result;
use clap::Args;
use serde_json::json;

use udc::core::error::Error;
use udc::core::shard::Shard;
use udc::scenes::natural::NaturalKind;
use udc::scenes::{MOST_SCENES, SceneSet};

use super::choices::{FLOAT_FORMATS, SCENE_KINDS};
use super::{Session, text_of};

/// Paint HDR scenes with the statistics of natural images, in any number
///
/// Dead leaves of power-law sizes, foliage against the sky, landscapes with a sun, streets at night, rooms with windows,
/// pages of text, and glints; light up to 10⁶ times the unit of which mid-tones are 0.04 to 0.5. They take the place of
/// panoramas' views in `udc synth`, each a source of its own, and are free of anybody's rights.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  udc scenes -o scenes --count 1000 --seed 1\n  \
    udc scenes -o scenes --count 1000 --seed 1 --size 512x768 --margin 200 --half\n  \
    udc scenes -o scenes --count 20 --kinds night,sky --seed 1\n  \
    udc scenes -o scenes --count 100000 --seed 1 --shard 2/8")]
pub(crate) struct ScenesArgs {
    /// Folder for the scenes, <kind>-s<seed>-<number>.<format>
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Number of scenes, up to 1000000: the first of the seed's endless sequence
    #[arg(long, value_name = "N",
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=MOST_SCENES as u64))]
    count: usize,
    /// Which sequence; those of two seeds have no scene in common
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// What the scenes show, one after another; without, all kinds at random, each with its share of the sequence
    #[arg(long, value_name = "KIND,…", value_delimiter = ',', value_parser = SCENE_KINDS)]
    kinds: Vec<NaturalKind>,
    /// Size in pixels: the side of a square, or height and width as 512x768
    #[arg(long, value_name = "SIZE", default_value = "512")]
    size: Size,
    /// Pixels more on each side: light from outside of the frame reaches it in `udc synth`, which reads the margin from
    /// .exr files
    #[arg(long, value_name = "PX", default_value_t = 0)]
    margin: usize,
    /// Format of the scenes; .exr carries their origin
    #[arg(long, value_name = "FORMAT", value_parser = FLOAT_FORMATS, default_value = "exr")]
    format: &'static str,
    /// Write half floats, to whose largest number of 65504 brighter lights are clipped
    #[arg(long)]
    half: bool,
    /// Paint only the I-th of N parts; all parts may be painted at the same time
    #[arg(long, value_name = "I/N", default_value = "1/1")]
    shard: Shard,
    /// Keep scenes that are there, and paint the others; .npy does not say how it was painted, and is kept
    #[arg(long)]
    resume: bool,
}

/// Height and width in pixels.
#[derive(Clone, Copy, Debug)]
struct Size([usize; 2]);

impl FromStr for Size {
    type Err = Error;

    fn from_str(text: &str) -> udc::core::error::Result<Self> {
        let (height, width) = text.split_once('x').unwrap_or((text, text));
        match (height.parse(), width.parse()) {
            (Ok(height), Ok(width)) => Ok(Self([height, width])),
            _ => Err(Error::config("size", format!("expected 512 or 512x768, found `{text}`"))),
        }
    }
}

impl ScenesArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        session.check_resume(self.resume)?;
        let set = SceneSet {
            seed: self.seed,
            kinds: self.kinds,
            numbers: (0..self.count).skip(self.shard.index).step_by(self.shard.count).collect(),
            size: self.size.0,
            margin: self.margin,
            image_format: self.format,
            half: self.half,
            overwrite: session.overwrite,
            resume: self.resume,
        };
        set.check()?;
        if self.margin > 0 && self.format == "npy" {
            session.warn(format_args!(
                ".npy does not say that these scenes have a margin of {0}: give `udc synth --margin {0}`, or write .exr",
                self.margin
            ));
        }
        // Shards share a folder.
        if session.overwrite && !self.shard.is_part() {
            set.tell_of_others(&self.output)?.iter().for_each(|others| session.warn(others));
        }
        let kept = set.run(&self.output, &session.progress)?;
        let ([height, width], count) = (set.size, set.numbers.len());
        session.results_of(json!({ "output": text_of(&self.output), "scenes": count, "kept": kept.whole }));
        let margin = match self.margin {
            0 => String::new(),
            margin => format!(" and a margin of {margin} on each side"),
        };
        let folder = self.output.display();
        session.say(format_args!("{folder}: {count} scenes, {height} × {width} pixels{margin}{kept}"))
    }
}
