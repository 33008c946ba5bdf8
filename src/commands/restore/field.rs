//! Finds the kernel codes of several places of the frame.

use std::path::Path;

use anyhow::{Context as _, Result};

use udc::core::field::FieldGrid;
use udc::core::kernel_code::KernelCode;
use udc::io::read_field;

/// Kernel codes at the places of a grid.
pub(super) struct Field {
    pub(super) grid: FieldGrid,
    pub(super) codes: Vec<KernelCode>,
}

impl Field {
    /// Reads a field file; `code_of` finds the code of a PSF's file.
    pub(super) fn read(file: &Path, code_of: impl Fn(&Path) -> Result<KernelCode>) -> Result<Self> {
        let (grid, psfs) = read_field(file)?;
        let codes: Result<Vec<_>> = psfs.iter().map(|psf| code_of(psf)).collect();
        Ok(Self { grid, codes: codes.with_context(|| format!("reading the field {}", file.display()))? })
    }
}
