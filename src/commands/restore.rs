//! `udc restore`.

mod code;
mod engine;
mod files;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use clap::{ArgGroup, Args, ValueEnum};
use serde_json::json;

use udc::core::io::WriteOptions;
use udc::core::provenance::Provenance;
use udc::core::tone::ToneCurve;

use super::domain::DomainArg;
use super::fuse::parse_fraction;
use super::{Session, was_interrupted};
use code::CodeArgs;
use engine::{Engine, MethodArgs};
use files::{Capture, Job};

/// Restore degraded images, by a network or by deconvolution
///
/// A model that was trained with kernel codes needs to know the PSF: name the kernel bank with the panel's
/// angle or with a measured PSF, or give the code itself. Deconvolution needs the PSF.
///
/// Several inputs, or a folder, are restored one after another into the folder OUT; a file that cannot be
/// restored is named at the end, the others are done. With --exposures the inputs are one bracket.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("how").required(true).args(["model", "method"]))]
#[command(after_help = "Examples:\n  \
    udc restore capture.exr --model model.safetensors --bank bank.safetensors --angle 3 -o restored.exr\n  \
    udc restore captures/ --model model.safetensors --bank bank.safetensors --psf psf.exr -o restored/\n  \
    udc restore --exposures 1,1/4,1/16 a.exr b.exr c.exr --method constrained --psf psf.exr -o restored.exr")]
pub(crate) struct RestoreArgs {
    /// Images, folders or patterns; also the folder of the published dataset, for its real captures
    #[arg(required = true, value_name = "IN")]
    inputs: Vec<PathBuf>,
    /// Image to write; a folder for several inputs
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Network to restore with (.safetensors, or a PyTorch .pth)
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    #[command(flatten)]
    method: MethodArgs,
    #[command(flatten)]
    code: CodeArgs,
    /// Exposure times of the inputs, which are one bracket: 1,1/4,1/16
    #[arg(long, value_name = "T,T,…", value_delimiter = ',', value_parser = parse_fraction)]
    exposures: Option<Vec<f64>>,
    /// What the inputs hold [default: what the file says, else linear; integer formats must be told]
    #[arg(long, value_enum, value_name = "DOMAIN")]
    domain: Option<DomainArg>,
    /// What to write [default: the same as the input]
    #[arg(long, value_enum, value_name = "DOMAIN")]
    output_domain: Option<DomainArg>,
    /// Format of the files in an output folder
    #[arg(long, value_enum, value_name = "FORMAT", default_value_t = FormatArg::Exr)]
    format: FormatArg,
    /// Side of the tiles, a multiple of 4 (of 16 for de-unet) [default: chosen by --max-memory]
    #[arg(long, value_name = "N", conflicts_with = "method")]
    tile: Option<usize>,
    /// Memory to stay under: 2GiB, 500MB, …
    #[arg(long, value_name = "SIZE", default_value = "2GiB", value_parser = udc::restore::parse_bytes)]
    max_memory: u64,
    /// Write half floats, in formats that have them
    #[arg(long)]
    half: bool,
    /// Irradiance that the tone mapping maps to one half
    #[arg(long, value_name = "A", default_value_t = ToneCurve::default().alpha)]
    alpha: f32,
    /// Irradiance at which the capture saturates
    #[arg(long, value_name = "X", default_value_t = ToneCurve::default().x_max)]
    x_max: f32,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatArg {
    Exr,
    Npy,
    Png,
    Tif,
}

impl RestoreArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let curve = ToneCurve::new(self.alpha, self.x_max)?;
        let jobs = self.jobs(session)?;
        let engine = Engine::new(&self, curve, session)?;
        let several = jobs.len() > 1;
        let mut failures = Vec::new();
        for job in &jobs {
            let done = self.restore(job, &engine, curve, session);
            match done.with_context(|| format!("restoring {}", job.name())) {
                Ok(()) => session.say(job.output.display())?,
                Err(error) if !several || was_interrupted(&error) => return Err(error),
                Err(error) => {
                    session.warn(format_args!("{error:#}"));
                    failures.push(format!("{error:#}"));
                }
            }
        }
        if failures.is_empty() {
            return Ok(());
        }
        bail!("{} of {} images were not restored: {}", failures.len(), jobs.len(), failures.join("; "))
    }

    fn restore(&self, job: &Job, engine: &Engine, curve: ToneCurve, session: &Session) -> Result<()> {
        session.progress.check()?;
        let started = Instant::now();
        let capture = Capture::read(job, self.domain)?;
        let saturation = capture.saturation.unwrap_or(curve.x_max).min(curve.x_max);
        let domain = self.output_domain.unwrap_or(capture.pixels.domain());
        files::check_domain_of_output(&job.output, domain)?;
        let restored = engine.restore(capture.pixels, curve, saturation, session)?;
        session.detail(format_args!("{}: {:.2} s", job.name(), started.elapsed().as_secs_f64()));
        let config = json!({
            "inputs": job.inputs, "exposures": self.exposures, "tone": curve, "how": engine.describe(),
        });
        let options = WriteOptions {
            half: self.half,
            overwrite: session.overwrite,
            provenance: Some(Provenance::new("restore", &config)),
        };
        files::write(&job.output, restored, domain, curve, &options)
    }

    /// What to restore to where; refuses outputs that exist before any work.
    fn jobs(&self, session: &Session) -> Result<Vec<Job>> {
        match &self.exposures {
            Some(times) => files::bracket_job(&self.inputs, times, &self.output, session),
            None => files::jobs(&self.inputs, &self.output, self.format.extension(), session),
        }
    }
}

impl FormatArg {
    fn extension(self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Npy => "npy",
            Self::Png => "png",
            Self::Tif => "tif",
        }
    }
}

/// The text of a path, for provenance and messages.
fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}
