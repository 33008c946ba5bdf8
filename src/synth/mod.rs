//! From clean scenes and kernels to degraded ones: the image formation model, Eq. 1.
//!
//! [`Formation`] is the model, for one scene and one PSF; [`Synthesis`] makes a dataset folder with it, every
//! scene through every kernel of a bank.

mod archives;
mod degradations;
mod existing;
mod field;
mod folder;
mod formation;
mod kept;
mod kernels;
mod list;
mod noise;
mod run;
mod scene_run;
mod scenes;
mod sources;
mod synthesis;

pub use degradations::{BankFile, Degradations};
pub use existing::Existing;
pub use field::convolve_field;
pub use formation::Formation;
pub use kernels::MemoryNeeds;
pub use noise::add_noise;
pub use run::SynthesisReport;
pub use scene_run::SceneReport;
pub use scenes::{Division, Scene, common_margin, common_primaries, list_scenes};
pub use synthesis::{Needs, Synthesis, SynthesisConfig};
