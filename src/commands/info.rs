//! `udc info`.

mod text;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::Args;

use super::Session;
use udc::core::io::{Description, describe, describe_psf, expand_inputs};

/// Describe a file: image, PSF, kernel bank, model, dataset
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc info scene.exr bank.safetensors\n         udc info --psf psf.exr\n         \
                        udc info --json captures/*.png | jq .channels[0].max"
)]
pub(crate) struct InfoArgs {
    /// Files, folders of images, or patterns
    #[arg(required = true, value_name = "FILE")]
    inputs: Vec<PathBuf>,
    /// Describe images as PSFs: peak, energy radii, identity
    #[arg(long)]
    psf: bool,
    /// Print one JSON object a file
    #[arg(long)]
    json: bool,
}

impl InfoArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let files = expand_inputs(&self.inputs)?;
        if let [file] = &files[..] {
            return self.show(file, session);
        }
        let mut failed = 0;
        for file in &files {
            if let Err(error) = self.show(file, session) {
                // Output that nobody reads any more ends the program; a file that is damaged does not.
                if super::is_broken_pipe(&error) {
                    return Err(error);
                }
                session.warn(format_args!("{error:#}"));
                failed += 1;
            }
        }
        if failed > 0 {
            bail!("{failed} of {} files could not be described", files.len());
        }
        Ok(())
    }

    fn show(&self, file: &Path, session: &Session) -> Result<()> {
        let description = if self.psf { describe_psf(file)? } else { describe(file)? };
        if self.json {
            session.say(json(file, &description)?)
        } else {
            session.say(text::render(file, &description))
        }
    }
}

fn json(file: &Path, description: &Description) -> Result<String> {
    let mut object = serde_json::to_value(description)?;
    object["file"] = file.to_string_lossy().into();
    Ok(object.to_string())
}
