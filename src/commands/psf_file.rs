//! PSFs that the user names: read as the flags say, with a warning of what is wrong with the file.

use std::path::Path;

use anyhow::Result;
use clap::Args;

use udc::core::field::PsfField;
use udc::core::psf::Psf;
use udc::io::{DomainTag, PsfOptions, PsfReading, inspect_psf, inspect_psf_field};

use super::Session;
use super::choices::LIGHT_DOMAINS;

/// The flags of commands whose only images are PSFs.
#[derive(Args, Debug)]
pub(super) struct PsfFileArgs {
    /// What a PSF's file holds; required for 8- and 16-bit files that do not say it [default: what the file says, else
    /// linear]
    #[arg(long, value_name = "DOMAIN", value_parser = LIGHT_DOMAINS, alias = "psf-domain")]
    domain: Option<DomainTag>,
    /// Move a PSF whose peak is not at the centre, index N // 2, there: by whole pixels, all colours together, or rolled
    /// where it begins with its centre, as ifftshift writes it
    #[arg(long)]
    recenter: bool,
}

/// The group of the flags that name PSFs, in commands that read other images too.
pub(super) const PSF_FILES: &str = "psf-files";

/// The flags of commands that read other images too; they belong to those of the group [`PSF_FILES`].
#[derive(Args, Debug)]
pub(super) struct PsfAmongImagesArgs {
    /// What a PSF's file holds; required for 8- and 16-bit files that do not say it [default: what the file says, else
    /// linear]
    #[arg(long, value_name = "DOMAIN", value_parser = LIGHT_DOMAINS, requires = PSF_FILES)]
    psf_domain: Option<DomainTag>,
    /// Move a PSF whose peak is not at the centre, index N // 2, there: by whole pixels, all colours together, or rolled
    /// where it begins with its centre, as ifftshift writes it
    #[arg(long, requires = PSF_FILES)]
    recenter: bool,
}

impl PsfFileArgs {
    /// Whether a flag says how PSFs are read.
    pub(super) fn is_given(&self) -> bool {
        self.domain.is_some() || self.recenter
    }

    pub(super) fn options(&self) -> PsfOptions {
        PsfOptions { domain: self.domain, recenter: self.recenter, ..PsfOptions::default() }
    }

    /// Reads a PSF; warns of what is wrong with it.
    pub(super) fn read(&self, path: &Path, session: &Session) -> Result<Psf> {
        read(path, self.options(), session)
    }
}

impl PsfAmongImagesArgs {
    pub(super) fn options(&self) -> PsfOptions {
        PsfOptions { domain: self.psf_domain, domain_flag: "--psf-domain", recenter: self.recenter }
    }

    /// Reads a PSF; warns of what is wrong with it.
    pub(super) fn read(&self, path: &Path, session: &Session) -> Result<Psf> {
        read(path, self.options(), session)
    }

    /// Reads the PSFs of a field file; warns of what is wrong with each.
    pub(super) fn read_field(&self, path: &Path, session: &Session) -> Result<PsfField> {
        let (field, readings) = inspect_psf_field(path, self.options())?;
        readings.iter().for_each(|reading| tell(reading, session));
        Ok(field)
    }
}

/// Warns of what is wrong with a PSF that is read by a stage, without a flag of its own.
pub(super) fn look(path: &Path, session: &Session) -> Result<()> {
    read(path, PsfOptions::default(), session).map(|_| ())
}

fn read(path: &Path, options: PsfOptions, session: &Session) -> Result<Psf> {
    let reading = inspect_psf(path, options)?;
    tell(&reading, session);
    Ok(reading.psf)
}

fn tell(reading: &PsfReading, session: &Session) {
    if let Some((how, lost)) = reading.describe_move() {
        session.note(how);
        lost.into_iter().for_each(|lost| session.warn(lost));
    }
    reading.describe_grey().into_iter().for_each(|grey| session.note(grey));
    reading.warnings().into_iter().for_each(|warning| session.warn(warning));
}
