//! `udc psf`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;
use serde::Serialize;
use serde_json::json;

use super::psf_file::PsfFileArgs;
use super::{Session, misuse, text_of};
use udc::batch::check_kept;
use udc::codes::MeasurementErrors;
use udc::core::error::Error;
use udc::core::provenance::Provenance;
use udc::core::psf::Psf;
use udc::core::rng::stream;
use udc::io::{Format, WriteOptions, check_extension, check_output, write_psf};
use udc::psf::{DisplayConfig, SimulatedPsf, random_display, simulate_psf};

/// Simulate a PSF from a display layout by light propagation
///
/// The panel is that of a display file or drawn at random. With the flags of a measurement's errors, the PSF is what a
/// measurement of it would hand over; --from gives such errors to a PSF that there is.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  udc psf --display configs/display/pentile.toml -o psf.exr\n  \
    udc psf --random 7 --display-out panel.toml -o psf.exr\n  \
    udc psf --from psf.exr --turn 0.3 --scale 0.005 --noise 1e-5 -o measured.exr\n\n\
    The display file describes source, panel, lens, sensor and light; the files in configs/display/ explain its \
    keys. Rows of the PSF run down and columns to the right as the camera shows its pictures")]
pub(crate) struct PsfArgs {
    #[command(flatten)]
    source: SourceArgs,
    /// PSF to write (.exr, .npy)
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Side of the square PSF in pixels, instead of the display file's, or of the 401 of a random panel
    #[arg(long, value_name = "N", conflicts_with = "from")]
    size: Option<usize>,
    /// Also write the display file of the random panel (.toml), for --display of this command and of `udc codes`
    #[arg(long, value_name = "FILE", requires = "random", conflicts_with_all = ["display", "from"])]
    display_out: Option<PathBuf>,
    #[command(flatten)]
    psf_file: PsfFileArgs,
    #[command(flatten)]
    errors: ErrorArgs,
}

/// Where the PSF comes from.
#[derive(Args, Debug)]
#[group(required = true, multiple = false)]
struct SourceArgs {
    /// Display file (TOML)
    #[arg(long, value_name = "FILE")]
    display: Option<PathBuf>,
    /// Draw a plausible panel with lens, sensor and light at random: the same for the same seed
    #[arg(long, value_name = "SEED")]
    random: Option<u64>,
    /// A PSF that there is, to give it a measurement's errors
    #[arg(long, value_name = "PSF", requires = "errors")]
    from: Option<PathBuf>,
}

/// By how much the PSF differs from the true one, as a measured one does.
#[derive(Args, Debug)]
#[group(id = "errors", multiple = true)]
#[command(next_help_heading = "Errors of a measurement")]
struct ErrorArgs {
    /// Turned by so many degrees, counter-clockwise
    #[arg(long, value_name = "DEG", allow_hyphen_values = true)]
    turn: Option<f64>,
    /// Larger by this share: 0.005 is half a percent
    #[arg(long, value_name = "SHARE", allow_hyphen_values = true)]
    scale: Option<f64>,
    /// Out of focus: blurred by this standard deviation in pixels
    #[arg(long, value_name = "PX")]
    defocus: Option<f64>,
    /// Noise of this standard deviation where it is dark, as a share of the brightest pixel, and the photon noise that
    /// goes with it
    #[arg(long, value_name = "SHARE")]
    noise: Option<f64>,
    /// Cut off: only a square of this side was measured
    #[arg(long, value_name = "PX")]
    reach: Option<usize>,
    /// What decides the noise
    #[arg(long, value_name = "SEED", default_value_t = 0, requires = "noise")]
    seed: u64,
}

/// What the PSF's file says of its origin: the display's own keys, or the file that it was read from.
#[derive(Serialize)]
#[serde(rename_all = "kebab-case")]
struct Origin<'a> {
    #[serde(flatten)]
    display: Option<&'a DisplayConfig>,
    #[serde(skip_serializing_if = "Option::is_none")]
    random: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    from: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    errors: Option<OriginOfErrors>,
}

#[derive(Serialize)]
struct OriginOfErrors {
    #[serde(flatten)]
    errors: MeasurementErrors,
    seed: u64,
}

impl PsfArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        if self.psf_file.is_given() && self.source.from.is_none() {
            return Err(misuse("psf", "--domain and --recenter are for a PSF that is read with --from"));
        }
        check_float_output(&self.output)?;
        check_output(&self.output, session.overwrite)?;
        check_kept(std::slice::from_ref(&self.output), self.source.from.as_slice())?;
        let display = self.display()?;
        if let (Some(file), Some(display)) = (&self.display_out, &display) {
            check_extension(file, "toml")?;
            check_output(file, session.overwrite)?;
            display.check()?;
        }
        let (psf, simulated) = match &display {
            Some(display) => {
                let simulated = self.simulate(display, session)?;
                (simulated.psf.clone(), Some(simulated))
            }
            None => {
                (self.psf_file.read(self.source.from.as_deref().unwrap_or(Path::new("")), session)?, None)
            }
        };
        let errors = self.errors.config();
        let psf = errors
            .apply(&psf, &mut stream(self.errors.seed, "psf/errors"))
            .context("giving the PSF the errors of a measurement")?;
        self.write(session, display.as_ref(), &psf)?;
        session.results_of(json!({
            "output": text_of(&self.output), "width": psf.width(), "height": psf.height(), "psf-sha256": psf.sha256(),
        }));
        session.say(format_args!("{}: PSF of {} × {}", self.output.display(), psf.width(), psf.height()))?;
        let lines = simulated.map_or(Vec::new(), |simulated| simulated.summary());
        lines.into_iter().try_for_each(|line| session.say(line))
    }

    /// The display to simulate, where it is one.
    fn display(&self) -> Result<Option<DisplayConfig>> {
        match (&self.source.display, self.source.random) {
            (Some(file), _) => {
                let config = DisplayConfig::read(file, self.size);
                config.map(Some).with_context(|| format!("simulating the PSF of {}", file.display()))
            }
            (None, Some(seed)) => {
                let mut display = random_display(seed);
                display.sensor.size_px = self.size.unwrap_or(display.sensor.size_px);
                Ok(Some(display))
            }
            (None, None) => Ok(None),
        }
    }

    fn simulate(&self, display: &DisplayConfig, session: &Session) -> Result<SimulatedPsf> {
        let what = match (&self.source.display, self.source.random) {
            (Some(file), _) => file.display().to_string(),
            (None, seed) => format!("random panel {}", seed.unwrap_or_default()),
        };
        if display.display.is_featureless() {
            session.warn(format_args!(
                "the panel of {what} has no sub-pixels, openings or wiring: its PSF is that of the bare lens"
            ));
        }
        if let Some(pixels) = display.too_few_pixels() {
            session.warn(format_args!(
                "the aperture of {what} spans {pixels:.2} pixels of its panel, so that hardly anything is repeated before the lens: \
                 display.pitch-um is in micrometres, optics.aperture-mm in millimetres"
            ));
        }
        session.configured(display);
        let simulated = simulate_psf(display, &session.progress)
            .with_context(|| format!("simulating the PSF of {what}"))?;
        session.detail(simulated.geometry_in_words());
        Ok(simulated)
    }

    fn write(&self, session: &Session, display: Option<&DisplayConfig>, psf: &Psf) -> Result<()> {
        let errors = self.errors.config();
        let origin = Origin {
            display,
            random: self.source.random,
            from: self.source.from.as_deref().map(text_of),
            errors: (!errors.is_none()).then_some(OriginOfErrors { errors, seed: self.errors.seed }),
        };
        let provenance = Some(Provenance::new("psf", &origin));
        let options = WriteOptions { overwrite: session.overwrite, provenance, ..WriteOptions::default() };
        write_psf(&self.output, psf, &options)?;
        if let (Some(file), Some(display)) = (&self.display_out, display) {
            display.write(file, session.overwrite)?;
            session.say(format_args!(
                "{}: display file of a {} panel",
                file.display(),
                display.display.kind.name()
            ))?;
        }
        Ok(())
    }
}

impl ErrorArgs {
    fn config(&self) -> MeasurementErrors {
        MeasurementErrors {
            turn_deg: self.turn.unwrap_or_default(),
            scale: self.scale.unwrap_or_default(),
            defocus_px: self.defocus.unwrap_or_default(),
            noise: self.noise.unwrap_or_default(),
            reach_px: self.reach,
        }
    }
}

/// Refuses formats of few bits: a PSF's sidelobes are far below the steps of integers, and a shared exponent leaves 8 bits.
pub(crate) fn check_float_output(path: &Path) -> udc::core::error::Result<()> {
    match Format::of_extension(path)? {
        Format::Exr | Format::Npy => Ok(()),
        format => {
            Err(Error::format(path, format!("{} is too coarse for a PSF; write .exr or .npy", format.name())))
        }
    }
}
