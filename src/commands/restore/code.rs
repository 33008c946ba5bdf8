//! Finds the kernel code that a network is told, from whatever the user knows about the PSF.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::Args;

use udc::codes::{interpolate_code, project};
use udc::core::kernel_code::{KernelBank, KernelCode};
use udc::core::psf::Psf;
use udc::io::{is_bank_of_sha256, read_bank, read_bank_codes, read_code};
use udc::network::Model;
use udc::restore::Conditioning;

use super::field::Field;
use crate::commands::Session;
use crate::commands::psf_file::PsfAmongImagesArgs;

#[derive(Args, Debug)]
pub(super) struct CodeArgs {
    /// Kernel bank that the model was trained with (.safetensors)
    #[arg(long, value_name = "BANK", conflicts_with = "method")]
    pub(super) bank: Option<PathBuf>,
    /// Rotation of the panel in degrees, counter-clockwise; between those of the bank, codes are interpolated. `auto`
    /// takes the angle whose kernel explains the spectrum of the capture best, in about a second
    #[arg(long, value_name = "DEGREES|auto", requires = "bank", conflicts_with_all = ["psf", "code"])]
    #[arg(allow_negative_numbers = true, value_parser = parse_angle)]
    angle: Option<AngleArg>,
    /// PSFs of several places of the frame (.toml: rows, columns, psfs row by row), whose codes are interpolated
    #[arg(long, value_name = "FIELD", requires = "bank", conflicts_with_all = ["angle", "psf", "code"])]
    field: Option<PathBuf>,
    /// Kernel code itself (.npy)
    #[arg(long, value_name = "CODE", conflicts_with_all = ["bank", "psf", "method"])]
    code: Option<PathBuf>,
    /// Measured PSF: what a deconvolution inverts, or what --bank turns into a code
    #[arg(long, value_name = "PSF")]
    pub(super) psf: Option<PathBuf>,
}

/// An angle as the user writes it.
#[derive(Clone, Copy, Debug, PartialEq)]
enum AngleArg {
    Auto,
    Degrees(f64),
}

fn parse_angle(text: &str) -> Result<AngleArg, String> {
    match text.parse() {
        Ok(degrees) => Ok(AngleArg::Degrees(degrees)),
        Err(_) if text == "auto" => Ok(AngleArg::Auto),
        Err(_) => Err("write a number of degrees, or auto".to_owned()),
    }
}

/// What is known of the code before a capture is seen.
pub(super) enum KnownCode {
    /// All of it.
    Fixed(Conditioning),
    /// The kernels, one of whose angles is to be found in each capture.
    Search(Box<KernelBank>),
    /// A code for each of several places.
    Field(Field),
}

impl KnownCode {
    /// Something that the network could be told, to see whether it fits.
    pub(super) fn example(&self) -> Conditioning {
        match self {
            Self::Fixed(conditioning) => conditioning.clone(),
            Self::Search(bank) => Conditioning::Code(bank.code(0).to_owned()),
            Self::Field(field) => Conditioning::Code(field.codes[0].clone()),
        }
    }
}

impl CodeArgs {
    /// The code for `model`, with warnings about banks that do not belong to it.
    pub(super) fn resolve(
        &self,
        model: &Model,
        psf_file: &PsfAmongImagesArgs,
        session: &Session,
    ) -> Result<KnownCode> {
        if !model.architecture().reads_code() {
            if self.bank.is_some() || self.code.is_some() || self.psf.is_some() {
                session.warn("the model was trained without kernel codes; --bank, --angle, --code and --psf change nothing");
            }
            return Ok(KnownCode::Fixed(Conditioning::None));
        }
        if let (Some(field), Some(bank)) = (&self.field, &self.bank) {
            check_bank(bank, model, session)?;
            return Ok(KnownCode::Field(Field::read(field, |psf| {
                projected(bank, psf, &psf_file.read(psf, session)?, session)
            })?));
        }
        let code = match (&self.code, &self.bank, self.angle, &self.psf) {
            (Some(code), ..) => read_code(code)?,
            (None, Some(bank), Some(AngleArg::Auto), _) => {
                check_bank(bank, model, session)?;
                return Ok(KnownCode::Search(Box::new(read_bank(bank)?)));
            }
            (None, Some(bank), Some(AngleArg::Degrees(angle)), _) => {
                check_bank(bank, model, session)?;
                interpolate_code(&read_bank_codes(bank)?, angle)
                    .with_context(|| format!("finding the code of {angle}° in {}", bank.display()))?
            }
            (None, Some(bank), None, Some(psf)) => {
                check_bank(bank, model, session)?;
                projected(bank, psf, &psf_file.read(psf, session)?, session)?
            }
            (None, Some(_), None, None) => {
                bail!(
                    "--bank holds a code for every angle: add --angle A, --angle auto, or --psf PSF for a measured panel"
                )
            }
            (None, None, _, Some(_)) => {
                bail!("the model needs the code of the PSF: add --bank BANK, the bank it was trained with")
            }
            (None, None, _, None) => bail!(
                "the model needs a kernel code of {} numbers: add --bank BANK with --angle A or --psf PSF, or \
                 --code CODE.npy",
                model.architecture().code_dim
            ),
        };
        Ok(KnownCode::Fixed(Conditioning::Code(code)))
    }
}

/// The code of the PSF that was read from `path`.
fn projected(bank: &Path, path: &Path, psf: &Psf, session: &Session) -> Result<KernelCode> {
    let kernels = read_bank(bank)?;
    let projection = project(&kernels, psf)
        .with_context(|| format!("projecting {} onto {}", path.display(), bank.display()))?;
    session.detail(format_args!(
        "{} is nearest to {}, {:.3} % outside of the bank",
        path.display(),
        kernels.kernel_name(projection.nearest),
        100.0 * projection.residual_l2
    ));
    if !projection.fits() {
        session.warn(format_args!(
            "{:.2} % of {} lies outside of what {} can describe ({:.2} % is its own spread): the model may \
             restore badly; train one with a bank of this PSF",
            100.0 * projection.residual_l2,
            path.display(),
            bank.display(),
            100.0 * projection.limit_l2
        ));
    }
    Ok(projection.code)
}

fn check_bank(bank: &Path, model: &Model, session: &Session) -> Result<()> {
    let Some(expected) = &model.origin().kernel_bank_sha256 else { return Ok(()) };
    if !is_bank_of_sha256(bank, expected)? {
        session.warn(format_args!(
            "{} is not the bank that the model was trained with (SHA-256 {}…): its codes may mean something else",
            bank.display(),
            expected.get(..12).unwrap_or(expected)
        ));
    }
    Ok(())
}
