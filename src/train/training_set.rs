//! Opens what a training learns from: a dataset's files, clean images degraded as they are drawn, or examples.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use sha2::{Digest, Sha256};

use super::clean::CleanImages;
use super::config::{DataConfig, Degradation, TrainConfig};
use super::data::{ExampleData, StoredData, TrainingData};
use super::identity::DataIdentity;
use crate::core::error::{Error, Result};
use crate::core::psf::hex;
use crate::core::tone::ToneCurve;
use crate::dataset::{CONFIG_FILE, Dataset, FormationConfig, KernelChoice, Split};
use crate::examples::ExamplesFolder;
use crate::io;
use crate::network::{Architecture, Condition};

/// Everything that samples are made of, opened once.
pub enum TrainingSet {
    /// A dataset whose degraded images are read.
    Stored(Dataset),
    /// Clean images that are degraded as they are drawn, with the dataset that they are of, if any.
    OnTheFly(Box<CleanImages>, Option<Dataset>),
    /// Examples whose planes were made before.
    Examples(ExamplesFolder),
}

impl TrainingSet {
    /// Opens `data` as the configuration asks; `bank` degrades a folder of clean images.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when configuration, data and bank do not go together; [`Error::Config`] when clean images
    /// were cut with another margin than the configuration says; those of reading the files.
    pub fn open(data: &Path, bank: Option<&Path>, config: &TrainConfig) -> Result<Self> {
        let refuse = |reason: &str| Err(Error::Unsupported(reason.to_owned()));
        if ExamplesFolder::is_one(data) {
            return Self::open_examples(data, bank, &config.data);
        }
        let on_the_fly = config.data.degradation == Degradation::OnTheFly;
        match bank {
            Some(_) if !on_the_fly || data.join(CONFIG_FILE).is_file() => refuse(
                "--bank goes with a folder of clean images and data.degradation = \"on-the-fly\"; a dataset has a \
                 bank of its own",
            ),
            Some(bank) => Ok(Self::OnTheFly(CleanImages::of_folder(data, bank, config)?.into(), None)),
            None if config.data.formation != FormationConfig::default() => refuse(
                "data.formation goes with a folder of clean images and --bank; a dataset says itself how its \
                 images were formed",
            ),
            None if on_the_fly && data.is_dir() && !Dataset::is_one(data) => Err(Error::format(
                data,
                "is no dataset, which has a kernel bank of its own: add --bank with the kernels that clean images are to be \
                 degraded by",
            )),
            None => {
                let dataset =
                    Dataset::open(data).map_err(|error| error.while_doing("opening the dataset"))?;
                Ok(if on_the_fly {
                    Self::OnTheFly(CleanImages::of_dataset(&dataset, config)?.into(), Some(dataset))
                } else {
                    Self::Stored(dataset)
                })
            }
        }
    }

    /// Opens a folder of examples, which have their kernels and their formation behind them.
    fn open_examples(data: &Path, bank: Option<&Path>, config: &DataConfig) -> Result<Self> {
        let is_plain = config.degradation == Degradation::Stored
            && config.kernels == KernelChoice::All
            && config.formation == FormationConfig::default();
        if bank.is_some() || !is_plain {
            return Err(Error::Unsupported(format!(
                "{} holds examples, which were degraded when they were made; leave out --bank, data.degradation, data.kernels \
                 and data.formation",
                data.display()
            )));
        }
        let folder = ExamplesFolder::open(data).map_err(|error| error.while_doing("opening the examples"))?;
        Ok(Self::Examples(folder))
    }

    /// Refuses kernel codes of another length than the network reads.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key to change.
    pub fn check_codes(&self, config: &TrainConfig) -> Result<()> {
        let found = match self {
            Self::Stored(dataset) => dataset.code_dim(),
            Self::OnTheFly(clean, _) => clean.bank.code_dim(),
            Self::Examples(_) => 0,
        };
        let needed = config.architecture.code_len().unwrap_or(found);
        if needed == found {
            return Ok(());
        }
        let blind = Architecture { condition: Condition::Image, ..config.architecture.clone() };
        let reason = match (found, blind.validate().is_ok()) {
            (0, true) => format!(
                "is {needed}, and the kernels have no codes; --set architecture.condition=image trains a network that needs none"
            ),
            (0, false) => format!(
                "is {needed}, and the kernels have no codes, which this kind of network needs; make the data with a bank of `udc \
                 codes`"
            ),
            (_, true) => format!(
                "is {needed}, and the kernels have codes of {found} numbers; set it to {found}, or architecture.condition to \
                 image"
            ),
            (_, false) => {
                format!("is {needed}, and the kernels have codes of {found} numbers; set it to {found}")
            }
        };
        Err(Error::config("architecture.code-dim", reason))
    }

    /// What is wrong between the data and how they are degraded, and need not be.
    pub fn warnings(&self, config: &TrainConfig) -> Vec<String> {
        let formation = self.dataset().map_or(&config.data.formation, |dataset| &dataset.formation);
        let x_max = self.dataset().is_none().then_some("data.formation.x-max");
        let lost_margin = match self {
            Self::OnTheFly(_, Some(_)) if formation.margin > 0 => Some(
                "stored ground truths lack the margin that the dataset's scenes had: what is degraded on the fly lacks the \
                 flare of lamps outside of the frame; to keep it, name the folder of scenes as --data, the kernels with \
                 --bank, and the margin with --set data.formation.margin=PX"
                    .to_owned(),
            ),
            _ => None,
        };
        let unfinished = match self {
            Self::Examples(folder) => folder.unfinished(),
            Self::Stored(_) | Self::OnTheFly(..) => None,
        };
        formation.scale_warning(x_max).into_iter().chain(lost_margin).chain(unfinished).collect()
    }

    /// The dataset, unless a folder of clean images was named.
    pub fn dataset(&self) -> Option<&Dataset> {
        match self {
            Self::Stored(dataset) => Some(dataset),
            Self::OnTheFly(_, dataset) => dataset.as_ref(),
            Self::Examples(_) => None,
        }
    }

    /// Whether the data say themselves how images were formed, and not the configuration.
    pub(super) fn says_formation(&self) -> bool {
        self.dataset().is_some() || matches!(self, Self::Examples(_))
    }

    /// The samples to learn from; `warn` hears of what is found wrong with images as they are drawn.
    ///
    /// # Errors
    /// [`Error::Config`] for chosen kernels that there are not; [`Error::Format`] when no image is left to learn from.
    pub fn samples<'a>(
        &'a self,
        config: &TrainConfig,
        warn: &'a (dyn Fn(&str) + Sync),
    ) -> Result<Box<dyn TrainingData + 'a>> {
        let (DataConfig { kernels, cache_mib, .. }, planes) = (&config.data, config.architecture.planes());
        Ok(match self {
            Self::Stored(dataset) => Box::new(
                StoredData::new(dataset, Split::Train, *cache_mib)?.only(kernels)?.with_planes(planes)?,
            ),
            Self::OnTheFly(clean, _) => Box::new(clean.samples(config, warn)?),
            Self::Examples(folder) => Box::new(ExampleData::new(folder, Split::Train, planes, *cache_mib)?),
        })
    }

    /// The samples to measure on: those of the first split there is that training does not learn from.
    ///
    /// # Errors
    /// As [`Self::samples`].
    pub fn validation(&self, config: &TrainConfig) -> Result<Option<Box<dyn TrainingData + '_>>> {
        let planes = config.architecture.planes();
        if let Self::Examples(folder) = self {
            let is_there = folder.records.iter().any(|record| record.split == Split::Val);
            let data = || Ok(Box::new(ExampleData::new(folder, Split::Val, planes, 0)?) as _);
            return is_there.then(data).transpose();
        }
        let Some(dataset) = self.dataset() else { return Ok(None) };
        let is_there = |split: &Split| dataset.triplets.iter().any(|triplet| triplet.split == *split);
        let split = [Split::Val, Split::Test].into_iter().find(is_there);
        let data = |split| {
            let data = StoredData::new(dataset, split, 0)?.only(&config.data.kernels)?;
            Ok(Box::new(data.with_planes(planes)?) as _)
        };
        split.map(data).transpose()
    }

    /// SHA-256 of the kernel bank behind the codes, where there is one.
    pub(super) fn bank_sha256(&self) -> Option<&str> {
        match self {
            Self::Stored(dataset) => dataset.bank_sha256(),
            Self::OnTheFly(clean, _) => Some(&clean.bank_sha256),
            Self::Examples(_) => None,
        }
    }

    /// What tells the data from others.
    ///
    /// # Errors
    /// [`Error::Io`] when a clean image cannot be read; [`Error::Config`] for a tone curve that is none.
    pub fn identity(&self) -> Result<DataIdentity> {
        Ok(match self {
            Self::Stored(dataset) => DataIdentity {
                images_sha256: Some(dataset.triplets_sha256()),
                kernel_bank_sha256: self.bank_sha256().map(str::to_owned),
                codes_sha256: dataset.config.is_none().then(|| dataset.codes_sha256()),
                scenes_sha256: None,
                tone_curve: dataset.formation.curve()?,
            },
            Self::OnTheFly(clean, dataset) => DataIdentity {
                images_sha256: dataset.as_ref().map(Dataset::triplets_sha256),
                kernel_bank_sha256: self.bank_sha256().map(str::to_owned),
                codes_sha256: None,
                scenes_sha256: Some(contents_sha256(&clean.scenes)?),
                tone_curve: clean.curve,
            },
            Self::Examples(folder) => {
                let config = &folder.file.examples;
                #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
                let x_max = config.sensor.x_max[1] as f32;
                DataIdentity {
                    images_sha256: Some(folder.sha256()),
                    // Each example has an x_max of its own; this is the largest.
                    tone_curve: ToneCurve::new(config.alpha, x_max)?,
                    ..DataIdentity::default()
                }
            }
        })
    }
}

/// SHA-256 of the hashes of files in their order: they may move, and keep what they hold.
fn contents_sha256(files: &[PathBuf]) -> Result<String> {
    let hashes: Vec<String> = files.par_iter().map(|path| io::sha256_of_file(path)).collect::<Result<_>>()?;
    Ok(hex(&Sha256::digest(hashes.concat())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::LinearImage;
    use crate::core::kernel_code::KernelBank;
    use crate::core::psf::Psf;
    use crate::network::Kind;
    use ndarray::Array3;

    /// A folder of two clean images, and a bank of one kernel.
    fn clean_images(root: &Path) -> (PathBuf, PathBuf) {
        let (folder, bank) = (root.join("views"), root.join("bank.safetensors"));
        io::create_folder(&folder).unwrap();
        write_scene(&folder.join("a.npy"), 0.25);
        write_scene(&folder.join("b.npy"), 0.5);
        let psf = Psf::from_energy(Array3::ones((3, 3, 3))).unwrap();
        io::write_bank(&bank, &KernelBank::single(psf), false).unwrap();
        (folder, bank)
    }

    fn write_scene(path: &Path, value: f32) {
        let scene = LinearImage::from_planes(Array3::from_elem((3, 9, 8), value)).unwrap();
        io::write_image(path, &scene, &io::WriteOptions { overwrite: true, ..Default::default() }).unwrap();
    }

    fn on_the_fly() -> TrainConfig {
        let mut config = TrainConfig::default();
        config.data.degradation = Degradation::OnTheFly;
        config
    }

    fn refusal(folder: &Path, bank: Option<&Path>, config: &TrainConfig) -> String {
        TrainingSet::open(folder, bank, config).err().expect("it is refused").to_string()
    }

    #[test]
    fn data_bank_and_configuration_must_go_together() {
        let root = tempfile::tempdir().unwrap();
        let (folder, bank) = clean_images(root.path());
        let stored = TrainConfig::default();
        assert!(refusal(&folder, Some(&bank), &stored).contains("--bank goes with a folder of clean images"));
        assert!(refusal(&folder, None, &on_the_fly()).contains("views: is no dataset"));
        assert!(refusal(&folder, None, &on_the_fly()).contains("add --bank"));
        assert_eq!(refusal(&folder.join("absent"), None, &on_the_fly()), "opening the dataset");
        let mut config = on_the_fly();
        config.data.formation.x_max = 16.0;
        assert!(refusal(&folder, None, &config).contains("data.formation goes with a folder"));
        let set = TrainingSet::open(&folder, Some(&bank), &config).unwrap();
        assert!(set.dataset().is_none() && set.validation(&config).unwrap().is_none());
        assert_eq!(set.samples(&config, &|_| {}).unwrap().len(), 2);
        let message = set.check_codes(&config).unwrap_err().to_string();
        assert!(message.contains("no codes; --set architecture.condition=image"), "{message}");
        assert!(!message.contains("set it to"), "{message}");
        config.architecture = Architecture { kind: Kind::Sftmd, features: 8, ..Architecture::default() };
        let message = set.check_codes(&config).unwrap_err().to_string();
        assert!(message.contains("make the data with a bank") && !message.contains("condition"), "{message}");
        config.data.formation.margin = 4;
        assert!(refusal(&folder, Some(&bank), &config).contains("data.formation.margin with"));
    }

    #[test]
    fn clean_images_are_known_by_what_they_hold() {
        let root = tempfile::tempdir().unwrap();
        let (folder, bank) = clean_images(root.path());
        let identity = |folder: &Path| {
            TrainingSet::open(folder, Some(&bank), &on_the_fly()).unwrap().identity().unwrap()
        };
        let first = identity(&folder);
        assert!(first.scenes_sha256.is_some() && first.images_sha256.is_none());
        let moved = root.path().join("moved");
        std::fs::rename(&folder, &moved).unwrap();
        assert_eq!(identity(&moved), first);
        write_scene(&moved.join("b.npy"), 0.75);
        assert_ne!(identity(&moved).scenes_sha256, first.scenes_sha256);
    }
}
