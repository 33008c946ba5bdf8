//! Synthesises a dataset: every scene through every kernel, into a folder.

use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::core::error::{Error, Result};
use crate::core::field::PsfField;
use crate::core::image::{CHANNELS, Linear};
use crate::core::kernel_code::KernelBank;
use crate::core::progress::Progress;
use crate::dataset::{CONFIG_FILE, DatasetConfig};
use crate::io::{self, DomainTag};

use super::Formation;
use super::existing::Existing;
use super::folder::DatasetFolder;
use super::kernels::{KernelSet, MemoryPlan};
use super::scene_run::Run;
use super::scenes::{Scene, Shard};

/// The size that EXR and NumPy headers stay below.
const HEADER_BYTES: u64 = 1 << 14;

/// The bytes of a bank as the dataset will hold them; those of a file are not kept in memory.
pub enum BankFile {
    /// A file to copy.
    Stored(PathBuf),
    /// A bank that has no file yet.
    Encoded(Vec<u8>),
}

impl BankFile {
    /// The bytes.
    ///
    /// # Errors
    /// [`Error::Io`](crate::core::error::Error::Io) when the file cannot be read.
    pub fn read(&self) -> Result<Vec<u8>> {
        match self {
            Self::Stored(path) => io::read_bytes(path),
            Self::Encoded(bytes) => Ok(bytes.clone()),
        }
    }
}

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
    pub memory: MemoryPlan,
    /// Bytes on disk at most.
    pub disk_bytes: u64,
}

/// What happened to one scene.
#[derive(Clone, Debug)]
pub struct SceneReport {
    /// The scene.
    pub id: String,
    /// Its height and width.
    pub size: [usize; 2],
    /// Images that were made; the others were there.
    pub made: usize,
    /// What its file says of its colours against what the user says.
    pub contradiction: Option<String>,
    /// Time to read it and to write its ground truth.
    pub reading: Duration,
    /// Time for transforms, noise and clipping, on all threads together.
    pub computing: Duration,
    /// Time to encode and write the degraded images, on all threads together.
    pub writing: Duration,
}

impl Synthesis {
    /// Says what the synthesis will take, from the sizes that the scenes' files declare.
    ///
    /// # Errors
    /// [`Error::Config`] when the memory does not suffice for the largest scene; [`Error::Io`] or [`Error::Format`]
    /// when a scene cannot be read.
    pub fn needs(&self) -> Result<Needs> {
        let mut counts = BTreeMap::new();
        for scene in &self.scenes {
            *counts.entry(io::read_image_size::<Linear>(&scene.path, self.told)?).or_insert(0) += 1;
        }
        // The largest first: it is the one to be refused.
        let mut sizes: Vec<[usize; 2]> = counts.keys().copied().collect();
        sizes.sort_by_key(|[height, width]| Reverse(height * width));
        let plans: Vec<_> = sizes.iter().map(|&size| self.plan(size)).collect::<Result<_>>()?;
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

    /// Plans the work on scenes of one size.
    fn plan(&self, size: [usize; 2]) -> Result<MemoryPlan> {
        let psf = &self.bank.psfs[0];
        let convolver = self.formation()?.convolver(size, [psf.height(), psf.width()])?;
        MemoryPlan::new(&convolver, self.kernels(), rayon::current_num_threads(), self.max_bytes)
    }

    /// Makes the dataset in the folder `root`, telling `on_scene` of each scene as it is done.
    ///
    /// # Errors
    /// [`Error::Config`] when the folder must not be touched or memory does not suffice; [`Error::Interrupted`]
    /// after an interrupt, whatever is finished staying; else of reading or writing a file.
    pub fn run(
        &self,
        root: &Path,
        existing: Existing,
        progress: &Progress,
        mut on_scene: impl FnMut(&SceneReport),
    ) -> Result<()> {
        let names: Vec<_> = (0..self.bank.len()).map(|index| self.bank.kernel_name(index)).collect();
        let formation = self.formation()?;
        if let (Some(first), false) = (self.scenes.first(), root.join(CONFIG_FILE).is_file()) {
            // A header does not show all that is wrong; nothing is begun that cannot go on.
            io::read_image_told::<Linear>(&first.path, self.told)?;
        }
        let folder = DatasetFolder::prepare(root, self, existing)?;
        folder.create_image_folders(&names)?;
        let bar = progress.bar((self.scenes.len() * names.len()) as u64, "images");
        let mut run = Run { synthesis: self, formation, folder, names, kernels: None };
        for scene in &self.scenes {
            let todo = run.unfinished(scene);
            bar.inc((run.names.len() - todo.len()) as u64);
            if !todo.is_empty() {
                progress.check()?;
                let report = run.make(scene, &todo, |images| {
                    bar.inc(images as u64);
                    progress.check()
                })?;
                on_scene(&report);
            }
        }
        bar.finish_and_clear();
        Ok(())
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
