//! The networks in Burn: what they are made of, how they compute, and the files that keep their weights.
//!
//! An [`Architecture`] lists the weights; [`Parameters`] are such weights in main memory; a [`Network`]
//! is the network built of them on a device; a [`Model`] is a network together with where it came from, ready to restore
//! what its [`Inputs`] are.

mod architecture;
mod backend;
mod backends;
pub mod benchmark;
mod builder;
mod de_unet;
mod discnet;
mod engine;
mod family;
pub mod gpu;
mod guided;
mod inputs;
mod layers;
mod model;
mod networks;
pub mod operations;
mod parameters;
mod precision;
mod sftmd;
mod shipped;
mod srmdnf;
mod streamed;
#[cfg(test)]
pub(crate) mod testing;
pub mod weights;

pub use crate::kernels::Isa;
pub use architecture::{Architecture, Condition, Scales};
pub(crate) use backend::numbers_of;
pub use backend::{Backend, DeviceChoice};
pub use backends::Backends;
pub use family::Kind;
pub use inputs::{InputTensors, Inputs, Plane, Planes};
pub use model::{Model, Origin};
pub use networks::Network;
pub(crate) use operations::{largest_of_all, sum_of_all};
pub use parameters::{Initialisation, Parameter, Parameters, TensorValues};
pub use precision::Precision;
pub use shipped::{GUIDED, guided_model, guided_sha256, guided_weights, shipped};
