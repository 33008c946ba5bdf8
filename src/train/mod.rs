//! From a dataset to a trained network.
//!
//! A [`TrainingSet`] is what to learn from. A [`Trainer`] holds weights, optimiser and position, and advances them step
//! by step; a [`Job`] runs one in a folder, with log, checkpoints and previews; a [`Training`] is all of it together. All that is drawn depends on the seed and the position alone, so that a
//! training repeats, and resumes, bit for bit.

pub mod benchmark;
mod checkpoint;
mod clean;
mod config;
mod data;
mod estimate;
#[cfg(test)]
mod exchange;
mod identity;
mod instruction_sets;
mod live;
mod log;
mod loss;
mod on_device;
mod optimizer;
mod peers;
mod preview;
mod recent;
mod run;
mod sampler;
mod schedule;
mod tensorboard;
mod trainer;
mod training;
mod training_set;
mod validation;
mod worker;

pub use clean::CleanImages;
pub use config::{
    CheckpointConfig, DataConfig, Degradation, KERNELS_KEY, LossConfig, OptimizerConfig, PerceptualConfig,
    ScheduleConfig, TrainConfig, ValidationConfig,
};
pub use data::{Degrade, ExampleData, InMemory, OnTheFlyData, Patch, StoredData, TrainingData, Window};
pub use estimate::estimate;
pub use identity::DataIdentity;
pub use run::{Job, Outcome, Start, read_config};
pub use sampler::Sampler;
pub use schedule::learning_rate;
pub use trainer::{Step, Trainer};
pub use training::{Initial, Training};
pub use training_set::TrainingSet;
pub use validation::{Validation, ValidationScore};
