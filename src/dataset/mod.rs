//! Describes a dataset folder: what was made of which scene by which kernel.
//!
//! A dataset is a list of triplets (ground truth, degraded image, kernel). Our own folders say all of it in
//! `dataset.toml` and `triplets*.jsonl`; the published dataset is read in place from its folder names.

pub mod benchmark;
mod config;
mod folder;
mod kernels;
mod published;
mod sensor;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::core::error::{Error, Result};
use crate::core::image::LinearImage;
use crate::core::kernel_code::{KernelBank, KernelCode};
use crate::core::primaries::Primaries;
use crate::core::psf::hex;
use crate::io;

pub use config::{DatasetConfig, FORMAT, FormationConfig, NoiseConfig, VERSION};
pub use folder::{BANK_FILE, CONFIG_FILE, FIELD_FILE, TripletFiles};
pub use kernels::KernelChoice;
pub use sensor::SensorConfig;

/// The use that a triplet is reserved for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// To learn from.
    Train,
    /// To measure with, once.
    Test,
    /// To watch a training with.
    Val,
}

impl Split {
    /// The name in files and folders: `train`, `test`, `val`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Test => "test",
            Self::Val => "val",
        }
    }
}

/// One scene seen through one kernel.
///
/// One line of `triplets.jsonl`; paths are relative to the dataset's folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Triplet {
    /// The scene's name, unique among scenes; the scene appears once for each kernel.
    pub id: String,
    /// What the triplet is reserved for.
    pub split: Split,
    /// The clean image.
    pub gt: String,
    /// The image through the display.
    pub degraded: String,
    /// The kernel's name, `r-12` … `r+12`.
    pub kernel: String,
    /// The kernel's rotation; absent for a set that was not made by rotation.
    pub angle_deg: Option<f64>,
    /// What the scene was cut from: the panorama.
    pub source: String,
    /// SHA-256 of the degraded file; absent in datasets that do not record it.
    pub sha256: Option<String>,
    /// SHA-256 of the file of the whole scene, with its margin and unclipped; absent in lists of earlier versions and of other
    /// software.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene_sha256: Option<String>,
}

impl Triplet {
    /// Refuses paths that may lead out of the dataset's folder, on any system: a list that somebody else wrote must not
    /// name files of this computer. What a folder of the dataset links to is for its owner to say.
    ///
    /// # Errors
    /// What is wrong with which path.
    pub(crate) fn check_paths(&self) -> Result<(), String> {
        [("gt", &self.gt), ("degraded", &self.degraded)]
            .into_iter()
            .try_for_each(|(key, path)| check_path(key, path))
    }
}

/// Refuses a path that may lead out of the dataset's folder.
///
/// # Errors
/// What is wrong with it.
fn check_path(key: &str, path: &str) -> Result<(), String> {
    let fault = fault_of_path(path);
    fault.map_or(Ok(()), |fault| {
        Err(format!(
            "names the path `{path}` as {key}, which {fault}; paths are relative and stay in the dataset"
        ))
    })
}

/// Why a path may lead out of the folder that it is relative to.
fn fault_of_path(path: &str) -> Option<&'static str> {
    let mut letters = path.chars();
    let has_drive = letters.next().is_some_and(|c| c.is_ascii_alphabetic()) && letters.next() == Some(':');
    if path.is_empty() {
        Some("is empty")
    } else if path.starts_with(['/', '\\']) || has_drive {
        Some("is absolute")
    } else if path.split(['/', '\\']).any(|part| part == "..") {
        Some("leads out by `..`")
    } else {
        path.contains('\0').then_some("holds a zero byte")
    }
}

/// A dataset folder that has been opened: its description, not its images.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// The folder.
    pub root: PathBuf,
    /// How the degraded images were formed.
    pub formation: FormationConfig,
    /// All of `dataset.toml`; absent for the published dataset.
    pub config: Option<DatasetConfig>,
    /// The kernels with their PSFs; absent for the published dataset, which has codes only.
    pub bank: Option<KernelBank>,
    /// Every triplet, ordered by split, scene and kernel.
    pub triplets: Vec<Triplet>,
    /// Captures without ground truth, where the folder has them.
    pub real_captures: Vec<PathBuf>,
    kernels: Vec<String>,
    codes: Vec<KernelCode>,
}

impl Dataset {
    /// Opens a dataset folder: ours, or the published one as it is distributed.
    ///
    /// # Errors
    /// [`Error::Format`] saying what is missing: `dataset.toml` or `synthetic_data/`, triplets, files that
    /// triplets name, a bank of the recorded hash, a version that this program reads.
    pub fn open(root: &Path) -> Result<Self> {
        let dataset = Self::open_incomplete(root)?;
        dataset.check_files()?;
        Ok(dataset)
    }

    /// The red, green and blue of its scenes, where it says that these are others than those of sRGB.
    pub fn scene_primaries(&self) -> Option<Primaries> {
        self.config.as_ref()?.scene_primaries
    }

    /// Whether a folder is meant to be a dataset, ours or the published one.
    pub fn is_one(root: &Path) -> bool {
        root.join(CONFIG_FILE).is_file() || root.join(published::SYNTHETIC).is_dir()
    }

    /// Opens a dataset folder of which images may be missing.
    ///
    /// # Errors
    /// As [`open`](Self::open), but for the files that triplets name.
    pub fn open_incomplete(root: &Path) -> Result<Self> {
        if root.join(CONFIG_FILE).is_file() {
            folder::open(root)
        } else if root.join(published::SYNTHETIC).is_dir() {
            published::open(root)
        } else {
            Err(Error::format(root, not_a_dataset(root)))
        }
    }

    /// What is missing of the synthesis, in words for a warning; nothing of the published dataset.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder cannot be listed.
    pub fn unfinished(&self) -> Result<Option<String>> {
        if self.config.is_none() {
            return Ok(None);
        }
        let lacks = TripletFiles::find(&self.root)?.unfinished();
        let Some(first) = lacks.first() else { return Ok(None) };
        let more = if lacks.len() > 1 { format!(", and {} more", lacks.len() - 1) } else { String::new() };
        Ok(Some(format!("{} is not finished: {first}{more}", self.root.display())))
    }

    /// Which images lie in a folder of the published layout and are left out, for their kernels have no codes there, in words for a
    /// warning; nothing of other datasets.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder cannot be listed.
    pub fn left_out(&self) -> Result<Option<String>> {
        if self.config.is_some() {
            return Ok(None);
        }
        let left = published::other_inputs(&self.root, &self.kernels)?;
        let Some(first) = left.first() else { return Ok(None) };
        Ok(Some(format!(
            "{} holds images of other kernels than those whose codes it has, which are left out: {first}{}",
            self.root.display(),
            if left.len() > 1 { format!(", and {} more folders", left.len() - 1) } else { String::new() }
        )))
    }

    /// Refuses to form images anew where one PSF stands for a field of them.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a dataset whose PSF changes over the frame.
    pub fn check_one_psf(&self) -> Result<()> {
        match self.config.as_ref().and_then(|config| config.field_sha256.as_ref()) {
            None => Ok(()),
            Some(_) => Err(Error::Unsupported(format!(
                "the PSF of {} changes over the frame ({FIELD_FILE}): use its stored images, or synthesise with --bank",
                self.root.display()
            ))),
        }
    }

    /// The triplets reserved for `split`.
    ///
    /// # Errors
    /// [`Error::Format`] when there is none, naming the splits that there are.
    pub fn split(&self, split: Split) -> Result<Vec<&Triplet>> {
        let chosen: Vec<_> = self.triplets.iter().filter(|triplet| triplet.split == split).collect();
        if !chosen.is_empty() {
            return Ok(chosen);
        }
        let mut present: Vec<_> = self.triplets.iter().map(|triplet| triplet.split).collect();
        present.sort_unstable();
        present.dedup();
        let present: Vec<_> = present.into_iter().map(Split::name).collect();
        let reason = format!(
            "the dataset has no {name} split (only {}); make one with `udc synth SCENES --split {name}`",
            present.join(", "),
            name = split.name()
        );
        Err(Error::format(&self.root, reason))
    }

    /// The names of the kernels, in the order of the bank.
    pub fn kernel_names(&self) -> &[String] {
        &self.kernels
    }

    /// The kernels' codes, in the order of [`Self::kernel_names`].
    pub fn codes(&self) -> &[KernelCode] {
        &self.codes
    }

    /// SHA-256 of the list of triplets, which holds the hashes of their images.
    ///
    /// # Panics
    /// Never: triplets are plain data.
    pub fn triplets_sha256(&self) -> String {
        let mut hash = Sha256::new();
        for triplet in &self.triplets {
            hash.update(serde_json::to_vec(triplet).expect("triplets are plain data"));
        }
        hex(&hash.finalize())
    }

    /// SHA-256 of the kernel bank, where the dataset has one.
    pub fn bank_sha256(&self) -> Option<&str> {
        self.config.as_ref().map(|config| config.bank_sha256.as_str())
    }

    /// SHA-256 of the kernel codes.
    pub fn codes_sha256(&self) -> String {
        let mut hash = Sha256::new();
        for number in self.codes.iter().flatten() {
            hash.update(number.to_le_bytes());
        }
        hex(&hash.finalize())
    }

    /// Length of a kernel code, b; 0 when the kernels have none.
    pub fn code_dim(&self) -> usize {
        self.codes.first().map_or(0, KernelCode::len)
    }

    /// The index in the bank of the kernel of `triplet`.
    ///
    /// # Errors
    /// [`Error::Format`] when the bank has no kernel of that name.
    pub fn kernel_index(&self, triplet: &Triplet) -> Result<usize> {
        self.kernels.iter().position(|name| *name == triplet.kernel).ok_or_else(|| {
            let reason = format!(
                "triplet {} names kernel {}, and the bank has {}",
                triplet.id,
                triplet.kernel,
                self.kernels.join(", ")
            );
            Error::format(&self.root, reason)
        })
    }

    /// The code of the kernel of `triplet`, `[b]`.
    ///
    /// # Errors
    /// [`Error::Format`] when the kernel is unknown; [`Error::Unsupported`] when the bank has no codes.
    pub fn code(&self, triplet: &Triplet) -> Result<KernelCode> {
        self.code_of(self.kernel_index(triplet)?)
    }

    /// The code of a kernel by its index in the bank, `[b]`.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when the bank has no codes.
    ///
    /// # Panics
    /// When the bank has no kernel of this index.
    pub fn code_of(&self, kernel: usize) -> Result<KernelCode> {
        let code = self.codes[kernel].clone();
        if code.is_empty() {
            return Err(Error::Unsupported(format!(
                "the kernels of {} have no codes; use a network without PSF condition, or synthesise with a \
                 bank of `udc codes`",
                self.root.display()
            )));
        }
        Ok(code)
    }

    /// Reads the clean image of `triplet`.
    ///
    /// # Errors
    /// Those of [`io::read_image`].
    pub fn read_ground_truth(&self, triplet: &Triplet) -> Result<LinearImage> {
        io::read_image(&self.root.join(&triplet.gt))
    }

    /// Reads the degraded image of `triplet`, linear and clipped.
    ///
    /// # Errors
    /// Those of [`io::read_image`].
    pub fn read_degraded(&self, triplet: &Triplet) -> Result<LinearImage> {
        io::read_image(&self.root.join(&triplet.degraded))
    }

    fn check_files(&self) -> Result<()> {
        let named = self.triplets.iter().flat_map(|triplet| [&triplet.gt, &triplet.degraded]);
        let mut missing: Vec<_> = named.filter(|path| !io::is_file(&self.root.join(path))).collect();
        missing.sort_unstable();
        missing.dedup();
        match missing.first() {
            None => Ok(()),
            Some(first) => {
                let count = missing.len();
                let reason = format!(
                    "{count} of its images are missing, the first is {first}; put them there, or make a dataset \
                     of the clean images with `udc synth`"
                );
                Err(Error::format(&self.root, reason))
            }
        }
    }
}

fn not_a_dataset(root: &Path) -> String {
    if root.is_dir() {
        format!(
            "is no dataset: it has neither {CONFIG_FILE} (as `udc synth` writes it) nor {}/ (as the \
             published dataset has it)",
            published::SYNTHETIC
        )
    } else if root.exists() {
        "is a file; name the folder of a dataset".to_owned()
    } else {
        "no such dataset folder".to_owned()
    }
}

#[cfg(test)]
mod tests;
