//! `udc info`.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::Args;

use udc::inspect::{inspect, subjects};

use super::Session;
use super::psf_file::PsfFileArgs;

/// Describe a file or folder: image, PSF, kernel bank, model, dataset, training run, configuration
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc info scene.exr bank.safetensors model.pth dataset/ configs/sftmd.toml\n         udc info --as-psf \
                        psf.exr\n         udc info --json captures/*.png | jq .channels[0].max"
)]
pub(crate) struct InfoArgs {
    /// Files, datasets, training runs, folders of images, or patterns
    #[arg(required = true, value_name = "FILE")]
    inputs: Vec<PathBuf>,
    /// Describe images as PSFs: peak, energy radii, identity
    #[arg(long, alias = "psf")]
    as_psf: bool,
    #[command(flatten)]
    psf_file: PsfFileArgs,
}

impl InfoArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let mut files: Vec<Result<PathBuf>> = Vec::new();
        for input in &self.inputs {
            match subjects(input) {
                Ok(found) => files.extend(found.into_iter().map(Ok)),
                Err(error) => files.push(Err(error.into())),
            }
        }
        if files.len() == 1 {
            return self.show(&files.remove(0)?, session);
        }
        let (count, mut failed) = (files.len(), 0);
        for file in files {
            session.progress.check()?;
            if let Err(error) = file.and_then(|file| self.show(&file, session)) {
                // Output that nobody reads any more ends the program; a file that is damaged does not.
                if super::is_broken_pipe(&error) {
                    return Err(error);
                }
                session.warn(format_args!("{error:#}"));
                failed += 1;
            }
        }
        if failed > 0 {
            bail!("{failed} of {count} files could not be described");
        }
        Ok(())
    }

    fn show(&self, file: &Path, session: &Session) -> Result<()> {
        let found = inspect(file, self.as_psf.then(|| self.psf_file.options()))?;
        if session.is_json {
            let mut object = serde_json::to_value(&found)?;
            object["file"] = file.to_string_lossy().into();
            session.say(object)
        } else {
            session.say(format_args!("{}: {found}", file.display()))
        }
    }
}
