//! `udc tonemap`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use udc::batch::{Destination, ToneMapping};
use udc::core::shard::Shard;
use udc::core::tone::ToneFlags;
use udc::io::DomainTag;

use super::Session;
use super::choices::FORMATS;
use super::choices::LIGHT_DOMAINS;
use super::layer::LayerArgs;

/// Apply the tone mapping or its inverse
///
/// A file that cannot be mapped is named at the end, the others are done.
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc tonemap scene.exr -o scene.png\n         udc tonemap --inverse restored.png -o \
                        restored.exr\n\nThe mapping is x/(x+alpha) of x clipped to x-max"
)]
pub(crate) struct TonemapArgs {
    /// Images, folders or patterns
    #[arg(required = true, value_name = "IN")]
    inputs: Vec<PathBuf>,
    /// Image to write; a folder for several inputs, or if the name ends in a slash
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    #[command(flatten)]
    layer: LayerArgs,
    /// Map tone-mapped values back to linear light
    #[arg(long, conflicts_with = "domain")]
    inverse: bool,
    /// What the inputs hold: srgb is decoded to linear light first; required for 8- and 16-bit files that do not say it
    /// [default: what the file says, else linear; with --inverse tone-mapped]
    ///
    /// Tone-mapped images are for --inverse, which takes them for that whatever their format.
    #[arg(long, value_name = "DOMAIN", value_parser = LIGHT_DOMAINS)]
    domain: Option<DomainTag>,
    /// Irradiance that is mapped to one half [default: 0.25; with --inverse what the file says, else 0.25]
    #[arg(long, value_name = "A")]
    alpha: Option<f32>,
    /// Irradiance at which the sensor saturates [default: 500; with --inverse what the file says, else 500]
    #[arg(long, value_name = "X")]
    x_max: Option<f32>,
    /// Format of the files in an output folder [default: exr]
    #[arg(long, value_name = "FORMAT", value_parser = FORMATS)]
    format: Option<&'static str>,
    /// Write half floats, in formats that have them
    #[arg(long)]
    half: bool,
}

impl TonemapArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let mapping = ToneMapping {
            tone: ToneFlags { alpha: self.alpha, x_max: self.x_max },
            inverse: self.inverse,
            domain: self.domain,
            half: self.half,
            overwrite: session.overwrite,
        };
        let destination = Destination {
            path: &self.output,
            extension: self.format.unwrap_or("exr"),
            is_asked: self.format.is_some(),
            accepts_existing: session.overwrite,
            shard: Shard::WHOLE,
        };
        Ok(mapping.run(&self.layer.of(&self.inputs), &destination, session)?)
    }
}
