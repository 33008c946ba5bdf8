//! The shared vocabulary of every stage: images, PSFs, kernel codes, tone mapping, transforms, errors.
//!
//! Core knows no file, no stage and no command line, and prints nothing.

pub mod bayer;
pub mod broad_peak;
pub mod bytes;
pub mod camera_color;
pub mod capture;
pub(crate) mod coded;
pub mod color;
pub mod config;
pub mod error;
pub mod event;
pub mod exif;
pub mod fft;
pub mod field;
pub(crate) mod haze;
pub mod image;
pub mod kernel_code;
pub(crate) mod lone;
pub mod matrix3;
pub mod metrics;
pub mod nearest;
pub mod orientation;
pub mod primaries;
pub mod progress;
pub mod provenance;
pub mod psf;
pub mod rng;
pub mod saturation;
pub mod shard;
pub mod spread;
pub mod tone;
