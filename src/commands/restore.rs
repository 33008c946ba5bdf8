//! `udc restore`.

mod estimate;
mod files;
mod found;
mod kernel;
mod method;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, Once, OnceLock, PoisonError};

use anyhow::Result;
use clap::{ArgGroup, Args};
use serde_json::{Map, Value, json};

use udc::batch::{self, Selection, Stages};
use udc::capture::{Told, relative_times};
use udc::core::error;
use udc::core::progress::Progress;
use udc::core::provenance::Provenance;
use udc::core::shard::Shard;
use udc::core::tone::ToneFlags;
use udc::dataset::NoiseConfig;
use udc::finish::Photograph;
use udc::io::{DomainTag, WriteOptions, check_output_domain, what_is_lost, what_is_lost_of_mapping};
use udc::kernels::Isa;
use udc::network::Backend;
use udc::restore::{
    Capture, Highlights, MemoryBudget, MethodConfig, PoseSource, Precision, Restoration, RestorationConfig,
    Restored, is_guided,
};

use super::bracket::BracketArgs;
use super::choices::{Choices, DOMAINS, HIGHLIGHTS, OUTPUT_DOMAINS, PRECISIONS, parse_noise};
use super::device::DeviceArgs;
use super::dry_run::DryRunArgs;
use super::layer::LayerArgs;
use super::psf_file::{PSF_FILES, PsfAmongImagesArgs};
use super::{Session, misuse, text_of};
use files::Job;
use kernel::KernelArgs;
use method::MethodArgs;

/// Restore captures of any panel, given its PSF; or by a network of your own, or by deconvolution
///
/// With neither --model nor --method, the capture is deconvolved, the light of lamps that the sensor clipped and the pose of the
/// panel are measured by their flare, and the guided network corrects the result, for any panel: all it needs is the PSF, or a
/// kernel bank with the panel's angle.
///
/// A model that was trained with kernel codes needs to know the PSF: name the kernel bank with the panel's
/// angle or with a measured PSF, or give the code itself. Deconvolution needs the PSF.
///
/// Several inputs, or a folder, are restored one after another into the folder OUT; a file that cannot be
/// restored is named at the end, the others are done. With --exposures or --bracket the files are one bracket, and each
/// folder is one. A DNG says the mosaic's colours, levels, gains, exposure time and ISO itself; the shading of its lens is
/// corrected, and it is restored as it lies on the sensor. An EXR carries to `udc finish` at what light each channel of the
/// capture saturates, and of a DNG how it is put upright, its colour matrix and its baseline exposure. A JPEG is finished
/// for viewing, as `udc finish` does without flags.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("how").args(["model", "method"]))]
#[command(group = ArgGroup::new(PSF_FILES).args(["psf", "field"]).multiple(true))]
#[command(after_help = "Examples:\n  \
    udc restore capture.exr --psf psf.exr -o photo.jpg\n  \
    udc restore captures/ --psf psf.exr -o restored/\n  \
    udc restore capture.exr --model model.safetensors --bank bank.safetensors --angle 3 -o restored.exr\n  \
    udc restore captures/ --model model.safetensors --bank bank.safetensors --psf psf.exr -o restored/\n  \
    udc restore --exposures 1,1/4,1/16 a.exr b.exr c.exr --method constrained --psf psf.exr -o restored.exr\n  \
    udc restore phone.dng --model m.pth --code c.npy -o restored.exr\n  \
    udc restore phone.dng --model m.pth --code c.npy -o photo.jpg\n  \
    udc restore --bracket --bayer rggb --white 16383 --black 64 scenes/ --model m.pth --code c.npy -o out/ --resume\n  \
    udc restore captures/ --psf psf.exr -o restored/ --shard 2/8 --resume")]
pub(crate) struct RestoreArgs {
    /// Images, folders or patterns; also the folder of the published dataset, for its real captures
    #[arg(required = true, value_name = "IN")]
    inputs: Vec<PathBuf>,
    /// Image to write; a folder for several inputs, or if the name ends in a slash
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Network to restore with (.safetensors, or a PyTorch .pth); `guided` is the one for any panel
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// How much of the guided network's corrections to take, from 0 (the deconvolution) to 1 [default: 1]
    #[arg(long, value_name = "0..1", conflicts_with = "method")]
    refine: Option<f32>,
    /// Write lamps with the light that their flare tells, far above what saturates (guided; linear formats that hold it)
    #[arg(long, conflicts_with = "method")]
    true_highlights: bool,
    /// Pose of the panel, a file of `udc pose`; `psf` takes the PSF as it is [default: what the flare of each capture tells]
    #[arg(long, value_name = "POSE|psf", conflicts_with = "method", value_parser = parse_pose)]
    pose: Option<PoseSource>,
    /// The captures' noise, as `udc synth` takes it: none, gaussian:SIGMA, sensor, sensor:FILE (guided, joint) [default: as it is
    /// estimated from each capture]
    #[arg(long, value_name = "NOISE", value_parser = parse_noise)]
    noise: Option<NoiseConfig>,
    #[command(flatten)]
    method: MethodArgs,
    #[command(flatten)]
    kernel: KernelArgs,
    #[command(flatten)]
    layer: LayerArgs,
    #[command(flatten)]
    psf_file: PsfAmongImagesArgs,
    /// The files are one bracket, and each folder is one, with the exposure times and ISO that the files tell
    #[arg(long)]
    bracket: bool,
    #[command(flatten)]
    raw: BracketArgs,
    /// What the inputs hold: srgb is decoded to linear light [default: what the file says, else linear; required
    /// for 8- and 16-bit files that do not say it]
    #[arg(long, value_name = "DOMAIN", value_parser = DOMAINS)]
    domain: Option<DomainTag>,
    /// What to write [default: the same as the input]
    #[arg(long, value_name = "DOMAIN", value_parser = OUTPUT_DOMAINS)]
    output_domain: Option<DomainTag>,
    /// What to do where the capture is saturated
    #[arg(long, value_name = "WHAT", value_parser = HIGHLIGHTS, default_value = "restored")]
    highlights: Highlights,
    /// Format of the files in an output folder [default: exr]
    #[arg(long, value_name = "FORMAT", value_parser = FORMATS)]
    format: Option<&'static str>,
    /// Keep the images that are there and go on with the others
    ///
    /// An EXR says how it was made, and is refused if that was otherwise or of a capture or dark frames with other contents
    /// (SHA-256), wherever those lie; other formats are kept as they are.
    #[arg(long)]
    resume: bool,
    /// Restore only the I-th of N parts; all parts may be restored at the same time, into one folder
    #[arg(long, value_name = "I/N", default_value = "1/1")]
    shard: Shard,
    /// Arithmetic precision of the network
    #[arg(long, value_name = "PRECISION", value_parser = PRECISIONS, default_value = "f32", conflicts_with = "method")]
    precision: Precision,
    /// Side of the tiles, a multiple of 4 (of 8 for guided, of 16 for de-unet) [default: chosen by --max-memory]
    #[arg(long, value_name = "N", conflicts_with = "method")]
    tile: Option<usize>,
    #[command(flatten)]
    device: DeviceArgs,
    /// Memory to stay under: 2GiB, 500MB, …
    #[arg(long, value_name = "SIZE", default_value = "2GiB", value_parser = udc::core::bytes::parse_bytes)]
    max_memory: u64,
    /// Write half floats, in formats that have them
    #[arg(long)]
    half: bool,
    /// Irradiance that the tone mapping maps to one half; captures that are tone-mapped and say theirs are mapped back by that, unless
    /// this is given [default: that of the model's training, else 0.25; without a method, and
    /// for joint, of captures in much larger or smaller units, as counts of a sensor, what suits the median of their green light]
    #[arg(long, value_name = "A")]
    alpha: Option<f32>,
    /// Irradiance at which the capture, fused of all its exposures, saturates [default: what its file says; for the guided network
    /// and joint, what its brightest pixels show; else that of the model's training, or 500]
    #[arg(long, value_name = "X")]
    x_max: Option<f32>,
    #[command(flatten)]
    dry_run: DryRunArgs,
}

/// The formats of files in an output folder, as the extensions that stand for them.
const FORMATS: Choices<&str> = Choices(&[
    ("exr", "exr", ""),
    ("npy", "npy", ""),
    ("png", "png", ""),
    ("tif", "tif", ""),
    ("jpg", "jpg", "Finished for viewing, as `udc finish` does without flags"),
]);

impl RestoreArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        self.method.check()?;
        let is_guided = self.is_guided();
        self.check_guided(is_guided)?;
        self.config(is_guided, &[], Backend::default()).curve(None)?;
        self.raw.config()?;
        let jobs = self.jobs(session)?;
        if self.output_domain.is_some() && jobs.iter().any(Job::is_photograph) {
            let reason = "--output-domain is for images of light, and a JPEG is finished for viewing: leave it out, or write \
                          .exr";
            return Err(misuse("restore", reason));
        }
        if let Some(job) = jobs.iter().find(|job| self.true_highlights && !job.holds_bright_light()) {
            let reason = format!(
                "--true-highlights gives lamps light far above white, which {} does not hold: write .exr, .npy or .hdr",
                job.output.display()
            );
            return Err(misuse("restore", &reason));
        }
        let backend = self.device.find(session)?;
        let (restoration, notices) = self.config(is_guided, &jobs, backend).open()?;
        notices.iter().for_each(|notice| session.notice(notice));
        let run = Run::new(&self, restoration, jobs.len() > 1, session)?;
        if self.dry_run.dry_run {
            let estimate = run.estimate(jobs, self.shard)?;
            return self.dry_run.tell("restore", &estimate, session);
        }
        Ok(batch::run(&run, jobs, Selection { shard: self.shard, resume: self.resume }, session)?)
    }

    /// The domain that is written: the one that is asked for, or that of the capture.
    fn domain_of_output(&self, capture: &Capture) -> DomainTag {
        let usual = if self.true_highlights { DomainTag::Linear } else { capture.image.domain() };
        self.output_domain.unwrap_or(usual)
    }

    /// Whether a network for any panel restores.
    fn is_guided(&self) -> bool {
        !self.method.is_given() && self.model.as_deref().is_none_or(is_guided)
    }

    /// Refuses what belongs to the guided restoration where something else restores.
    fn check_guided(&self, is_guided: bool) -> Result<()> {
        if is_guided {
            let lost = self.true_highlights && self.output_domain == Some(DomainTag::ToneMapped);
            let kept = self.true_highlights && self.highlights != Highlights::Restored;
            let faults = [
                (
                    lost,
                    "--true-highlights is light above what saturates, which a tone-mapped image does not hold: leave out \
                     --output-domain",
                ),
                (
                    kept,
                    "--true-highlights gives lamps the light that their flare tells, and --highlights the capture's own: leave one \
                     of them out",
                ),
                (
                    self.kernel.has_bank_beside_psf(),
                    "--bank belongs to models that read kernel codes, and the guided restoration would ignore it beside --psf: leave \
                     one of them out",
                ),
            ];
            let fault = faults.into_iter().find(|(is_one, _)| *is_one);
            return fault.map_or(Ok(()), |(_, reason)| Err(misuse("restore", reason)));
        }
        if self.model.is_none() {
            return Ok(());
        }
        self.method.check_beside_model()?;
        let flag = [
            ("--refine", self.refine.is_some()),
            ("--true-highlights", self.true_highlights),
            ("--pose", self.pose.is_some()),
            ("--noise", self.noise.is_some()),
        ];
        match flag.into_iter().find(|(_, is_given)| *is_given) {
            Some((flag, _)) => {
                let reason = format!(
                    "{flag} belongs to the guided restoration, and --model would ignore it: leave it out"
                );
                Err(misuse("restore", &reason))
            }
            None => Ok(()),
        }
    }

    /// How captures are restored, as the flags say.
    fn config(&self, is_guided: bool, jobs: &[Job], backend: Backend) -> RestorationConfig {
        let pictures = jobs.iter().map(|job| job.inputs.len() as u64).max().unwrap_or(0);
        let queued_frames = if jobs.len() > 1 { QUEUED_FRAMES + pictures } else { 0 };
        let network = |model: &PathBuf| MethodConfig::Network {
            model: model.clone(),
            precision: self.precision,
            tile: self.tile,
        };
        let method = match (self.method.config(), &self.model) {
            (Some(config), _) => MethodConfig::Deconvolution(config.into()),
            (None, Some(model)) if !is_guided => network(model),
            (None, model) => MethodConfig::Guided {
                model: model.clone(),
                refine: self.refine.unwrap_or(1.0),
                true_highlights: self.true_highlights,
                pose: self.pose.clone().unwrap_or_default(),
                border: self.method.border(),
                precision: self.precision,
                tile: self.tile,
            },
        };
        RestorationConfig {
            method,
            kernel: self.kernel.files(self.psf_file.options()),
            alpha: self.alpha,
            x_max: self.x_max,
            highlights: self.highlights,
            noise: self.noise.clone(),
            memory: MemoryBudget { limit_bytes: self.max_memory, queued_frames, ..MemoryBudget::default() },
            backend,
        }
    }
}

#[expect(clippy::unnecessary_wraps, reason = "parsers of flags may fail")]
fn parse_pose(text: &str) -> Result<PoseSource, String> {
    Ok(if text == "psf" { PoseSource::Psf } else { PoseSource::File(text.into()) })
}

/// Frames of 32-bit RGB that the queue holds beside the image in work and the pictures that are read: the file of one of
/// these, and an image that is written, with its file.
const QUEUED_FRAMES: u64 = 3;

/// The keys of a description under which the paths of a model and of a PSF stand.
const MODEL: &str = "model";
const PSF: &str = "psf";

/// An image that is ready.
enum Ready {
    /// Light, and the domain that it is written in.
    Light(Box<Restored>, DomainTag),
    /// A picture for viewing.
    Photograph(Box<Photograph>),
}

/// A run over several captures.
struct Run<'a> {
    args: &'a RestoreArgs,
    /// What the flags say of the captures.
    told: Told,
    restoration: Restoration,
    session: &'a Session,
    /// Where a capture's own progress is shown.
    progress: Progress,
    /// What was said last of the memory that an image takes.
    said: Mutex<String>,
    /// Done when it was said what files cannot say of their tone mapping.
    lost: Once,
    /// SHA-256 of the dark frames, when they were first asked for.
    darks_sha256: OnceLock<Option<Vec<Option<String>>>>,
}

impl<'a> Run<'a> {
    fn new(
        args: &'a RestoreArgs,
        restoration: Restoration,
        several: bool,
        session: &'a Session,
    ) -> Result<Self> {
        let progress = if several { session.progress.without_bars() } else { session.progress.clone() };
        let tone = ToneFlags { alpha: args.alpha, x_max: args.x_max };
        let told = Told { tone, ..args.raw.told(args.domain)? };
        let (said, lost, darks_sha256) = (Mutex::default(), Once::new(), OnceLock::new());
        Ok(Self { args, told, restoration, session, progress, said, lost, darks_sha256 })
    }

    /// Restores one capture; says beforehand what memory that takes, unless the image before took the same.
    fn restore(&self, job: &Job, capture: Capture) -> error::Result<Restored> {
        let line = self.restoration.plan(capture.image.size())?.to_string();
        let mut said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        if *said != line {
            self.session.note(&line);
            *said = line;
        }
        found::tell_of_level(self.session, &job.name(), &capture, self.args.x_max);
        let restored = self.restoration.restore(capture, &self.progress)?;
        found::tell(self.session, &job.name(), &restored);
        if let Some(angle) = &restored.angle {
            self.session.tell(format_args!("{}: {angle}", job.name()));
            let warning = angle.warning().map(|warning| format!("{}: {warning}", job.name()));
            warning.into_iter().for_each(|warning| self.session.warn(warning));
        }
        Ok(restored)
    }

    fn darks_sha256(&self) -> error::Result<Option<&[Option<String>]>> {
        if self.darks_sha256.get().is_none() {
            // Set by whoever comes first: the reader, or the check of what is there.
            let _ = self.darks_sha256.set(self.told.darks_sha256()?);
        }
        Ok(self.darks_sha256.get().and_then(Option::as_deref))
    }

    /// The contents that an image is made of.
    fn contents(&self, job: &Job) -> error::Result<Map<String, Value>> {
        let mut contents = Map::new();
        contents.insert("inputs-sha256".to_owned(), json!(job.inputs_sha256()?));
        if let Some(darks) = self.darks_sha256()? {
            contents.insert("dark-sha256".to_owned(), json!(darks));
        }
        Ok(contents)
    }

    /// How a job's image was made, and where its files lay.
    fn provenance(&self, job: &Job) -> error::Result<Provenance> {
        let mut described = self.describe(job);
        // What is not compared: the memory, which changes roundings, and more only where it is too little for a whole capture; and what
        // computed.
        described["max-memory"] = json!(self.args.max_memory);
        described["instruction-set"] = json!(Isa::current().name());
        described["device"] = json!(self.restoration.backend().to_string());
        // Where files lay; what they are is told by their contents.
        let (key, path) = match &self.args.model {
            Some(model) if !self.args.is_guided() => (MODEL, Some(model.as_path())),
            _ => (PSF, self.args.kernel.psf()),
        };
        described["how"][key] = json!(path.map(text_of));
        described["inputs"] = job.inputs.iter().map(|input| text_of(input)).collect();
        if let Some(files) = self.args.raw.dark_files() {
            described["dark-files"] = json!(files);
        }
        for (name, contents) in self.contents(job)? {
            described[name] = contents;
        }
        Ok(Provenance::new("restore", &described))
    }

    fn options(&self) -> WriteOptions {
        WriteOptions { half: self.args.half, overwrite: self.session.overwrite, ..WriteOptions::default() }
    }

    fn write_light(&self, job: &Job, restored: Restored, domain: DomainTag) -> error::Result<()> {
        let mut provenance = self.provenance(job)?;
        if let Some(found) =
            found::lasting(&restored, self.restoration.curve(), domain == DomainTag::ToneMapped)
        {
            provenance = provenance.with_found(found);
        }
        let options = WriteOptions { provenance: Some(provenance), ..self.options() };
        let lost = restored.info.as_ref().and_then(|info| what_is_lost(&job.output, info));
        lost.iter().for_each(|lost| self.session.note(lost));
        if let Some(lost) = what_is_lost_of_mapping(&job.output, restored.curve)
            && domain == DomainTag::ToneMapped
        {
            self.lost.call_once(|| self.session.warn(lost));
        }
        found::tell_of_steps(self.session, &job.output, &restored, (domain, self.args.half));
        restored.write(&job.output, domain, &options)
    }
}

impl Stages for Run<'_> {
    type Job = Job;
    type Input = Capture;
    type Output = Ready;

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
            "tone": self.restoration.curve(), "how": self.restoration.describe(), "half": half,
            "domain": domain.map(DomainTag::name), "output-domain": output_domain.map(DomainTag::name),
        });
        if let Some(darks) = raw.describe_darks() {
            described["dark"] = darks;
        }
        described
    }

    fn forget_places(&self, made: &mut Value) {
        if let Some(how) = made.get_mut("how").and_then(Value::as_object_mut) {
            how.retain(|key, _| ![MODEL, PSF].contains(&key.as_str()));
        }
    }

    fn identify(&self, job: &Job) -> error::Result<Value> {
        self.contents(job).map(Value::Object)
    }

    fn prepare(&self) {
        self.restoration.prepare();
    }

    fn read(&self, job: &Job) -> error::Result<Capture> {
        // Before the pixels, so that they are not older than it.
        self.contents(job)?;
        let capture = self.args.read_capture(job, &self.told, self.session)?;
        if !job.is_photograph() {
            check_output_domain(&job.output, self.args.domain_of_output(&capture))?;
        }
        Ok(capture)
    }

    fn compute(&self, job: &Job, capture: Capture) -> error::Result<Ready> {
        self.session.progress.check()?;
        let domain = self.args.domain_of_output(&capture);
        let restored = self.session.timed(self.doing(job), || self.restore(job, capture))?;
        if !job.is_photograph() {
            return Ok(Ready::Light(Box::new(restored), domain));
        }
        let finishing = format!("finishing {}", job.name());
        let photograph = self.session.timed(finishing, || restored.into_photograph())?;
        Ok(Ready::Photograph(Box::new(photograph)))
    }

    fn write(&self, job: &Job, ready: Ready) -> error::Result<()> {
        let write = || match ready {
            Ready::Light(restored, domain) => self.write_light(job, *restored, domain),
            Ready::Photograph(photograph) => photograph.write(&job.output, &self.options()),
        };
        self.session.timed(format_args!("writing {}", job.output.display()), write)
    }
}
