//! Samples from a dataset's files: clean and degraded image of a triplet, cut at one place.

use std::collections::BTreeSet;
use std::path::PathBuf;

use super::super::config::KERNELS_KEY;
use super::cache::Cache;
use super::{Patch, TrainingData, Window, check_files, pixel_bytes};
use crate::core::error::{Error, Result};
use crate::core::image::ToneMappedImage;
use crate::core::kernel_code::KernelCode;
use crate::core::progress::Progress;
use crate::core::rng::Rng;
use crate::core::tone::ToneCurve;
use crate::dataset::{Dataset, KernelChoice, Split, Triplet};
use crate::network::Plane;
use crate::restore::{PlaneConfig, make_planes};

/// The triplets of one split.
#[derive(Debug)]
pub struct StoredData<'a> {
    dataset: &'a Dataset,
    items: Vec<(&'a Triplet, Option<KernelCode>)>,
    curve: ToneCurve,
    cache: Cache<ToneMappedImage>,
    /// The planes that samples carry.
    planes: &'static [Plane],
}

impl<'a> StoredData<'a> {
    /// Opens a split; at most `cache_mib` of images stay in memory.
    ///
    /// # Errors
    /// [`Error::Format`] when the split is empty, or a kernel is unknown.
    pub fn new(dataset: &'a Dataset, split: Split, cache_mib: usize) -> Result<Self> {
        let has_codes = dataset.code_dim() > 0;
        let with_code = |triplet| {
            let code = if has_codes { Some(dataset.code(triplet)?) } else { None };
            Ok((triplet, code))
        };
        let items = dataset.split(split)?.into_iter().map(with_code).collect::<Result<_>>()?;
        let curve = dataset.formation.curve()?;
        Ok(Self { dataset, items, curve, cache: Cache::new(cache_mib), planes: &[] })
    }

    /// Gives samples planes, made of each whole image once where there is room to keep them.
    ///
    /// # Errors
    /// [`Error::Config`] when the dataset has no PSFs to make them with.
    pub fn with_planes(self, planes: &'static [Plane]) -> Result<Self> {
        if !planes.is_empty() && self.dataset.bank.is_none() {
            let root = self.dataset.root.display();
            let reason = format!(
                "the network reads planes that are made with PSFs, and {root} has kernel codes alone; train on a dataset \
                 of `udc synth`"
            );
            return Err(Error::config("architecture.kind", reason));
        }
        Ok(Self { planes, ..self })
    }

    /// Keeps the triplets of the chosen kernels; files of others are never read.
    ///
    /// # Errors
    /// [`Error::Config`] for a kernel that the dataset does not know; [`Error::Format`] when the split has no triplet of
    /// those chosen.
    pub fn only(mut self, kernels: &KernelChoice) -> Result<Self> {
        let chosen = self.dataset.kernel_indices(kernels, KERNELS_KEY)?;
        let names: Vec<&String> = chosen.iter().map(|&index| &self.dataset.kernel_names()[index]).collect();
        let split = self.items.first().map_or("", |(triplet, _)| triplet.split.name());
        self.items.retain(|(triplet, _)| *kernels == KernelChoice::All || names.contains(&&triplet.kernel));
        if self.items.is_empty() {
            let reason =
                format!("the {split} split has no image of the chosen kernels, {KERNELS_KEY} = {names:?}");
            return Err(Error::format(&self.dataset.root, reason));
        }
        Ok(self)
    }
}

impl StoredData<'_> {
    /// The files of clean images, each once.
    fn clean_files(&self) -> Vec<PathBuf> {
        let clean: BTreeSet<&String> = self.items.iter().map(|(triplet, _)| &triplet.gt).collect();
        clean.into_iter().map(|gt| self.dataset.root.join(gt)).collect()
    }

    /// The part of a plane of a degraded image that lies in a window.
    fn cut_plane(&self, plane: Plane, triplet: &Triplet, window: Window) -> Result<(Plane, ToneMappedImage)> {
        let whole = self.cache.get(&format!("{}#{}", triplet.degraded, plane.name()), || {
            let bank = self.dataset.bank.as_ref().expect("there is one where planes are wanted");
            let psf = &bank.psfs[self.dataset.kernel_index(triplet)?];
            let config = PlaneConfig::of_formation(&self.dataset.formation)?;
            let degraded = self.dataset.read_degraded(triplet)?;
            let made = make_planes(&[plane], &degraded, psf, &config, &Progress::default())?;
            Ok(made.get(plane).expect("what is wanted is made").clone())
        })?;
        Ok((plane, window.of(&whole)))
    }
}

impl TrainingData for StoredData<'_> {
    fn len(&self) -> usize {
        self.items.len()
    }

    fn patch(&self, item: usize, side: usize, rng: &mut Rng) -> Result<Patch> {
        let (triplet, code) = &self.items[item];
        let clean = self.cache.get(&triplet.gt, || {
            self.dataset.read_ground_truth(triplet).map(|image| self.curve.tone_map(&image))
        })?;
        let degraded = self.cache.get(&triplet.degraded, || {
            self.dataset.read_degraded(triplet).map(|image| self.curve.tone_map(&image))
        })?;
        let size = |image: &ToneMappedImage| format!("{} × {}", image.height(), image.width());
        if size(&clean) != size(&degraded) {
            let path = self.dataset.root.join(&triplet.degraded);
            let what = format!("size of the degraded image {}", path.display());
            return Err(Error::shape(what, size(&clean), size(&degraded)));
        }
        let window = Window::draw(side, degraded.height(), degraded.width(), rng).map_err(|error| {
            error.while_doing(format!("cutting {}", self.dataset.root.join(&triplet.degraded).display()))
        })?;
        Ok(Patch {
            degraded: window.of(&degraded),
            ground_truth: window.of(&clean),
            code: code.clone(),
            planes: self
                .planes
                .iter()
                .map(|&plane| self.cut_plane(plane, triplet, window))
                .collect::<Result<_>>()?,
        })
    }

    /// Of the clean images alone: those that are degraded have the same sizes.
    fn check_size(&self, side: usize) -> Result<()> {
        check_files(&self.clean_files(), 0, side)
    }

    /// Clean images, degraded ones and their planes, all of about one size.
    fn kept_bytes(&self) -> Result<u64> {
        let clean = self.clean_files();
        let images = clean.len() + self.items.len() * (1 + self.planes.len());
        Ok(pixel_bytes(&clean)? / clean.len().max(1) as u64 * images as u64)
    }
}
