//! A training as it is asked for: data, configuration, and what to begin with.

use std::path::{Path, PathBuf};

use super::config::TrainConfig;
use super::run::{Job, Outcome, Start};
use super::training_set::TrainingSet;
use crate::core::error::{Error, Result};
use crate::core::metrics::Measure;
use crate::core::progress::Progress;
use crate::network::weights::{self, Weights};
use crate::network::{Architecture, Backends, GUIDED, Parameters, guided_weights};

/// A training of data that were opened.
pub struct Training<'a> {
    /// How to train.
    pub config: &'a TrainConfig,
    /// What to learn from, opened with the same configuration, and to measure on.
    pub set: &'a TrainingSet,
    /// The configuration's `validation.metrics`, ready to measure.
    pub measures: &'a [Measure],
    /// Where to compute.
    pub backends: Backends,
    /// Where to report, and whom to ask whether to stop.
    pub progress: &'a Progress,
    /// Where warnings go.
    pub warn: &'a (dyn Fn(&str) + Sync),
}

impl Training<'_> {
    /// Trains in a folder until the configured number of iterations, or until the user asks to stop.
    ///
    /// # Errors
    /// [`Error::Config`] when the network needs codes of another length than the kernels have, for chosen kernels
    /// that there are not, and for images that are smaller than the crop; those of [`Job::run`] and of reading the data.
    pub fn run(&self, folder: &Path, start: Start) -> Result<Outcome> {
        let (config, set) = (self.config, self.set);
        set.warnings(config).iter().for_each(|warning| (self.warn)(warning));
        set.check_codes(config)?;
        let validation = set.validation(config)?;
        if validation.is_none() {
            (self.warn)("there is no val or test split; the training is not validated");
        }
        let samples = set.samples(config, self.warn)?;
        samples.check_size(config.data.crop)?;
        let identity = set.identity()?;
        let job = Job {
            config,
            data: &*samples,
            validation: validation.as_deref(),
            measures: self.measures,
            data_say_formation: set.says_formation(),
            identity,
            backends: self.backends.clone(),
            progress: self.progress,
            warn: self.warn,
        };
        job.run(folder, start)
    }
}

/// The weights of a model to begin a training with, and what the model says of them.
#[derive(Clone, Debug)]
pub struct Initial {
    path: PathBuf,
    weights: Weights,
}

impl Initial {
    /// Reads a model.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when the model is a network of another architecture than the configuration's; those of
    /// reading it.
    pub fn read(path: &Path, config: &TrainConfig) -> Result<Self> {
        let weights =
            weights::read(path).map_err(|error| error.while_doing("reading the initial weights"))?;
        Self::of(path, weights, config)
    }

    /// The network for any panel, which the program carries.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when the configuration is of another architecture.
    pub fn guided(config: &TrainConfig) -> Result<Self> {
        Self::of(Path::new(GUIDED), guided_weights()?, config)
    }

    fn of(path: &Path, weights: Weights, config: &TrainConfig) -> Result<Self> {
        if weights.architecture == config.architecture {
            return Ok(Self { path: path.to_owned(), weights });
        }
        let json = |architecture: &Architecture| architecture.to_json().to_string();
        Err(Error::Unsupported(format!(
            "{} is a network of another architecture than the configuration's; set [architecture] to its {}, found {}",
            path.display(),
            json(&weights.architecture),
            json(&config.architecture)
        )))
    }

    /// What is to be told where the model reads kernel codes and learned others than those of the data.
    pub fn doubt(&self, set: &TrainingSet) -> Option<String> {
        let Weights { architecture, origin, .. } = &self.weights;
        let learned = origin.kernel_bank_sha256.as_ref().filter(|_| architecture.reads_code())?;
        let own = set.bank_sha256()?;
        (learned != own).then(|| {
            let short = |sha256: &str| sha256.get(..12).unwrap_or(sha256).to_owned();
            format!(
                "{} was trained with another kernel bank (SHA-256 {}…) than that of the data ({}…): where their codes are not of \
                 one basis, it has to learn anew what they mean",
                self.path.display(),
                short(learned),
                short(own)
            )
        })
    }

    /// The weights.
    pub fn into_parameters(self) -> Parameters {
        self.weights.parameters
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::LinearImage;
    use crate::core::kernel_code::KernelBank;
    use crate::core::psf::Psf;
    use crate::io;
    use crate::network::{Condition, Initialisation, Origin};
    use crate::train::Degradation;
    use ndarray::Array3;

    #[test]
    fn weights_that_learned_other_codes_are_told_of_where_they_read_codes() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        io::create_folder(&at("views")).unwrap();
        let scene = LinearImage::from_planes(Array3::ones((3, 9, 8))).unwrap();
        io::write_image(&at("views/a.npy"), &scene, &io::WriteOptions::default()).unwrap();
        let psf = Psf::from_energy(Array3::ones((3, 3, 3))).unwrap();
        io::write_bank(&at("bank.safetensors"), &KernelBank::single(psf), false).unwrap();
        let mut config = TrainConfig::default();
        config.data.degradation = Degradation::OnTheFly;
        let set = TrainingSet::open(&at("views"), Some(&at("bank.safetensors")), &config).unwrap();
        let own = io::bank_sha256(&at("bank.safetensors")).unwrap();
        let doubt = |condition, bank: &str| {
            let architecture =
                Architecture { features: 2, filter_size: 3, condition, ..Architecture::default() };
            let parameters = Parameters::random(&architecture, Initialisation::Paper, 1);
            let origin = Origin { kernel_bank_sha256: Some(bank.to_owned()), ..Origin::default() };
            let weights = Weights { architecture, parameters, origin };
            Initial { path: "net.safetensors".into(), weights }.doubt(&set)
        };
        assert_eq!(doubt(Condition::ImagePsf, &own), None);
        assert_eq!(doubt(Condition::Image, "0123456789abcdef"), None);
        let said = doubt(Condition::ImagePsf, "0123456789abcdef").unwrap();
        assert!(
            said.contains("net.safetensors was trained with another kernel bank (SHA-256 0123456789ab…)"),
            "{said}"
        );
        assert!(said.contains(&own[..12]), "{said}");
    }
}
