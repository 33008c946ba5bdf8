//! Measures candidates on the images of a dataset: told the kernel of each, or another.

use super::candidate::{Candidate, Degraded};
use super::measurement::MeasuredMismatch;
use super::pictures::KeptPictures;
use super::score::MacCounts;
use super::{
    ComparedMethod, EvalConfig, Evaluation, Label, Listener, Measured, Regions, Sample, measure_part,
};
use crate::batch::LinearCost;
use crate::core::error::{Error, Result};
use crate::core::image::{LinearImage, ToneMappedImage};
use crate::core::progress::Progress;
use crate::core::shard::Shard;
use crate::dataset::{Dataset, KernelChoice, Split, Triplet};
use crate::restore::Capture;

/// Candidates with the images of a dataset that they are measured on.
pub struct Comparison<'a> {
    pub(super) dataset: &'a Dataset,
    /// Those of all shards.
    triplets: Vec<Triplet>,
    shard: Shard,
    pub(super) listener: Listener<'a>,
    candidates: &'a [Candidate],
    measured: Measured,
    max_memory: u64,
}

/// Which images of a dataset are measured on, and what may be spent on each.
#[derive(Clone, Debug)]
pub struct ImagesConfig {
    /// The part of the dataset.
    pub split: Split,
    /// The kernels whose images count.
    pub kernels: KernelChoice,
    /// At most the first so many of these.
    pub limit: Option<usize>,
    /// Bytes that one restoration may take.
    pub max_memory: u64,
    /// Whose images are measured: a block of these, so that blocks one after the other are all in their order.
    pub shard: Shard,
}

impl ImagesConfig {
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
            return Err(Error::Unsupported(format!(
                "{root}: the {split} split has no image of the chosen kernels {names:?}; choose others"
            )));
        }
        Ok(triplets)
    }
}

impl<'a> Comparison<'a> {
    /// Takes the triplets to measure on, after checking that the candidates can work on them.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when the dataset lacks what a candidate needs, or has no image of those that are asked for;
    /// [`Error::Config`] when it has no kernel of a name.
    pub fn new(
        dataset: &'a Dataset,
        candidates: &'a [Candidate],
        images: &ImagesConfig,
        listener: Listener<'a>,
    ) -> Result<Self> {
        for candidate in candidates {
            candidate.check(dataset)?;
            candidate.warnings(dataset).iter().for_each(|warning| (listener.warn)(warning));
        }
        let measured = Measured::of(dataset, images.split, images.kernels.clone(), images.limit);
        let (triplets, max_memory, shard) = (images.of(dataset)?, images.max_memory, images.shard);
        Ok(Self { dataset, triplets, shard, listener, candidates, measured, max_memory })
    }

    /// The triplets that are measured on, with their places among those of all shards.
    pub(super) fn own(&self) -> impl ExactSizeIterator<Item = (usize, &Triplet)> {
        self.shard.block(self.triplets.len()).map(|index| (index, &self.triplets[index]))
    }

    /// The number of triplets of all shards.
    pub(super) fn total(&self) -> usize {
        self.triplets.len()
    }

    /// Measures every candidate on every image of the shard under its own kernel, with the parts of images apart if
    /// `regions` is set; some of the images become pictures. What candidates cost is left open.
    ///
    /// # Errors
    /// Those of [`measure`](super::measure) but for the absence of images, and of writing pictures.
    pub fn evaluate(
        &self,
        config: &EvalConfig,
        regions: bool,
        pictures: &KeptPictures,
    ) -> Result<Evaluation> {
        let methods: Vec<ComparedMethod> = self.candidates.iter().map(Candidate::method).collect();
        let sample = |triplet: &Triplet| {
            let (clean, degraded) = self.read(triplet)?;
            let kernel = self.dataset.kernel_index(triplet)?;
            let curve = self.dataset.formation.curve()?;
            let images =
                self.candidates.iter().map(|candidate| self.restore(candidate, (&clean, &degraded), kernel));
            let images = images.collect::<Result<_>>()?;
            let regions = regions.then(|| Regions::divide(&clean, &degraded, curve));
            Ok(Sample { ground_truth: curve.tone_map(&clean), images, regions })
        };
        let keep = |index: usize, triplet: &Triplet, sample: &Sample| {
            let files = pictures.files((index, self.triplets.len()), &scene_of(triplet), &methods);
            pictures.keep(&files, sample, self.dataset.formation.curve()?)
        };
        let mut evaluation = self.run(config, methods.clone(), sample, keep)?;
        evaluation.measured = vec![self.measured.clone()];
        Ok(evaluation)
    }

    pub(super) fn candidates(&self) -> &[Candidate] {
        self.candidates
    }

    /// The cost of a candidate by the number of pixels, and the memory for a whole image.
    pub(super) fn cost(
        &self,
        candidate: &Candidate,
        (triplet, image): (&Triplet, &LinearImage),
        progress: &Progress,
    ) -> Result<(LinearCost, u64)> {
        let kernel = self.dataset.kernel_index(triplet)?;
        let (dataset, max_memory) = (self.dataset, self.max_memory);
        let degraded = Degraded { dataset, image, clean: image, kernel, max_memory };
        let Some(restoration) = candidate.restoration(&degraded)? else { return Ok(Default::default()) };
        let capture = Capture::from(image.clone());
        let bytes = restoration.plan(capture.image.size())?.bytes;
        Ok((restoration.cost(&capture, progress)?, bytes))
    }

    /// How tables name the candidates.
    pub(super) fn method_names(&self) -> Vec<String> {
        self.candidates.iter().map(|candidate| candidate.method().name).collect()
    }

    /// The multiply-accumulates of every candidate for images of these sizes, where they are counted.
    pub(super) fn macs(&self, sizes: &[([usize; 2], usize)]) -> Vec<Option<MacCounts>> {
        self.candidates.iter().map(|candidate| candidate.macs(sizes)).collect()
    }

    /// The files that [`evaluate`](Self::evaluate) keeps as pictures.
    pub(super) fn picture_files(&self, pictures: &KeptPictures) -> impl Iterator<Item = String> {
        let methods: Vec<ComparedMethod> = self.candidates.iter().map(Candidate::method).collect();
        let total = self.triplets.len();
        let files = move |(index, triplet): (usize, &Triplet)| {
            pictures.files((index, total), &scene_of(triplet), &methods)
        };
        self.own().flat_map(files)
    }

    /// The candidates whose result depends on the kernel that they are told.
    pub(super) fn told(&self) -> impl Iterator<Item = &Candidate> {
        self.candidates.iter().filter(|candidate| candidate.knows_the_kernel())
    }

    /// Measures every image of the shard under every kernel that a candidate may be told, right or wrong; one evaluation a
    /// candidate.
    ///
    /// # Errors
    /// Those of [`measure`](super::measure) but for the absence of images.
    pub(super) fn mismatch(&self, config: &EvalConfig) -> Result<Vec<MeasuredMismatch>> {
        let mut mismatch = Vec::new();
        for candidate in self.told() {
            let told: Vec<ComparedMethod> =
                self.dataset.kernel_names().iter().map(ComparedMethod::restored).collect();
            let sample = |triplet: &Triplet| {
                let (clean, degraded) = self.read(triplet)?;
                let images =
                    (0..told.len()).map(|kernel| self.restore(candidate, (&clean, &degraded), kernel));
                let images = images.collect::<Result<_>>()?;
                let ground_truth = self.dataset.formation.curve()?.tone_map(&clean);
                Ok(Sample { ground_truth, images, regions: None })
            };
            let evaluation = self.run(config, told.clone(), sample, |_, _, _| Ok(()))?;
            mismatch.push(MeasuredMismatch { method: candidate.method().name, evaluation });
        }
        Ok(mismatch)
    }

    /// Measures the samples of the shard's triplets, and hands each over to be kept before, with the place of its triplet.
    fn run(
        &self,
        config: &EvalConfig,
        methods: Vec<ComparedMethod>,
        sample: impl Fn(&Triplet) -> Result<Sample>,
        keep: impl Fn(usize, &Triplet, &Sample) -> Result<()>,
    ) -> Result<Evaluation> {
        let bar = self.listener.progress.bar(self.own().len() as u64, "triplets");
        let samples = self.own().map(|(index, triplet)| {
            let (id, kernel) = (triplet.id.clone(), Some(triplet.kernel.clone()));
            let sample = sample(triplet);
            bar.inc(1);
            sample.as_ref().map_or(Ok(()), |sample| keep(index, triplet, sample))?;
            Ok((Label { id, kernel, angle_deg: triplet.angle_deg }, sample))
        });
        let evaluation = measure_part(config, methods, samples)
            .map_err(|error| error.while_doing_unless_interrupted(self.doing()))?;
        bar.finish_and_clear();
        Ok(evaluation)
    }

    /// What is being done, for messages.
    pub(super) fn doing(&self) -> String {
        format!("measuring on {}", self.dataset.root.display())
    }

    /// The clean and the degraded image of a triplet, of one size.
    pub(super) fn read(&self, triplet: &Triplet) -> Result<(LinearImage, LinearImage)> {
        let clean = self.dataset.read_ground_truth(triplet)?;
        let degraded = self.dataset.read_degraded(triplet)?;
        let size = |image: &LinearImage| format!("{} × {}", image.height(), image.width());
        if size(&clean) != size(&degraded) {
            return Err(Error::shape("size of the degraded image", size(&clean), size(&degraded)));
        }
        Ok((clean, degraded))
    }

    fn restore(
        &self,
        candidate: &Candidate,
        (clean, image): (&LinearImage, &LinearImage),
        kernel: usize,
    ) -> Result<ToneMappedImage> {
        self.listener.progress.check()?;
        let degraded = Degraded { dataset: self.dataset, image, clean, kernel, max_memory: self.max_memory };
        let doing = || format!("restored by {}", candidate.method().name);
        candidate.restore(&degraded).map_err(|error| error.while_doing_unless_interrupted(doing()))
    }
}

/// What the pictures of a triplet are called.
fn scene_of(triplet: &Triplet) -> String {
    format!("{}_{}", triplet.id, triplet.kernel)
}
