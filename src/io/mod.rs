//! The only opener of files: images, PSFs, kernel banks; whole files only, never half of one.
//!
//! Files are recognised by their contents when they are read and by their extension when they are written.
//! Sizes that a header declares are checked against the file's length and [`MAX_PIXELS`] before anything is
//! allocated for them.

mod any_image;
mod archive;
mod array;
mod atomic;
mod bank;
mod color_tags;
mod container;
mod convert;
mod directory;
mod dng;
mod exif;
mod exr;
mod field;
mod folder;
mod foreign;
mod format;
mod guard;
mod half_sides;
mod half_tensors;
mod icc;
mod inputs;
mod jpeg;
mod layer;
mod lost;
mod low_bits;
mod machine;
mod made_folder;
mod npy;
mod owned_folder;
mod pixels;
mod plain;
mod planes;
mod process;
mod psf;
mod radiance;
mod raster;
mod read;
mod shared_input;
mod size;
mod tell;
mod tiff;
mod whole;
mod write;
mod written;

pub use any_image::{AnyImage, ImageReading, any_image_of, check_output_domain, inspect_any_image};
pub use archive::{ArchiveWriter, file_bytes, is_file};
pub use array::{read_array, write_array};
pub use atomic::{WriteSeek, check_output, list_unfinished, remove_unfinished, write_atomically, write_once};
pub use bank::{
    FORMAT as BANK_FORMAT, bank_sha256, bank_sha256_of, encode_bank, is_bank_of_sha256, read_bank,
    read_bank_codes, write_bank, write_published_bank,
};
pub use color_tags::ColorTag;
pub use container::{FloatWidth, TensorData, write_safetensors};
pub use convert::{Conversion, ConvertedImage};
pub use exr::ImageLayer;
pub use field::{inspect_psf_field, read_field, read_psf_field, write_psf_field};
pub use folder::{AppendFile, LineLog, create_folder, lock_folder, publish, remove, try_lock_folder};
pub use format::{Encoding, Format, check_extension};
pub use half_tensors::{HalfTensor, HalfTensors, read_half_tensors};
pub use inputs::{check_distinct, expand_inputs, identity, is_hidden, without_repeats};
pub use layer::{file_of_input, names_folder, sha256_of_input, stem_of_input, with_layer};
pub use lost::{what_is_lost, what_is_lost_of_mapping};
pub use machine::{available_memory_bytes, check_writable, free_disk_bytes};
pub use made_folder::MadeFolder;
pub use owned_folder::OwnedFolder;
pub use pixels::{DomainTag, IgnoredOpcode, Pixels, RawMetadata};
pub use plain::{
    list_folder, read_bytes, read_code, read_configuration, read_text, sha256_of_bytes, sha256_of_file,
};
pub use process::{core_seconds, core_seconds_of_children, peak_memory_bytes, scratch_folder};
pub use psf::{PsfFaults, PsfMove, PsfOptions, PsfReading, inspect_psf, read_psf, show_shift, write_psf};
pub use raster::GAIN_OFFSET;
pub use read::{
    image_of, inspect_image, inspect_mosaic, read_capture_info, read_image, read_image_told, read_layers,
    read_pixels, read_primaries, read_provenance, to_rgb,
};
pub use shared_input::SharedInput;
pub use size::{read_any_image_size, read_image_size};
pub use whole::is_whole;
use write::Contents;
pub use write::{
    PixelOptions, WriteOptions, check_display, encode_image, write_image, write_pixels, write_with_gains,
};
pub use written::tell_of_files;

/// The largest number of pixels an image may have: 16384 × 16384, four times the largest panorama in use.
pub const MAX_PIXELS: usize = 1 << 28;

/// Enough for the headers of an image with its provenance.
const HEAD_BYTES: u64 = 1 << 18;

#[cfg(test)]
mod tests;
