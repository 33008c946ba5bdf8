//! Examples to train a network on that restores captures of any panel: an [`ExampleSet`] makes a folder of them, an
//! [`ExamplesFolder`] is one that can be read.
//!
//! An example is a capture, what it should be, and the planes that a restoration makes of the capture and of the PSF that it
//! is told, which differs from the true one as a measurement does. Panel, pose, scene, sensor and range of exposure are drawn
//! anew for every example, from the seed and the example's number alone. A part of them is harder than the simulator is: see
//! [`HarderConfig`].

mod capture;
mod config;
mod example;
mod folder;
mod make;
mod panels;
mod panoramas;
mod recipe;
mod record;
mod scene;

pub use config::{ExamplesConfig, HarderConfig, PanelsConfig, Range, ScenesConfig, SensorsConfig};
pub use example::{CAPTURE, GROUND_TRUTH};
pub use folder::{EXAMPLES_FILE, ExamplesFile, ExamplesFolder};
pub use make::{ExampleSet, MadeExamples};
pub use panoramas::PanoramaFile;
pub use record::ExampleRecord;
