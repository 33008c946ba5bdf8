//! Compares every stage with reference vectors that other software made; `fixtures/README.md` says which.
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a test may stop at what it does not expect, and counts in small numbers"
)]

mod codes;
mod discnet;
mod finish;
mod formation;
mod full_width;
mod fusion;
mod metrics;
mod networks;
mod panorama;
mod perceptual;
#[path = "../common/perceptual_weights.rs"]
mod perceptual_weights;
mod training;
mod wiener;
