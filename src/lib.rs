//! Under-display camera imaging: from a measured panel to a restored photograph.
//!
//! Data flows one way: [`capture`]s become a [`psf`], whose [`codes`] and kernels [`synth`] applies to [`crop`]s; of the
//! triplets [`train`] makes models, with which [`restore`] turns captures into images, for [`finish`] to develop and for
//! [`experiment`] to measure and [`report`] to show.
//!
//! The modules from the ground up; each imports only what stands before it:
//! - [`core`]: values and the mathematics that all share;
//! - [`io`]: the only opener of files; [`dataset`]: a folder of triplets as a value;
//! - [`kernels`]: the loops that networks spend their time in; [`network`]: the networks made of them;
//! - [`capture`], [`psf`], [`codes`], [`crop`], [`scenes`], [`synth`], [`finish`]: the stages before and after a network;
//! - [`perceptual`]: what trained eyes see;
//! - [`restore`], [`train`]; [`inspect`]: what a file or folder of the project holds; [`experiment`], [`report`].
//!
//! The binary's commands turn flags into configurations of these.
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

pub mod capture;
pub mod codes;
pub mod core;
pub mod crop;
pub mod dataset;
pub mod experiment;
pub mod finish;
pub mod inspect;
pub mod io;
pub mod kernels;
pub mod network;
pub mod perceptual;
pub mod psf;
pub mod report;
pub mod restore;
pub mod scenes;
pub mod synth;
pub mod train;
