//! From a dataset to a trained network.
//!
//! A [`Trainer`] holds weights, optimiser and position, and advances them step by step; a [`Job`] runs one in a
//! folder, with log, checkpoints and previews. All that is drawn depends on the seed and the position alone, so that a
//! training repeats, and resumes, bit for bit.

mod checkpoint;
mod config;
mod data;
mod identity;
mod instruction_sets;
mod loss;
mod optimizer;
mod preview;
mod run;
mod sampler;
mod schedule;
mod tensorboard;
mod trainer;
mod validation;

pub use config::{
    CheckpointConfig, DataConfig, Degradation, KERNELS_KEY, LossConfig, OptimizerConfig, PerceptualConfig,
    ScheduleConfig, TrainConfig, ValidationConfig,
};
pub use data::{Degrade, InMemory, OnTheFlyData, Patch, StoredData, TrainingData, Window};
pub use identity::DataIdentity;
pub use run::{Job, Outcome, Start, read_config};
pub use sampler::Sampler;
pub use schedule::learning_rate;
pub use trainer::{Step, Trainer};
pub use validation::{Validation, ValidationScore};
