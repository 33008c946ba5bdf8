//! How alike two images look to a network that was trained to recognise objects: VGG-19 features as a loss,
//! AlexNet features as a metric (LPIPS).
//!
//! The weights are others' and are read from files that the user names; every missing or unfitting file is an
//! error that says which one is needed, where it comes from and how it is laid out.

mod features;
mod lpips;
mod pool;
mod tensors;
mod vgg;
mod weights;

pub use lpips::Lpips;
pub use tensors::PerceptualTensors;
pub use vgg::{FeatureDistance, PerceptualLoss};
