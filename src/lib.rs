//! Under-display camera imaging: from a measured panel to a restored photograph.
//!
//! Data flows one way, each stage a module that takes values and returns values:
//! captures → [`psf`] → [`codes`] → [`synth`] (of [`crop`]s) → [`train`] → [`restore`] → [`finish`], [`eval`] → [`report`].
//! The stages never import one another; they meet through the types and files of [`core`]. The binary's
//! commands connect them. Beneath [`train`] and [`restore`] lie the networks ([`network`]) and the loops that they
//! spend their time in ([`kernels`]); beneath [`train`] and [`eval`] what trained eyes see ([`perceptual`]).
//!
//! # Axes and units
//! Images are RGB, planar, `[channel, height, width]`; batches `[item, channel, height, width]`; positions
//! are (row y, column x), row 0 on top. Physical quantities carry their unit in their name.
//!
//! # Scope
//! Still captures through a panel whose PSF does not change over the exposure; processing on the CPU.
//! Out of scope: video, autofocus, panel design.

#![cfg_attr(
    test,
    allow(
        clippy::float_cmp,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "tests compare what must be equal to the bit, and count in small numbers"
    )
)]

pub mod codes;
pub mod core;
pub mod crop;
pub mod demo;
pub mod eval;
pub mod finish;
pub mod kernels;
pub mod network;
pub mod perceptual;
pub mod psf;
pub mod report;
pub mod restore;
pub mod synth;
pub mod train;
