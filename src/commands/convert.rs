//! `udc convert`.

use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use serde_json::json;

use super::Session;
use super::domain::DomainArg;
use udc::core::io::{DomainTag, PixelOptions, check_output, read_pixels, write_pixels};
use udc::core::provenance::Provenance;
use udc::network::weights;

/// Convert an image, or a PyTorch checkpoint to a model
#[derive(Args, Debug)]
#[command(after_help = "Example: udc convert scene.npy scene.exr --half --domain linear\n         \
    udc convert DISCNet.pth discnet.safetensors\n\n\
    The format follows from the name of OUT: .exr, .npy, .hdr, .png, .tif or .jpg. PNG and TIFF have 16 bits, \
    JPEG has 8; they hold values from 0 to 1. Use `udc tonemap` to bring linear light into that range")]
pub(crate) struct ConvertArgs {
    /// Image or checkpoint to read
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Image, or model (.safetensors), to write
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Write half floats, in formats that have them
    #[arg(long)]
    half: bool,
    /// Say what the values are, of a file that does not
    #[arg(long, value_enum, value_name = "DOMAIN")]
    domain: Option<DomainArg>,
    /// Clip values above 1 when the output has integers
    #[arg(long)]
    clip: bool,
}

impl ConvertArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let (input, output) = (self.input.display(), self.output.display());
        let doing = || format!("converting {input}");
        check_output(&self.output, session.overwrite).with_context(doing)?;
        if self.output.extension().is_some_and(|extension| extension == "safetensors") {
            weights::convert(&self.input, &self.output, session.overwrite).with_context(doing)?;
            return session.say(format_args!("{output}: {}", weights::describe(&self.output)?));
        }
        let mut pixels = read_pixels(&self.input).with_context(doing)?;
        let wanted = self.domain.map(DomainTag::from);
        if let (Some(declared), Some(wanted)) = (pixels.domain, wanted)
            && declared != wanted
        {
            bail!(
                "{input} declares {} values: --domain {} would only rename them; use `udc tonemap` to change them",
                declared.name(),
                wanted.name()
            );
        }
        pixels.domain = pixels.domain.or(wanted);
        let source = pixels.provenance.take();
        let config =
            json!({"input": input.to_string(), "half": self.half, "clip": self.clip, "source": source});
        pixels.provenance = Some(Provenance::new("convert", &config));
        let clip = self.clip || matches!(pixels.domain, Some(DomainTag::ToneMapped | DomainTag::Display));
        let options = PixelOptions { half: self.half, overwrite: session.overwrite, clip, eight_bit: false };
        write_pixels(&self.output, &pixels, options).with_context(doing)?;
        let (channels, height, width) = pixels.planes.dim();
        session.say(format_args!("{output}: {width} × {height}, {channels} channels"))
    }
}
