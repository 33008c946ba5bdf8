//! Predicts a filter for every channel and pixel and applies it at once; the filters are never stored.
//!
//! # Equation
//! `filter(c, t) = PReLU(bias(c, t) + Σᵢ weight(c, t, i) · condition(i))` at each pixel, for the `s²` taps
//! `t = dy·s + dx`, and `output(y, x, c) = Σₜ filter(c, t) · features(y + dy − s/2, x + dx − s/2, c)`, the
//! features continued by replication (DISCNet, arXiv 2104.09556, section 4.2).
//!
//! # Method
//! At 800 × 800 and 32 channels the filters of one image are 2 GB. So a tile of a row's pixels takes one tap
//! after the other: a product of its conditions with that tap's weights gives the filters of all channels in
//! registers; there they are rectified, multiplied with the shifted features and added to the tile's outputs,
//! which stay in the first-level cache. Where two taps' filters fit in the registers, two are taken at once.
//!
//! # Sizes
//! Tiles of `tile_pixels` pixels: enough to reuse a tap's weights (4 KB at 32 channels, 64 KB at 128), few
//! enough that conditions and outputs stay cached.
//!
//! # Memory
//! What the next tile reads for the first time, and what it writes, is asked for between taps.
//!
//! # Error
//! That of a direct sum: about 1e-6 of the largest output.

mod backward;
mod forward;

pub use backward::DynamicFilterGradients;
pub use forward::DynamicFilter;
pub(crate) use forward::FilterBlock;

/// Pixels per tile: multiples of every register tile's rows.
fn tile_pixels(channels: usize) -> usize {
    match channels {
        0..=32 => 48,
        33..=64 => 24,
        _ => 96,
    }
}
