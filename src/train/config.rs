//! The configuration of a training: a TOML file, and settings that the command line puts over it.

mod settings;

use serde::{Deserialize, Serialize};

use self::settings::{in_plain_words, keys, put};
use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::core::metrics::{Metric, MetricDefinition};
use crate::dataset::{FormationConfig, KernelChoice, NoiseConfig};
use crate::examples::ExamplesConfig;
use crate::network::{Architecture, Initialisation, Precision};
use crate::perceptual::FeatureDistance;

/// Everything that decides what a training computes; the default is the paper's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct TrainConfig {
    /// Seed of the initial weights and of every draw of samples.
    pub seed: u64,
    /// Number of optimiser steps.
    pub iterations: u64,
    /// Iterations between two lines of the log.
    pub log_every: u64,
    /// How the initial weights are drawn.
    pub initialisation: Initialisation,
    /// The numbers that features and products are of; weights, gradients, what is remembered of them and the loss are of 32 bits.
    pub precision: Precision,
    /// The network.
    pub architecture: Architecture,
    /// What a step learns from.
    pub data: DataConfig,
    /// What a step minimises.
    pub loss: LossConfig,
    /// How a step changes the weights.
    pub optimizer: OptimizerConfig,
    /// How the learning rate falls.
    pub schedule: ScheduleConfig,
    /// How the training is watched.
    pub validation: ValidationConfig,
    /// What is kept to go on from.
    pub checkpoint: CheckpointConfig,
    /// How `udc examples` makes the examples that are learned from, so that one file says all; a training reads it in
    /// their folder, and records nothing of this.
    #[serde(skip_serializing)]
    pub examples: Option<ExamplesConfig>,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            iterations: 1_000_000,
            log_every: 10,
            initialisation: Initialisation::default(),
            precision: Precision::default(),
            architecture: Architecture::default(),
            data: DataConfig::default(),
            loss: LossConfig::default(),
            optimizer: OptimizerConfig::default(),
            schedule: ScheduleConfig::default(),
            validation: ValidationConfig::default(),
            checkpoint: CheckpointConfig::default(),
            examples: None,
        }
    }
}

/// Where degraded images come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Degradation {
    /// The dataset's files.
    #[default]
    Stored,
    /// Computed from the clean image and a kernel of the bank whenever a sample is drawn.
    OnTheFly,
}

/// What errors call [`DataConfig::kernels`].
pub const KERNELS_KEY: &str = "data.kernels";

/// What a step learns from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct DataConfig {
    /// Where degraded images come from.
    pub degradation: Degradation,
    /// The kernels whose images are learned from and validated with.
    pub kernels: KernelChoice,
    /// Side of the random crops in pixels.
    pub crop: usize,
    /// Crops that are computed at once.
    pub batch: usize,
    /// Batches whose gradients are averaged for one step.
    pub accumulate: usize,
    /// Whether every pass over the data has an order of its own.
    pub shuffle: bool,
    /// Memory for images that have been read, and as much again for the transforms of kernels that degrade on the fly.
    pub cache_mib: usize,
    /// How clean images that are no dataset's are degraded on the fly: saturation, noise, the margin around the frame. A
    /// dataset says it itself.
    pub formation: FormationConfig,
}

impl Default for DataConfig {
    /// 16 crops of 256 × 256 a step, one at a time because their memory adds up.
    fn default() -> Self {
        Self {
            degradation: Degradation::Stored,
            kernels: KernelChoice::All,
            crop: 256,
            batch: 1,
            accumulate: 16,
            shuffle: true,
            cache_mib: 2048,
            formation: FormationConfig::default(),
        }
    }
}

impl DataConfig {
    /// Checks that the images of a batch fit into memory, and that the samples of a step can be counted.
    fn check_size(&self) -> Result<()> {
        /// Degraded and clean crop of three channels.
        const PIXEL_BYTES: u128 = 2 * 3 * size_of::<f32>() as u128;
        /// What a network computes of a batch takes a hundred times its images and more: 16 crops of 800 × 800 make
        /// as many bytes, and the full network takes some 60 GiB for them.
        const BATCH_BYTES: u128 = 256 << 20;
        const STEP_SAMPLES: u128 = 1 << 24;
        let [crop, batch, accumulate] = [self.crop, self.batch, self.accumulate].map(|count| count as u128);
        let bytes = batch.saturating_mul(crop.saturating_mul(crop).saturating_mul(PIXEL_BYTES));
        if bytes > BATCH_BYTES {
            let reason = format!(
                "{batch} × {crop} × {crop} pixels take {} MiB before anything is computed of them, more than {}; make \
                 data.batch or data.crop smaller (data.accumulate adds up batches)",
                bytes >> 20,
                BATCH_BYTES >> 20
            );
            return Err(Error::config("data.batch", reason));
        }
        if batch * accumulate > STEP_SAMPLES {
            let reason =
                format!("times data.batch must be at most {STEP_SAMPLES}, found {}", batch * accumulate);
            return Err(Error::config("data.accumulate", reason));
        }
        Ok(())
    }
}

/// What a step minimises.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct LossConfig {
    /// Weight of the mean absolute difference between restored and clean crop, both tone-mapped.
    pub l1: f64,
    /// Weight of the mean squared difference: where a value is one of two, as of a saturated pixel that is a lamp or its glare, the
    /// absolute difference is least at one of them and the squared, which PSNR is made of, between them.
    pub l2: f64,
    /// Where above 0, these differences count relative to themselves, sample by sample, down to this: easy samples, whose errors are
    /// small, teach as much as hard ones.
    pub relative_floor: f64,
    /// The distance of VGG-19's features of the two.
    pub perceptual: PerceptualConfig,
}

impl Default for LossConfig {
    /// The first alone: the perceptual distance needs a file of weights.
    fn default() -> Self {
        Self { l1: 1.0, l2: 0.0, relative_floor: 0.0, perceptual: PerceptualConfig::default() }
    }
}

impl LossConfig {
    /// Each number with its key, whether it is right, and what it may be.
    fn ranges(&self) -> [(&'static str, f64, bool, &'static str); 4] {
        let Self { l1, l2, relative_floor: floor, perceptual: PerceptualConfig { weight, .. } } = *self;
        let is_right = |weight: f64| weight == 0.0 || is_positive(weight);
        // One of the two has to pull towards the clean image.
        let pulls = is_positive(l1) || (l1 == 0.0 && l2 > 0.0);
        [
            ("loss.l2", l2, is_right(l2), "0 (off) or positive"),
            ("loss.l1", l1, pulls, "positive, or 0 where loss.l2 is positive"),
            ("loss.relative-floor", floor, (0.0..=1.0).contains(&floor), "between 0 (off) and 1"),
            ("loss.perceptual.weight", weight, is_right(weight), "0 (off) or positive"),
        ]
    }
}

fn is_positive(value: f64) -> bool {
    value > 0.0 && value.is_finite()
}

/// The part of the loss that compares features of VGG-19, conv5_4.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct PerceptualConfig {
    /// Weight of the distance, 0.01 in the paper and its code; 0 leaves it out.
    pub weight: f64,
    /// How features are compared.
    pub distance: FeatureDistance,
    /// VGG-19's weights, `.pth` or `.safetensors`.
    pub file: String,
}

/// How a step changes the weights: Adam.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct OptimizerConfig {
    /// Learning rate at the start of every period.
    pub learning_rate: f64,
    /// Decay of the mean gradient.
    pub beta1: f64,
    /// Decay of the mean squared gradient.
    pub beta2: f64,
    /// What keeps the division by the latter's root finite.
    pub epsilon: f64,
    /// Largest Euclidean norm of all gradients together; 0 leaves them as they are.
    pub clip_norm: f64,
    /// Decay of the running mean of the weights that is saved in their place; 0 saves the weights.
    pub ema_decay: f64,
}

impl Default for OptimizerConfig {
    fn default() -> Self {
        Self { learning_rate: 2e-4, beta1: 0.9, beta2: 0.999, epsilon: 1e-8, clip_norm: 0.0, ema_decay: 0.0 }
    }
}

/// How the learning rate falls: along half a cosine, again and again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ScheduleConfig {
    /// Learning rate that a period ends with.
    pub minimum: f64,
    /// Iterations from one start to the next.
    pub period: u64,
}

impl Default for ScheduleConfig {
    fn default() -> Self {
        Self { minimum: 1e-7, period: 200_000 }
    }
}

/// How the training is watched.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct ValidationConfig {
    /// Iterations between two validations; 0 for none.
    pub every: u64,
    /// Number of images, spread evenly over the split.
    pub images: usize,
    /// Side of the crop of each image.
    pub crop: usize,
    /// What is measured.
    pub metrics: Vec<Metric>,
    /// Which of these metrics decides what `best.safetensors` holds.
    pub best: Metric,
    /// AlexNet's weights, for `lpips`.
    pub lpips_alexnet: String,
    /// The weights of LPIPS' linear layers.
    pub lpips_linear: String,
}

impl Default for ValidationConfig {
    fn default() -> Self {
        let metrics = vec![Metric::Psnr, Metric::Ssim];
        let (lpips_alexnet, lpips_linear) = (String::new(), String::new());
        Self { every: 5000, images: 8, crop: 256, metrics, best: Metric::Psnr, lpips_alexnet, lpips_linear }
    }
}

impl ValidationConfig {
    /// Checks that the metrics can be computed, and that the best can be told.
    fn validate(&self) -> Result<()> {
        let window = MetricDefinition::float().ssim_window;
        if self.metrics.contains(&Metric::Ssim) && self.crop < window {
            let reason = format!(
                "must be at least {window} for ssim, found {}; or take ssim off validation.metrics",
                self.crop
            );
            return Err(Error::config("validation.crop", reason));
        }
        if !self.metrics.contains(&self.best) {
            let names: Vec<&str> = self.metrics.iter().map(|metric| metric.name()).collect();
            let reason = format!(
                "must be one of validation.metrics ({}), found {}",
                names.join(", "),
                self.best.name()
            );
            return Err(Error::config("validation.best", reason));
        }
        Ok(())
    }
}

/// What is kept to go on from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields, rename_all = "kebab-case")]
pub struct CheckpointConfig {
    /// Iterations between two checkpoints.
    pub every: u64,
    /// Number of checkpoints that are kept, the latest ones.
    pub keep: usize,
}

impl Default for CheckpointConfig {
    fn default() -> Self {
        Self { every: 1000, keep: 3 }
    }
}

impl TrainConfig {
    /// Reads a configuration, puts `key.path=value` settings over it and checks it.
    ///
    /// # Errors
    /// [`Error::Config`] with the line and column of a mistake in `text`; naming the key of a setting that
    /// is unknown, with the nearest ones, or of a value that is out of range.
    ///
    /// The noise of a sensor says where it saturates, which is x-max where nothing else is said.
    pub fn from_toml(text: &str, settings: &[String]) -> Result<Self> {
        // Once without the settings, so that mistakes of the file are reported at their line.
        let broken = |reason: String| Error::config("configuration", in_plain_words(&reason));
        let mut config: Self = parse_toml(text).map_err(broken)?;
        let mut table: toml::Table = parse_toml(text).map_err(broken)?;
        if !settings.is_empty() {
            config = put(&mut table, settings)?;
        }
        let formation = &mut config.data.formation;
        let says_x_max = |table: &toml::Table| table.get("data")?.get("formation")?.get("x-max").map(|_| ());
        if let NoiseConfig::Sensor(sensor) = &formation.noise
            && says_x_max(&table).is_none()
        {
            formation.x_max = sensor.x_max();
        }
        config.validate()?;
        Ok(config)
    }

    /// The whole configuration as TOML, every default resolved.
    ///
    /// # Panics
    /// Never: the fields are plain data.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("configurations are plain data")
    }

    /// Checks every value's range.
    ///
    /// # Errors
    /// [`Error::Config`] naming the first key that is out of range.
    pub fn validate(&self) -> Result<()> {
        self.architecture.validate()?;
        self.initialisation.check(&self.architecture)?;
        self.validation.validate()?;
        let counts = [
            ("iterations", self.iterations),
            ("log-every", self.log_every),
            ("data.crop", self.data.crop as u64),
            ("data.batch", self.data.batch as u64),
            ("data.accumulate", self.data.accumulate as u64),
            ("schedule.period", self.schedule.period),
            ("validation.images", self.validation.images as u64),
            ("validation.crop", self.validation.crop as u64),
            ("checkpoint.every", self.checkpoint.every),
            ("checkpoint.keep", self.checkpoint.keep as u64),
        ];
        if let Some((key, _)) = counts.into_iter().find(|(_, count)| *count == 0) {
            return Err(Error::config(key, "must be at least 1, found 0"));
        }
        self.data.kernels.check(KERNELS_KEY)?;
        self.data.check_size()?;
        let optimizer = &self.optimizer;
        let is_share = |value: f64| (0.0..1.0).contains(&value);
        let ranges = [
            (
                "optimizer.learning-rate",
                optimizer.learning_rate,
                is_positive(optimizer.learning_rate),
                "positive",
            ),
            ("optimizer.beta1", optimizer.beta1, is_share(optimizer.beta1), "at least 0 and below 1"),
            ("optimizer.beta2", optimizer.beta2, is_share(optimizer.beta2), "at least 0 and below 1"),
            ("optimizer.epsilon", optimizer.epsilon, is_positive(optimizer.epsilon), "positive"),
            ("optimizer.clip-norm", optimizer.clip_norm, optimizer.clip_norm >= 0.0, "0 (off) or positive"),
            ("optimizer.ema-decay", optimizer.ema_decay, is_share(optimizer.ema_decay), "0 (off) or below 1"),
            (
                "schedule.minimum",
                self.schedule.minimum,
                (0.0..=optimizer.learning_rate).contains(&self.schedule.minimum),
                "between 0 and optimizer.learning-rate",
            ),
        ];
        match self.loss.ranges().into_iter().chain(ranges).find(|(.., holds, _)| !holds) {
            Some((key, value, _, range)) => {
                Err(Error::config(key, format!("must be {range}, found {value}")))
            }
            None => Ok(()),
        }
    }

    /// The first key whose change would make a resumed training another one: how long it runs, what it reports
    /// and keeps, and the memory it may take for images, may change.
    ///
    /// # Panics
    /// Never: the fields are plain data.
    pub fn first_difference(&self, other: &Self) -> Option<String> {
        let comparable = |config: &Self| {
            let data = DataConfig { cache_mib: self.data.cache_mib, ..config.data.clone() };
            let Self { iterations, log_every, checkpoint, .. } = self.clone();
            let comparable = Self { iterations, log_every, checkpoint, data, ..config.clone() };
            keys(&toml::Table::try_from(comparable).expect("configurations are plain data"))
        };
        let (ours, theirs) = (comparable(self), comparable(other));
        ours.into_iter()
            .zip(theirs)
            .find(|(a, b)| a != b)
            .map(|((key, a), (_, b))| format!("{key} is {a} and was {b}"))
    }
}

#[cfg(test)]
mod tests;
