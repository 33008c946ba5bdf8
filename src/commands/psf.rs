//! `udc psf`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;

use super::Session;
use udc::core::error::Error;
use udc::core::provenance::Provenance;
use udc::io::{Format, WriteOptions, check_output, read_text, write_psf};
use udc::psf::{DisplayConfig, SimulatedPsf, assess_psf, simulate_psf};

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
        let config = read_display(&self.display, self.size).with_context(doing)?;
        check_float_output(&self.output)?;
        check_output(&self.output, session.overwrite)?;
        if config.display.is_featureless() {
            session.warn(format_args!(
                "the panel of {} has no sub-pixels, openings or wiring: its PSF is that of the bare lens",
                self.display.display()
            ));
        }
        let simulated = simulate_psf(&config, &session.progress).with_context(doing)?;
        session.detail(format_args!(
            "grid of {0} × {0} points, {1:.3} µm apart; sensor {2:.4} mm behind the lens; arrays of {3} MiB",
            simulated.grid.size,
            simulated.grid.pitch_m * 1e6,
            simulated.optics.sensor_distance_m * 1e3,
            simulated.memory_bytes >> 20
        ));
        let provenance = Some(Provenance::new("psf", &config));
        let options = WriteOptions { overwrite: session.overwrite, provenance, ..WriteOptions::default() };
        write_psf(&self.output, &simulated.psf, &options)?;
        session.say(summary(&simulated, &self.output))
    }
}

/// Reads a display file, with another size of the PSF where one is asked for.
pub(crate) fn read_display(path: &Path, size: Option<usize>) -> udc::core::error::Result<DisplayConfig> {
    let mut config = DisplayConfig::parse(&read_text(path)?, path)?;
    if let Some(size) = size {
        config.sensor.size_px = size;
    }
    config.check()?;
    Ok(config)
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

fn summary(simulated: &SimulatedPsf, output: &Path) -> String {
    let psf = &simulated.psf;
    let mut text = format!("{}: PSF of {} × {}\n", output.display(), psf.width(), psf.height());
    text += "channel  passes panel  outside window  in peak pixel  50 / 90 / 99 % within px";
    let rows = ["red", "green", "blue"].into_iter().zip(&simulated.light);
    for ((name, light), quality) in rows.zip(&assess_psf(psf).channels) {
        let [half, most, all] = quality.encircled_px;
        text += &format!(
            "\n{name:7}  {:10.1} %  {:12.2} %  {:11.2} %  {half:8.1} / {most:.1} / {all:.1}",
            100.0 * light.transmitted,
            100.0 * light.outside,
            100.0 * quality.peak_share
        );
    }
    text
}
