//! The networks in Burn: what they are made of, how they compute, and the files that keep their weights.
//!
//! An [`Architecture`] lists the weights; [`Parameters`] are such weights in main memory; a [`Network`]
//! is the network built of them on a device; a [`Model`] is a network together with where it came from.

mod architecture;
mod backend;
mod builder;
mod de_unet;
mod discnet;
mod inference;
mod layers;
mod model;
mod networks;
pub mod operations;
mod parameters;
mod sftmd;
mod srmdnf;
pub mod weights;

pub use crate::kernels::Isa;
pub use architecture::{Architecture, Condition, Kind, Scales};
pub use backend::Backend;
pub(crate) use model::map_of_code;
pub use model::{Model, Origin};
pub use networks::Network;
pub use parameters::{Initialisation, Parameter, Parameters, Values};
