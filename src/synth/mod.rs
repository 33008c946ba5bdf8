//! From clean scenes and kernels to degraded ones: the image formation model, Eq. 1.

mod formation;
mod noise;

pub use formation::Formation;
pub use noise::add_noise;
