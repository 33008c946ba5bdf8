//! Measures restorations on the images of a dataset: as they are, or told another kernel than theirs.

use anyhow::{Context as _, Result, bail};

use udc::core::error;
use udc::core::image::{LinearImage, ToneMappedImage};
use udc::dataset::{Dataset, KernelChoice, Split, Triplet};
use udc::experiment::{self, EvalConfig, Evaluation, Label, Matrix, Measured, Method, Regions, Sample};

use super::pictures::Pictures;
use super::restorer::{Degraded, Restorer};
use crate::commands::Session;

/// Restorations with the images of a dataset that they are measured on.
pub(in crate::commands) struct Comparison<'a> {
    pub(in crate::commands) dataset: &'a Dataset,
    pub(in crate::commands) triplets: Vec<Triplet>,
    measured: Measured,
    pub(in crate::commands) restorers: &'a [Restorer],
    /// Memory that one restoration may take.
    pub(in crate::commands) max_memory: u64,
    pub(in crate::commands) session: &'a Session,
}

/// Which images of a dataset are measured on.
#[derive(Clone, Debug)]
pub(in crate::commands) struct Images {
    pub(in crate::commands) split: Split,
    /// The kernels whose images count.
    pub(in crate::commands) kernels: KernelChoice,
    /// At most the first so many of these.
    pub(in crate::commands) limit: Option<usize>,
}

impl Images {
    fn of(&self, dataset: &Dataset) -> Result<Vec<Triplet>> {
        let chosen = dataset.kernel_indices(&self.kernels, "--kernels")?;
        let names: Vec<&String> = chosen.iter().map(|&index| &dataset.kernel_names()[index]).collect();
        let is_chosen =
            |triplet: &&Triplet| self.kernels == KernelChoice::All || names.contains(&&triplet.kernel);
        let limit = self.limit.unwrap_or(usize::MAX);
        let triplets: Vec<Triplet> =
            dataset.split(self.split)?.into_iter().filter(is_chosen).take(limit).cloned().collect();
        if triplets.is_empty() {
            let (root, split) = (dataset.root.display(), self.split.name());
            bail!("{root}: the {split} split has no image of the chosen kernels {names:?}; choose others");
        }
        Ok(triplets)
    }
}

/// What is done beside measuring whole images.
pub(in crate::commands) struct Extras<'a> {
    /// Whether regions are measured each for itself.
    pub(in crate::commands) regions: bool,
    /// Which images are kept.
    pub(in crate::commands) pictures: &'a Pictures,
}

impl<'a> Comparison<'a> {
    /// Takes the triplets to measure on, after checking that the restorations can work on them.
    pub(in crate::commands) fn new(
        dataset: &'a Dataset,
        restorers: &'a [Restorer],
        images: &Images,
        max_memory: u64,
        session: &'a Session,
    ) -> Result<Self> {
        for restorer in restorers {
            restorer.check(dataset)?;
            restorer.warnings(dataset).into_iter().for_each(|warning| session.warn(warning));
        }
        let measured = Measured::of(dataset, images.split, images.kernels.clone(), images.limit);
        Ok(Self { dataset, triplets: images.of(dataset)?, measured, restorers, max_memory, session })
    }

    /// Measures every restoration of every image under its own kernel.
    pub(in crate::commands) fn measure(
        &self,
        config: &EvalConfig,
        extras: &Extras<'_>,
    ) -> Result<Evaluation> {
        let methods: Vec<Method> = self.restorers.iter().map(Restorer::method).collect();
        let sample = |index: usize, triplet: &Triplet| {
            let (clean, degraded) = self.read(triplet)?;
            let kernel = self.dataset.kernel_index(triplet)?;
            let curve = self.dataset.formation.curve()?;
            let images = self.restorers.iter().map(|restorer| self.restore(restorer, &degraded, kernel));
            let images = images.collect::<error::Result<_>>()?;
            let regions = extras.regions.then(|| Regions::divide(&clean, &degraded, curve));
            let sample = Sample { ground_truth: curve.tone_map(&clean), images, regions };
            let place = (index, self.triplets.len());
            extras.pictures.keep(&extras.pictures.files(place, &scene_of(triplet), &methods), &sample)?;
            Ok(sample)
        };
        let mut evaluation = self.run(config, methods.clone(), sample)?;
        evaluation.measured = vec![self.measured.clone()];
        for (method, restorer) in evaluation.methods.iter_mut().zip(self.restorers) {
            method.cost = restorer.cost(&evaluation.sizes);
        }
        Ok(evaluation)
    }

    /// The files that [`measure`](Self::measure) keeps as pictures.
    pub(super) fn picture_files(&self, pictures: &Pictures) -> impl Iterator<Item = String> {
        let methods: Vec<Method> = self.restorers.iter().map(Restorer::method).collect();
        let total = self.triplets.len();
        let files = move |(index, triplet): (usize, &Triplet)| {
            pictures.files((index, total), &scene_of(triplet), &methods)
        };
        self.triplets.iter().enumerate().flat_map(files)
    }

    /// Measures every image under every kernel that a restoration may be told, right or wrong.
    pub(super) fn mismatch(&self, config: &EvalConfig) -> Result<Vec<Matrix>> {
        let mut matrices = Vec::new();
        for restorer in self.restorers.iter().filter(|restorer| restorer.knows_the_kernel()) {
            let told: Vec<Method> = self.dataset.kernel_names().iter().map(Method::restored).collect();
            let sample = |_, triplet: &Triplet| {
                let (clean, degraded) = self.read(triplet)?;
                let images = (0..told.len()).map(|kernel| self.restore(restorer, &degraded, kernel));
                let images = images.collect::<error::Result<_>>()?;
                let ground_truth = self.dataset.formation.curve()?.tone_map(&clean);
                Ok(Sample { ground_truth, images, regions: None })
            };
            let evaluation = self.run(config, told.clone(), sample)?;
            matrices.extend(Matrix::of(&restorer.method().name, &evaluation));
        }
        Ok(matrices)
    }

    fn run(
        &self,
        config: &EvalConfig,
        methods: Vec<Method>,
        mut sample: impl FnMut(usize, &Triplet) -> error::Result<Sample>,
    ) -> Result<Evaluation> {
        let bar = self.session.progress.bar(self.triplets.len() as u64, "triplets");
        let samples = self.triplets.iter().enumerate().map(|(index, triplet)| {
            let (id, kernel) = (triplet.id.clone(), Some(triplet.kernel.clone()));
            let sample = sample(index, triplet);
            bar.inc(1);
            (Label { id, kernel, angle_deg: triplet.angle_deg }, sample)
        });
        let evaluation = experiment::measure(config, methods, samples)
            .with_context(|| format!("measuring on {}", self.dataset.root.display()))?;
        bar.finish_and_clear();
        Ok(evaluation)
    }

    /// The clean and the degraded image of a triplet, of one size.
    pub(super) fn read(&self, triplet: &Triplet) -> error::Result<(LinearImage, LinearImage)> {
        let clean = self.dataset.read_ground_truth(triplet)?;
        let degraded = self.dataset.read_degraded(triplet)?;
        let size = |image: &LinearImage| format!("{} × {}", image.height(), image.width());
        if size(&clean) != size(&degraded) {
            return Err(error::Error::shape("size of the degraded image", size(&clean), size(&degraded)));
        }
        Ok((clean, degraded))
    }

    fn restore(
        &self,
        restorer: &Restorer,
        image: &LinearImage,
        kernel: usize,
    ) -> error::Result<ToneMappedImage> {
        self.session.progress.check()?;
        let degraded = Degraded { dataset: self.dataset, image, kernel, max_memory: self.max_memory };
        restorer.restore(&degraded).map_err(|error| match error {
            error::Error::Interrupted => error,
            other => error::Error::Unsupported(format!("restored by {}: {other}", restorer.method().name)),
        })
    }
}

/// What the pictures of a triplet are called.
fn scene_of(triplet: &Triplet) -> String {
    format!("{}_{}", triplet.id, triplet.kernel)
}
