//! Makes all degraded images of one scene.

use std::time::{Duration, Instant};

use ndarray::Array3;
use rayon::prelude::*;
use serde::Serialize;

use crate::core::capture::{CaptureInfo, is_level};
use crate::core::error::Result;
use crate::core::fft::Spectrum;
use crate::core::field::PsfField;
use crate::core::image::{CHANNELS, Linear, LinearImage};
use crate::core::provenance::Provenance;
use crate::dataset::{FormationConfig, Triplet};
use crate::io::{self, WriteOptions};

use super::Formation;
use super::field::convolve_nodes;
use super::folder::{DatasetFolder, Image};
use super::kernels::Kernels;
use super::scenes::Scene;
use super::synthesis::Synthesis;

/// A synthesis at work.
pub(super) struct Run<'a> {
    pub(super) synthesis: &'a Synthesis,
    pub(super) formation: Formation,
    pub(super) folder: DatasetFolder,
    /// The kernels' names, in the order of the bank.
    pub(super) names: Vec<String>,
    /// The kernels' transforms for scenes of the last size.
    pub(super) kernels: Option<Kernels<'a>>,
}

/// What happened to one scene.
#[derive(Clone, Debug)]
pub struct SceneReport {
    /// The scene.
    pub id: String,
    /// Its height and width.
    pub size: [usize; 2],
    /// Images that were made; the others were there.
    pub made: usize,
    /// What its file says of its colours against what the user says.
    pub contradiction: Option<String>,
    /// Time to read it and to write its ground truth.
    pub reading: Duration,
    /// Time for transforms, noise and clipping, on all threads together.
    pub computing: Duration,
    /// Time to encode and write the degraded images, on all threads together.
    pub writing: Duration,
}

/// What an image's provenance says.
#[derive(Serialize)]
#[serde(rename_all = "kebab-case")]
struct Origin<'a> {
    scene: &'a str,
    /// The key by which `udc crop` names a scene's origin.
    panorama: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    kernel: Option<&'a str>,
    /// By which a run that goes on knows the scene again; in ground truths only.
    #[serde(skip_serializing_if = "Option::is_none")]
    scene_sha256: Option<&'a str>,
    bank_sha256: &'a str,
    seed: u64,
    formation: &'a FormationConfig,
}

/// One degraded image that has been made.
struct Made {
    triplet: Triplet,
    image: Image,
    computing: Duration,
    writing: Duration,
}

/// A scene, ready for the convolution.
enum Light<'a> {
    /// Its transform.
    Spectrum(Spectrum),
    /// The scene itself, and the PSFs over the frame.
    Field(LinearImage, &'a PsfField),
}

impl Light<'_> {
    /// x∗k of kernel `index` on the frame; a field has one image.
    fn through(&self, kernels: &Kernels<'_>, formation: &Formation, index: usize) -> Result<Array3<f32>> {
        let convolver = &kernels.convolver;
        match self {
            Self::Spectrum(spectrum) => Ok(formation.irradiance(convolver, spectrum, &*kernels.otf(index)?)),
            Self::Field(scene, field) => {
                convolve_nodes(convolver, (scene, formation.margin()), field.grid(), |node| kernels.otf(node))
            }
        }
    }
}

impl<'a> Run<'a> {
    /// The kernels that a scene has yet to be seen through.
    pub(super) fn unfinished(&self, scene: &Scene) -> Vec<usize> {
        (0..self.names.len())
            .filter(|&index| !self.folder.is_finished(&scene.id, &self.names[index]))
            .collect()
    }

    /// Makes the images of a scene for the kernels `todo`, telling `on_images` how many more are done.
    pub(super) fn make(
        &mut self,
        scene: &Scene,
        todo: &[usize],
        mut on_images: impl FnMut(usize) -> Result<()>,
    ) -> Result<SceneReport> {
        let started = Instant::now();
        // Before the pixels, so that they are not older than it.
        let sha256 = io::sha256_of_file(&scene.path)?;
        let (image, contradiction) = io::read_image_told::<Linear>(&scene.path, self.synthesis.told)?;
        let size = [image.height(), image.width()];
        let kernels = self.take_kernels(size)?;
        self.write_ground_truth(scene, &image, &sha256)?;
        let reading = started.elapsed();
        let started = Instant::now();
        let light = match &self.synthesis.field {
            Some(field) => Light::Field(self.formation.scene(&image).into_owned(), field),
            None => Light::Spectrum(kernels.convolver.spectrum(&self.formation.scene(&image))?),
        };
        let (mut computing, mut writing) = (started.elapsed(), Duration::ZERO);
        drop(image);
        for indices in todo.chunks(kernels.plan.at_once) {
            let made = indices.par_iter().map(|&index| {
                let mut made = self.degrade(scene, &kernels, &light, index)?;
                made.triplet.scene_sha256 = Some(sha256.clone());
                Ok(made)
            });
            let made: Vec<Made> = made.collect::<Result<_>>()?;
            computing += made.iter().map(|made| made.computing).sum::<Duration>();
            writing += made.iter().map(|made| made.writing).sum::<Duration>();
            made.iter().try_for_each(|made| self.folder.keep(&made.triplet.degraded, &made.image))?;
            self.folder.record(made.into_iter().map(|made| made.triplet))?;
            on_images(indices.len())?;
        }
        if let Light::Spectrum(spectrum) = light {
            kernels.convolver.reuse(spectrum);
        }
        self.kernels = Some(kernels);
        let bank = &self.synthesis.bank;
        let names = &self.names;
        self.folder.end_scene(&scene.id, |triplet| {
            let kernel = names.iter().position(|name| *name == triplet.kernel);
            kernel.map(|index| bank.code(index).to_vec()).unwrap_or_default()
        })?;
        let size = self.synthesis.config.formation.frame_size(size)?;
        let (id, made) = (scene.id.clone(), todo.len());
        Ok(SceneReport { id, size, made, contradiction, reading, computing, writing })
    }

    /// The kernels' transforms for scenes of `size`: those of the last scene where they fit.
    fn take_kernels(&mut self, size: [usize; 2]) -> Result<Kernels<'a>> {
        // Those of another size are let go first: memory is planned for one size at a time.
        let kept = self.kernels.take().filter(|kernels| kernels.convolver.image_size() == size);
        match kept {
            Some(kernels) => Ok(kernels),
            None => Kernels::new(&self.formation, self.synthesis.kernels(), size, self.synthesis.max_bytes),
        }
    }

    /// Writes the ground truth anew, with the hash of its scene's file.
    fn write_ground_truth(&mut self, scene: &Scene, image: &LinearImage, sha256: &str) -> Result<()> {
        let path = self.path_of(scene, None);
        let options = self.write_options(scene, None, Some(sha256));
        let image = self.folder.write(&path, &self.formation.ground_truth(image)?, &options)?;
        self.folder.keep(&path, &image)
    }

    fn degrade(&self, scene: &Scene, kernels: &Kernels<'_>, light: &Light<'_>, index: usize) -> Result<Made> {
        let name = &self.names[index];
        let started = Instant::now();
        let irradiance = light.through(kernels, &self.formation, index)?;
        let image = self.formation.record(irradiance, &format!("{}/{name}", scene.id))?;
        let computing = started.elapsed();
        let started = Instant::now();
        let degraded = self.path_of(scene, Some(name));
        let image = self.folder.write(&degraded, &image, &self.write_options(scene, Some(name), None))?;
        let triplet = Triplet {
            id: scene.id.clone(),
            split: scene.split,
            gt: self.path_of(scene, None),
            degraded,
            kernel: name.clone(),
            angle_deg: self.synthesis.bank.angles_deg.as_ref().map(|angles| angles[index]),
            source: scene.source.clone(),
            sha256: Some(image.sha256.clone()),
            scene_sha256: None,
        };
        Ok(Made { triplet, image, computing, writing: started.elapsed() })
    }

    fn path_of(&self, scene: &Scene, kernel: Option<&str>) -> String {
        self.folder.path_of(&scene.id, kernel, &self.synthesis.config.image_format)
    }

    /// What is not listed is unfinished, so that a file of its name may be replaced.
    fn write_options(&self, scene: &Scene, kernel: Option<&str>, scene_sha256: Option<&str>) -> WriteOptions {
        let config = &self.synthesis.config;
        let x_max = config.formation.x_max;
        let saturation = is_level(x_max).then_some([x_max; CHANNELS]);
        let origin = Origin {
            scene: &scene.id,
            panorama: &scene.source,
            kernel,
            scene_sha256,
            bank_sha256: &config.bank_sha256,
            seed: config.seed,
            formation: &config.formation,
        };
        WriteOptions {
            half: config.half,
            overwrite: true,
            provenance: Some(Provenance::new("synth", &origin)),
            capture: Some(CaptureInfo {
                saturation,
                primaries: config.scene_primaries,
                ..CaptureInfo::default()
            }),
        }
    }
}
