//! `udc info`.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::Args;

use serde_json::{Value, json};

use udc::inspect::{inspect, subjects};
use udc::network::Isa;
use udc::network::gpu::{self, GpuInfo};

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
    #[arg(required_unless_present = "devices", value_name = "FILE")]
    inputs: Vec<PathBuf>,
    /// Describe images as PSFs: peak, energy radii, identity
    #[arg(long, alias = "psf")]
    as_psf: bool,
    #[command(flatten)]
    psf_file: PsfFileArgs,
    /// List the GPUs that networks can compute on
    #[arg(long, conflicts_with = "inputs")]
    devices: bool,
    /// Print one JSON object a file
    #[arg(long)]
    json: bool,
}

impl InfoArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        if self.devices {
            return list_devices(self.json, session);
        }
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
        if self.json {
            let mut object = serde_json::to_value(&found)?;
            object["file"] = file.to_string_lossy().into();
            session.say(object)
        } else {
            session.say(format_args!("{}: {found}", file.display()))
        }
    }
}

/// Lists what `--device` chooses among.
fn list_devices(as_json: bool, session: &Session) -> Result<()> {
    if as_json {
        let device = |gpu: &GpuInfo| json!({"device": format!("gpu:{}", gpu.number), "name": gpu.name, "interface": gpu.interface, "card": gpu.is_card});
        return session.say(Value::from(gpu::list().iter().map(device).collect::<Vec<_>>()));
    }
    session.say(format_args!("cpu: {} threads, {}", rayon::current_num_threads(), Isa::current().name()))?;
    gpu::list().iter().try_for_each(|gpu| session.say(gpu))?;
    if !gpu::IS_BUILT {
        session.tell(
            "this build computes on the CPU alone; `cargo build --release --features gpu` makes one for GPUs",
        );
    }
    Ok(())
}
