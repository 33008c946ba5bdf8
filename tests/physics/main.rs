//! Checks every stage against analytic truth: laws that hold whatever software computes them.
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a test may stop at what it does not expect, and counts in small numbers"
)]

mod convolution;
mod haze;
mod irregular;
mod panorama;
mod propagation;
mod rotation;
mod sensor;
mod turning;
