//! `udc psf`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;

use super::Session;
use udc::core::error::Error;
use udc::core::provenance::Provenance;
use udc::io::{Format, WriteOptions, check_output, write_psf};
use udc::psf::{DisplayConfig, simulate_psf};

/// Simulate a PSF from a display layout by light propagation
#[derive(Args, Debug)]
#[command(after_help = "Example: udc psf --display configs/display/pentile.toml -o psf.exr\n\n\
    The display file describes source, panel, lens, sensor and light; the files in configs/display/ explain its \
    keys. Rows of the PSF run down and columns to the right as the camera shows its pictures")]
pub(crate) struct PsfArgs {
    /// Display file (TOML)
    #[arg(long, value_name = "FILE")]
    display: PathBuf,
    /// PSF to write (.exr, .npy)
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Side of the square PSF in pixels, instead of the display file's
    #[arg(long, value_name = "N")]
    size: Option<usize>,
}

impl PsfArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let doing = || format!("simulating the PSF of {}", self.display.display());
        let config = DisplayConfig::read(&self.display, self.size).with_context(doing)?;
        check_float_output(&self.output)?;
        check_output(&self.output, session.overwrite)?;
        if config.display.is_featureless() {
            session.warn(format_args!(
                "the panel of {} has no sub-pixels, openings or wiring: its PSF is that of the bare lens",
                self.display.display()
            ));
        }
        let simulated = simulate_psf(&config, &session.progress).with_context(doing)?;
        session.detail(simulated.geometry_in_words());
        let provenance = Some(Provenance::new("psf", &config));
        let options = WriteOptions { overwrite: session.overwrite, provenance, ..WriteOptions::default() };
        write_psf(&self.output, &simulated.psf, &options)?;
        let (output, psf) = (self.output.display(), &simulated.psf);
        session.say(format_args!("{output}: PSF of {} × {}", psf.width(), psf.height()))?;
        simulated.summary().into_iter().try_for_each(|line| session.say(line))
    }
}

/// Refuses integer formats: a PSF's sidelobes are far below their steps.
pub(crate) fn check_float_output(path: &Path) -> udc::core::error::Result<()> {
    match Format::of_extension(path)? {
        Format::Exr | Format::Npy | Format::Hdr => Ok(()),
        format => Err(Error::format(
            path,
            format!("{} holds integers, too coarse for a PSF; write .exr or .npy", format.name()),
        )),
    }
}
