//! The scenes, the capture and the settings of `udc demo`: the whole pipeline on input made here.

pub mod capture;
pub mod scenes;

/// The panel that the demo simulates: a layout file as `udc psf` reads it.
pub const PANEL: &str = include_str!("panel.toml");

/// The training of the demo: a configuration as `udc train` reads it.
pub const TRAINING: &str = include_str!("training.toml");
