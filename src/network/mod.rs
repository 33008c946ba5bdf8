//! The networks in Burn: what they are made of, how they compute, and the files that keep their weights.
//!
//! An [`Architecture`] lists the weights; [`Parameters`] are such weights in main memory; a [`DiscNet`] is
//! the network built of them on a device; a [`Model`] is a network together with where it came from.

mod architecture;
mod backend;
mod discnet;
mod inference;
mod model;
pub mod operations;
mod parameters;
pub mod weights;

pub use architecture::{Architecture, Condition, Kind, Scales};
pub use backend::Backend;
pub use discnet::DiscNet;
pub use model::{Model, Origin};
pub use parameters::{Initialisation, Parameter, Parameters, Values};
