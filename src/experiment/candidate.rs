//! What an experiment compares: the degraded image itself, networks, deconvolutions.

use super::ComparedMethod;
use super::score::MacCounts;
use crate::core::error::{Error, Result};
use crate::core::image::{CHANNELS, LinearImage, ToneMappedImage};
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::tone::ToneCurve;
use crate::dataset::Dataset;
use crate::network::{Backend, GUIDED, Model, guided_model};
use crate::restore::deconvolution::{self, DeconvolutionConfig};
use crate::restore::{Capture, Highlights, KernelKnowledge, MemoryBudget, Restoration};

/// A restoration that needs the PSF and no model of the user's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RestorationMethod {
    /// The network for any panel.
    Guided,
    /// A deconvolution.
    Deconvolution(deconvolution::Method),
    /// A filter that is told the scene: what is left to gain.
    Oracle,
}

/// Something that makes an image of a degraded one.
#[derive(Clone, Debug)]
pub enum Candidate {
    /// Leaves the image as it is, to compare with.
    Nothing,
    /// A network, by its name in tables.
    Network(String, Box<Model>, Highlights),
    /// The network for any panel, with the kernel's PSF.
    Guided(Backend, Highlights),
    /// A deconvolution with the kernel's PSF.
    Deconvolution(deconvolution::Method, Highlights),
    /// A filter that is told the scene, with the kernel's PSF.
    Oracle,
}

/// The name of [`Candidate::Oracle`].
const ORACLE: &str = "oracle";

/// A degraded image with what a restoration may know of it.
pub(super) struct Degraded<'a> {
    pub(super) dataset: &'a Dataset,
    pub(super) image: &'a LinearImage,
    /// What it is of, which only an oracle looks at.
    pub(super) clean: &'a LinearImage,
    /// Index in the bank of the kernel that is taken for the image's.
    pub(super) kernel: usize,
    /// Memory that one restoration may take.
    pub(super) max_memory: u64,
}

impl Candidate {
    /// The degraded images themselves, every model (by its name in tables) and every deconvolution, these with each of
    /// the treatments of highlights, or with the usual one where none is named. The network for any panel computes on
    /// `backend`.
    pub fn list(
        models: Vec<(String, Model)>,
        methods: &[RestorationMethod],
        highlights: &[Highlights],
        backend: Backend,
    ) -> Vec<Self> {
        let treatments = if highlights.is_empty() { &[Highlights::default()] } else { highlights };
        let mut candidates = vec![Self::Nothing];
        for (name, model) in models {
            let of = |&highlights| Self::Network(name.clone(), Box::new(model.clone()), highlights);
            candidates.extend(treatments.iter().map(of));
        }
        for &method in methods {
            match method {
                RestorationMethod::Guided => {
                    candidates.extend(treatments.iter().map(|&highlights| Self::Guided(backend, highlights)));
                }
                RestorationMethod::Deconvolution(method) => {
                    let of = |&highlights| Self::Deconvolution(method, highlights);
                    candidates.extend(treatments.iter().map(of));
                }
                RestorationMethod::Oracle => candidates.push(Self::Oracle),
            }
        }
        candidates
    }

    /// How tables name it.
    pub(super) fn method(&self) -> ComparedMethod {
        match self {
            Self::Nothing => ComparedMethod::baseline("degraded"),
            Self::Network(name, _, highlights) => {
                ComparedMethod::restored(with_highlights(name, *highlights))
            }
            Self::Guided(_, highlights) => ComparedMethod::restored(with_highlights(GUIDED, *highlights)),
            Self::Deconvolution(method, highlights) => {
                ComparedMethod::restored(with_highlights(method.name(), *highlights))
            }
            Self::Oracle => ComparedMethod::restored(ORACLE),
        }
    }

    /// The multiply-accumulates that restoring images of these sizes takes, where they are counted.
    pub(super) fn macs(&self, sizes: &[([usize; 2], usize)]) -> Option<MacCounts> {
        let guided;
        let architecture = match self {
            Self::Network(_, model, _) => model.architecture(),
            Self::Guided(..) => {
                guided = guided_model().ok()?;
                guided.architecture()
            }
            Self::Nothing | Self::Deconvolution(..) | Self::Oracle => return None,
        };
        Some(MacCounts::of(architecture.parameters(), sizes, |height, width| {
            architecture.macs(height, width)
        }))
    }

    /// Whether the result depends on the kernel that it is told, right or wrong.
    pub(super) fn knows_the_kernel(&self) -> bool {
        match self {
            Self::Nothing | Self::Oracle => false,
            Self::Network(_, model, _) => {
                model.architecture().reads_code() || !model.architecture().planes().is_empty()
            }
            Self::Guided(..) | Self::Deconvolution(..) => true,
        }
    }

    /// Checks, before any work, that the dataset has what the restoration needs.
    pub(super) fn check(&self, dataset: &Dataset) -> Result<()> {
        let root = dataset.root.display();
        match self {
            Self::Guided(..) | Self::Deconvolution(..) | Self::Oracle if dataset.bank.is_none() => {
                Err(Error::Unsupported(format!(
                    "{root} has kernel codes and no PSFs, which --method {} needs; name a dataset of `udc synth`",
                    match self {
                        Self::Deconvolution(method, _) => method.name(),
                        Self::Oracle => ORACLE,
                        _ => GUIDED,
                    }
                )))
            }
            Self::Network(name, model, _) if model.architecture().reads_code() => {
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
        let Some(restoration) = self.restoration(degraded)? else {
            return Ok(match (self, degraded.psf()) {
                (Self::Oracle, Some(psf)) => curve.tone_map(&degraded.filtered_by_truth(&psf, curve)?),
                _ => curve.tone_map(degraded.image),
            });
        };
        let capture = Capture::from(degraded.image.clone());
        Ok(restoration.restore(capture, &Progress::default())?.into_tone_mapped())
    }

    /// What restores the image, if anything does.
    pub(super) fn restoration(&self, degraded: &Degraded<'_>) -> Result<Option<Restoration>> {
        let curve = degraded.dataset.formation.curve()?;
        let (restoration, highlights) = match self {
            Self::Nothing | Self::Oracle => return Ok(None),
            Self::Network(_, model, highlights) => {
                (Restoration::by_network(Model::clone(model), degraded.kernel_for(model)?)?, highlights)
            }
            Self::Guided(backend, highlights) => {
                let kernel = degraded.psf().map_or(KernelKnowledge::Nothing, KernelKnowledge::of_psf);
                (Restoration::guided(kernel)?.with_backend(*backend), highlights)
            }
            Self::Deconvolution(method, highlights) => {
                let config = DeconvolutionConfig::of_method(*method);
                let kernel = degraded.psf().map_or(KernelKnowledge::Nothing, KernelKnowledge::of_psf);
                (Restoration::by_deconvolution(config, kernel)?, highlights)
            }
        };
        let memory =
            MemoryBudget { limit_bytes: degraded.max_memory, counts_process: false, queued_frames: 0 };
        let restoration = restoration.with_border((&degraded.dataset.formation).into()).with_curve(curve);
        Ok(Some(restoration.with_highlights(*highlights).with_memory(memory)))
    }
}

/// The name of a row: the restoration, and what is done with highlights unless nothing.
fn with_highlights(name: &str, highlights: Highlights) -> String {
    match highlights {
        Highlights::Restored => name.to_owned(),
        Highlights::Keep => format!("{name}, highlights kept"),
        Highlights::Blend => format!("{name}, highlights blended"),
    }
}

impl Degraded<'_> {
    /// What a network is told of the kernel.
    fn kernel_for(&self, model: &Model) -> Result<KernelKnowledge> {
        let architecture = model.architecture();
        let code = architecture.reads_code().then(|| self.dataset.code_of(self.kernel)).transpose()?;
        Ok(match (self.psf().filter(|_| !architecture.planes().is_empty()), code) {
            (Some(psf), code) => KernelKnowledge::Psf { psf: psf.into(), code },
            (None, Some(code)) => KernelKnowledge::Code(code),
            (None, None) => KernelKnowledge::Nothing,
        })
    }

    /// The bound of [`Candidate::Oracle`].
    fn filtered_by_truth(&self, psf: &Psf, ToneCurve { alpha, x_max }: ToneCurve) -> Result<LinearImage> {
        let config = DeconvolutionConfig {
            border: (&self.dataset.formation).into(),
            alpha,
            saturation: [x_max; CHANNELS],
            ..DeconvolutionConfig::of_method(deconvolution::Method::Joint)
        };
        deconvolution::filter_by_truth((self.image, self.clean), psf, &config, &Progress::default())
    }

    /// The PSF of the kernel, where the dataset has PSFs.
    fn psf(&self) -> Option<Psf> {
        self.dataset.bank.as_ref().map(|bank| bank.psfs[self.kernel].clone())
    }
}
