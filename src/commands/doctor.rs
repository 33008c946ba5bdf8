//! `udc doctor`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::{ArgGroup, Args};
use serde_json::json;

use udc::doctor::{Finding, Level, Patient, Role, examine};

use super::Session;
use super::psf_file::{PSF_FILES, PsfAmongImagesArgs};

/// Look at a dataset, bank, model, PSF and configuration, each by itself and all together, and say what mends what is wrong
///
/// What files hold is found out; the flags say it where a damaged file no longer tells. The machine is looked at too: its
/// instruction set, threads, memory, and the room on the disk. The exit code is 1 where there is an error, and 0 where there
/// are warnings alone. With --json, one object has all findings.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new(PSF_FILES).args(["psf"]).multiple(true))]
#[command(after_help = "Examples:\n  udc doctor\n  udc doctor dataset run/best.safetensors psf.exr\n  \
    udc doctor --data dataset --config configs/discnet.toml -o run\n  \
    udc doctor dataset bank.safetensors --all\n  \
    udc doctor dataset --json | jq '.findings[] | select(.level == \"error\")'")]
pub(crate) struct DoctorArgs {
    /// Datasets, examples, runs, kernel banks, models, configurations, poses, images, or patterns
    #[arg(value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Dataset or folder of examples
    #[arg(long, value_name = "DATASET")]
    data: Vec<PathBuf>,
    /// Kernel bank
    #[arg(long, value_name = "BANK")]
    bank: Vec<PathBuf>,
    /// Network
    #[arg(long, value_name = "MODEL")]
    model: Vec<PathBuf>,
    /// PSF
    #[arg(long, value_name = "PSF")]
    psf: Vec<PathBuf>,
    /// Configuration of a training
    #[arg(long, value_name = "CONFIG")]
    config: Vec<PathBuf>,
    #[command(flatten)]
    psf_file: PsfAmongImagesArgs,
    /// Where results are to be written: whether they can be, and whether they fit
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Triplets of a dataset, or examples, whose files are read, spread evenly
    #[arg(long, value_name = "N", default_value_t = 32, conflicts_with = "all",
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    images: usize,
    /// Read the files of all of them
    #[arg(long)]
    all: bool,
}

impl DoctorArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let is_json = session.is_json;
        let findings = examine(&self.patient(), &session.progress)?;
        let count = |level: Level| findings.iter().filter(|finding| finding.level == level).count();
        let (errors, warnings) = (count(Level::Error), count(Level::Warning));
        if is_json {
            session.say(json!({ "findings": findings, "errors": errors, "warnings": warnings }))?;
        } else {
            findings.iter().try_for_each(|finding: &Finding| session.say(finding))?;
            session.say(format_args!(
                "{} looked at, {}, {}",
                findings.len(),
                of(errors, "error"),
                of(warnings, "warning")
            ))?;
        }
        match errors {
            0 => Ok(()),
            errors => bail!("{} found; each says what mends it", of(errors, "error")),
        }
    }

    fn patient(self) -> Patient {
        let named = [
            (self.paths, Role::Unknown),
            (self.data, Role::Data),
            (self.bank, Role::Bank),
            (self.model, Role::Model),
            (self.psf, Role::Psf),
            (self.config, Role::Configuration),
        ];
        let paths =
            named.into_iter().flat_map(|(paths, role)| paths.into_iter().map(move |path| (path, role)));
        Patient {
            paths: paths.collect(),
            psf_options: self.psf_file.options(),
            output: self.output,
            images: (!self.all).then_some(self.images),
        }
    }
}

/// A number of things: `1 error`, `2 errors`.
fn of(count: usize, thing: &str) -> String {
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}
