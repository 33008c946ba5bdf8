//! Turns degraded images into restored ones: by a network, tile by tile, or by deconvolution.

mod angle;
pub mod deconvolution;
mod field;
mod highlights;
mod network;
mod planes;
mod tiles;

pub use angle::{AngleSearch, WEAK_LEAD, search_angle};
pub use field::code_map;
pub use highlights::{Highlights, blend_highlights};
pub use network::{Conditioning, NetworkRestorer};
pub use planes::{PlaneConfig, make_plane, make_planes};
pub use tiles::{ALIGNMENT, Restorer, Tiling, restore_tiled};
