//! 3 × 3 convolutions of stride 1 by Winograd's minimal filtering F(4×4, 3×3): 36 multiplications for 16
//! outputs instead of 144.
//!
//! # Method
//! A tile of 4 × 4 outputs is `Y = Aᵀ [ (G g Gᵀ) ⊙ (Bᵀ d B) ] A` of the 6 × 6 inputs d around it and the
//! 3 × 3 weights g (Lavin and Gray, "Fast algorithms for convolutional neural networks", CVPR 2016, section
//! 4). The products ⊙ of all tiles and channels at one of the 36 points are a matrix product.
//!
//! # Points
//! The textbook's points 0, ±1, ±2 lose accuracy; 0, ±1/√2, ±√2 keep the matrices balanced and cost the
//! same, since the squares 1/2 and 2 are what the even parts need: measured 1.4e-6 of the largest output
//! against 4e-6 (and 1e-6 for the direct sum). F(6×6) would save a tenth of the time at 8e-6.
//!
//! # Order of work
//! [`weights`] transforms weights once. [`forward`] works on batches of tiles, a row of points at a time, so that what
//! lies between the steps stays in the caches: inputs down the columns; then for each row of points inputs across, six
//! matrix products, outputs across; outputs down the columns, with bias, activation and whatever else is done to them.
//! [`gradient`] turns the same steps around for the weights' gradient.

pub(crate) mod forward;
pub(crate) mod gradient;
pub(crate) mod transform;
pub(crate) mod weights;

/// Outputs along a side of a tile.
pub(crate) const TILE: usize = 4;

/// Inputs along a side of a tile, and points of the transform along each axis.
pub(crate) const POINTS: usize = 6;
