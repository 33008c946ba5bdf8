//! Clean images, and the model of image formation that degrades them as they are drawn.

use std::path::{Path, PathBuf};
use std::sync::Once;

use rand::Rng as _;

use super::config::TrainConfig;
use super::data::OnTheFlyData;
use super::recent::RecentlyUsed;
use crate::core::error::{Error, Result};
use crate::core::fft::{Convolver, Otf};
use crate::core::image::{Linear, LinearImage};
use crate::core::kernel_code::KernelBank;
use crate::core::provenance::Provenance;
use crate::core::rng::Rng;
use crate::core::tone::ToneCurve;
use crate::dataset::{Dataset, FormationConfig, Split};
use crate::io;
use crate::synth::{Formation, common_margin};

/// Clean images, kernels, and the model of image formation.
pub struct CleanImages {
    pub(super) scenes: Vec<PathBuf>,
    pub(super) bank: KernelBank,
    pub(super) bank_sha256: String,
    /// φ∘C.
    pub(super) curve: ToneCurve,
    /// Whether the clean images are ground truths that were clipped to x_max when they were stored, though the model
    /// spreads all of a scene's light.
    clipped: bool,
    formation: Formation,
    /// By the size of the scene.
    convolvers: RecentlyUsed<[usize; 2], Convolver>,
    /// By the size of the scene, and the kernel.
    otfs: RecentlyUsed<([usize; 2], usize), Otf>,
}

impl CleanImages {
    /// A folder of clean images, which a bank's kernels degrade as the configuration says.
    pub(super) fn of_folder(folder: &Path, bank: &Path, config: &TrainConfig) -> Result<Self> {
        let scenes = io::expand_inputs(&[folder.to_owned()])?;
        let declared = |path: &PathBuf| Ok(io::read_provenance(path)?.as_ref().and_then(Provenance::margin));
        let margins: Vec<Option<usize>> = scenes.iter().map(declared).collect::<Result<_>>()?;
        let declared: Vec<_> = scenes.iter().map(PathBuf::as_path).zip(margins).collect();
        let formation = config.data.formation.clone();
        common_margin(&declared, Some(formation.margin))
            .map_err(|error| error.while_doing("checking data.formation.margin"))?;
        for scene in &scenes {
            let size = io::read_image_size::<Linear>(scene, None)?;
            formation.frame_size(size).map_err(|error| {
                error.while_doing(format!("checking data.formation.margin with {}", scene.display()))
            })?;
        }
        Self::new((scenes, false), (io::read_bank(bank)?, io::bank_sha256(bank)?), formation, config)
    }

    /// The ground truths that a dataset has for training, which its own kernels degrade anew.
    pub(super) fn of_dataset(dataset: &Dataset, config: &TrainConfig) -> Result<Self> {
        dataset.check_one_psf()?;
        let (Some(bank), Some(described)) = (dataset.bank.clone(), &dataset.config) else {
            return Err(Error::Unsupported(format!(
                "{} has kernel codes and no PSFs, so that nothing can be degraded on the fly; train with \
                 data.degradation = \"stored\"",
                dataset.root.display()
            )));
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
        Ok(Self { scenes, bank, bank_sha256, curve, clipped, formation, convolvers, otfs })
    }

    /// Samples of the images; `warn` hears once of images that lack the light that the model would spread.
    pub(super) fn samples<'a>(
        &'a self,
        config: &TrainConfig,
        warn: &'a (dyn Fn(&str) + Sync),
    ) -> Result<OnTheFlyData<'a>> {
        let warned = Once::new();
        let degrade = move |scene: &LinearImage, kernel: usize, rng: &mut Rng| {
            if !warned.is_completed() && self.lost_highlights(scene) {
                warned.call_once(|| warn(&lost_highlights(self.curve.x_max)));
            }
            self.degrade(scene, kernel, rng)
        };
        let scenes = self.scenes.clone();
        OnTheFlyData::new(scenes, &self.bank, self.curve, Box::new(degrade), config.data.cache_mib)
            .with_margin(self.formation.margin())
            .with_planes(config.architecture.planes(), self.formation.config())?
            .only(&config.data.kernels)
    }

    /// Whether a clean image lost light above x_max when it was stored.
    fn lost_highlights(&self, scene: &LinearImage) -> bool {
        // Half floats round by 2⁻¹¹ at most.
        let clipped = self.curve.x_max * (1.0 - 1.0 / 2048.0);
        self.clipped && scene.as_slice().iter().any(|&value| value >= clipped)
    }

    /// Degrades a clean image by a kernel; the noise is drawn anew every time.
    fn degrade(&self, scene: &LinearImage, kernel: usize, rng: &mut Rng) -> Result<LinearImage> {
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
    fn convolver(&self, scene: [usize; 2]) -> Result<(Convolver, usize)> {
        let psf = &self.bank.psfs[0];
        let convolver = self.formation.convolver(scene, [psf.height(), psf.width()])?;
        let bytes = convolver.spectrum_bytes() + convolver.intermediate_bytes();
        Ok((convolver, bytes))
    }
}

fn lost_highlights(x_max: f32) -> String {
    format!(
        "stored ground truths reach x-max = {x_max}, where they were clipped: what is degraded on the fly lacks the \
         highlights above it, which the dataset's own degraded images have; to keep them, name the folder of \
         unclipped scenes as --data, the kernels with --bank, and what dataset.toml says of the formation with --set \
         data.formation.x-max={x_max} and the like"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::kernel_code::CodeBasis;
    use crate::core::psf::Psf;
    use crate::core::rng;
    use crate::train::TrainingData as _;
    use ndarray::{Array1, Array2, Array3};
    use std::sync::Mutex;

    /// A kernel that leaves images as they are.
    fn bank() -> KernelBank {
        let psf = Psf::from_energy(Array3::ones((3, 1, 1))).unwrap();
        let basis = CodeBasis {
            mean: Array1::zeros(3),
            components: Array2::zeros((1, 3)),
            explained_variance: Array1::zeros(1),
        };
        KernelBank::new(vec![psf], Array2::zeros((1, 1)), basis, None).unwrap()
    }

    #[test]
    fn light_that_a_stored_image_has_lost_is_told_of_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.npy");
        let planes = Array3::from_shape_fn((3, 8, 8), |(_, y, x)| (y + x) as f32);
        let scene = LinearImage::from_planes(planes).unwrap();
        io::write_image(&path, &scene, &io::WriteOptions::default()).unwrap();
        let (config, x_max) = (TrainConfig::default(), 14.0);
        let warnings = |clipped, x_max| {
            let formation = FormationConfig { x_max, ..FormationConfig::default() };
            let bank = (bank(), "ab".to_owned());
            let clean = CleanImages::new((vec![path.clone()], clipped), bank, formation, &config).unwrap();
            let told = Mutex::new(Vec::new());
            let warn = |text: &str| told.lock().unwrap().push(text.to_owned());
            let samples = clean.samples(&config, &warn).unwrap();
            for position in 0..3 {
                samples.patch(0, 4, &mut rng::stream(1, &position.to_string())).unwrap();
            }
            drop(samples);
            told.into_inner().unwrap()
        };
        let [told] = &warnings(true, x_max)[..] else { panic!("it is told once") };
        assert!(told.contains("stored ground truths reach x-max = 14"), "{told}");
        assert!(warnings(true, 15.0).is_empty(), "nothing reaches it");
        assert!(warnings(false, x_max).is_empty(), "nothing was clipped");
    }
}
