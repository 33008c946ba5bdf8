//! `udc fuse`.

mod summary;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};
use ndarray::{Array2, Array3};
use serde_json::json;

use super::Session;
use super::psf::check_float_output;
use udc::core::error::Error;
use udc::core::io::{
    DomainTag, Pixels, WriteOptions, check_output, expand_inputs, read_pixels, write_image, write_psf,
};
use udc::core::provenance::Provenance;
use udc::psf::bayer::BayerPattern;
use udc::psf::{Bracket, FuseConfig, MeasureConfig, MergeRule, Normalization, fuse, measure_psf};

use summary::Summary;

/// Fuse a bracket of exposures to one linear HDR image or PSF
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc fuse --exposures 1,1/32,1/768 long.exr middle.exr short.exr -o psf.exr --psf\n\n\
    Give the times in the order of the files. Levels may be fractions too: --white 16383/65535 for 14 bits in a \
    16-bit PNG, which is read as 0 to 1"
)]
pub(crate) struct FuseArgs {
    /// Pictures of the bracket; a folder or pattern stands for its files by name
    #[arg(value_name = "IN", required = true)]
    inputs: Vec<PathBuf>,
    /// Image to write
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Exposure times, in the order of the files [default: those in the files, else 1,1/32,1/768]
    #[arg(long, value_name = "T,T,…", value_delimiter = ',', value_parser = parse_fraction)]
    exposures: Option<Vec<f64>>,
    /// Value of a full photosite [default: 1]
    #[arg(long, value_name = "W", value_parser = parse_fraction)]
    white: Option<f64>,
    /// Value of a dark photosite [default: 0]
    #[arg(long, value_name = "B", value_parser = parse_fraction)]
    black: Option<f64>,
    /// Take the longest unsaturated exposure, or the mean of all weighted by time [default: longest]
    #[arg(long, value_enum, value_name = "RULE")]
    merge: Option<Merge>,
    /// Colours of the first two rows of a mosaic
    #[arg(long, value_enum, value_name = "PATTERN")]
    bayer: Option<Bayer>,
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
enum Merge {
    Longest,
    Weighted,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Bayer {
    Rggb,
    Bggr,
    Grbg,
    Gbrg,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Normalize {
    Channel,
    Total,
    None,
}

/// Reads `0.5`, `1/32`, `16383/65535`.
pub(crate) fn parse_fraction(text: &str) -> std::result::Result<f64, String> {
    let number = |part: &str| part.trim().parse::<f64>().ok().filter(|value| value.is_finite());
    let value = match text.split_once('/') {
        Some((above, below)) => number(above).zip(number(below)).map(|(above, below)| above / below),
        None => number(text),
    };
    value
        .filter(|value| value.is_finite())
        .ok_or_else(|| "write a number or a fraction such as 1/32".to_owned())
}

impl FuseArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let files = expand_inputs(&self.inputs)?;
        let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
        let doing = || format!("fusing bracket {}", names.join(" "));
        if self.psf {
            check_float_output(&self.output)?;
        }
        check_output(&self.output, session.overwrite)?;

        let pictures =
            files.iter().map(|file| read_linear(file)).collect::<Result<Vec<_>, _>>().with_context(doing)?;
        let times = self.exposures.clone().unwrap_or_else(|| times_of_files(&pictures));
        let mask = self.mask.as_deref().map(read_mask).transpose()?;
        let mut bracket = Bracket::new(pictures.into_iter().map(|picture| picture.planes).collect(), &times)
            .with_context(doing)?;
        if let Some(mask) = &mask {
            bracket = bracket.with_mask(mask.clone()).with_context(doing)?;
        }
        let config = self.fuse_config();
        let fused = fuse(&bracket, &config).with_context(doing)?;
        let measure = self.psf.then(|| self.measure_config());
        let measured = measure.as_ref().map(|measure| measure_psf(&fused.image, mask.as_ref(), measure));
        let measured = measured.transpose().with_context(doing)?;

        let resolved = json!({"inputs": names, "exposures": times, "fuse": config, "psf": measure});
        let provenance = Some(Provenance::new("fuse", &resolved));
        let options = WriteOptions { overwrite: session.overwrite, provenance, ..WriteOptions::default() };
        match (&measured, &measure) {
            (Some(measured), Some(MeasureConfig { normalize: Normalization::Channel, .. })) => {
                write_psf(&self.output, &measured.psf, &options)?;
            }
            (Some(measured), _) => write_image(&self.output, &measured.image, &options)?,
            (None, _) => write_image(&self.output, &fused.image, &options)?,
        }
        let summary = Summary {
            output: &self.output,
            times: &bracket.times(),
            fused: &fused,
            measured: measured.as_ref(),
        };
        summary.warnings().into_iter().for_each(|warning| session.warn(warning));
        session.say(if self.json { summary.json().to_string() } else { summary.text() })
    }

    fn fuse_config(&self) -> FuseConfig {
        let default = FuseConfig::default();
        FuseConfig {
            white: self.white.unwrap_or(default.white),
            black: self.black.unwrap_or(default.black),
            merge: self.merge.map_or(default.merge, MergeRule::from),
            bayer: self.bayer.map(BayerPattern::from),
            ..default
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

fn times_of_files(pictures: &[Pixels]) -> Vec<f64> {
    pictures
        .iter()
        .map(|picture| picture.exposure_s)
        .collect::<Option<_>>()
        .unwrap_or_else(|| PSF_BRACKET.to_vec())
}

fn read_linear(file: &Path) -> udc::core::error::Result<Pixels> {
    let pixels = read_pixels(file)?;
    if pixels.domain == Some(DomainTag::ToneMapped) {
        let reason = "holds tone-mapped values, which add up to nothing; use the linear pictures";
        return Err(Error::format(file, reason));
    }
    Ok(pixels)
}

fn read_mask(file: &Path) -> udc::core::error::Result<Array2<bool>> {
    let planes: Array3<f32> = read_pixels(file)?.planes;
    let (_, height, width) = planes.dim();
    let good = |place: (usize, usize)| planes.outer_iter().all(|plane| plane[place] >= 0.5);
    Ok(Array2::from_shape_fn((height, width), good))
}

impl From<Merge> for MergeRule {
    fn from(merge: Merge) -> Self {
        match merge {
            Merge::Longest => Self::Longest,
            Merge::Weighted => Self::Weighted,
        }
    }
}

impl From<Bayer> for BayerPattern {
    fn from(bayer: Bayer) -> Self {
        match bayer {
            Bayer::Rggb => Self::Rggb,
            Bayer::Bggr => Self::Bggr,
            Bayer::Grbg => Self::Grbg,
            Bayer::Gbrg => Self::Gbrg,
        }
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_numbers_and_fractions() {
        assert_eq!(parse_fraction("0.25"), Ok(0.25));
        assert_eq!(parse_fraction(" 1 / 32 "), Ok(0.03125));
        for text in ["", "1/", "1/0", "one", "1/2/3", "inf"] {
            assert!(parse_fraction(text).is_err(), "{text}");
        }
    }
}
