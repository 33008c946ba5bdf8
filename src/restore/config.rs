//! How captures are restored, as a user names it: files and settings, read and resolved before the work.

use std::path::{Path, PathBuf};

use super::deconvolution::{Border, DeconvolutionConfig};
use super::highlights::Highlights;
use super::kernel::KernelFiles;
use super::memory::MemoryBudget;
use super::notice::Notice;
use super::pose::read_pose;
use super::precision::in_precision;
use super::restoration::Restoration;
use crate::core::error::Result;
use crate::core::tone::ToneCurve;
use crate::dataset::NoiseConfig;
use crate::io::sha256_of_file;
use crate::network::{Backend, Kind, Model, Precision, guided_model, guided_sha256, shipped, weights};

/// What restores.
#[derive(Clone, Debug)]
pub enum MethodConfig {
    /// A network.
    Network {
        /// Its file.
        model: PathBuf,
        /// What it multiplies.
        precision: Precision,
        /// Side of the tiles, where the memory does not choose it.
        tile: Option<usize>,
    },
    /// A network that restores captures of any panel, given its PSF.
    Guided {
        /// Its file, or the name of the one that the program carries, which it is without one.
        model: Option<PathBuf>,
        /// The part of its corrections that is taken, from 0 to 1.
        refine: f32,
        /// Whether lamps get the light that their flare tells.
        true_highlights: bool,
        /// Where the panel stands.
        pose: PoseSource,
        /// What lies beyond the border.
        border: Border,
        /// What it multiplies.
        precision: Precision,
        /// Side of the tiles, where the memory does not choose it.
        tile: Option<usize>,
    },
    /// A deconvolution with the PSF of the kernel files; α and saturation are those of the curve.
    Deconvolution(Box<DeconvolutionConfig>),
}

/// What tells how the panel stands against its PSF.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum PoseSource {
    /// The flare of each capture.
    #[default]
    Capture,
    /// The PSF itself.
    Psf,
    /// A file of `udc pose`.
    File(PathBuf),
}

impl PoseSource {
    /// The same restoration with this pose.
    fn take_for(&self, restoration: Restoration) -> Result<Restoration> {
        match self {
            Self::Capture => Ok(restoration),
            Self::Psf => restoration.with_pose(None),
            Self::File(path) => restoration.with_pose(Some(&read_pose(path)?)),
        }
    }
}

/// A restoration before its files are read.
#[derive(Clone, Debug)]
pub struct RestorationConfig {
    /// What restores.
    pub method: MethodConfig,
    /// What is known of the kernel.
    pub kernel: KernelFiles,
    /// α of the tone mapping, in place of the training's or the usual one.
    pub alpha: Option<f32>,
    /// The irradiance at which captures saturate, in place of the training's or the usual one.
    pub x_max: Option<f32>,
    /// What is done where a capture is saturated.
    pub highlights: Highlights,
    /// The noise of captures, where it is not to be estimated.
    pub noise: Option<NoiseConfig>,
    /// The memory that there is.
    pub memory: MemoryBudget,
    /// What a network computes on.
    pub backend: Backend,
}

impl RestorationConfig {
    /// Reads the files; says what is to be told of them.
    ///
    /// # Errors
    /// Those of reading; [`Error::Config`](crate::core::error::Error::Config) when settings are out of range or what is known
    /// of the kernel does not suit the method.
    pub fn open(&self) -> Result<(Restoration, Vec<Notice>)> {
        let (restoration, notices) = match &self.method {
            MethodConfig::Network { model: path, precision, tile } => {
                let (model, sha256) = rayon::join(|| Model::load(path), || sha256_of_file(path));
                let (model, mut notices) = take(in_precision(model?.with_backend(self.backend), *precision));
                let trained = model.origin().tone_curve();
                let curve = self.curve(trained)?;
                if let Some(ToneCurve { alpha, x_max }) = trained.filter(|trained| *trained != curve) {
                    notices.push(Notice::Warning(format!(
                        "the model was trained on images tone-mapped with --alpha {alpha} --x-max {x_max}"
                    )));
                }
                let (kernel, of_kernel) = self.kernel.read_for(&model)?;
                notices.extend(of_kernel);
                let restoration = Restoration::by_network(model, kernel)?.with_curve(curve).with_tile(*tile);
                (restoration.with_files(Some(sha256?), self.kernel.bank_bytes()), notices)
            }
            MethodConfig::Guided { model, refine, true_highlights, pose, border, precision, tile } => {
                let (kernel, mut notices) = self.kernel.read_any_psf()?;
                let (network, sha256) = read_guided(model.as_deref())?;
                let restoration = Restoration::by_guided_network(network.with_backend(self.backend), kernel)?;
                let mut restoration = restoration.with_border(*border).with_tile(*tile);
                notices.extend(restoration.set_precision(*precision));
                restoration = pose.take_for(restoration.with_refine(*refine)?)?;
                let usual = restoration.curve();
                let curve = self.curve(Some(usual))?;
                if curve.alpha.total_cmp(&usual.alpha).is_ne() {
                    notices.push(Notice::Warning(format!(
                        "the guided network was trained on images tone-mapped with --alpha {}",
                        usual.alpha
                    )));
                }
                if self.x_max.is_some() {
                    restoration = restoration.with_curve(curve);
                }
                if *true_highlights {
                    restoration = restoration.with_true_highlights()?;
                }
                (restoration.with_files(Some(sha256), self.kernel.bank_bytes()), notices)
            }
            MethodConfig::Deconvolution(config) => {
                let (kernel, notices) = self.kernel.read_psf()?;
                let restoration = Restoration::by_deconvolution(**config, kernel)?;
                let restoration = restoration.with_curve(self.curve(None)?);
                (
                    if self.x_max.is_none() { restoration.with_levels_of_captures() } else { restoration },
                    notices,
                )
            }
        };
        let mut restoration = restoration.with_highlights(self.highlights).with_memory(self.memory);
        if let Some(alpha) = self.alpha {
            restoration = restoration.with_alpha(alpha);
        }
        if let Some(noise) = &self.noise {
            restoration = restoration.with_noise(noise.clone())?;
        }
        Ok((restoration, notices))
    }

    /// φ∘C as it is given, and for what is not as a model was trained.
    ///
    /// # Errors
    /// [`Error::Config`](crate::core::error::Error::Config) when a number of it is not positive and finite.
    pub fn curve(&self, of_model: Option<ToneCurve>) -> Result<ToneCurve> {
        let default = of_model.unwrap_or_default();
        ToneCurve::new(self.alpha.unwrap_or(default.alpha), self.x_max.unwrap_or(default.x_max))
    }
}

/// Whether a model is a network for any panel: by its name, or by what its file says.
pub fn is_guided(model: &Path) -> bool {
    let is_file_of_one = || weights::read(model).is_ok_and(|read| read.architecture.kind == Kind::Guided);
    let may_be = model.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("safetensors"));
    shipped(model).is_some() || (may_be && is_file_of_one())
}

/// The network for any panel of a file, or the one that the program carries, and the SHA-256 of its file.
fn read_guided(model: Option<&Path>) -> Result<(Model, String)> {
    Ok(match model.filter(|path| shipped(path).is_none()) {
        Some(path) => (Model::load(path)?, sha256_of_file(path)?),
        None => (guided_model()?, guided_sha256().to_owned()),
    })
}

fn take((model, notice): (Model, Option<Notice>)) -> (Model, Vec<Notice>) {
    (model, notice.into_iter().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::ToneMappedImage;
    use crate::core::progress::Progress;
    use crate::network::weights::Weights;
    use crate::network::{Architecture, Condition, Initialisation, Inputs, Origin, Parameters};
    use crate::restore::Capture;
    use ndarray::Array3;

    /// What a CPU rounds, whether or not it can, says nothing of it.
    #[test]
    fn the_precision_is_that_of_the_backend_that_is_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("model.safetensors");
        let architecture =
            Architecture { features: 4, condition: Condition::Image, ..Architecture::default() };
        let parameters = Parameters::random(&architecture, Initialisation::Released, 1);
        let exact = Model::new(Weights { architecture, parameters, origin: Origin::default() });
        exact.save(&file, false).unwrap();
        let config = RestorationConfig {
            method: MethodConfig::Network { model: file, precision: Precision::Bf16, tile: None },
            kernel: KernelFiles::default(),
            alpha: None,
            x_max: None,
            highlights: Highlights::default(),
            noise: None,
            memory: MemoryBudget::default(),
            backend: Backend::AsDevice,
        };
        let planes = Array3::from_shape_fn((3, 24, 20), |(c, y, x)| (c + 2 * y + 3 * x) as f32 / 150.0);
        let image = ToneMappedImage::from_planes(planes).unwrap();
        let on_device = exact.with_backend(Backend::AsDevice);
        let of = |model: &Model| model.restore(&Inputs::new(&image, None)).unwrap();
        let rounded = of(&on_device.with_bf16_products().unwrap());
        assert_ne!(rounded, of(&on_device));
        let (restoration, notices) = config.open().unwrap();
        let restored = restoration.restore(Capture::from(image.clone()), &Progress::default()).unwrap();
        assert!(notices.is_empty());
        assert_eq!(restored.into_tone_mapped(), rounded);
    }
}
