//! Reads and writes PSFs as image files, and says what is wrong with those that are read.

mod faults;
mod floor;
mod levels;
mod lone;
mod noise;
mod place;

use std::path::{Path, PathBuf};

use super::read::{check_cooked, check_domain, to_rgb};
use super::{DomainTag, WriteOptions, read_pixels, write_image};
use crate::core::error::{Error, Result};
use crate::core::image::{Domain as _, Image, Linear};
use crate::core::psf::Psf;

pub use faults::PsfFaults;
use noise::without_noise;
use place::recenter;
pub use place::{PsfMove, show_shift};

/// How a PSF is read.
#[derive(Clone, Copy, Debug)]
pub struct PsfOptions {
    /// What the user says that the values are.
    pub domain: Option<DomainTag>,
    /// The flag that says it.
    pub domain_flag: &'static str,
    /// Whether a peak that is off the centre is moved there.
    pub recenter: bool,
}

impl Default for PsfOptions {
    fn default() -> Self {
        Self { domain: None, domain_flag: "--domain", recenter: false }
    }
}

/// A PSF with what was found in its file.
#[derive(Clone, Debug)]
pub struct PsfReading {
    /// The file.
    pub path: PathBuf,
    /// The PSF, non-negative and of unit sum.
    pub psf: Psf,
    /// What is wrong with the file as a PSF.
    pub faults: PsfFaults,
    /// How it was moved to bring its peak to the centre.
    pub moved: Option<PsfMove>,
    /// What the file says and its reading does not heed.
    pub doubts: Vec<String>,
    /// What the file says of its colours against what the user says.
    pub contradiction: Option<String>,
    /// Whether the file has one channel, which was taken for all colours.
    pub is_grey: bool,
}

impl PsfReading {
    /// What the user should know, a sentence each; nothing of a PSF without fault.
    pub fn warnings(&self) -> Vec<String> {
        let faults = self.faults.describe().map(|faults| format!("{}: {faults}", self.path.display()));
        let found = faults.into_iter().chain(self.doubts.iter().cloned());
        found.chain(self.contradiction.clone()).collect()
    }

    /// What is to be told of a PSF of one channel.
    pub fn describe_grey(&self) -> Option<String> {
        self.is_grey.then(|| {
            format!(
                "{}: it has one channel, which is taken for all colours, as of a monochrome camera; the orders of red lie further out than \
                 those of blue, so that captures in colour need a PSF of three",
                self.path.display()
            )
        })
    }

    /// How it was moved, where it was, and what light that cost.
    pub fn describe_move(&self) -> Option<(String, Option<String>)> {
        let (moved, path) = (self.moved?, self.path.display());
        let by = show_shift(moved.by);
        let how = if moved.is_rolled {
            format!(
                "{path}: it is in the layout of a Fourier transform, which begins with the centre; it was rolled to the \
                 middle, {by}, and nothing was lost"
            )
        } else {
            format!("{path}: its peak was moved to the centre, {by}")
        };
        let lost = moved.lost_in_words();
        let lost = lost.map(|lost| {
            format!("{path}: {lost} of its light left the frame as its peak was moved to the centre")
        });
        Some((how, lost))
    }
}

/// Reads a PSF from an image file, non-negative and of unit sum, without a word on what was wrong with it.
///
/// # Errors
/// As [`inspect_psf`].
pub fn read_psf(path: &Path) -> Result<Psf> {
    inspect_psf(path, PsfOptions::default()).map(|reading| reading.psf)
}

/// Reads a PSF from an image file, and finds what is wrong with it.
///
/// # Errors
/// As [`read_image`](super::read_image) of linear values; [`Error::Format`] when a value is not finite, a channel holds no
/// light, or moving the peak to the centre would lose much of it.
pub fn inspect_psf(path: &Path, options: PsfOptions) -> Result<PsfReading> {
    let mut pixels = read_pixels(path)?;
    // Around a PSF is darkness.
    pixels.without_data = 0;
    let doubts = pixels.take_doubts(path);
    let contradiction = pixels.tell(path, options.domain)?;
    check_domain(path, pixels.domain, Linear::NAME)?;
    check_cooked(path, &pixels)?;
    let flag = options.domain_flag;
    pixels.check_told_by(path, &format!("{flag} linear or {flag} srgb"))?;
    let is_grey = pixels.planes.dim().0 == 1;
    let planes = to_rgb(path, pixels.planes)?;
    let in_file = |error: Error| Error::format(path, error.to_string());
    let mut faults = PsfFaults::of(&planes).map_err(in_file)?;
    let (planes, moved) = if options.recenter { recenter(planes).map_err(in_file)? } else { (planes, None) };
    if moved.is_some() {
        // What lies at the edge, too, is known where the peak is in the middle.
        let PsfFaults { shifts, floors, lone, .. } = PsfFaults::of(&planes).map_err(in_file)?;
        (faults.shifts, faults.floors, faults.lone) = (shifts, floors, lone);
    }
    faults.recentered = options.recenter;
    let psf = Psf::from_energy(without_noise(planes, faults.noise)).map_err(in_file)?;
    Ok(PsfReading { path: path.to_owned(), psf, faults, moved, doubts, contradiction, is_grey })
}

/// Writes a PSF as an image file of linear values.
///
/// # Errors
/// As [`write_image`].
pub fn write_psf(path: &Path, psf: &Psf, options: &WriteOptions) -> Result<()> {
    let image = Image::<Linear>::from_planes(psf.planes().to_owned())?;
    write_image(path, &image, options)
}
