//! Turns degraded images into restored ones: by a network, tile by tile, or by deconvolution.

pub mod deconvolution;
mod network;
mod tiles;

pub use network::{Conditioning, NetworkRestorer};
pub use tiles::{ALIGNMENT, Restorer, Tiling, format_bytes, parse_bytes, restore_tiled};
