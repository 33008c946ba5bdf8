//! Kernel banks: PSFs with their codes.

use std::path::PathBuf;
use std::sync::Arc;

use ndarray::Axis;
use numpy::{PyArray1, PyArray2, PyArray4};
use pyo3::prelude::*;

use udc::codes::{self, PUBLISHED_ANGLES_DEG};
use udc::core::error::{Error, Result};
use udc::core::psf::Psf;
use udc::io::{self, PsfOptions, inspect_psf};
use udc::psf::DisplayConfig;
use udc::restore::Notice;

use crate::error::to_python;
use crate::psf::display_of;
use crate::source::{Notices, light_domain, name_of, to_arrays, to_numbers, told, warning};
use crate::work::run;

/// PSFs of one size, their codes, and the PCA basis of the codes.
#[pyclass(frozen, module = "udc")]
pub(crate) struct KernelBank(pub(crate) Arc<udc::core::kernel_code::KernelBank>);

#[pymethods]
impl KernelBank {
    /// The PSFs, float32 [K, h, w, 3], each channel of unit sum.
    #[getter]
    fn psfs<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray4<f32>>> {
        let planes: Vec<_> = self.0.psfs.iter().map(Psf::planes).collect();
        let stacked = ndarray::stack(Axis(0), &planes);
        to_arrays(py, stacked.map_err(|error| to_python(&Error::Unsupported(error.to_string())))?)
    }

    /// The codes, float32 [K, b].
    #[getter]
    fn codes<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f32>> {
        to_numbers(py, &self.0.codes)
    }

    /// The rotation of each kernel in degrees, counter-clockwise; None for a set that was not made by rotation.
    #[getter]
    fn angles(&self) -> Option<Vec<f64>> {
        self.0.angles_deg.clone()
    }

    /// The name of each kernel, as datasets have it: r-12, r+03, or k01.
    #[getter]
    fn names(&self) -> Vec<String> {
        (0..self.0.len()).map(|index| self.0.kernel_name(index)).collect()
    }

    /// The mean PSF, float32 [3·h·w] in the order channel, row, column.
    #[getter]
    fn mean<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        to_numbers(py, &self.0.basis.mean)
    }

    /// The principal components, strongest first, float32 [b, 3·h·w].
    #[getter]
    fn components<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f32>> {
        to_numbers(py, &self.0.basis.components)
    }

    /// The variance along each component, float32 [b].
    #[getter]
    fn explained_variance<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f32>> {
        to_numbers(py, &self.0.basis.explained_variance)
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    fn __repr__(&self) -> String {
        let psf = &self.0.psfs[0];
        format!(
            "KernelBank({} PSFs of {} × {}, codes of {})",
            self.0.len(),
            psf.height(),
            psf.width(),
            self.0.code_dim()
        )
    }
}

/// What a bank is made of.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct CodeSettings {
    psfs: Vec<PathBuf>,
    display: Option<PathBuf>,
    description: Option<String>,
    size: Option<usize>,
    angles: Option<Vec<f64>>,
    angles_text: Option<String>,
    dim: usize,
    domain: Option<String>,
    recenter: bool,
}

impl CodeSettings {
    fn display(&self) -> Result<Option<DisplayConfig>> {
        match (&self.display, &self.description) {
            (Some(path), _) => DisplayConfig::read(path, self.size).map(Some),
            (None, Some(text)) => display_of(text, self.size).map(Some),
            (None, None) => Ok(None),
        }
    }

    fn angles(&self) -> Result<Vec<f64>> {
        match (&self.angles, &self.angles_text) {
            (Some(angles), _) => Ok(angles.clone()),
            (None, Some(text)) => codes::parse_angles(text),
            (None, None) => Ok(PUBLISHED_ANGLES_DEG.to_vec()),
        }
    }

    fn options(&self) -> Result<PsfOptions> {
        let domain = light_domain("domain", self.domain.as_deref())?;
        Ok(PsfOptions { domain, recenter: self.recenter, ..PsfOptions::default() })
    }
}

/// Makes a bank of a PSF that is rotated, of a set, or of a panel that is turned.
#[pyfunction]
pub(crate) fn codes_of(py: Python<'_>, settings: CodeSettings) -> PyResult<(KernelBank, Notices)> {
    let (bank, notices) = run(py, |progress| {
        let (mut notices, angles, dim) = (Notices::new(), settings.angles()?, settings.dim);
        if let Some(display) = settings.display()? {
            return Ok((codes::make_turned_bank(&display, &angles, dim, progress)?, notices));
        }
        let options = settings.options()?;
        let mut read = |path: &PathBuf| {
            let reading = inspect_psf(path, options)?;
            notices.extend(Notice::of_psf(&reading).iter().map(told));
            Ok(reading.psf)
        };
        let psfs: Vec<Psf> = settings.psfs.iter().map(&mut read).collect::<Result<_>>()?;
        let bank = match &psfs[..] {
            [psf] => codes::make_rotated_bank(psf, &angles, dim)?,
            _ => codes::make_bank(psfs, None, dim)?,
        };
        Ok((bank, notices))
    })?;
    Ok((KernelBank(Arc::new(bank)), notices))
}

/// The code of a PSF, the share of it that the code leaves out, whether the bank can describe it, and what there is to tell.
type Projected<'py> = (Bound<'py, PyArray1<f32>>, f64, bool, Notices);

/// Finds the code of another PSF in a bank.
#[pyfunction]
pub(crate) fn project<'py>(
    py: Python<'py>,
    bank: &KernelBank,
    psf: PathBuf,
    domain: Option<&str>,
    recenter: bool,
) -> PyResult<Projected<'py>> {
    let domain = light_domain("domain", domain).map_err(|error| to_python(&error))?;
    let bank = Arc::clone(&bank.0);
    let (projection, notices) = run(py, |_| {
        let reading = inspect_psf(&psf, PsfOptions { domain, recenter, ..PsfOptions::default() })?;
        let mut notices: Notices = Notice::of_psf(&reading).iter().map(told).collect();
        let projection = codes::project(&bank, &reading.psf)?;
        if !projection.fits() {
            notices.push(warning(format!(
                "the bank cannot describe {}: it is further off than any kernel of the bank is from the others; make a bank \
                 of this PSF",
                name_of(&psf)
            )));
        }
        Ok((projection, notices))
    })?;
    Ok((to_numbers(py, &projection.code), projection.residual_l2, projection.fits(), notices))
}

/// Reads a bank.
#[pyfunction]
pub(crate) fn read_bank(py: Python<'_>, path: PathBuf) -> PyResult<KernelBank> {
    run(py, |_| io::read_bank(&path)).map(|bank| KernelBank(Arc::new(bank)))
}

/// Writes a bank.
#[pyfunction]
pub(crate) fn write_bank(py: Python<'_>, path: PathBuf, bank: &KernelBank, overwrite: bool) -> PyResult<()> {
    let bank = Arc::clone(&bank.0);
    run(py, |_| {
        io::check_extension(&path, "safetensors")?;
        io::write_bank(&path, &bank, overwrite)
    })
}
