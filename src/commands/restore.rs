//! `udc restore`.

mod code;
mod engine;
mod field;
mod files;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use anyhow::Result;
use clap::{ArgGroup, Args, ValueEnum};
use serde_json::{Map, Value, json};

use udc::capture::relative_times;
use udc::core::capture::CaptureInfo;
use udc::core::provenance::Provenance;
use udc::core::tone::ToneCurve;
use udc::io::WriteOptions;

use super::bracket::BracketArgs;
use super::capture::note_what_is_lost;
use super::destination::OutputFolder;
use super::domain::{DomainArg, OutputDomainArg};
use super::highlights::HighlightsArg;
use super::picture::{AnyImage, check_domain_of_output};
use super::precision::PrecisionArg;
use super::psf_file::{PSF_FILES, PsfAmongImagesArgs};
use super::queue::{Stages, remaining, run_all};
use super::{Session, text_of};
use code::CodeArgs;
use engine::{Engine, MethodArgs};
use files::{Capture, Job};

/// Restore degraded images, by a network or by deconvolution
///
/// A model that was trained with kernel codes needs to know the PSF: name the kernel bank with the panel's
/// angle or with a measured PSF, or give the code itself. Deconvolution needs the PSF.
///
/// Several inputs, or a folder, are restored one after another into the folder OUT; a file that cannot be
/// restored is named at the end, the others are done. With --exposures or --bracket the files are one bracket, and each
/// folder is one. A DNG says the mosaic's colours, levels, gains, exposure time and ISO itself; the shading of its lens is
/// corrected, and it is restored as it lies on the sensor. An EXR carries to `udc finish` at what light each channel of the
/// capture saturates, and of a DNG how it is put upright, its colour matrix and its baseline exposure.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("how").required(true).args(["model", "method"]))]
#[command(group = ArgGroup::new(PSF_FILES).args(["psf", "field"]).multiple(true))]
#[command(after_help = "Examples:\n  \
    udc restore capture.exr --model model.safetensors --bank bank.safetensors --angle 3 -o restored.exr\n  \
    udc restore captures/ --model model.safetensors --bank bank.safetensors --psf psf.exr -o restored/\n  \
    udc restore --exposures 1,1/4,1/16 a.exr b.exr c.exr --method constrained --psf psf.exr -o restored.exr\n  \
    udc restore phone.dng --model m.pth --code c.npy -o restored.exr\n  \
    udc restore --bracket --bayer rggb --white 16383 --black 64 scenes/ --model m.pth --code c.npy -o out/ --resume")]
pub(crate) struct RestoreArgs {
    /// Images, folders or patterns; also the folder of the published dataset, for its real captures
    #[arg(required = true, value_name = "IN")]
    inputs: Vec<PathBuf>,
    /// Image to write; a folder for several inputs, or if the name ends in a slash
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Network to restore with (.safetensors, or a PyTorch .pth)
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    #[command(flatten)]
    method: MethodArgs,
    #[command(flatten)]
    code: CodeArgs,
    #[command(flatten)]
    psf_file: PsfAmongImagesArgs,
    /// The files are one bracket, and each folder is one, with the exposure times and ISO that the files tell
    #[arg(long)]
    bracket: bool,
    #[command(flatten)]
    raw: BracketArgs,
    /// What the inputs hold: srgb is decoded to linear light [default: what the file says, else linear; integer formats must
    /// be told]
    #[arg(long, value_enum, value_name = "DOMAIN")]
    domain: Option<DomainArg>,
    /// What to write [default: the same as the input]
    #[arg(long, value_enum, value_name = "DOMAIN")]
    output_domain: Option<OutputDomainArg>,
    /// What to do where the capture is saturated
    #[arg(long, value_enum, value_name = "WHAT", default_value_t = HighlightsArg::Network)]
    highlights: HighlightsArg,
    /// Format of the files in an output folder
    #[arg(long, value_enum, value_name = "FORMAT", default_value_t = FormatArg::Exr)]
    format: FormatArg,
    /// Keep the images that are there and go on with the others
    ///
    /// An EXR says how it was made, and is refused if that was otherwise or of a capture or dark frames with other contents
    /// (SHA-256), wherever those lie; other formats are kept as they are.
    #[arg(long)]
    resume: bool,
    /// What the network multiplies
    #[arg(long, value_enum, value_name = "PRECISION", default_value_t = PrecisionArg::F32, conflicts_with = "method")]
    precision: PrecisionArg,
    /// Side of the tiles, a multiple of 4 (of 16 for de-unet) [default: chosen by --max-memory]
    #[arg(long, value_name = "N", conflicts_with = "method")]
    tile: Option<usize>,
    /// Memory to stay under: 2GiB, 500MB, …
    #[arg(long, value_name = "SIZE", default_value = "2GiB", value_parser = udc::core::bytes::parse_bytes)]
    max_memory: u64,
    /// Write half floats, in formats that have them
    #[arg(long)]
    half: bool,
    /// Irradiance that the tone mapping maps to one half [default: that of the model's training, else 0.25]
    #[arg(long, value_name = "A")]
    alpha: Option<f32>,
    /// Irradiance at which the capture saturates [default: that of the model's training, else 500]
    #[arg(long, value_name = "X")]
    x_max: Option<f32>,
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
        self.curve(None)?;
        self.raw.config()?;
        let mut jobs = self.jobs(session)?;
        let engine = Engine::new(&self, &jobs, session)?;
        let restoration = Restoration { args: &self, engine, session, darks_sha256: OnceLock::new() };
        if self.resume {
            jobs = remaining(&restoration, jobs, session)?;
        }
        let _folder = OutputFolder::of(&mut jobs.iter().map(|job| job.output.as_path()))?;
        run_all(&restoration, &jobs, session)
    }

    /// φ∘C as the flags say, and for what they do not say as a model was trained.
    fn curve(&self, of_model: Option<ToneCurve>) -> Result<ToneCurve> {
        let default = of_model.unwrap_or_default();
        Ok(ToneCurve::new(self.alpha.unwrap_or(default.alpha), self.x_max.unwrap_or(default.x_max))?)
    }
}

/// An image that is ready, and what is known of its capture.
struct Restored {
    image: AnyImage,
    domain: OutputDomainArg,
    info: Option<CaptureInfo>,
}

/// A run over several captures.
struct Restoration<'a> {
    args: &'a RestoreArgs,
    engine: Engine,
    session: &'a Session,
    /// SHA-256 of the dark frames, when they were first asked for.
    darks_sha256: OnceLock<Option<Vec<Option<String>>>>,
}

impl Restoration<'_> {
    fn darks_sha256(&self) -> Result<Option<&[Option<String>]>> {
        if self.darks_sha256.get().is_none() {
            // Set by whoever comes first: the reader, or the check of what is there.
            let _ = self.darks_sha256.set(self.args.raw.darks_sha256()?);
        }
        Ok(self.darks_sha256.get().and_then(Option::as_deref))
    }

    /// The contents that an image is made of.
    fn contents(&self, job: &Job) -> Result<Map<String, Value>> {
        let mut contents = Map::new();
        contents.insert("inputs-sha256".to_owned(), json!(job.inputs_sha256()?));
        if let Some(darks) = self.darks_sha256()? {
            contents.insert("dark-sha256".to_owned(), json!(darks));
        }
        Ok(contents)
    }
}

impl Stages for Restoration<'_> {
    type Job = Job;
    type Input = Capture;
    type Output = Restored;

    fn doing(&self, job: &Job) -> String {
        format!("restoring {}", job.name())
    }

    fn output<'a>(&self, job: &'a Job) -> &'a Path {
        &job.output
    }

    fn describe(&self, _job: &Job) -> Value {
        let RestoreArgs { raw, domain, output_domain, half, .. } = self.args;
        let is_raw = self.args.is_bracket() || raw.is_raw();
        // As shares of the longest, since the image is the same whatever their unit.
        let exposures = raw.exposures.as_deref().map(relative_times);
        let mut described = json!({
            "exposures": exposures, "raw": is_raw.then(|| raw.config().ok()),
            "tone": self.engine.curve, "how": self.engine.describe(), "half": half,
            "domain": domain.map(DomainArg::name), "output-domain": output_domain.map(OutputDomainArg::name),
        });
        if let Some(darks) = raw.describe_darks() {
            described["dark"] = darks;
        }
        described
    }

    fn forget_places(&self, made: &mut Value) {
        if let Some(how) = made.get_mut("how") {
            Engine::forget_place(how);
        }
    }

    fn identify(&self, job: &Job) -> Result<Value> {
        self.contents(job).map(Value::Object)
    }

    fn prepare(&self) {
        self.engine.prepare();
    }

    fn read(&self, job: &Job) -> Result<Capture> {
        // Before the pixels, so that they are not older than it.
        self.contents(job)?;
        let capture = self.args.read_capture(job, self.session)?;
        let domain = self.args.output_domain.unwrap_or(capture.pixels.domain());
        check_domain_of_output(&job.output, domain)?;
        Ok(capture)
    }

    fn compute(&self, job: &Job, capture: Capture) -> Result<Self::Output> {
        self.session.progress.check()?;
        let domain = self.args.output_domain.unwrap_or(capture.pixels.domain());
        let info = capture.info.clone();
        let restore = || self.engine.restore(&job.name(), capture, self.session);
        Ok(Restored { image: self.session.timed(self.doing(job), restore)?, domain, info })
    }

    fn write(&self, job: &Job, Restored { image, domain, info }: Restored) -> Result<()> {
        let mut described = self.describe(job);
        // It decides the tiles, which change nothing but roundings.
        described["max-memory"] = json!(self.args.max_memory);
        // Where files lay; what they are is told by their contents.
        described["how"] = self.engine.describe_with_place();
        described["inputs"] = job.inputs.iter().map(|input| text_of(input)).collect();
        if let Some(files) = self.args.raw.dark_files() {
            described["dark-files"] = json!(files);
        }
        for (name, contents) in self.contents(job)? {
            described[name] = contents;
        }
        let options = WriteOptions {
            half: self.args.half,
            overwrite: self.session.overwrite,
            provenance: Some(Provenance::new("restore", &described)),
            capture: info,
        };
        if let Some(info) = &options.capture {
            note_what_is_lost(&job.output, info, self.session);
        }
        let write = || image.write(&job.output, domain, self.engine.curve, &options);
        self.session.timed(format_args!("writing {}", job.output.display()), write)?;
        self.session.tell(job.output.display());
        Ok(())
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
