//! `udc convert`.

use std::path::PathBuf;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use serde_json::json;

use super::Session;
use super::domain::DomainArg;
use udc::core::image::CHANNELS;
use udc::core::provenance::Provenance;
use udc::io::{
    DomainTag, Format, PixelOptions, Pixels, check_output, read_pixels, what_is_lost, write_pixels,
};
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
    /// Say what the values are, of a file that does not: srgb is decoded to linear light. Floats (.exr, .npy, .hdr) that are
    /// made of integers need it; other values are taken for linear
    #[arg(long, value_enum, value_name = "DOMAIN")]
    domain: Option<DomainArg>,
    /// Clip values that the output cannot hold: negative ones, above 1 in integers, above 65504 in half floats
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
        if let Some(contradiction) = pixels.tell(&self.input, wanted)? {
            session.warn(contradiction);
        }
        if self.writes_floats() {
            pixels.check_told(&self.input)?;
        }
        let is_assumed = pixels.domain.is_none() && self.writes_exr();
        if is_assumed {
            pixels.domain = Some(DomainTag::Linear);
        }
        let source = pixels.provenance.take();
        let config = json!({
            "input": input.to_string(), "half": self.half, "clip": self.clip, "source": source,
            "domain": self.domain.map(DomainArg::name),
        });
        pixels.provenance = Some(Provenance::new("convert", &config));
        let clip = self.clip || matches!(pixels.domain, Some(DomainTag::ToneMapped | DomainTag::Display));
        let options =
            PixelOptions { half: self.half, overwrite: session.overwrite, clip, ..PixelOptions::default() };
        write_pixels(&self.output, &pixels, options).with_context(doing)?;
        self.note_what_is_lost(&pixels, session);
        if pixels.raw.is_some() {
            session.warn(format_args!(
                "{output} holds the values of the raw file as they are stored, black level and mosaic included; \
                 `udc restore` and `udc fuse` read the raw file itself"
            ));
        }
        if is_assumed {
            session.warn(format_args!(
                "{input} does not say its domain; {output} says linear (add --domain tone-mapped if that is wrong)"
            ));
        }
        let (channels, height, width) = pixels.planes.dim();
        session.say(format_args!("{output}: {width} × {height}, {channels} channels"))
    }

    /// Says what the output cannot carry of the capture. Linear integers clip at 1 wherever they are read.
    fn note_what_is_lost(&self, pixels: &Pixels, session: &Session) {
        let Some(mut info) = pixels.capture.clone() else { return };
        let is_implied = !self.writes_floats() && pixels.domain == Some(DomainTag::Linear);
        let is_one = |levels: &[f32; CHANNELS]| levels.iter().all(|level| (level - 1.0).abs() < f32::EPSILON);
        info.saturation = info.saturation.filter(|levels| !(is_implied && is_one(levels)));
        what_is_lost(&self.output, &info).iter().for_each(|lost| session.note(lost));
    }

    /// Whether the output no longer shows that its values were integers, which are asked for their domain.
    fn writes_floats(&self) -> bool {
        Format::of_extension(&self.output)
            .is_ok_and(|format| matches!(format, Format::Exr | Format::Npy | Format::Hdr))
    }

    /// Whether the output must say its domain.
    fn writes_exr(&self) -> bool {
        Format::of_extension(&self.output).is_ok_and(|format| format == Format::Exr)
    }
}
