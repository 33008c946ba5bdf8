//! What is known of the kernel that captures were seen through, and the files that tell it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::{Value, json};

use super::Notice;
use super::angle::TurnedKernel;
use crate::codes::{interpolate_code, project};
use crate::core::error::{Error, Result};
use crate::core::field::FieldGrid;
use crate::core::kernel_code::{KernelBank, KernelCode};
use crate::core::psf::Psf;
use crate::io::{
    PsfOptions, PsfReading, bank_sha256, inspect_psf, is_bank_of_sha256, read_bank, read_bank_codes,
    read_code, read_field,
};
use crate::network::Model;

/// What is known of the kernel of captures.
#[derive(Clone, Debug)]
pub enum KernelKnowledge {
    /// Nothing.
    Nothing,
    /// Its code.
    Code(KernelCode),
    /// The PSF itself, with its code where a bank gives it one.
    Psf {
        /// The PSF.
        psf: Arc<Psf>,
        /// Its code.
        code: Option<KernelCode>,
    },
    /// The kernels, one of whose angles is to be found in each capture.
    Search {
        /// The kernels.
        bank: Arc<KernelBank>,
        /// Their identity, by which other files refer to them.
        sha256: String,
    },
    /// The codes at several places of the frame.
    Field {
        /// The places.
        grid: FieldGrid,
        /// The code at each, row by row.
        codes: Vec<KernelCode>,
    },
}

/// The rotation of the panel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Angle {
    /// That which explains a capture best.
    Search,
    /// Degrees, counter-clockwise; between those of a bank, codes are interpolated.
    Degrees(f64),
}

/// The files that tell what is known of the kernel.
#[derive(Clone, Debug, Default)]
pub struct KernelFiles {
    /// Kernel bank that the model was trained with.
    pub bank: Option<PathBuf>,
    /// The rotation of the panel, among those of the bank.
    pub angle: Option<Angle>,
    /// A measured PSF: what a deconvolution inverts, or what the bank turns into a code.
    pub psf: Option<PathBuf>,
    /// PSFs of several places of the frame, which the bank turns into codes.
    pub field: Option<PathBuf>,
    /// The kernel code itself.
    pub code: Option<PathBuf>,
    /// How PSFs are read.
    pub psf_options: PsfOptions,
}

impl KernelKnowledge {
    /// A PSF without a code.
    pub fn of_psf(psf: Psf) -> Self {
        Self::Psf { psf: Arc::new(psf), code: None }
    }

    /// The PSF, where it is known.
    pub(super) fn psf(&self) -> Option<&Psf> {
        match self {
            Self::Psf { psf, .. } => Some(psf),
            Self::Nothing | Self::Code(_) | Self::Search { .. } | Self::Field { .. } => None,
        }
    }

    /// The PSF, which a deconvolution needs.
    ///
    /// # Errors
    /// [`Error::Config`] when it is not known.
    pub(super) fn needed_psf(&self) -> Result<&Psf> {
        self.psf().ok_or_else(without_psf)
    }

    /// A PSF of the size of the one that captures are seen through.
    ///
    /// # Errors
    /// [`Error::Config`] when none is known.
    pub(super) fn sized_psf(&self) -> Result<&Psf> {
        match self {
            Self::Search { bank, .. } => bank.psfs.first().ok_or_else(without_psf),
            known => known.needed_psf(),
        }
    }

    /// A code that a network could be told, to see whether it fits.
    pub(super) fn example(&self) -> Option<KernelCode> {
        match self {
            Self::Nothing => None,
            Self::Code(code) => Some(code.clone()),
            Self::Psf { code, .. } => code.clone(),
            Self::Search { bank, .. } => Some(bank.code(0).to_owned()),
            Self::Field { codes, .. } => codes.first().cloned(),
        }
    }

    /// What is known of the code, for provenance.
    pub(super) fn describe(&self) -> Option<Value> {
        match self {
            Self::Nothing => None,
            Self::Code(code) => Some(json!(code.to_vec())),
            Self::Psf { code, .. } => code.as_ref().map(|code| json!(code.to_vec())),
            Self::Search { sha256, .. } => Some(json!({ "auto-of-bank": sha256 })),
            Self::Field { grid, codes } => {
                let codes: Vec<Vec<f32>> = codes.iter().map(|code| code.to_vec()).collect();
                Some(json!({ "rows": grid.rows(), "columns": grid.columns(), "codes": codes }))
            }
        }
    }
}

impl KernelFiles {
    /// Reads what is known of the kernel for a network, with what is to be told of the files.
    ///
    /// # Errors
    /// [`Error::Config`] or [`Error::Unsupported`] when the files do not tell the code that the network needs; those of reading
    /// them.
    pub fn read_for(&self, model: &Model) -> Result<(KernelKnowledge, Vec<Notice>)> {
        let reads_planes = !model.architecture().planes().is_empty();
        if !model.architecture().reads_code() {
            let is_told = self.bank.is_some() || self.code.is_some() || self.psf.is_some() && !reads_planes;
            let flags =
                if reads_planes { "--bank, --angle and --code" } else { "--bank, --angle, --code and --psf" };
            let ignored = format!("the model was trained without kernel codes; {flags} change nothing");
            let ignored = is_told.then_some(Notice::Warning(ignored));
            let (knowledge, of_psf) = match reads_planes && self.psf.is_some() {
                true => self.read_psf()?,
                false => (KernelKnowledge::Nothing, Vec::new()),
            };
            return Ok((knowledge, ignored.into_iter().chain(of_psf).collect()));
        }
        if let Some(code) = &self.code {
            return Ok((KernelKnowledge::Code(read_code(code)?), Vec::new()));
        }
        let Some(bank) = &self.bank else { return Err(self.without_bank(model)) };
        let mut notices = Vec::from_iter(check_bank(bank, model)?);
        let knowledge = match (&self.field, self.angle, &self.psf) {
            (Some(field), ..) => self.read_field(bank, field, &mut notices)?,
            (None, Some(Angle::Search), _) => self.read_search(bank)?.0,
            (None, Some(Angle::Degrees(angle)), _) => {
                let code = interpolate_code(&read_bank_codes(bank)?, angle);
                let what = || format!("finding the code of {angle}° in {}", bank.display());
                KernelKnowledge::Code(code.map_err(|error| error.while_doing(what()))?)
            }
            (None, None, Some(psf)) => {
                let reading = inspect_psf(psf, self.psf_options)?;
                let code = projected(bank, &read_bank(bank)?, &reading, &mut notices)?;
                KernelKnowledge::Psf { psf: Arc::new(reading.psf), code: Some(code) }
            }
            (None, None, None) => {
                let advice = "--bank holds a code for every angle: add --angle A, --angle auto, or --psf PSF for a measured panel";
                return Err(Error::Unsupported(advice.to_owned()));
            }
        };
        Ok((knowledge, notices))
    }

    /// Reads the PSF for a deconvolution, with what is to be told of its file.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when none is named; those of [`inspect_psf`].
    pub fn read_psf(&self) -> Result<(KernelKnowledge, Vec<Notice>)> {
        let Some(path) = &self.psf else {
            return Err(Error::Unsupported("name a --model, or a --method with its --psf".to_owned()));
        };
        let reading = inspect_psf(path, self.psf_options)?;
        let notices = Notice::of_psf(&reading);
        Ok((KernelKnowledge::of_psf(reading.psf), notices))
    }

    /// Reads the PSF, or, where none is named, takes that of a bank at the panel's angle, or the bank where that is to be found, with
    /// what is to be told of the files.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when neither is named; those of [`read_psf`](Self::read_psf), [`read_bank`] and of turning a PSF.
    pub fn read_any_psf(&self) -> Result<(KernelKnowledge, Vec<Notice>)> {
        if self.field.is_some() {
            let advice = "the guided restoration takes one PSF for all of the frame, and --field tells models of their own the codes at \
                          several places: name the PSF of the middle with --psf, or a --model with its --bank";
            return Err(Error::Unsupported(advice.to_owned()));
        }
        let (bank, angle) = match (&self.psf, &self.bank, self.angle) {
            (Some(_), ..) => return self.read_psf(),
            (None, Some(bank), Some(Angle::Degrees(angle))) => (bank, angle),
            (None, Some(bank), Some(Angle::Search)) => return self.read_search(bank),
            (None, Some(_), None) => {
                let advice = "the guided restoration needs the PSF itself: add --angle DEGREES, at which --bank has one, \
                              --angle auto, or name it with --psf";
                return Err(Error::Unsupported(advice.to_owned()));
            }
            (None, None, _) => {
                let advice = "the guided restoration needs the panel's PSF: name it with --psf, or a --bank with --angle; \
                              otherwise name a --model of your own";
                return Err(Error::Unsupported(advice.to_owned()));
            }
        };
        let (kernels, bank) = (read_bank(bank)?, bank.display());
        let TurnedKernel { psf, nearest_deg, turned_deg, beyond } = TurnedKernel::of(&kernels, angle)
            .map_err(|error| error.while_doing(format!("taking the kernel of {angle}° of {bank}")))?;
        let turned = turned_deg.map(|turned_deg| {
            Notice::Detail(format!("turns the kernel of {nearest_deg}° in {bank} by {turned_deg:.3}°"))
        });
        let beyond = beyond.map(|[low, high]| {
            Notice::Warning(format!(
                "{angle}° is outside of {bank}, which has kernels from {low}° to {high}°: the nearest is turned further; check \
                 --angle"
            ))
        });
        Ok((KernelKnowledge::of_psf(psf), turned.into_iter().chain(beyond).collect()))
    }

    fn read_search(&self, bank: &Path) -> Result<(KernelKnowledge, Vec<Notice>)> {
        let sha256 = bank_sha256(bank)?;
        Ok((KernelKnowledge::Search { bank: Arc::new(read_bank(bank)?), sha256 }, Vec::new()))
    }

    /// Bytes that a bank which is read whole takes: it is there twice, as a file and as kernels.
    pub(super) fn bank_bytes(&self) -> u64 {
        let reads_all = self.angle == Some(Angle::Search) || self.psf.is_some();
        let bank = self.bank.as_ref().filter(|_| reads_all);
        bank.and_then(|bank| bank.metadata().ok()).map_or(0, |file| 2 * file.len())
    }

    fn read_field(&self, bank: &Path, field: &Path, notices: &mut Vec<Notice>) -> Result<KernelKnowledge> {
        let (grid, psfs) = read_field(field)?;
        let kernels = read_bank(bank)?;
        let code = |psf: &PathBuf| {
            let of_field = |error: Error| error.while_doing(format!("reading the field {}", field.display()));
            let reading = inspect_psf(psf, self.psf_options).map_err(of_field)?;
            projected(bank, &kernels, &reading, notices).map_err(of_field)
        };
        Ok(KernelKnowledge::Field { grid, codes: psfs.iter().map(code).collect::<Result<_>>()? })
    }

    fn without_bank(&self, model: &Model) -> Error {
        Error::Unsupported(match &self.psf {
            Some(_) => "the model needs the code of the PSF: add --bank BANK, the bank it was trained with"
                .to_owned(),
            None => format!(
                "the model needs a kernel code of {} numbers: add --bank BANK with --angle A or --psf PSF, or \
                 --code CODE.npy",
                model.architecture().code_len().unwrap_or_default()
            ),
        })
    }
}

fn without_psf() -> Error {
    Error::config("psf", "a deconvolution needs the PSF itself")
}

/// The code of a PSF in a bank; what is to be told of both goes to `notices`.
fn projected(
    bank: &Path,
    kernels: &KernelBank,
    reading: &PsfReading,
    notices: &mut Vec<Notice>,
) -> Result<KernelCode> {
    notices.extend(Notice::of_psf(reading));
    let (bank, psf) = (bank.display(), reading.path.display());
    let projection = project(kernels, &reading.psf)
        .map_err(|error| error.while_doing(format!("projecting {psf} onto {bank}")))?;
    notices.push(Notice::Detail(format!(
        "{psf} is nearest to {}, {:.3} % outside of the bank",
        kernels.kernel_name(projection.nearest),
        100.0 * projection.residual_l2
    )));
    if !projection.fits() {
        notices.push(Notice::Warning(format!(
            "{:.2} % of {psf} lies outside of what {bank} can describe ({:.2} % is its own spread): the model may \
             restore badly; train one with a bank of this PSF",
            100.0 * projection.residual_l2,
            100.0 * projection.limit_l2
        )));
    }
    Ok(projection.code)
}

fn check_bank(bank: &Path, model: &Model) -> Result<Option<Notice>> {
    let Some(expected) = &model.origin().kernel_bank_sha256 else { return Ok(None) };
    Ok((!is_bank_of_sha256(bank, expected)?).then(|| {
        Notice::Warning(format!(
            "{} is not the bank that the model was trained with (SHA-256 {}…): its codes may mean something else",
            bank.display(),
            expected.get(..12).unwrap_or(expected)
        ))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn a_description_tells_banks_and_grids_apart() {
        let psf = Psf::from_energy(Array3::ones((3, 3, 3))).unwrap();
        let bank = Arc::new(KernelBank::single(psf));
        let search =
            |sha256: &str| KernelKnowledge::Search { bank: Arc::clone(&bank), sha256: sha256.to_owned() };
        assert_ne!(search("a").describe(), search("b").describe());
        let field = |rows, columns| KernelKnowledge::Field {
            grid: FieldGrid::new(rows, columns).unwrap(),
            codes: vec![KernelCode::zeros(2); 4],
        };
        assert_ne!(field(2, 2).describe(), field(1, 4).describe());
    }
}
