//! A training as it is asked for: data, configuration, and what to begin with.

use std::path::Path;

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
        let identity = set.identity()?;
        let samples = set.samples(config, self.warn)?;
        samples.check_size(config.data.crop)?;
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

/// Reads the weights of a model to begin a training with.
///
/// # Errors
/// [`Error::Unsupported`] when the model is a network of another architecture than the configuration's; those of
/// reading it.
pub fn read_initial(path: &Path, config: &TrainConfig) -> Result<Parameters> {
    let initial = weights::read(path).map_err(|error| error.while_doing("reading the initial weights"))?;
    parameters_for(config, path, initial)
}

/// The weights of the network for any panel, which the program carries, to begin a training with.
///
/// # Errors
/// [`Error::Unsupported`] when the configuration is of another architecture.
pub fn guided_initial(config: &TrainConfig) -> Result<Parameters> {
    parameters_for(config, Path::new(GUIDED), guided_weights()?)
}

/// The parameters of weights of a name, if they are of the configuration's architecture.
fn parameters_for(config: &TrainConfig, name: &Path, initial: Weights) -> Result<Parameters> {
    if initial.architecture != config.architecture {
        let json = |architecture: &Architecture| architecture.to_json().to_string();
        return Err(Error::Unsupported(format!(
            "{} is a network of another architecture than the configuration's; set [architecture] to its {}, found {}",
            name.display(),
            json(&initial.architecture),
            json(&config.architecture)
        )));
    }
    Ok(initial.parameters)
}
