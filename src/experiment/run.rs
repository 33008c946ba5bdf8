//! A whole experiment on datasets: evaluation, wrong kernels, scenes of a monitor's range.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::json;

use super::candidate::Candidate;
use super::comparison::{Comparison, ImagesConfig};
use super::files::{LDR, MISMATCH, REGIONS, RESULTS, plot_of_matrix, plots_of};
use super::ldr::{Ldr, LdrResults, LdrRow};
use super::matrix::Mismatch;
use super::measurement::{MeasuredDataset, MeasuredLdr, Measurement};
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

/// Refuses rows of tables that nobody could tell apart.
fn check_once(key: &str, names: impl Iterator<Item = String>) -> Result<()> {
    let mut seen = BTreeSet::new();
    for name in names {
        if seen.contains(&name) {
            return Err(Error::config(key, format!("names {name} twice")));
        }
        seen.insert(name);
    }
    Ok(())
}

impl<'a> Experiment<'a> {
    /// Checks that the candidates can be compared on the datasets, which come with their names in tables.
    ///
    /// # Errors
    /// Those of [`Comparison::new`] and [`Ldr::new`]; [`Error::Config`] for a dataset or a method that is named twice;
    /// [`Error::Unsupported`] when no candidate is told kernels, or several
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
        let named = candidates.iter().map(|candidate| candidate.method().name);
        check_once("dataset", datasets.iter().map(|(name, _)| name.clone()))?;
        check_once("method", named)?;
        let comparison = |(name, dataset): &'a (String, Dataset)| {
            Ok((name.as_str(), Comparison::new(dataset, candidates, &config.images, listener)?))
        };
        let comparisons = datasets.iter().map(comparison).collect::<Result<Vec<_>>>()?;
        let total = comparisons.iter().map(|(_, comparison)| comparison.total()).max().unwrap_or(0);
        config.images.shard.check(total, "images")?;
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

    pub(super) fn config(&self) -> &ExperimentConfig {
        self.config
    }

    pub(super) fn comparisons(&self) -> impl Iterator<Item = &Comparison<'a>> {
        self.comparisons.iter().map(|(_, comparison)| comparison)
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
        names.extend(self.pictures_kept().into_iter().map(|file| format!("{FOLDER}/{file}")));
        names
    }

    /// Measures everything and takes the means; pictures are written into the folder of the results on the way.
    ///
    /// # Errors
    /// Those of [`measure`](Self::measure) and [`Measurement::into_findings`].
    pub fn run(&self, folder: &Path) -> Result<Findings> {
        let (measurement, rows) = self.measure(folder)?;
        let mut findings = measurement.into_findings()?;
        if let Some((_, shown)) = &mut findings.ldr {
            *shown = rows;
        }
        Ok(findings)
    }

    /// Measures the images of the configuration's shard; pictures are written into the folder of the results on the way.
    /// Rows to look at come along, where scenes of a monitor's range are measured.
    ///
    /// # Errors
    /// Those of [`Comparison::evaluate`] and [`Ldr::measure`]; more shards than there are images.
    pub fn measure(&self, folder: &Path) -> Result<(Measurement, Vec<LdrRow>)> {
        let ExperimentConfig { measuring, regions, .. } = self.config;
        let first = self.first()?;
        let mut datasets = Vec::new();
        for (name, comparison) in &self.comparisons {
            let primaries = comparison.dataset.scene_primaries();
            let pictures = KeptPictures { primaries, ..self.pictures(folder, name) };
            let evaluation = comparison.evaluate(measuring, *regions, &pictures)?;
            datasets.push(MeasuredDataset::of(name, comparison, evaluation));
        }
        let mismatch = self.config.mismatch.then(|| first.mismatch(measuring)).transpose()?;
        let ldr = self.ldr.as_ref().map(|ldr| ldr.measure(first, measuring)).transpose()?;
        let (ldr, rows) = match ldr {
            Some((LdrResults { white, images, .. }, rows)) => (Some(MeasuredLdr { white, images }), rows),
            None => (None, Vec::new()),
        };
        Ok((Measurement { datasets, mismatch, ldr }, rows))
    }

    /// The names of the pictures that the shard keeps, within their folder.
    pub fn pictures_kept(&self) -> Vec<String> {
        let of = |(name, comparison): &(&str, Comparison<'_>)| {
            let pictures = self.pictures(Path::new(""), name);
            comparison.picture_files(&pictures).collect::<Vec<_>>()
        };
        self.comparisons.iter().flat_map(of).collect()
    }

    /// Everything that decides the numbers, by what it is called; of models, their names.
    pub fn describe(&self) -> BTreeMap<String, String> {
        let ExperimentConfig { measuring, images, regions, mismatch, ldr, pictures } = self.config;
        let mut described = measuring.describe();
        let mut say =
            |key: &str, value: serde_json::Value| described.insert(key.to_owned(), value.to_string());
        say("split", json!(images.split));
        say("kernels", json!(images.kernels));
        say("limit", json!(images.limit));
        say("max-memory", json!(images.max_memory));
        say("regions", json!(regions));
        say("mismatch", json!(mismatch));
        say("ldr", json!(ldr));
        say("pictures", json!(pictures));
        for (name, comparison) in &self.comparisons {
            let dataset = comparison.dataset;
            say(
                &format!("dataset {name}"),
                json!([dataset.triplets_sha256(), dataset.bank_sha256(), comparison.total()]),
            );
            say("methods", json!(comparison.method_names()));
        }
        described
    }

    /// Where a dataset's pictures go; where there are several datasets, its name tells them apart.
    fn pictures(&self, folder: &Path, dataset: &str) -> KeptPictures {
        let prefix = match self.comparisons.len() {
            1 => String::new(),
            _ => format!("{}_", dataset.replace(['/', '\\'], "-")),
        };
        let (folder, count) = (folder.join(FOLDER), self.config.pictures);
        KeptPictures { folder, count, prefix, ..KeptPictures::default() }
    }
}

/// The names of the files that every evaluation may write.
pub fn files_of_evaluation(metrics: impl Iterator<Item = Metric>) -> Vec<String> {
    RESULTS.map(str::to_owned).into_iter().chain(metrics.flat_map(plots_of)).collect()
}

#[cfg(test)]
mod tests;
