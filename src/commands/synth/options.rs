//! The groups of flags of `udc synth`: kernels, formation, storage.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;

use udc::core::bytes::parse_bytes;
use udc::core::fft::Boundary;
use udc::dataset::{FormationConfig, NoiseConfig};
use udc::io;
use udc::synth::Degradations;

use crate::commands::Session;
use crate::commands::choices::{Choices, FLOAT_FORMATS, parse_noise};
use crate::commands::psf_file::PsfAmongImagesArgs;

#[derive(Args, Debug)]
#[group(required = true, multiple = true)]
pub(super) struct KernelArgs {
    /// Kernel bank made by `udc codes`
    #[arg(long, value_name = "BANK")]
    bank: Option<PathBuf>,
    /// A single PSF, which has no code
    #[arg(long, value_name = "PSF", conflicts_with_all = ["bank", "field"])]
    psf: Option<PathBuf>,
    /// PSFs of several places of the frame (.toml: rows, columns, psfs row by row): every scene becomes one image, whose
    /// PSF is interpolated between them. With --bank, the PSF in the middle of the frame gets its code in that basis
    #[arg(long, value_name = "FIELD")]
    field: Option<PathBuf>,
}

#[derive(Args, Debug)]
pub(super) struct FormationArgs {
    /// Where the paper and its released data differ, take the values of one of them
    #[arg(long, value_name = "PRESET", value_parser = PRESETS, default_value = "paper")]
    preset: Defaults,
    /// Irradiance at which the sensor saturates, 1 being white of a capture's longest exposure: 16 for a bracket 1, 1/4,
    /// 1/16 [default: that of --noise sensor, else 500 as published]
    #[arg(long, value_name = "X")]
    x_max: Option<f32>,
    /// Irradiance that the tone mapping maps to one half: stored images stay linear, and training and evaluation
    /// tone-map them with it [default: 0.25]
    #[arg(long, value_name = "A")]
    alpha: Option<f32>,
    /// What lies beyond the scene's border, beyond its margin if it has one [default: zero]
    #[arg(long, value_name = "BORDER", value_parser = BORDERS)]
    border: Option<Boundary>,
    /// Pixels by which the scenes are larger than the frame on each side [default: what .exr files of `udc crop` say,
    /// else 0]
    #[arg(long, value_name = "PX")]
    pub(super) margin: Option<usize>,
    /// Clip the scene to the saturation before the convolution, as preset `released` does
    #[arg(long)]
    clip_ground_truth: bool,
    /// Noise: none, gaussian:SIGMA (in units of irradiance), sensor, or sensor:FILE.toml. A sensor says where it
    /// saturates, which is then x-max
    #[arg(long, value_name = "NOISE", default_value = "none", value_parser = parse_noise)]
    noise: NoiseConfig,
}

#[derive(Args, Debug)]
pub(super) struct StorageArgs {
    /// Format of the images; .exr carries their origin
    #[arg(long, value_name = "FORMAT", value_parser = FLOAT_FORMATS, default_value = "exr")]
    pub(super) format: &'static str,
    /// Write half floats
    #[arg(long)]
    pub(super) half: bool,
    /// Keep the images in tar archives of about this size, a sample of WebDataset each scene, not each in a file of its own: for
    /// file systems that bear few large files better. A run that is killed loses the archive that it was writing
    #[arg(long, value_name = "SIZE", value_parser = parse_bytes)]
    pub(super) tar: Option<u64>,
}

/// The parameters that a preset begins with.
type Defaults = fn() -> FormationConfig;

const PRESETS: Choices<Defaults> = Choices(&[
    ("paper", FormationConfig::default as Defaults, ""),
    ("released", FormationConfig::released, ""),
]);

const BORDERS: Choices<Boundary> = Choices(&[
    ("zero", Boundary::Zero, "Darkness"),
    ("replicate", Boundary::Replicate, "The outermost pixels again and again"),
    ("reflect", Boundary::Reflect, "The scene mirrored"),
]);

impl KernelArgs {
    pub(super) fn read(&self, psf_file: &PsfAmongImagesArgs, session: &Session) -> Result<Degradations> {
        let reading = |path: &Path| format!("reading {}", path.display());
        if let Some(path) = &self.field {
            let field = psf_file.read_field(path, session).with_context(|| reading(path))?;
            let read_bank = |path: &PathBuf| io::read_bank(path).with_context(|| reading(path));
            let bank = self.bank.as_ref().map(read_bank).transpose()?;
            return Degradations::of_field(field, bank).with_context(|| reading(path));
        }
        if let Some(path) = &self.bank {
            return Degradations::of_bank(path).with_context(|| reading(path));
        }
        let path = self.psf.as_ref().context("name a --bank, a --psf or a --field")?;
        Ok(Degradations::of_psf(psf_file.read(path, session).with_context(|| reading(path))?))
    }
}

impl FormationArgs {
    /// The parameters, with every default resolved but that of the margin, which the scenes' files know.
    pub(super) fn resolve(&self) -> FormationConfig {
        let preset = (self.preset)();
        let x_max = match &self.noise {
            NoiseConfig::Sensor(sensor) => sensor.x_max(),
            NoiseConfig::None | NoiseConfig::Gaussian { .. } => preset.x_max,
        };
        FormationConfig {
            x_max: self.x_max.unwrap_or(x_max),
            alpha: self.alpha.unwrap_or(preset.alpha),
            boundary: self.border.unwrap_or(preset.boundary),
            clip_ground_truth: self.clip_ground_truth || preset.clip_ground_truth,
            noise: self.noise.clone(),
            ..preset
        }
    }
}
