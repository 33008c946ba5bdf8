//! `udc info`.

mod configuration;
mod dataset;
mod run;
mod text;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::Args;
use serde_json::{Value, json};

use super::Session;
use super::psf_file::PsfFileArgs;
use udc::dataset::CONFIG_FILE;
use udc::io::{FileDescription, describe, describe_psf, expand_inputs};
use udc::network::weights;

/// Describe a file or folder: image, PSF, kernel bank, model, dataset, training run, configuration
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc info scene.exr bank.safetensors model.pth dataset/ configs/sftmd.toml\n         udc info --psf \
                        psf.exr\n         udc info --json captures/*.png | jq .channels[0].max"
)]
pub(crate) struct InfoArgs {
    /// Files, datasets, training runs, folders of images, or patterns
    #[arg(required = true, value_name = "FILE")]
    inputs: Vec<PathBuf>,
    /// Describe images as PSFs: peak, energy radii, identity
    #[arg(long)]
    psf: bool,
    #[command(flatten)]
    psf_file: PsfFileArgs,
    /// Print one JSON object a file
    #[arg(long)]
    json: bool,
}

impl InfoArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let mut subjects: Vec<Result<PathBuf>> =
            self.inputs.iter().flat_map(|input| subjects(input)).collect();
        if subjects.len() == 1 {
            return self.show(&subjects.remove(0)?, session);
        }
        let (count, mut failed) = (subjects.len(), 0);
        for subject in subjects {
            session.progress.check()?;
            if let Err(error) = subject.and_then(|subject| self.show(&subject, session)) {
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
        let (mut object, text) = self.examine(file)?;
        if self.json {
            object["file"] = file.to_string_lossy().into();
            session.say(object)
        } else {
            session.say(format_args!("{}: {text}", file.display()))
        }
    }

    /// What a file is, for scripts and for people.
    fn examine(&self, file: &Path) -> Result<(Value, String)> {
        if run::is_checkpoint(file) {
            return run::examine_checkpoint(file);
        }
        if file.is_dir() {
            return if dataset::is_dataset(file) { examine_dataset(file) } else { run::examine(file) };
        }
        if let Some(folder) = folder_described_by(file) {
            return examine_dataset(folder);
        }
        if is_checkpoint(file) {
            return examine_model(file);
        }
        if file.extension().is_some_and(|extension| extension == "toml") {
            return configuration::examine(file);
        }
        let description =
            if self.psf { describe_psf(file, self.psf_file.options())? } else { describe(file)? };
        if let FileDescription::Model(model) = &description
            && model.metadata.get("format").is_some_and(|format| format == weights::FORMAT)
        {
            return examine_model(file);
        }
        Ok((serde_json::to_value(&description)?, text::render(&description)))
    }
}

/// Whether a file is named as PyTorch names its checkpoints.
fn is_checkpoint(file: &Path) -> bool {
    file.extension().is_some_and(|extension| extension == "pth" || extension == "pt")
}

/// What an input stands for: itself, or the images of a folder. A dataset, a run and a checkpoint are described as one.
fn subjects(input: &Path) -> Vec<Result<PathBuf>> {
    if dataset::is_dataset(input) || run::is_run(input) || run::is_checkpoint(input) {
        return vec![Ok(input.to_owned())];
    }
    match expand_inputs(&[input.to_owned()]) {
        Ok(files) => files.into_iter().map(Ok).collect(),
        Err(error) => vec![Err(error.into())],
    }
}

/// The folder of the dataset that a `dataset.toml` belongs to.
fn folder_described_by(file: &Path) -> Option<&Path> {
    let folder = file.parent().filter(|_| file.file_name().is_some_and(|name| name == CONFIG_FILE))?;
    Some(if folder.as_os_str().is_empty() { Path::new(".") } else { folder })
}

fn examine_dataset(folder: &Path) -> Result<(Value, String)> {
    let summary = dataset::summarise(folder)?;
    Ok((serde_json::to_value(&summary)?, summary.render()?))
}

fn examine_model(file: &Path) -> Result<(Value, String)> {
    let model = weights::describe(file)?;
    let object = json!({
        "kind": "model",
        "architecture": model.architecture.to_json(),
        "parameters": model.architecture.parameters(),
        "macs_800": model.architecture.macs(800, 800),
        "training": model.origin.training,
        "kernel_bank_sha256": model.origin.kernel_bank_sha256,
    });
    Ok((object, model.to_string()))
}
