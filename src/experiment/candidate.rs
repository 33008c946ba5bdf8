//! What an experiment compares: the degraded image itself, networks, deconvolutions.

use super::{Cost, Method};
use crate::core::bytes::format_bytes;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::progress::Progress;
use crate::core::saturation::saturated_from;
use crate::core::tone::ToneCurve;
use crate::dataset::Dataset;
use crate::network::Model;
use crate::restore::deconvolution::{self, DeconvolutionConfig, deconvolution_bytes, deconvolve};
use crate::restore::{Conditioning, Highlights, NetworkRestorer, Tiling, blend_highlights, restore_tiled};

/// Something that makes an image of a degraded one.
#[derive(Clone, Debug)]
pub enum Candidate {
    /// Leaves the image as it is, to compare with.
    Nothing,
    /// A network, by its name in tables.
    Network(String, Box<Model>, Highlights),
    /// A deconvolution with the kernel's PSF.
    Deconvolution(deconvolution::Method, Highlights),
}

/// A degraded image with what a restoration may know of it.
pub(super) struct Degraded<'a> {
    pub(super) dataset: &'a Dataset,
    pub(super) image: &'a LinearImage,
    /// Index in the bank of the kernel that is taken for the image's.
    pub(super) kernel: usize,
    /// Memory that one restoration may take.
    pub(super) max_memory: u64,
}

impl Candidate {
    /// The degraded images themselves, every model (by its name in tables) and every deconvolution, these with each of
    /// the treatments of highlights, or with the usual one where none is named.
    pub fn list(
        models: Vec<(String, Model)>,
        methods: &[deconvolution::Method],
        highlights: &[Highlights],
    ) -> Vec<Self> {
        let treatments = if highlights.is_empty() { &[Highlights::default()] } else { highlights };
        let mut candidates = vec![Self::Nothing];
        for (name, model) in models {
            let of = |&highlights| Self::Network(name.clone(), Box::new(model.clone()), highlights);
            candidates.extend(treatments.iter().map(of));
        }
        for &method in methods {
            candidates.extend(treatments.iter().map(|&highlights| Self::Deconvolution(method, highlights)));
        }
        candidates
    }

    /// How tables name it.
    pub(super) fn method(&self) -> Method {
        match self {
            Self::Nothing => Method::baseline("degraded"),
            Self::Network(name, _, highlights) => Method::restored(with_highlights(name, *highlights)),
            Self::Deconvolution(method, highlights) => {
                Method::restored(with_highlights(method.name(), *highlights))
            }
        }
    }

    /// What it costs to restore images of these sizes, where that is counted.
    pub(super) fn cost(&self, sizes: &[([usize; 2], usize)]) -> Option<Cost> {
        let Self::Network(_, model, _) = self else { return None };
        let architecture = model.architecture();
        Some(Cost::of(architecture.parameters(), sizes, |height, width| architecture.macs(height, width)))
    }

    /// Whether the result depends on the kernel that it is told.
    pub(super) fn knows_the_kernel(&self) -> bool {
        match self {
            Self::Nothing => false,
            Self::Network(_, model, _) => model.architecture().reads_code(),
            Self::Deconvolution(..) => true,
        }
    }

    /// Checks, before any work, that the dataset has what the restoration needs.
    pub(super) fn check(&self, dataset: &Dataset) -> Result<()> {
        let root = dataset.root.display();
        match self {
            Self::Deconvolution(method, _) if dataset.bank.is_none() => Err(Error::Unsupported(format!(
                "{root} has kernel codes and no PSFs, which --method {} needs; name a dataset of `udc synth`",
                method.name()
            ))),
            Self::Network(name, model, _) if self.knows_the_kernel() => {
                let (needed, found) = (model.architecture().code_dim, dataset.code_dim());
                if needed != found {
                    return Err(Error::Unsupported(format!(
                        "{name} needs kernel codes of {needed} numbers, and those of {root} have {found}"
                    )));
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// What may be wrong between the restoration and the dataset, and need not be.
    pub(super) fn warnings(&self, dataset: &Dataset) -> Vec<String> {
        let Self::Network(name, model, _) = self else { return Vec::new() };
        let (origin, root) = (model.origin(), dataset.root.display());
        let own = dataset.config.as_ref().map(|config| &config.bank_sha256);
        let is_other = |trained: &String| self.knows_the_kernel() && own.is_some_and(|own| own != trained);
        let bank = origin.kernel_bank_sha256.as_ref().filter(|trained| is_other(trained)).map(|_| {
            format!(
                "{name} was trained with another kernel bank than that of {root}: its codes mean other PSFs"
            )
        });
        let own = dataset.formation.curve().ok();
        let curve = origin.tone_curve().filter(|trained| own.is_some_and(|own| own != *trained));
        let curve = curve.map(|ToneCurve { alpha, x_max }| {
            format!(
                "{name} was trained on images tone-mapped with alpha {alpha} and x-max {x_max}, unlike {root}"
            )
        });
        bank.into_iter().chain(curve).collect()
    }

    pub(super) fn restore(&self, degraded: &Degraded<'_>) -> Result<ToneMappedImage> {
        let curve = degraded.dataset.formation.curve()?;
        match self {
            Self::Nothing => Ok(curve.tone_map(degraded.image)),
            Self::Network(_, model, highlights) => {
                degraded.treat_highlights(degraded.restore_by_network(model, curve)?, *highlights, curve)
            }
            Self::Deconvolution(method, highlights) => {
                degraded.treat_highlights(degraded.deconvolve(*method, curve)?, *highlights, curve)
            }
        }
    }
}

/// The name of a row: the restoration, and what is done with highlights unless nothing.
fn with_highlights(name: &str, highlights: Highlights) -> String {
    match highlights {
        Highlights::Network => name.to_owned(),
        Highlights::Keep => format!("{name}, highlights kept"),
        Highlights::Blend => format!("{name}, highlights blended"),
    }
}

impl Degraded<'_> {
    fn treat_highlights(
        &self,
        restored: ToneMappedImage,
        highlights: Highlights,
        curve: ToneCurve,
    ) -> Result<ToneMappedImage> {
        if highlights == Highlights::Network {
            return Ok(restored);
        }
        let level = [curve.compress(saturated_from(curve.x_max)); CHANNELS];
        blend_highlights(restored, &curve.tone_map(self.image), level, highlights)
    }

    fn restore_by_network(&self, model: &Model, curve: ToneCurve) -> Result<ToneMappedImage> {
        let code = match model.architecture().reads_code() {
            true => Conditioning::Code(self.dataset.code_of(self.kernel)?),
            false => Conditioning::None,
        };
        let restorer = NetworkRestorer::new(model, code)?;
        let tiling = Tiling::within(self.image.height(), self.image.width(), self.max_memory, &restorer)?;
        let room = self.max_memory.saturating_sub(tiling.bytes(&restorer));
        let restorer = restorer.with_room(room);
        restore_tiled(&curve.tone_map(self.image), &tiling, &restorer, &Progress::default())
    }

    fn deconvolve(&self, method: deconvolution::Method, curve: ToneCurve) -> Result<ToneMappedImage> {
        let ToneCurve { alpha, x_max } = curve;
        let border = (&self.dataset.formation).into();
        let default = DeconvolutionConfig::of_method(method);
        let config = DeconvolutionConfig { alpha, saturation: [x_max; CHANNELS], border, ..default };
        let bank = self.dataset.bank.as_ref().expect("checked before the work");
        let psf = &bank.psfs[self.kernel];
        let (size, of_psf) = ([self.image.height(), self.image.width()], [psf.height(), psf.width()]);
        let bytes = deconvolution_bytes(size, of_psf, &config);
        if bytes > self.max_memory {
            let reason = format!(
                "{} × {} pixels take {} to deconvolve; allow at least that",
                size[0],
                size[1],
                format_bytes(bytes)
            );
            return Err(Error::config("max-memory", reason));
        }
        Ok(curve.tone_map(&deconvolve(self.image, psf, &config, &Progress::default())?))
    }
}
