//! `udc train`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::Args;
use clap::error::ErrorKind;
use serde_json::json;

use udc::core::shard::Shard;
use udc::examples::{EXAMPLES_FILE, ExampleSet, ExamplesConfig, ExamplesFile};
use udc::experiment::validation_measures;
use udc::io;
use udc::kernels::keep_freed_memory;
use udc::network::{Backend, Backends, Precision};
use udc::synth::Existing;
use udc::train::{self, Initial, Outcome, Start, TrainConfig, Training, TrainingSet, ValidationScore};

use super::choices::TRAINING_PRECISIONS;
use super::device::{self, DeviceArgs};
use super::dry_run::{DryRunArgs, PATIENCE};
use super::events::Stopped;
use super::{Session, psf_file, text_of};

/// Train a restoration network
///
/// The run's folder gets config.toml (with every default), metrics.jsonl and TensorBoard event files, checkpoints,
/// model.safetensors (the latest), best.safetensors (the best by validation.best) and previews of the validation
/// images (degraded, restored, clean).
#[derive(Args, Debug)]
#[command(after_help = "Examples:
  udc train configs/discnet.toml --data dataset -o run
  udc train configs/discnet.toml --data dataset -o small --set architecture.features=8 --set data.crop=64
  udc train configs/sftmd.toml --data dataset -o sftmd
  udc train configs/paper.toml --data dataset -o paper --set loss.perceptual.file=vgg19-dcbb9e9d.pth
  udc train --data dataset -o run --resume
  udc train configs/discnet.toml --data views --bank bank.safetensors --set data.degradation=on-the-fly -o run
  udc train configs/guided.toml --data examples -o guided
  udc train --psf psf.exr -o adapted && udc restore capture.exr --psf psf.exr --model adapted/best.safetensors -o photo.jpg")]
pub(crate) struct TrainArgs {
    /// Configuration (with --resume: the run's own if left out; with --psf: one of some minutes)
    #[arg(required_unless_present_any = ["resume", "psf"])]
    pub(super) config: Option<PathBuf>,
    /// Dataset of `udc synth`, or the published one; or clean images, with --bank; or examples of `udc examples`
    #[arg(long, value_name = "DATASET", required_unless_present = "psf")]
    pub(super) data: Option<PathBuf>,
    /// Adapt a network that restores captures of any panel to the panel of this PSF: examples of it are made in
    /// RUN/examples first, and the training begins with --init, or with the network that comes with the program
    #[arg(long, value_name = "PSF", conflicts_with_all = ["data", "bank"])]
    psf: Option<PathBuf>,
    /// HDR panoramas to cut views for these examples out of; without, all scenes are painted
    #[arg(long, value_name = "PANORAMA", num_args = 1.., requires = "psf", conflicts_with_all = ["data", "bank"])]
    scenes: Vec<PathBuf>,
    /// Kernel bank that degrades a folder of clean images (with data.degradation = "on-the-fly")
    #[arg(long, value_name = "BANK")]
    pub(super) bank: Option<PathBuf>,
    /// Folder for log, checkpoints and model
    #[arg(short, long, value_name = "RUN")]
    pub(super) output: PathBuf,
    /// Change a key of the configuration; may be repeated
    #[arg(long, value_name = "KEY.PATH=VALUE")]
    pub(super) set: Vec<String>,
    /// Begin with the weights of a model (.safetensors or .pth)
    #[arg(long, value_name = "MODEL", conflicts_with = "resume")]
    pub(super) init: Option<PathBuf>,
    /// Go on from the run's latest checkpoint
    #[arg(long)]
    pub(super) resume: bool,
    #[command(flatten)]
    pub(super) device: DeviceArgs,
    /// GPUs to train one network on together, by their numbers (`udc info --devices` lists them): each takes an equal share of
    /// every batch. Several have to be NVIDIA's, and the program built for CUDA
    #[arg(long, value_name = "N,…", value_delimiter = ',', conflicts_with = "device")]
    pub(super) devices: Vec<usize>,
    /// Numbers to compute with, as --set precision=PRECISION [default: the configuration's]
    #[arg(long, value_name = "PRECISION", value_parser = TRAINING_PRECISIONS)]
    pub(super) precision: Option<Precision>,
    /// Burn backend to compute with on the CPU: flex or ndarray
    #[arg(long, default_value = "flex", value_name = "NAME")]
    pub(super) backend: Backend,
    #[command(flatten)]
    pub(super) dry_run: DryRunArgs,
}

impl TrainArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        if self.dry_run.dry_run {
            return self.estimate(session);
        }
        let outcome = self.train(session)?;
        report(&outcome, &self.output, session)
    }

    /// Trains as far as the configuration, or the user, wants.
    pub(super) fn train(&self, session: &Session) -> Result<Outcome> {
        session.check_resume(self.resume)?;
        let config = self.read_config()?;
        session.configured(&config);
        let initial = self.initial(&config)?;
        let made = self.psf.as_deref().map(|psf| self.make_examples(psf, session)).transpose()?;
        let data = made.as_deref().or(self.data.as_deref()).expect("one of --data and --psf is required");
        let set = TrainingSet::open(data, self.bank.as_deref(), &config)?;
        set.dataset().map_or(Ok(()), |dataset| session.warn_of_unfinished(dataset))?;
        initial.as_ref().and_then(|initial| initial.doubt(&set)).iter().for_each(|doubt| session.warn(doubt));
        let start = self.start(initial, session);
        session.detail(format!("{} parameters", config.architecture.parameters()));
        let backends = self.backends(session)?;
        let training = Training {
            config: &config,
            set: &set,
            measures: &validation_measures(&config.validation, backends.first())?,
            backends,
            progress: &session.progress,
            warn: &|text| session.warn(text),
        };
        keep_freed_memory();
        Ok(training.run(&self.output, start)?)
    }

    /// Says what the training would take, all of its iterations counted.
    fn estimate(&self, session: &Session) -> Result<()> {
        let config = self.read_config()?;
        let Some(data) = self.data.as_deref() else {
            bail!(
                "--dry-run needs examples that are there: make them with `udc examples`, and name them with --data"
            );
        };
        let set = TrainingSet::open(data, self.bank.as_deref(), &config)?;
        let warn = |text: &str| session.warn(text);
        let samples = set.samples(&config, &warn)?;
        let estimate = train::estimate(&config, &*samples, self.backend, PATIENCE)?;
        self.dry_run.tell("train", &estimate, session)
    }

    /// What is computed on.
    fn backends(&self, session: &Session) -> Result<Backends> {
        if self.devices.is_empty() {
            return Ok(self.device.find_or(self.backend, session)?.into());
        }
        let backends = Backends::gpus(&self.devices)?;
        device::tell(session, &backends);
        Ok(backends)
    }

    fn read_config(&self) -> Result<TrainConfig> {
        let (text, path) = match &self.config {
            Some(path) => (io::read_configuration(path)?, path.clone()),
            None if self.resume => (train::read_config(&self.output)?, self.output.join("config.toml")),
            None => (ADAPTATION.to_owned(), PathBuf::from("configs/adapt.toml")),
        };
        let precision = self.precision.map(|precision| format!("precision={}", precision.name()));
        configure(&text, &path, &self.set.iter().cloned().chain(precision).collect::<Vec<_>>())
    }

    /// Makes examples of one panel in the run's folder, or those that are missing; returns their folder.
    fn make_examples(&self, psf: &Path, session: &Session) -> Result<PathBuf> {
        let folder = self.output.join(EXAMPLES);
        let mut config = match &self.config {
            Some(path) => ExamplesConfig::from_toml(&io::read_configuration(path)?)?,
            None if self.resume && folder.join(EXAMPLES_FILE).is_file() => {
                ExamplesFile::read(&folder)?.examples
            }
            None => ExamplesConfig::from_toml(ADAPTATION)?,
        };
        psf_file::look(psf, session)?;
        config.panels.psf = Some(psf.to_owned());
        if !self.scenes.is_empty() {
            config.scenes.panoramas = io::expand_inputs(&self.scenes)?;
        } else if config.scenes.panoramas.is_empty() {
            config.scenes.procedural_share = 1.0;
        }
        let existing = if session.overwrite { Existing::Overwrite } else { Existing::Resume };
        ExampleSet { config, shard: Shard::WHOLE }
            .make(&folder, existing, &session.progress, |warning| session.warn(warning))
            .with_context(|| format!("making examples in {}", folder.display()))?;
        Ok(folder)
    }

    /// The weights that the training begins with, where they are a model's.
    fn initial(&self, config: &TrainConfig) -> Result<Option<Initial>> {
        if self.resume {
            return Ok(None);
        }
        Ok(match &self.init {
            Some(path) => Some(Initial::read(path, config)?),
            None => self.psf.as_ref().map(|_| Initial::guided(config)).transpose()?,
        })
    }

    fn start(&self, initial: Option<Initial>, session: &Session) -> Start {
        let initial = initial.map(Initial::into_parameters);
        match (self.resume, session.overwrite) {
            (true, _) => Start::Resume,
            (false, true) => Start::Replace(initial),
            (false, false) => Start::New(initial),
        }
    }
}

/// The training that adapts a network to one panel.
const ADAPTATION: &str = include_str!("../../configs/adapt.toml");

/// The folder of a run that holds the examples which it made by itself.
const EXAMPLES: &str = "examples";

/// Reads the configuration of a file and puts settings over it; to blame these where the file is right is to blame the
/// command line.
pub(super) fn configure(text: &str, path: &Path, settings: &[String]) -> Result<TrainConfig> {
    match TrainConfig::from_toml(text, settings) {
        Err(error) if TrainConfig::from_toml(text, &[]).is_ok() => {
            Err(clap::Error::raw(ErrorKind::ValueValidation, error).into())
        }
        config => config.with_context(|| format!("reading {}", path.display())),
    }
}

fn report(outcome: &Outcome, folder: &Path, session: &Session) -> Result<()> {
    let model = folder.join("model.safetensors");
    if outcome.interrupted {
        let iteration = outcome.iteration;
        let how = format!(
            "interrupted after iteration {iteration}; a checkpoint was written, pass --resume to go on from it"
        );
        return Err(Stopped(how).into());
    }
    session.results_of(json!({
        "model": text_of(&model), "iteration": outcome.iteration, "last-step": outcome.last_step,
        "validation": outcome.last_validation,
    }));
    for ValidationScore { metric, restored, degraded, deconvolved } in outcome.validation_scores() {
        let (name, decimals) = (metric.heading(), metric.decimals());
        let told = |value: Option<f64>, what: &str| {
            value.map_or(String::new(), |value| format!(" {value:.decimals$} {what},"))
        };
        // Such a network's corrections are limited where captures are restored.
        let by = if deconvolved.is_some() { "by the network alone" } else { "restored" };
        let (deconvolved, initial) =
            (told(*deconvolved, "deconvolved"), told(outcome.initial(*metric), "before the training"));
        session.tell(format_args!(
            "validation {name}: {degraded:.decimals$} degraded,{deconvolved}{initial} {restored:.decimals$} {by}"
        ));
    }
    session.say(format!("{}: trained for {} iterations", model.display(), outcome.iteration))
}
