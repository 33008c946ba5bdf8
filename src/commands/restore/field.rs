//! Reads the PSFs of several places of the frame, and finds their codes.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use serde::Deserialize;

use udc::core::config::parse_toml;
use udc::core::error::Error;
use udc::core::field::FieldGrid;
use udc::core::io::read_text;
use udc::core::kernel_code::KernelCode;

/// The contents of a field file.
///
/// `rows = 2`, `columns = 3`, `psfs = ["top-left.exr", …]`: the PSFs row by row, beside the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct FieldFile {
    rows: usize,
    columns: usize,
    psfs: Vec<PathBuf>,
}

/// Kernel codes at the places of a grid.
pub(super) struct Field {
    pub(super) grid: FieldGrid,
    pub(super) codes: Vec<KernelCode>,
}

impl Field {
    /// Reads a field file; `code_of` finds the code of a PSF's file.
    pub(super) fn read(file: &Path, code_of: impl Fn(&Path) -> Result<KernelCode>) -> Result<Self> {
        let parsed = parse_toml(&read_text(file)?);
        let FieldFile { rows, columns, psfs } = parsed.map_err(|reason| Error::format(file, reason))?;
        let grid = FieldGrid::new(rows, columns)?;
        if psfs.len() != grid.len() {
            let (expected, found) = (grid.len(), psfs.len());
            bail!("{} names {found} PSFs for {rows} × {columns} places; name {expected}", file.display());
        }
        let folder = file.parent().unwrap_or(Path::new("."));
        let codes: Result<Vec<_>> = psfs.iter().map(|psf| code_of(&folder.join(psf))).collect();
        Ok(Self { grid, codes: codes.with_context(|| format!("reading the field {}", file.display()))? })
    }
}
