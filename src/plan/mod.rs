//! Plans a study on many machines: what is combined with what, and what its stages cost for any number of workers.

mod study;
mod table;

pub use study::{Evaluation, Rotations, Scenes, Shards, Study, Training};
pub use table::{Stage, StageTotals, StudyPlan, Workers};
