//! Where `udc train` learns from: a dataset's files, or clean images degraded as they are drawn.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use rand::Rng as _;
use rayon::prelude::*;
use sha2::{Digest, Sha256};

use udc::core::error::{Error, Result as CoreResult};
use udc::core::fft::{Convolver, Otf};
use udc::core::image::{Linear, LinearImage};
use udc::core::kernel_code::KernelBank;
use udc::core::provenance::Provenance;
use udc::core::psf::hex;
use udc::core::recent::RecentlyUsed;
use udc::core::rng::Rng;
use udc::core::tone::ToneCurve;
use udc::dataset::{CONFIG_FILE, Dataset, FormationConfig, Split};
use udc::io;
use udc::synth::{Formation, common_margin};
use udc::train::{DataIdentity, Degradation, TrainConfig};

/// Everything that samples are made of, opened once.
pub(super) enum Source {
    /// A dataset whose degraded images are read.
    Stored(Dataset),
    /// Clean images that are degraded as they are drawn, with the dataset that they are of, if any.
    OnTheFly(Box<OnTheFly>, Option<Dataset>),
}

/// Clean images, kernels, and the model of image formation.
pub(super) struct OnTheFly {
    pub(super) scenes: Vec<PathBuf>,
    pub(super) bank: KernelBank,
    /// φ∘C.
    pub(super) curve: ToneCurve,
    /// Whether the clean images are ground truths that were clipped to x_max when they were stored, though the model
    /// spreads all of a scene's light.
    clipped: bool,
    bank_sha256: String,
    formation: Formation,
    /// By the size of the scene.
    convolvers: RecentlyUsed<[usize; 2], Convolver>,
    /// By the size of the scene, and the kernel.
    otfs: RecentlyUsed<([usize; 2], usize), Otf>,
}

impl Source {
    /// Opens `data` as the configuration asks; `bank` degrades a folder of clean images.
    pub(super) fn open(data: &Path, bank: Option<&Path>, config: &TrainConfig) -> Result<Self> {
        let on_the_fly = config.data.degradation == Degradation::OnTheFly;
        match bank {
            Some(_) if !on_the_fly || data.join(CONFIG_FILE).is_file() => bail!(
                "--bank goes with a folder of clean images and data.degradation = \"on-the-fly\"; a dataset has a \
                 bank of its own"
            ),
            Some(bank) => Ok(Self::OnTheFly(OnTheFly::of_views(data, bank, config)?.into(), None)),
            None => {
                if config.data.formation != FormationConfig::default() {
                    bail!(
                        "data.formation goes with a folder of clean images and --bank; a dataset says itself how its \
                         images were formed"
                    );
                }
                let dataset = Dataset::open(data).context("opening the dataset")?;
                Ok(if on_the_fly {
                    Self::OnTheFly(OnTheFly::of_dataset(&dataset, config)?.into(), Some(dataset))
                } else {
                    Self::Stored(dataset)
                })
            }
        }
    }

    /// What is wrong between the data and how they are degraded, and need not be.
    pub(super) fn warnings(&self, config: &TrainConfig) -> Vec<String> {
        let formation = self.dataset().map_or(&config.data.formation, |dataset| &dataset.formation);
        let x_max = self.dataset().is_none().then_some("data.formation.x-max");
        let lost_margin = match self {
            Self::OnTheFly(_, Some(_)) if formation.margin > 0 => Some(
                "stored ground truths lack the margin that the dataset's scenes had: what is degraded on the fly lacks the \
                 flare of lamps outside of the frame; to keep it, name the folder of scenes as --data, the kernels with \
                 --bank, and the margin with --set data.formation.margin=PX"
                    .to_owned(),
            ),
            _ => None,
        };
        formation.scale_warning(x_max).into_iter().chain(lost_margin).collect()
    }

    /// The dataset, unless a folder of clean images was named.
    pub(super) fn dataset(&self) -> Option<&Dataset> {
        match self {
            Self::Stored(dataset) => Some(dataset),
            Self::OnTheFly(_, dataset) => dataset.as_ref(),
        }
    }

    /// Length of the kernel codes; 0 without any.
    pub(super) fn code_dim(&self) -> usize {
        match self {
            Self::Stored(dataset) => dataset.code_dim(),
            Self::OnTheFly(live, _) => live.bank.code_dim(),
        }
    }

    /// What tells the data from others.
    pub(super) fn identity(&self) -> CoreResult<DataIdentity> {
        Ok(match self {
            Self::Stored(dataset) => DataIdentity {
                images_sha256: Some(triplets_sha256(dataset)),
                kernel_bank_sha256: bank_sha256(dataset).map(str::to_owned),
                codes_sha256: dataset.config.is_none().then(|| codes_sha256(dataset)),
                scenes_sha256: None,
                tone_curve: dataset.formation.curve()?,
            },
            Self::OnTheFly(live, dataset) => DataIdentity {
                images_sha256: dataset.as_ref().map(triplets_sha256),
                kernel_bank_sha256: Some(live.bank_sha256.clone()),
                codes_sha256: None,
                scenes_sha256: Some(contents_sha256(&live.scenes)?),
                tone_curve: live.curve,
            },
        })
    }
}

/// SHA-256 of a dataset's list of triplets, which holds the hashes of their images.
pub(in crate::commands) fn triplets_sha256(dataset: &Dataset) -> String {
    let mut hash = Sha256::new();
    for triplet in &dataset.triplets {
        hash.update(serde_json::to_vec(triplet).expect("triplets are plain data"));
    }
    hex(&hash.finalize())
}

/// SHA-256 of a dataset's kernel bank, where it has one.
pub(in crate::commands) fn bank_sha256(dataset: &Dataset) -> Option<&str> {
    dataset.config.as_ref().map(|config| config.bank_sha256.as_str())
}

/// SHA-256 of a dataset's kernel codes.
fn codes_sha256(dataset: &Dataset) -> String {
    let mut hash = Sha256::new();
    for number in dataset.codes().iter().flatten() {
        hash.update(number.to_le_bytes());
    }
    hex(&hash.finalize())
}

/// SHA-256 of the hashes of files in their order: they may move, and keep what they hold.
fn contents_sha256(files: &[PathBuf]) -> CoreResult<String> {
    let hashes: Vec<String> =
        files.par_iter().map(|path| io::sha256_of_file(path)).collect::<CoreResult<_>>()?;
    Ok(hex(&Sha256::digest(hashes.concat())))
}

impl OnTheFly {
    fn of_views(folder: &Path, bank: &Path, config: &TrainConfig) -> Result<Self> {
        let scenes = io::expand_inputs(&[folder.to_owned()])?;
        let declared = |path: &PathBuf| Ok(io::read_provenance(path)?.as_ref().and_then(Provenance::margin));
        let margins: Vec<Option<usize>> = scenes.iter().map(declared).collect::<CoreResult<_>>()?;
        let declared: Vec<_> = scenes.iter().map(PathBuf::as_path).zip(margins).collect();
        let formation = config.data.formation.clone();
        common_margin(&declared, Some(formation.margin)).context("checking data.formation.margin")?;
        for scene in &scenes {
            let size = io::read_image_size::<Linear>(scene, None)?;
            let of_scene = || format!("checking data.formation.margin with {}", scene.display());
            formation.frame_size(size).with_context(of_scene)?;
        }
        Self::new((scenes, false), (io::read_bank(bank)?, io::bank_sha256(bank)?), formation, config)
    }

    fn of_dataset(dataset: &Dataset, config: &TrainConfig) -> Result<Self> {
        dataset.check_one_psf()?;
        let (Some(bank), Some(described)) = (dataset.bank.clone(), &dataset.config) else {
            bail!(
                "{} has kernel codes and no PSFs, so that nothing can be degraded on the fly; train with \
                 data.degradation = \"stored\"",
                dataset.root.display()
            );
        };
        let mut scenes: Vec<PathBuf> =
            dataset.split(Split::Train)?.iter().map(|triplet| dataset.root.join(&triplet.gt)).collect();
        scenes.dedup();
        let clipped = !dataset.formation.clip_ground_truth;
        let bank = (bank, described.bank_sha256.clone());
        Self::new((scenes, clipped), bank, dataset.formation.of_frames(), config)
    }

    fn new(
        (scenes, clipped): (Vec<PathBuf>, bool),
        (bank, bank_sha256): (KernelBank, String),
        formation: FormationConfig,
        config: &TrainConfig,
    ) -> Result<Self> {
        let curve = formation.curve()?;
        let formation = Formation::new(formation, config.seed)?;
        let room = config.data.cache_mib.saturating_mul(1 << 20);
        let (convolvers, otfs) = (RecentlyUsed::new(room), RecentlyUsed::new(room));
        Ok(Self { scenes, bank, curve, clipped, bank_sha256, formation, convolvers, otfs })
    }

    /// How the frames that [`degrade`](Self::degrade) returns are formed.
    pub(super) fn formation(&self) -> &FormationConfig {
        self.formation.config()
    }

    /// Pixels by which clean images are larger than the frame on each side.
    pub(super) fn margin(&self) -> usize {
        self.formation.margin()
    }

    /// Whether a clean image lost light above x_max when it was stored.
    pub(super) fn lost_highlights(&self, scene: &LinearImage) -> bool {
        // Half floats round by 2⁻¹¹ at most.
        let clipped = self.curve.x_max * (1.0 - 1.0 / 2048.0);
        self.clipped && scene.as_slice().iter().any(|&value| value >= clipped)
    }

    /// Degrades a clean image by a kernel; the noise is drawn anew every time.
    pub(super) fn degrade(
        &self,
        scene: &LinearImage,
        kernel: usize,
        rng: &mut Rng,
    ) -> CoreResult<LinearImage> {
        let size = [scene.height(), scene.width()];
        let convolver = self.convolvers.get(size, || self.convolver(size))?;
        let otf = self.otfs.get((size, kernel), || {
            Ok::<_, Error>((convolver.otf(&self.bank.psfs[kernel])?, convolver.spectrum_bytes()))
        })?;
        let spectrum = convolver.spectrum(&self.formation.scene(scene))?;
        let irradiance = self.formation.irradiance(&convolver, &spectrum, &otf);
        self.formation.record(irradiance, &format!("on-the-fly/{:016x}", rng.next_u64()))
    }

    /// The convolver for scenes of a size, and the bytes that its buffers come to take.
    fn convolver(&self, scene: [usize; 2]) -> CoreResult<(Convolver, usize)> {
        let psf = &self.bank.psfs[0];
        let convolver = self.formation.convolver(scene, [psf.height(), psf.width()])?;
        let bytes = convolver.spectrum_bytes() + convolver.intermediate_bytes();
        Ok((convolver, bytes))
    }
}
