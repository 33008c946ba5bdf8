//! `udc synth`.

mod options;

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::{ArgGroup, Args, value_parser};
use serde_json::json;

use udc::core::bytes::{format_bytes, parse_bytes};
use udc::core::capture::CaptureInfo;
use udc::core::shard::Shard;
use udc::dataset::Split;
use udc::io;
use udc::synth::{Division, Existing, SceneReport, Synthesis, SynthesisConfig, SynthesisReport};

use super::choices::SPLITS;
use super::domain::SceneDomainArgs;
use super::dry_run::{DryRunArgs, PATIENCE};
use super::psf_file::{PSF_FILES, PsfAmongImagesArgs};
use super::{Session, text_of};
use options::{FormationArgs, KernelArgs, StorageArgs};

/// The largest number that `dataset.toml` can hold.
pub(super) const MOST_SEED: u64 = i64::MAX.cast_unsigned();

/// Synthesise degraded images of clean scenes by the image formation model
///
/// Every scene is convolved with every kernel, noise is added, and the sum is clipped: C(x∗k + n) of the paper's
/// Eq. 1. Images are stored linear; training and evaluation apply the tone mapping. Scenes of one panorama
/// (named <panorama>_<nn>, as `udc crop` does) are never divided between training and testing. With --split, a dataset
/// that lacks this split gets it, if all other flags are as they were; --overwrite makes that split anew and leaves the
/// others.
///
/// A capture receives flare from lamps outside of its frame. Scenes with a margin (`udc crop --margin`) bring that light
/// along: all of the scene is convolved, and the ground truth and the degraded image are its middle.
///
/// With --field the PSF changes over the frame. The dataset keeps the field as field.toml, for `udc restore --field`;
/// training and evaluation take the PSF in the middle of the frame, and its code, for all of it.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new(PSF_FILES).args(["psf", "field"]).multiple(true))]
#[command(after_help = "Examples:\n  udc synth views/ --bank bank.safetensors -o dataset\n  \
    udc synth views/ --bank bank.safetensors --noise sensor:configs/sensor/phone-10bit.toml -o noisy\n  \
    udc synth views/ --psf psf.exr --split test -o one-kernel\n  \
    udc synth train_views/ --bank bank.safetensors --split train -o dataset\n  \
    udc synth test_views/ --bank bank.safetensors --split test -o dataset\n  \
    udc synth views/ --field field.toml --bank bank.safetensors -o varying\n  \
    udc synth scenes/*.npy --margin 400 --bank bank.safetensors -o flared\n  \
    udc synth views/ --bank bank.safetensors -o dataset --shard 2/8 --resume\n  \
    udc synth views/ --bank bank.safetensors --format npy --half --tar 1GiB -o packed")]
pub(crate) struct SynthArgs {
    /// Clean linear scenes: files, folders or patterns
    #[arg(required = true, value_name = "GT")]
    scenes: Vec<PathBuf>,
    #[command(flatten)]
    scene: SceneDomainArgs,
    #[command(flatten)]
    kernels: KernelArgs,
    #[command(flatten)]
    psf_file: PsfAmongImagesArgs,
    /// Folder for the dataset
    #[arg(short, long, value_name = "DATASET")]
    output: PathBuf,
    #[command(flatten)]
    formation: FormationArgs,
    #[command(flatten)]
    storage: StorageArgs,
    /// Seed of the noise and of the division into training and testing
    #[arg(long, value_name = "S", default_value_t = 0, value_parser = value_parser!(u64).range(..=MOST_SEED))]
    seed: u64,
    /// Share of the panoramas that is kept for testing
    #[arg(long, value_name = "SHARE", default_value_t = 0.15, conflicts_with = "split")]
    test_fraction: f64,
    /// Keep all scenes for one use; adds it to a dataset of the same flags that has none of it
    #[arg(long, value_name = "SPLIT", value_parser = SPLITS)]
    split: Option<Split>,
    /// Make only the I-th of N parts; all parts may be made at the same time
    #[arg(long, value_name = "I/N", default_value = "1/1")]
    shard: Shard,
    /// Go on with a dataset that was begun with the same flags; finished images are checked and kept, temporary files
    /// that killed runs left more than an hour ago are removed
    #[arg(long)]
    resume: bool,
    /// As --resume, even where another process holds the same part: one of a machine that is gone, whose locks a network file
    /// system has kept. If it still runs, it does no harm, and its work is done again
    #[arg(long)]
    take_over: bool,
    /// Memory that may be used
    #[arg(long, value_name = "SIZE", default_value = "2GiB", value_parser = parse_bytes)]
    max_memory: u64,
    #[command(flatten)]
    dry_run: DryRunArgs,
}

/// Scenes that a sample of the synthesis may come to.
const SAMPLED_SCENES: usize = 32;

impl SynthArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        session.check_resume(self.resume || self.take_over)?;
        let synthesis = self.plan(session)?;
        if self.dry_run.dry_run {
            return self.estimate(&synthesis, session);
        }
        let needs = synthesis.needs(&session.progress).context("planning the synthesis")?;
        let ([height, width], count) = (needs.size, synthesis.scenes.len());
        let formation = &synthesis.config.formation;
        let margin = match formation.margin {
            0 => String::new(),
            margin => format!(" with a margin of {margin}"),
        };
        session.configured(formation);
        session.tell(format_args!(
            "{count} scenes of {}{height} × {width}{margin} through {} kernels: {} images, at most {} on disk and {} of \
             memory",
            if needs.sizes_differ { "up to " } else { "" },
            synthesis.bank.len(),
            needs.images,
            format_bytes(needs.disk_bytes),
            format_bytes(needs.memory.bytes)
        ));
        if let Some(warning) = formation.scale_warning(Some("--x-max")) {
            session.warn(warning);
        }
        self.warn_of_one_source(session, &synthesis);
        if let Some(primaries) = synthesis.config.scene_primaries {
            let image = self.output.join(format!("gt/{}.{}", synthesis.scenes[0].id, self.storage.format));
            let lost = io::what_is_lost(&image, &CaptureInfo::of_primaries(primaries));
            lost.iter().for_each(|lost| session.warn(lost));
        }
        let existing = match (session.overwrite, self.resume, self.take_over) {
            (true, ..) => Existing::Overwrite,
            (false, _, true) => Existing::TakeOver,
            (false, true, false) => Existing::Resume,
            (false, false, false) => Existing::Refuse,
        };
        let mut made = 0;
        synthesis
            .run(&self.output, existing, &session.progress, |report| match report {
                SynthesisReport::Warning(warning) => session.warn(warning),
                SynthesisReport::Scene(scene) => {
                    made += scene.made;
                    scene.contradiction.iter().for_each(|contradiction| session.warn(contradiction));
                    session.detail(describe(scene));
                }
            })
            .with_context(|| format!("synthesising {}", self.output.display()))?;
        let kept = needs.images - made;
        session.results_of(json!({ "output": text_of(&self.output), "made": made, "kept": kept }));
        let kept = if kept == 0 { String::new() } else { format!(", {kept} were there") };
        session.say(format_args!("{}: {made} images made{kept}", self.output.display()))
    }

    /// Says what the synthesis would take.
    fn estimate(&self, synthesis: &Synthesis, session: &Session) -> Result<()> {
        // Before a scene is sampled: a shard may have none.
        synthesis.needs(&session.progress).context("planning the synthesis")?;
        // As many as can be worked on in the time of a sample.
        let sample: Vec<PathBuf> =
            synthesis.scenes.iter().take(SAMPLED_SCENES).map(|scene| scene.path.clone()).collect();
        let sample = self.plan_scenes(sample, Shard::WHOLE, session)?;
        let estimate = synthesis.estimate(&sample, &self.output, PATIENCE, &session.progress)?;
        self.dry_run.tell("synth", &estimate, session)
    }

    fn plan(&self, session: &Session) -> Result<Synthesis> {
        self.plan_scenes(io::expand_inputs(&self.scenes)?, self.shard, session)
    }

    fn plan_scenes(&self, scenes: Vec<PathBuf>, shard: Shard, session: &Session) -> Result<Synthesis> {
        let degradations = self.kernels.read(&self.psf_file, session)?;
        let config = SynthesisConfig {
            formation: self.formation.resolve(),
            margin: self.formation.margin,
            division: match self.split {
                Some(split) => Division::All(split),
                None => Division::TestFraction(self.test_fraction),
            },
            seed: self.seed,
            shard,
            told: self.scene.domain,
            image_format: self.storage.format,
            half: self.storage.half,
            archive_bytes: self.storage.tar,
            max_bytes: self.max_memory,
        };
        Ok(Synthesis::plan(scenes, degradations, config)?)
    }

    fn warn_of_one_source(&self, session: &Session, synthesis: &Synthesis) {
        let untested = synthesis.scenes.iter().all(|scene| scene.split == Split::Train);
        if self.split.is_none() && self.test_fraction > 0.0 && self.shard.count == 1 && untested {
            session.warn(
                "all scenes are of one panorama, so there is no test split; add scenes of another one, or name \
                 files <panorama>_<nn>",
            );
        }
    }
}

fn describe(scene: &SceneReport) -> String {
    format!(
        "{}: {} images of {} × {}, read in {:.0?}, computed in {:.0?}, written in {:.0?} (sums over threads)",
        scene.id, scene.made, scene.size[0], scene.size[1], scene.reading, scene.computing, scene.writing
    )
}
