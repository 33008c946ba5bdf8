//! A whole experiment on datasets: evaluation, wrong kernels, scenes of a monitor's range.

use std::path::Path;

use super::candidate::Candidate;
use super::comparison::{Comparison, ImagesConfig};
use super::files::{LDR, MISMATCH, REGIONS, RESULTS, plot_of_matrix, plots_of};
use super::ldr::{Ldr, LdrResults, LdrRow};
use super::matrix::Mismatch;
use super::pictures::{FOLDER, KeptPictures};
use super::{EvalConfig, Evaluation, Listener};
use crate::core::error::{Error, Result};
use crate::core::metrics::{Measure, Metric};
use crate::dataset::Dataset;

/// What is done with datasets and candidates.
#[derive(Clone, Debug)]
pub struct ExperimentConfig {
    /// What is measured.
    pub measuring: EvalConfig,
    /// On which images.
    pub images: ImagesConfig,
    /// Whether highlights, flare and the rest of each image are measured each for itself too.
    pub regions: bool,
    /// Whether every image is restored under the kernels of all rotations too.
    pub mismatch: bool,
    /// The white of a monitor at which scenes are clipped, to be measured too.
    pub ldr: Option<f32>,
    /// How many of the images are kept as pictures.
    pub pictures: usize,
}

/// An experiment that can be carried out: everything that can be checked before the work was.
pub struct Experiment<'a> {
    config: &'a ExperimentConfig,
    /// Dataset by dataset, with their names.
    comparisons: Vec<(&'a str, Comparison<'a>)>,
    ldr: Option<Ldr<'a>>,
}

/// What an experiment found.
#[derive(Clone, Debug)]
pub struct Findings {
    /// Every score.
    pub evaluation: Evaluation,
    /// The matrices of right and wrong kernels, where they were asked for.
    pub mismatch: Option<Mismatch>,
    /// The comparison with scenes of a monitor's range, where it was asked for, and rows to look at.
    pub ldr: Option<(LdrResults, Vec<LdrRow>)>,
}

impl Findings {
    /// The findings of an evaluation alone.
    pub fn of(evaluation: Evaluation) -> Self {
        Self { evaluation, mismatch: None, ldr: None }
    }
}

impl<'a> Experiment<'a> {
    /// Checks that the candidates can be compared on the datasets, which come with their names in tables.
    ///
    /// # Errors
    /// Those of [`Comparison::new`] and [`Ldr::new`]; [`Error::Unsupported`] when no candidate is told kernels, or several
    /// datasets are given, for what needs the one and can do with only one of the other.
    pub fn new(
        datasets: &'a [(String, Dataset)],
        candidates: &'a [Candidate],
        config: &'a ExperimentConfig,
        listener: Listener<'a>,
    ) -> Result<Self> {
        if datasets.len() > 1 && (config.mismatch || config.ldr.is_some()) {
            let reason = "--mismatch and --ldr are of one dataset; run them for each";
            return Err(Error::Unsupported(reason.to_owned()));
        }
        let comparison = |(name, dataset): &'a (String, Dataset)| {
            Ok((name.as_str(), Comparison::new(dataset, candidates, &config.images, listener)?))
        };
        let comparisons = datasets.iter().map(comparison).collect::<Result<_>>()?;
        let mut experiment = Self { config, comparisons, ldr: None };
        if config.mismatch && experiment.first()?.told().next().is_none() {
            let reason = "--mismatch tells wrong kernels to what is told kernels: add a --model that takes codes, or a \
                          --method";
            return Err(Error::Unsupported(reason.to_owned()));
        }
        if let Some(white) = config.ldr {
            experiment.ldr = Some(Ldr::new(experiment.first()?.dataset, white, listener.warn)?);
        }
        Ok(experiment)
    }

    fn first(&self) -> Result<&Comparison<'a>> {
        let first = self.comparisons.first().map(|(_, comparison)| comparison);
        first.ok_or_else(|| Error::Unsupported("there is no dataset to measure on".to_owned()))
    }

    /// The names of all files that its results may take, within their folder.
    pub fn files(&self) -> Vec<String> {
        let metrics = || self.config.measuring.metrics.iter().map(Measure::metric);
        let mut names = files_of_evaluation(metrics());
        names.extend(self.config.regions.then(|| REGIONS.to_owned()));
        if self.config.mismatch {
            let told = self.comparisons.first().map_or(0, |(_, comparison)| comparison.told().count());
            names.extend((1..=told).flat_map(|number| metrics().map(move |m| plot_of_matrix(m, number))));
            names.extend(MISMATCH.map(str::to_owned));
        }
        if self.config.ldr.is_some() {
            names.extend(LDR.map(str::to_owned));
        }
        for (name, comparison) in &self.comparisons {
            let pictures = self.pictures(Path::new(""), name);
            names.extend(comparison.picture_files(&pictures).map(|file| format!("{FOLDER}/{file}")));
        }
        names
    }

    /// Measures everything; pictures are written into the folder of the results on the way.
    ///
    /// # Errors
    /// Those of [`Comparison::evaluate`], [`Comparison::mismatch`] and [`Ldr::measure`].
    pub fn run(&self, folder: &Path) -> Result<Findings> {
        let ExperimentConfig { measuring, regions, .. } = self.config;
        let first = self.first()?;
        let mut evaluations = Vec::new();
        for (name, comparison) in &self.comparisons {
            let evaluation = comparison.evaluate(measuring, *regions, &self.pictures(folder, name))?;
            evaluations.push(((*name).to_owned(), evaluation));
        }
        let evaluation = match evaluations.len() {
            1 => evaluations.swap_remove(0).1,
            _ => Evaluation::join(evaluations),
        };
        let mismatch = self.config.mismatch.then(|| first.mismatch(measuring)).transpose()?;
        let ldr = self.ldr.as_ref().map(|ldr| ldr.measure(first, measuring.definition)).transpose()?;
        Ok(Findings { evaluation, mismatch, ldr })
    }

    /// Where a dataset's pictures go; where there are several datasets, its name tells them apart.
    fn pictures(&self, folder: &Path, dataset: &str) -> KeptPictures {
        let prefix = match self.comparisons.len() {
            1 => String::new(),
            _ => format!("{}_", dataset.replace(['/', '\\'], "-")),
        };
        KeptPictures { folder: folder.join(FOLDER), count: self.config.pictures, prefix }
    }
}

/// The names of the files that every evaluation may write.
pub fn files_of_evaluation(metrics: impl Iterator<Item = Metric>) -> Vec<String> {
    RESULTS.map(str::to_owned).into_iter().chain(metrics.flat_map(plots_of)).collect()
}

#[cfg(test)]
mod tests;
