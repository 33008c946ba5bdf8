//! The groups of flags of `udc synth`: kernels, formation, storage.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::{Args, ValueEnum};

use udc::core::config::parse_toml;
use udc::core::dataset::{FormationConfig, NoiseConfig, SensorConfig, Split};
use udc::core::error::Error;
use udc::core::fft::Boundary;
use udc::core::io;
use udc::core::kernel_code::KernelBank;
use udc::synth::BankFile;

#[derive(Args, Debug)]
#[group(required = true, multiple = false)]
pub(super) struct KernelArgs {
    /// Kernel bank made by `udc codes`
    #[arg(long, value_name = "BANK")]
    bank: Option<PathBuf>,
    /// A single PSF, which has no code
    #[arg(long, value_name = "PSF")]
    psf: Option<PathBuf>,
}

#[derive(Args, Debug)]
pub(super) struct FormationArgs {
    /// Where the paper and its released data differ, take the values of one of them
    #[arg(long, value_enum, default_value = "paper")]
    preset: Preset,
    /// Irradiance at which the sensor saturates [default: 500]
    #[arg(long, value_name = "X")]
    x_max: Option<f32>,
    /// Irradiance that the tone mapping maps to one half; only recorded [default: 0.25]
    #[arg(long, value_name = "A")]
    alpha: Option<f32>,
    /// What lies beyond the scene's border [default: zero]
    #[arg(long, value_enum)]
    boundary: Option<BoundaryName>,
    /// Clip the scene to the saturation before the convolution, as preset `released` does
    #[arg(long)]
    clip_ground_truth: bool,
    /// Noise: none, gaussian:SIGMA (in units of irradiance), sensor, or sensor:FILE.toml
    #[arg(long, value_name = "NOISE", default_value = "none", value_parser = parse_noise)]
    noise: NoiseConfig,
}

#[derive(Args, Debug)]
pub(super) struct StorageArgs {
    /// Format of the images; .exr carries their origin
    #[arg(long, value_enum, default_value = "exr")]
    pub(super) format: ImageFormat,
    /// Write half floats
    #[arg(long)]
    pub(super) half: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Preset {
    Paper,
    Released,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum BoundaryName {
    Zero,
    Replicate,
    Reflect,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum ImageFormat {
    Exr,
    Npy,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(super) enum SplitName {
    Train,
    Test,
    Val,
}

impl KernelArgs {
    /// The bank and its file's bytes.
    pub(super) fn read(&self) -> Result<(KernelBank, BankFile)> {
        let read = |path: &Path| format!("reading {}", path.display());
        if let Some(path) = &self.bank {
            let bank = io::read_bank(path).with_context(|| read(path))?;
            return Ok((bank, BankFile::Stored(path.clone())));
        }
        let path = self.psf.as_ref().context("name a --bank or a --psf")?;
        let bank = KernelBank::single(io::read_psf(path).with_context(|| read(path))?);
        let file = BankFile::Encoded(io::encode_bank(&bank));
        Ok((bank, file))
    }
}

impl FormationArgs {
    /// The parameters, with every default resolved.
    pub(super) fn resolve(&self) -> FormationConfig {
        let preset = match self.preset {
            Preset::Paper => FormationConfig::default(),
            Preset::Released => FormationConfig::released(),
        };
        FormationConfig {
            x_max: self.x_max.unwrap_or(preset.x_max),
            alpha: self.alpha.unwrap_or(preset.alpha),
            boundary: self.boundary.map_or(preset.boundary, Boundary::from),
            clip_ground_truth: self.clip_ground_truth || preset.clip_ground_truth,
            noise: self.noise.clone(),
        }
    }
}

impl From<BoundaryName> for Boundary {
    fn from(name: BoundaryName) -> Self {
        match name {
            BoundaryName::Zero => Self::Zero,
            BoundaryName::Replicate => Self::Replicate,
            BoundaryName::Reflect => Self::Reflect,
        }
    }
}

impl From<SplitName> for Split {
    fn from(name: SplitName) -> Self {
        match name {
            SplitName::Train => Self::Train,
            SplitName::Test => Self::Test,
            SplitName::Val => Self::Val,
        }
    }
}

impl ImageFormat {
    /// The extension of files in this format.
    pub(super) fn extension(self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Npy => "npy",
        }
    }
}

fn parse_noise(text: &str) -> Result<NoiseConfig, Error> {
    let noise = match text.split_once(':') {
        None if text == "none" => NoiseConfig::None,
        None if text == "sensor" => NoiseConfig::Sensor(SensorConfig::default()),
        Some(("gaussian", sigma)) => {
            let sigma = sigma.parse().map_err(|_| {
                Error::config(
                    "noise",
                    format!("expected gaussian:SIGMA such as gaussian:0.01, found `{text}`"),
                )
            })?;
            NoiseConfig::Gaussian { sigma }
        }
        Some(("sensor", file)) => {
            let path = Path::new(file);
            let sensor = parse_toml(&io::read_text(path)?);
            NoiseConfig::Sensor(sensor.map_err(|reason| Error::format(path, reason))?)
        }
        _ => {
            let reason = format!("expected none, gaussian:SIGMA, sensor or sensor:FILE.toml, found `{text}`");
            return Err(Error::config("noise", reason));
        }
    };
    noise.validate()?;
    Ok(noise)
}
