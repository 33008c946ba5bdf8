//! From a dataset to a trained network.
//!
//! A [`Trainer`] holds weights, optimiser and position, and advances them step by step; all that it draws
//! depends on the seed and the position alone, so that a training repeats, and resumes, bit for bit.

mod config;
mod data;
mod loss;
mod optimizer;
mod sampler;
mod schedule;
mod trainer;

pub use config::{
    CheckpointConfig, DataConfig, Degradation, LossConfig, OptimizerConfig, ScheduleConfig, TrainConfig,
    ValidationConfig,
};
pub use data::{InMemory, Patch, TrainingData, Window};
pub use sampler::Sampler;
pub use schedule::learning_rate;
pub use trainer::{Step, Trainer};
