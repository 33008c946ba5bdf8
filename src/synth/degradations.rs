//! What scenes are degraded by, with the bank that the dataset will hold of it.

use std::path::{Path, PathBuf};

use ndarray::Axis;

use crate::codes::project;
use crate::core::error::Result;
use crate::core::field::PsfField;
use crate::core::kernel_code::KernelBank;
use crate::core::psf::Psf;
use crate::io;

/// The bytes of a bank as the dataset will hold them; those of a file are not kept in memory.
pub enum BankFile {
    /// A file to copy.
    Stored(PathBuf),
    /// A bank that has no file yet.
    Encoded(Vec<u8>),
}

impl BankFile {
    /// The bytes.
    ///
    /// # Errors
    /// [`Error::Io`](crate::core::error::Error::Io) when the file cannot be read.
    pub fn read(&self) -> Result<Vec<u8>> {
        match self {
            Self::Stored(path) => io::read_bytes(path),
            Self::Encoded(bytes) => Ok(bytes.clone()),
        }
    }
}

/// What scenes are degraded by.
pub struct Degradations {
    /// The kernels.
    pub bank: KernelBank,
    /// The bank's file.
    pub bank_file: BankFile,
    /// PSFs over the frame, to degrade scenes by instead; the bank's one kernel is the PSF in the middle.
    pub field: Option<PsfField>,
}

impl Degradations {
    /// Every kernel of a bank's file.
    ///
    /// # Errors
    /// As [`io::read_bank`].
    pub fn of_bank(path: &Path) -> Result<Self> {
        let (bank, bank_file) = (io::read_bank(path)?, BankFile::Stored(path.to_owned()));
        Ok(Self { bank, bank_file, field: None })
    }

    /// A single PSF, which has no code.
    pub fn of_psf(psf: Psf) -> Self {
        Self::encoded(KernelBank::single(psf), None)
    }

    /// PSFs over the frame; the one in its middle has its code in the basis of `bank`, if there is one.
    ///
    /// # Errors
    /// As [`project`]; those of a field without a middle.
    pub fn of_field(field: PsfField, bank: Option<KernelBank>) -> Result<Self> {
        let psf = field.centre()?;
        let central = match bank {
            None => KernelBank::single(psf),
            Some(bank) => {
                let code = project(&bank, &psf)?.code;
                KernelBank::new(vec![psf], code.insert_axis(Axis(0)), bank.basis, Some(vec![0.0]))?
            }
        };
        Ok(Self::encoded(central, Some(field)))
    }

    fn encoded(bank: KernelBank, field: Option<PsfField>) -> Self {
        Self { bank_file: BankFile::Encoded(io::encode_bank(&bank)), bank, field }
    }
}
