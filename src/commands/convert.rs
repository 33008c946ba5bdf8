//! `udc convert`.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::json;

use super::choices::DOMAINS;
use super::{Session, text_of};
use udc::io::{Conversion, DomainTag, FloatWidth, check_output, what_is_lost};
use udc::network::weights;

/// Convert an image, or a PyTorch checkpoint or a model to a model
#[derive(Args, Debug)]
#[command(after_help = "Example: udc convert scene.npy scene.exr --half --domain linear\n         \
    udc convert DISCNet.pth discnet.safetensors\n         \
    udc convert model.safetensors small.safetensors --half\n\n\
    The format follows from the name of OUT: .exr, .npy, .hdr, .png, .tif or .jpg. PNG and TIFF have 16 bits, \
    JPEG has 8; they hold values from 0 to 1. Use `udc tonemap` to bring linear light into that range")]
pub(crate) struct ConvertArgs {
    /// Image, checkpoint or model to read
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Image, or model (.safetensors), to write
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Write half floats, in formats that have them; of a model they take half the room, and it computes with floats still
    #[arg(long)]
    half: bool,
    /// Say what the values are, of a file that does not: srgb is decoded to linear light. Floats (.exr, .npy, .hdr) that are
    /// made of integers need it; other values are taken for linear
    #[arg(long, value_name = "DOMAIN", value_parser = DOMAINS)]
    domain: Option<DomainTag>,
    /// Clip values that the output cannot hold: negative ones, above 1 in integers, above 65504 in half floats
    #[arg(long)]
    clip: bool,
}

impl ConvertArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let (input, output) = (self.input.display(), self.output.display());
        let doing = || format!("converting {input}");
        let _task = session.progress.task(doing());
        session.result("output", text_of(&self.output));
        check_output(&self.output, session.overwrite).with_context(doing)?;
        if self.output.extension().is_some_and(|extension| extension == "safetensors") {
            let width = if self.half { FloatWidth::Half } else { FloatWidth::Single };
            weights::convert(&self.input, &self.output, width, session.overwrite).with_context(doing)?;
            return session.say(format_args!("{output}: {}", weights::describe(&self.output)?));
        }
        let conversion = Conversion {
            domain: self.domain,
            half: self.half,
            clip: self.clip,
            overwrite: session.overwrite,
        };
        let image = conversion.read(&self.input, &self.output)?;
        image.contradiction.iter().for_each(|contradiction| session.warn(contradiction));
        conversion.write(&self.input, &self.output, &image)?;
        let lost = image.capture_beyond(&self.output).and_then(|info| what_is_lost(&self.output, &info));
        lost.iter().for_each(|lost| session.note(lost));
        image.mapping_beyond(&self.output).iter().for_each(|lost| session.warn(lost));
        if image.pixels.raw.is_some() {
            session.warn(format_args!(
                "{output} holds the values of the raw file as they are stored, black level and mosaic included; \
                 `udc restore` and `udc fuse` read the raw file itself"
            ));
        }
        if image.is_assumed_linear {
            session.warn(format_args!(
                "{input} does not say its domain; {output} says linear (add --domain tone-mapped if that is wrong)"
            ));
        }
        let (channels, height, width) = image.pixels.planes.dim();
        session.results_of(json!({ "channels": channels, "height": height, "width": width }));
        session.say(format_args!("{output}: {width} × {height}, {channels} channels"))
    }
}
