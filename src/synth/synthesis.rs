//! Plans a dataset: what of, how, and what it will take.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::batch::{Estimate, HEADER_BYTES, PROCESS_BYTES, Sampler};
use crate::core::error::{Error, Result};
use crate::core::field::PsfField;
use crate::core::image::{CHANNELS, Linear};
use crate::core::kernel_code::KernelBank;
use crate::core::progress::Progress;
use crate::core::shard::Shard;
use crate::dataset::{BANK_FILE, DatasetConfig, FORMAT, FormationConfig, VERSION};
use crate::io::{self, DomainTag};

use super::Formation;
use super::degradations::{BankFile, Degradations};
use super::existing::Existing;
use super::kernels::{KernelSet, MemoryNeeds};
use super::list::file_of;
use super::scenes::{Division, Scene, common_margin, common_primaries, list_scenes};
use super::sources::check_sources;

/// A dataset that is to be made.
pub struct Synthesis {
    /// The resolved configuration, as `dataset.toml` will hold it.
    pub config: DatasetConfig,
    /// The kernels.
    pub bank: KernelBank,
    /// The bank's file.
    pub bank_file: BankFile,
    /// PSFs over the frame, to degrade scenes by instead; the bank's one kernel is the PSF in the middle.
    pub field: Option<PsfField>,
    /// The scenes of this run.
    pub scenes: Vec<Scene>,
    /// What the user says that the scenes' files hold.
    pub told: Option<DomainTag>,
    /// Which run of how many this is.
    pub shard: Shard,
    /// Memory that may be used.
    pub max_bytes: u64,
}

/// How a dataset is to be made, whatever of.
#[derive(Clone, Debug)]
pub struct SynthesisConfig {
    /// The image formation model; its margin is found by [`Synthesis::plan`].
    pub formation: FormationConfig,
    /// Pixels by which the scenes are larger than the frame on each side; none where their files are to say it.
    pub margin: Option<usize>,
    /// How the scenes' sources are divided.
    pub division: Division,
    /// Seed of the noise and of the division.
    pub seed: u64,
    /// Which run of how many this is.
    pub shard: Shard,
    /// What the user says that the scenes' files hold.
    pub told: Option<DomainTag>,
    /// Extension of the images' files: `exr` or `npy`.
    pub image_format: &'static str,
    /// Whether images are written as half floats.
    pub half: bool,
    /// Bytes of images from which on another tar archive is begun; none where each is a file of its own.
    pub archive_bytes: Option<u64>,
    /// Memory that may be used.
    pub max_bytes: u64,
}

/// What a synthesis will take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    /// Number of degraded images.
    pub images: usize,
    /// Height and width of the largest images.
    pub size: [usize; 2],
    /// Whether other scenes have other sizes.
    pub sizes_differ: bool,
    /// Memory and how it is used, for the scenes that take the most.
    pub memory: MemoryNeeds,
    /// Bytes on disk at most.
    pub disk_bytes: u64,
}

impl Synthesis {
    /// Plans a dataset of the scenes in `paths`.
    ///
    /// # Errors
    /// Those of [`list_scenes`], [`common_margin`] and [`common_primaries`]; [`Error::Io`] when the bank cannot be read.
    pub fn plan(paths: Vec<PathBuf>, by: Degradations, config: SynthesisConfig) -> Result<Self> {
        let Degradations { bank, bank_file, field } = by;
        let scenes = list_scenes(paths, config.division, config.seed)?;
        let declared: Vec<_> = scenes.iter().map(|scene| (scene.path.as_path(), scene.margin)).collect();
        let margin = common_margin(&declared, config.margin)?;
        let paths = scenes.iter().map(|scene| scene.path.as_path());
        let scene_primaries = common_primaries(paths, io::read_primaries)?;
        let SynthesisConfig { shard, told, max_bytes, .. } = config;
        let config = DatasetConfig {
            format: FORMAT.to_owned(),
            version: VERSION,
            program: concat!("udc ", env!("CARGO_PKG_VERSION")).to_owned(),
            bank: BANK_FILE.to_owned(),
            bank_sha256: io::bank_sha256_of(&bank_file.read()?),
            field_sha256: field.as_ref().map(PsfField::sha256),
            scene_domain: told.filter(|told| *told == DomainTag::Srgb).map(|told| told.name().to_owned()),
            scene_primaries,
            seed: config.seed,
            division: config.division.to_string(),
            image_format: config.image_format.to_owned(),
            half: config.half,
            archive_bytes: config.archive_bytes,
            formation: FormationConfig { margin, ..config.formation },
        };
        Ok(Self { config, bank, bank_file, field, scenes: shard.choose(scenes), told, shard, max_bytes })
    }

    /// Says what the synthesis will take, from the sizes that the scenes' files declare.
    ///
    /// # Errors
    /// [`Error::Config`] when the memory does not suffice for the largest scene; [`Error::Io`] or [`Error::Format`]
    /// when a scene cannot be read; [`Error::Interrupted`] after an interrupt.
    pub fn needs(&self, progress: &Progress) -> Result<Needs> {
        let mut counts = BTreeMap::new();
        for scene in &self.scenes {
            progress.check()?;
            *counts.entry(io::read_image_size::<Linear>(&scene.path, self.told)?).or_insert(0) += 1;
        }
        // The largest first: it is the one to be refused.
        let mut sizes: Vec<[usize; 2]> = counts.keys().copied().collect();
        sizes.sort_by_key(|[height, width]| Reverse(height * width));
        let plans: Vec<_> = sizes.iter().map(|&size| self.memory(size)).collect::<Result<_>>()?;
        let (Some(&size), Some(memory)) = (sizes.first(), plans.into_iter().max_by_key(|plan| plan.bytes))
        else {
            return Err(Error::config("scenes", "this shard has none; use fewer shards"));
        };
        let sample_bytes = if self.config.half { 2 } else { 4 };
        let mut truths = 0;
        for (&size, &scenes) in &counts {
            let [height, width] = self.config.formation.frame_size(size)?;
            truths += scenes * ((CHANNELS * height * width * sample_bytes) as u64 + HEADER_BYTES);
        }
        let size = self.config.formation.frame_size(size)?;
        let images = self.scenes.len() * self.bank.len();
        let disk_bytes = truths * (1 + self.bank.len() as u64) + self.bank_file.read()?.len() as u64;
        Ok(Needs { images, size, sizes_differ: sizes.len() > 1, memory, disk_bytes })
    }

    /// Says what the synthesis into `folder` takes, after making images for about `patience` by `sample`: a synthesis of
    /// few of the scenes.
    ///
    /// # Errors
    /// As [`Self::needs`] and [`Self::run`].
    pub fn estimate(
        &self,
        sample: &Self,
        folder: &Path,
        patience: Duration,
        progress: &Progress,
    ) -> Result<Estimate> {
        check_sources(folder, self)?;
        let needs = self.needs(progress)?;
        let sampler = Sampler::new(patience);
        let scratch = io::scratch_folder(folder)?;
        let sampled = sample.run(scratch.path(), Existing::Overwrite, &sampler.progress(progress), |_| {});
        sampler.end(sampled, progress)?;
        let pixels = |synthesis: &Self| -> Result<f64> {
            let sizes = synthesis.scenes.iter().map(|scene| {
                progress.check()?;
                io::read_image_size::<Linear>(&scene.path, self.told)
            });
            sizes.map(|size| size.map(|[height, width]| (height * width) as f64)).sum()
        };
        let cost = sampler.cost();
        // In images of the sampled scenes' size.
        let sampled = pixels(sample)? / sample.scenes.len() as f64;
        let images = self.bank.len() as f64 * pixels(self)? / sampled;
        // As it was read, and as it is stored.
        let bank_bytes = 2 * self.bank_file.read()?.len() as u64;
        Ok(Estimate {
            items: needs.images as u64,
            unit: "images",
            disk_bytes: needs.disk_bytes,
            memory_bytes: needs.memory.bytes + bank_bytes + PROCESS_BYTES,
            cost: cost.of(images),
            fixed: cost.fixed,
            threads: rayon::current_num_threads(),
            measured: format!("{} images", sampler.steps()),
        })
    }

    /// The files of all images of this run, relative to its folder; none where archives keep them.
    pub(super) fn image_files(&self) -> impl Iterator<Item = String> + '_ {
        let DatasetConfig { image_format, archive_bytes, .. } = &self.config;
        let names = (0..self.bank.len()).map(|index| Some(self.bank.kernel_name(index)));
        let kernels: Vec<Option<String>> = names.chain([None]).collect();
        let files = move |scene: &Scene| {
            let file = |kernel: &Option<String>| file_of(&scene.id, kernel.as_deref(), image_format);
            kernels.iter().map(file).collect::<Vec<_>>()
        };
        self.scenes.iter().filter(|_| archive_bytes.is_none()).flat_map(files)
    }

    /// Plans the work on scenes of one size.
    fn memory(&self, size: [usize; 2]) -> Result<MemoryNeeds> {
        let psf = &self.bank.psfs[0];
        let convolver = self.formation()?.convolver(size, [psf.height(), psf.width()])?;
        MemoryNeeds::new(&convolver, self.kernels(), rayon::current_num_threads(), self.max_bytes)
    }

    /// What scenes are convolved with.
    pub(super) fn kernels(&self) -> KernelSet<'_> {
        let set = match &self.field {
            Some(field) => KernelSet::of_field(field, &self.bank),
            None => KernelSet::of_bank(&self.bank),
        };
        set.with_margin(self.config.formation.margin)
    }

    pub(super) fn formation(&self) -> Result<Formation> {
        Formation::new(self.config.formation.clone(), self.config.seed)
    }
}
