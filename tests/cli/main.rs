//! Runs the binary as a user would: each subcommand's success, and what it says when it cannot.

mod common;
mod crop_codes;
mod eval;
mod files;
mod measure;
mod restore;
mod synth;
mod train;
