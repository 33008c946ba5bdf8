//! `udc fuse`.

mod summary;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};
use ndarray::{Array2, Array3};
use serde_json::json;

use super::Session;
use super::bracket::{BracketArgs, Pictures, names_of};
use super::capture::{info_of, note_what_is_lost, uncorrected};
use super::domain::SceneDomainArgs;
use super::psf::check_float_output;
use udc::capture::{FuseConfig, fuse, relative_times};
use udc::core::provenance::Provenance;
use udc::io::{WriteOptions, check_output, expand_inputs, read_pixels, write_image, write_psf};
use udc::psf::{MeasureConfig, Normalization, measure_psf};

use summary::Summary;

/// Fuse a bracket of exposures to one linear HDR image or PSF
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc fuse --exposures 1,1/32,1/768 long.exr middle.exr short.exr -o psf.exr --psf\n\n\
    Give the times in the order of the files; files of one time are averaged. Levels above 1 are in the integers of the file: --white 16383 \
    --black 64 for 14 bits in a 16-bit PNG. DNGs say times, levels, mosaic and gains themselves"
)]
pub(crate) struct FuseArgs {
    /// Pictures of the bracket; a folder or pattern stands for its files by name
    #[arg(value_name = "IN", required = true)]
    inputs: Vec<PathBuf>,
    /// Image to write
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    #[command(flatten)]
    bracket: BracketArgs,
    #[command(flatten)]
    scene: SceneDomainArgs,
    /// Picture that is black where pixels are to be discarded and filled from their neighbours
    #[arg(long, value_name = "MASK")]
    mask: Option<PathBuf>,
    /// Cut out the PSF: background subtracted, main peak centred, cropped, normalised
    #[arg(long)]
    psf: bool,
    /// Side of the square PSF in pixels [default: 800]
    #[arg(long, value_name = "N", requires = "psf")]
    size: Option<usize>,
    /// What of the PSF sums to one [default: channel]
    #[arg(long, value_enum, value_name = "WHAT", requires = "psf")]
    normalize: Option<Normalize>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Normalize {
    Channel,
    Total,
    None,
}

impl FuseArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let files = expand_inputs(&self.inputs)?;
        let doing = || format!("fusing bracket {}", names_of(&files));
        if self.psf {
            check_float_output(&self.output)?;
        }
        check_output(&self.output, session.overwrite)?;
        let measure = self.psf.then(|| self.measure_config());
        measure.as_ref().map_or(Ok(()), MeasureConfig::check)?;

        let mut pictures = self.bracket.read(&files, self.scene.told(), session).with_context(doing)?;
        let times = self.times(&pictures).with_context(doing)?;
        let mask = self.mask.as_deref().map(read_mask).transpose()?;
        let mut bracket = self.bracket.join(&mut pictures, &times).with_context(doing)?;
        if let Some(mask) = &mask {
            bracket = bracket.with_mask(mask.clone()).with_context(doing)?;
        }
        let config = FuseConfig { demosaic_linear: self.psf, ..pictures.config };
        session.progress.check()?;
        let fused = session.timed("fusing", || fuse(bracket, &config)).with_context(doing)?;
        session.progress.check()?;
        let measured = measure.as_ref().map(|measure| measure_psf(&fused.image, mask.as_ref(), measure));
        let measured = measured.transpose().with_context(doing)?;
        session.progress.check()?;

        let resolved =
            json!({"inputs": files, "exposures": relative_times(&times), "fuse": config, "psf": measure});
        let provenance = Some(Provenance::new("fuse", &resolved));
        let raw = pictures.raw.as_ref();
        let info = measured.is_none().then(|| info_of(&fused, raw, config.white_balance));
        if let Some(info) = &info {
            note_what_is_lost(&self.output, info, session);
        }
        if let Some(warning) = raw.and_then(uncorrected) {
            session.warn(warning);
        }
        let options = WriteOptions {
            overwrite: session.overwrite,
            provenance,
            capture: info,
            ..WriteOptions::default()
        };
        match (&measured, &measure) {
            (Some(measured), Some(MeasureConfig { normalize: Normalization::Channel, .. })) => {
                write_psf(&self.output, &measured.psf, &options)?;
            }
            (Some(measured), _) => write_image(&self.output, &measured.image, &options)?,
            (None, _) => write_image(&self.output, &fused.image, &options)?,
        }
        let summary = Summary { output: &self.output, fused: &fused, measured: measured.as_ref() };
        summary.warnings().into_iter().for_each(|warning| session.warn(warning));
        session.say(if self.json { summary.json().to_string() } else { summary.text() })
    }

    /// The exposures of the flag, else of the files, else those that are published.
    fn times(&self, pictures: &Pictures) -> Result<Vec<f64>> {
        if let Some(times) = &self.bracket.exposures {
            return Ok(times.clone());
        }
        match pictures.told_times()? {
            Some(times) => Ok(times.to_vec()),
            None => self.default_times(pictures.planes.len()),
        }
    }

    /// The published exposures; a picture alone is the longest exposure.
    fn default_times(&self, pictures: usize) -> Result<Vec<f64>> {
        let times = if self.psf { PSF_BRACKET } else { SCENE_BRACKET };
        match pictures {
            1 => Ok(vec![1.0]),
            _ if pictures == times.len() => Ok(times.to_vec()),
            _ => bail!(
                "{pictures} pictures do not say their exposure times, and a published bracket has {}: add --exposures \
                 T,T,… in the order of the files",
                times.len()
            ),
        }
    }

    fn measure_config(&self) -> MeasureConfig {
        let default = MeasureConfig::default();
        MeasureConfig {
            size: self.size.unwrap_or(default.size),
            normalize: self.normalize.map_or(default.normalize, Normalization::from),
        }
    }
}

/// The exposures of the paper's PSF bracket.
const PSF_BRACKET: [f64; 3] = [1.0, 1.0 / 32.0, 1.0 / 768.0];

/// The exposures of the paper's scene bracket.
const SCENE_BRACKET: [f64; 3] = [1.0, 1.0 / 4.0, 1.0 / 16.0];

/// Good pixels of a picture that is no light: it is black where pixels are to be discarded.
fn read_mask(file: &Path) -> udc::core::error::Result<Array2<bool>> {
    let planes: Array3<f32> = read_pixels(file)?.planes;
    let (_, height, width) = planes.dim();
    let good = |place: (usize, usize)| planes.outer_iter().all(|plane| plane[place] >= 0.5);
    Ok(Array2::from_shape_fn((height, width), good))
}

impl From<Normalize> for Normalization {
    fn from(normalize: Normalize) -> Self {
        match normalize {
            Normalize::Channel => Self::Channel,
            Normalize::Total => Self::Total,
            Normalize::None => Self::None,
        }
    }
}
