//! `udc info`.

mod dataset;
mod text;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::Args;
use serde_json::{Value, json};

use super::Session;
use udc::core::io::{Description, describe, describe_psf, expand_inputs, read_text};
use udc::network::weights;
use udc::train::TrainConfig;

/// Describe a file: image, PSF, kernel bank, model, dataset, training configuration
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc info scene.exr bank.safetensors model.pth dataset/ configs/sftmd.toml\n         udc info --psf \
                        psf.exr\n         udc info --json captures/*.png | jq .channels[0].max"
)]
pub(crate) struct InfoArgs {
    /// Files, dataset folders, folders of images, or patterns
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
        let files = self.subjects()?;
        if let [file] = &files[..] {
            return self.show(file, session);
        }
        let mut failed = 0;
        for file in &files {
            session.progress.check()?;
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

    /// The files to describe; a dataset is described as one.
    fn subjects(&self) -> Result<Vec<PathBuf>> {
        let mut subjects = Vec::new();
        for input in &self.inputs {
            if dataset::is_dataset(input) {
                subjects.push(input.clone());
            } else {
                subjects.extend(expand_inputs(std::slice::from_ref(input))?);
            }
        }
        Ok(subjects)
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
        if file.is_dir() {
            let summary = dataset::summarise(file)?;
            return Ok((serde_json::to_value(&summary)?, summary.render()?));
        }
        if is_checkpoint(file) {
            return examine_model(file);
        }
        if file.extension().is_some_and(|extension| extension == "toml") {
            return examine_training(file);
        }
        let description = if self.psf { describe_psf(file)? } else { describe(file)? };
        if let Description::Model(model) = &description
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

/// Describes the network that a training's configuration asks for.
fn examine_training(file: &Path) -> Result<(Value, String)> {
    let config = TrainConfig::from_toml(&read_text(file)?, &[])
        .with_context(|| format!("reading {} as a training's configuration", file.display()))?;
    let architecture = config.architecture;
    let object = json!({
        "kind": "training-configuration",
        "architecture": architecture.to_json(),
        "parameters": architecture.parameters(),
        "macs_800": architecture.macs(800, 800),
    });
    Ok((object, format!("training configuration\n{}", architecture.describe())))
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
