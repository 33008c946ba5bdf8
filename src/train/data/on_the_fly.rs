//! Samples degraded when they are drawn: a clean image and any kernel of a bank.

use std::path::PathBuf;

use rand::RngExt as _;

use super::super::config::KERNELS_KEY;
use super::cache::Cache;
use super::{Patch, TrainingData, Window, check_files, pixel_bytes};
use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::core::kernel_code::KernelBank;
use crate::core::progress::Progress;
use crate::core::rng::Rng;
use crate::core::tone::ToneCurve;
use crate::dataset::{FormationConfig, KernelChoice};
use crate::io;
use crate::network::{Plane, Planes};
use crate::restore::{PlaneConfig, make_planes};

/// Degrades a clean image by the kernel of an index: the image formation model.
pub type Degrade<'a> = dyn Fn(&LinearImage, usize, &mut Rng) -> Result<LinearImage> + Sync + 'a;

/// Clean images, a bank, and the model that degrades the ones by the other.
pub struct OnTheFlyData<'a> {
    scenes: Vec<PathBuf>,
    bank: &'a KernelBank,
    /// Indices in the bank of the kernels that are drawn from.
    kernels: Vec<usize>,
    curve: ToneCurve,
    degrade: Box<Degrade<'a>>,
    cache: Cache<LinearImage>,
    /// Pixels by which clean images are larger than the frame on each side.
    margin: usize,
    /// The planes that samples carry, and what they are made by.
    planes: Option<(&'static [Plane], PlaneConfig)>,
}

impl<'a> OnTheFlyData<'a> {
    /// Takes clean images by their paths; at most `cache_mib` of them stay in memory.
    pub fn new(
        scenes: Vec<PathBuf>,
        bank: &'a KernelBank,
        curve: ToneCurve,
        degrade: Box<Degrade<'a>>,
        cache_mib: usize,
    ) -> Self {
        let kernels = (0..bank.len()).collect();
        let cache = Cache::new(cache_mib);
        Self { scenes, bank, kernels, curve, degrade, cache, margin: 0, planes: None }
    }

    /// Gives samples planes, made anew of every image that is degraded, as images of `formation` are.
    ///
    /// # Errors
    /// Those of [`PlaneConfig::of_formation`].
    pub fn with_planes(self, planes: &'static [Plane], formation: &FormationConfig) -> Result<Self> {
        let planes =
            if planes.is_empty() { None } else { Some((planes, PlaneConfig::of_formation(formation)?)) };
        Ok(Self { planes, ..self })
    }

    /// The same for clean images with a margin around the frame, which `degrade` returns without it.
    #[must_use]
    pub fn with_margin(self, margin: usize) -> Self {
        Self { margin, ..self }
    }

    /// Draws from the chosen kernels alone.
    ///
    /// # Errors
    /// [`Error::Config`](crate::core::error::Error::Config) for a kernel that the bank does not have.
    pub fn only(self, kernels: &KernelChoice) -> Result<Self> {
        let known: Vec<String> = (0..self.bank.len()).map(|index| self.bank.kernel_name(index)).collect();
        let kernels = kernels.indices(KERNELS_KEY, &known)?;
        Ok(Self { kernels, ..self })
    }
}

impl TrainingData for OnTheFlyData<'_> {
    fn len(&self) -> usize {
        self.scenes.len()
    }

    fn patch(&self, item: usize, side: usize, rng: &mut Rng) -> Result<Patch> {
        let path = &self.scenes[item];
        let clean = self.cache.get(&path.to_string_lossy(), || io::read_image(path))?;
        let kernel = self.kernels[rng.random_range(0..self.kernels.len())];
        let frame = |side: usize| side.saturating_sub(2 * self.margin);
        let window = Window::draw(side, frame(clean.height()), frame(clean.width()), rng)
            .map_err(|error| error.while_doing(format!("cutting {}", path.display())))?;
        // The whole image: a PSF's support reaches as far as the image's own sides.
        let degraded = (self.degrade)(&clean, kernel, rng)?;
        let in_scene = Window { top: window.top + self.margin, left: window.left + self.margin, ..window };
        let planes = match &self.planes {
            Some((wanted, config)) => {
                let psf = &self.bank.psfs[kernel];
                let planes = make_planes(wanted, &degraded, psf, config, &Progress::default())?;
                planes.crop(window.top, window.left, side, side)
            }
            None => Planes::default(),
        };
        Ok(Patch {
            degraded: self.curve.tone_map(&window.of(&degraded)),
            ground_truth: self.curve.tone_map(&in_scene.of(&clean)),
            code: Some(self.bank.code(kernel).to_owned()),
            planes,
        })
    }

    fn kept_bytes(&self) -> Result<u64> {
        pixel_bytes(&self.scenes)
    }

    fn check_size(&self, side: usize) -> Result<()> {
        check_files(&self.scenes, self.margin, side)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::kernel_code::CodeBasis;
    use crate::core::psf::Psf;
    use crate::core::rng;
    use ndarray::{Array1, Array2, Array3};

    /// A scene of 9 × 8 pixels, and two kernels with codes 0 and 1.
    fn scene_and_bank(folder: &std::path::Path) -> (PathBuf, KernelBank) {
        let path = folder.join("scene.npy");
        let planes = Array3::from_shape_fn((3, 9, 8), |(_, y, x)| (y * 8 + x) as f32);
        let scene = LinearImage::from_planes(planes).unwrap();
        io::write_image(&path, &scene, &io::WriteOptions::default()).unwrap();
        let psf = Psf::from_energy(Array3::ones((3, 2, 2))).unwrap();
        let basis = CodeBasis {
            mean: Array1::zeros(12),
            components: Array2::zeros((1, 12)),
            explained_variance: Array1::zeros(1),
        };
        let codes = Array2::from_shape_vec((2, 1), vec![0.0, 1.0]).unwrap();
        (path, KernelBank::new(vec![psf.clone(), psf], codes, basis, None).unwrap())
    }

    /// "Degrading" keeps the frame: what is degraded and what is clean show the same place.
    #[test]
    fn a_sample_of_a_scene_with_a_margin_is_of_the_frame() {
        let folder = tempfile::tempdir().unwrap();
        let (path, bank) = scene_and_bank(folder.path());
        let degrade = |image: &LinearImage, _: usize, _: &mut Rng| Ok(image.crop(2, 2, 5, 4));
        let curve = ToneCurve::default();
        let data = OnTheFlyData::new(vec![path], &bank, curve, Box::new(degrade), 16).with_margin(2);
        for position in 0..8 {
            let patch = data.patch(0, 3, &mut rng::stream(1, &position.to_string())).unwrap();
            assert_eq!(patch.degraded, patch.ground_truth);
            let first = curve.expand(patch.ground_truth.as_slice()[0]);
            assert!(first > 17.5 && first < 36.0, "{first} lies outside of the frame");
        }
        let said = data.patch(0, 5, &mut rng::stream(1, "large")).unwrap_err().in_full();
        assert!(said.contains("5 × 4"), "{said}");
        data.check_size(4).unwrap();
        let said = data.check_size(5).unwrap_err().in_full();
        assert!(said.contains("scene.npy") && said.contains("5 × 4"), "{said}");
    }

    /// "Degrading" adds the kernel's index.
    #[test]
    fn a_sample_carries_the_code_of_the_kernel_that_degraded_it() {
        let folder = tempfile::tempdir().unwrap();
        let (path, bank) = scene_and_bank(folder.path());
        let degrade =
            |image: &LinearImage, kernel: usize, _: &mut Rng| Ok(image.map_values(|x| x + kernel as f32));
        let curve = ToneCurve::default();
        let data = OnTheFlyData::new(vec![path], &bank, curve, Box::new(degrade), 16);
        for position in 0..8 {
            let patch = data.patch(0, 4, &mut rng::stream(1, &position.to_string())).unwrap();
            let kernel = patch.code.unwrap()[0];
            let pairs = patch.degraded.as_slice().iter().zip(patch.ground_truth.as_slice());
            for (degraded, clean) in pairs {
                assert!((degraded - curve.compress(curve.expand(*clean) + kernel)).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn a_sample_carries_the_planes_of_its_place_in_the_whole_image() {
        let folder = tempfile::tempdir().unwrap();
        let (path, bank) = scene_and_bank(folder.path());
        let brighten = |image: &LinearImage| image.map_values(|x| 7.4 * x);
        let degrade = move |image: &LinearImage, _: usize, _: &mut Rng| Ok(brighten(image));
        let curve = ToneCurve::default();
        let planes = &[Plane::Deconvolved, Plane::Saturated];
        let data = OnTheFlyData::new(vec![path.clone()], &bank, curve, Box::new(degrade), 16)
            .with_planes(planes, &FormationConfig::default())
            .unwrap();
        let whole = brighten(&io::read_image(&path).unwrap());
        let config = PlaneConfig::of_formation(&FormationConfig::default()).unwrap();
        let expected = make_planes(planes, &whole, &bank.psfs[0], &config, &Progress::default()).unwrap();
        let whole = curve.tone_map(&whole);
        for position in 0..4 {
            let patch = data.patch(0, 4, &mut rng::stream(1, &position.to_string())).unwrap();
            let places = (0..=5).flat_map(|top| (0..=4).map(move |left| (top, left)));
            let mut places = places.filter(|&(top, left)| whole.crop(top, left, 4, 4) == patch.degraded);
            let (top, left) = places.next().expect("the crop is of the image");
            assert_eq!(patch.planes, expected.crop(top, left, 4, 4));
        }
    }
}
