//! Runs the binary as a user would: each subcommand's success, and what it says when it cannot.
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a test may stop at what it does not expect, and counts in small numbers"
)]

mod angle;
mod archives;
mod bench;
mod black_level;
mod brackets;
mod color_tags;
mod common;
mod compare;
mod crop_codes;
mod demo;
mod doctor;
mod documentation;
mod domains;
mod eval;
mod events;
mod examples;
mod exr_headers;
mod files;
mod finish;
mod foreign;
mod guided;
mod info;
mod info_pictures;
mod instruction_sets;
mod json_events;
mod kernel_choice;
mod layers;
mod lens;
mod margin;
mod measure;
mod negatives;
mod overwrite;
#[path = "../common/perceptual_weights.rs"]
mod perceptual_weights;
mod photograph;
mod pictures;
mod plan;
mod pose;
mod positions;
mod psf_files;
mod radiance;
mod random_panels;
mod raw;
mod raw_brackets;
mod restore;
mod restore_brackets;
mod restore_files;
mod resume;
mod run_folder;
mod scale;
mod scenes;
mod shards;
mod stars;
mod sweep;
mod synth;
mod synth_resume;
#[path = "../common/tiff.rs"]
mod tiff;
mod told_light;
mod tone;
mod tone_of_files;
mod train;
mod view;
mod viewing;
mod whose_psf;
