//! Reads and writes field files: which PSF belongs to which place of the frame.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{
    PsfOptions, PsfReading, WriteOptions, create_folder, inspect_psf, read_text, write_atomically, write_psf,
};
use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::core::field::{FieldGrid, PsfField};

/// The contents of a field file.
///
/// `rows = 2`, `columns = 3`, `psfs = ["top-left.exr", …]`: the PSFs row by row, beside the file.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct FieldFile {
    rows: usize,
    columns: usize,
    psfs: Vec<PathBuf>,
}

/// Reads the grid of a field file, and the paths of the PSFs at its nodes.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Format`] with what is wrong in it.
pub fn read_field(file: &Path) -> Result<(FieldGrid, Vec<PathBuf>)> {
    let parsed = parse_toml(&read_text(file)?);
    let FieldFile { rows, columns, psfs } = parsed.map_err(|reason| Error::format(file, reason))?;
    let grid = FieldGrid::new(rows, columns)?;
    if psfs.len() != grid.len() {
        let (expected, found) = (grid.len(), psfs.len());
        let reason = format!("names {found} PSFs for {rows} × {columns} places; name {expected}");
        return Err(Error::format(file, reason));
    }
    let folder = file.parent().unwrap_or(Path::new("."));
    Ok((grid, psfs.iter().map(|psf| folder.join(psf)).collect()))
}

/// Reads a field file with its PSFs.
///
/// # Errors
/// As [`inspect_psf_field`].
pub fn read_psf_field(file: &Path) -> Result<PsfField> {
    inspect_psf_field(file, PsfOptions::default()).map(|(field, _)| field)
}

/// Reads a field file with its PSFs, and finds what is wrong with each of them.
///
/// # Errors
/// As [`read_field`] and [`inspect_psf`]; [`Error::Shape`] when the PSFs have several sizes.
pub fn inspect_psf_field(file: &Path, options: PsfOptions) -> Result<(PsfField, Vec<PsfReading>)> {
    let (grid, paths) = read_field(file)?;
    let readings: Vec<PsfReading> =
        paths.iter().map(|path| inspect_psf(path, options)).collect::<Result<_>>()?;
    let field = PsfField::new(grid, readings.iter().map(|reading| reading.psf.clone()).collect())?;
    Ok((field, readings))
}

/// Writes a field file, and its PSFs into the folder of the same name without extension; replaces what is there.
///
/// # Errors
/// As [`write_psf`].
pub fn write_psf_field(file: &Path, field: &PsfField) -> Result<()> {
    let folder = file.with_extension("");
    create_folder(&folder)?;
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    let stem = PathBuf::from(folder.file_name().unwrap_or_default());
    let mut psfs = Vec::with_capacity(field.psfs().len());
    for (index, psf) in field.psfs().iter().enumerate() {
        let name = format!("{:02}.exr", index + 1);
        write_psf(&folder.join(&name), psf, &options)?;
        psfs.push(stem.join(name));
    }
    let contents = FieldFile { rows: field.grid().rows(), columns: field.grid().columns(), psfs };
    let text = toml::to_string(&contents).map_err(|error| Error::format(file, error.to_string()))?;
    write_atomically(file, true, |file| file.write_all(text.as_bytes()))
}
