//! The flags that tell what is known of the kernel.

use std::path::{Path, PathBuf};

use clap::Args;

use udc::io::PsfOptions;
use udc::restore::{Angle, KernelFiles};

#[derive(Args, Clone, Debug)]
pub(super) struct KernelArgs {
    /// Kernel bank that the model was trained with, or whose kernels are the panel's PSF at several angles (.safetensors)
    #[arg(long, value_name = "BANK", conflicts_with = "method")]
    bank: Option<PathBuf>,
    /// Rotation of the panel in degrees, counter-clockwise; between those of the bank, codes are interpolated. `auto`
    /// takes the angle whose kernel explains the spectrum of the capture best, in about a second
    #[arg(long, value_name = "DEGREES|auto", requires = "bank", conflicts_with_all = ["psf", "code", "method"])]
    #[arg(allow_negative_numbers = true, value_parser = parse_angle)]
    angle: Option<Angle>,
    /// PSFs of several places of the frame (.toml: rows, columns, psfs row by row), whose codes are interpolated, for models that read
    /// codes; with --bank
    #[arg(long, value_name = "FIELD", conflicts_with_all = ["angle", "psf", "code", "method"])]
    field: Option<PathBuf>,
    /// Kernel code itself (.npy)
    #[arg(long, value_name = "CODE", conflicts_with_all = ["bank", "psf", "method"])]
    code: Option<PathBuf>,
    /// Measured PSF: what a deconvolution inverts, or what --bank turns into a code
    #[arg(long, value_name = "PSF")]
    psf: Option<PathBuf>,
}

impl KernelArgs {
    /// The PSF that is named.
    pub(super) fn psf(&self) -> Option<&Path> {
        self.psf.as_deref()
    }

    /// Whether both a bank and a PSF are named.
    pub(super) fn has_bank_beside_psf(&self) -> bool {
        self.bank.is_some() && self.psf.is_some()
    }

    /// All files that are named.
    pub(super) fn paths(&self) -> impl Iterator<Item = &PathBuf> {
        [&self.bank, &self.field, &self.code, &self.psf].into_iter().flatten()
    }

    /// What the files that are named tell, PSFs read as `psf_options` say.
    pub(super) fn files(&self, psf_options: PsfOptions) -> KernelFiles {
        let Self { bank, angle, field, code, psf } = self.clone();
        KernelFiles { bank, angle, psf, field, code, psf_options }
    }
}

fn parse_angle(text: &str) -> Result<Angle, String> {
    match text.parse() {
        Ok(degrees) => Ok(Angle::Degrees(degrees)),
        Err(_) if text == "auto" => Ok(Angle::Search),
        Err(_) => Err("write a number of degrees, or auto".to_owned()),
    }
}
