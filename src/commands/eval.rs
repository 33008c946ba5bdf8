//! `udc eval`.

mod parts;

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::{ArgGroup, Args};
use serde_json::json;

use udc::core::metrics::Measure;
use udc::core::primaries::Primaries;
use udc::core::shard::Shard;
use udc::core::tone::ToneFlags;
use udc::dataset::{Dataset, KernelChoice, Split};
use udc::experiment::{
    Candidate, Document as _, EvalConfig, Experiment, ExperimentConfig, Findings, Folders, ImagesConfig, LDR,
    Listener, MISMATCH, Measured, REGIONS, RESULTS, RestorationMethod, Results, ResultsFolder,
    files_of_evaluation, name_among,
};
use udc::io::{DomainTag, check_distinct};
use udc::network::{Backend, Model};
use udc::report::{self, picture};
use udc::restore::{Highlights, Precision, in_precision};

use super::choices::DOMAINS;
use super::choices::{HIGHLIGHTS, PRECISIONS, RESTORATIONS, SPLITS};
use super::device::DeviceArgs;
use super::dry_run::DryRunArgs;
use super::metrics::MetricArgs;
use super::{Session, misuse, text_of};

/// Measure models and deconvolutions on datasets, or restored images against ground truth
///
/// Writes metrics.json (with the definition of every number), metrics.csv, table.md and plots (SVG), and prints the
/// table. Rows are the degraded images, every model and every method, on every dataset; each image is restored
/// under its own kernel. Images of two folders are paired by their names without extension.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("images").required(true).args(["dataset", "data", "restored", "merge"]))]
#[command(group = ArgGroup::new("datasets").args(["dataset", "data"]))]
#[command(after_help = "Examples:\n  udc eval --data dataset --model run/model.safetensors -o results\n  \
    udc eval --data dataset --model a/model.safetensors b/model.safetensors --method wiener --method constrained \
    --regions --mismatch --ldr -o results\n  \
    udc eval --data dataset --model model.safetensors --highlights restored,blend,keep --regions -o results\n  \
    udc eval --restored restored --gt clean -o results\n  \
    udc eval dataset --model model.safetensors --shard 2/8 -o parts\n  \
    udc eval --merge parts -o results")]
pub(crate) struct EvalArgs {
    /// Datasets, as after --data
    #[arg(value_name = "DATASET")]
    dataset: Vec<PathBuf>,
    /// Datasets to restore and measure
    #[arg(long, value_name = "DATASET", num_args = 1..)]
    data: Vec<PathBuf>,
    /// Models to measure, .safetensors or .pth
    #[arg(long, value_name = "MODEL", num_args = 1.., requires = "datasets", conflicts_with = "restored")]
    model: Vec<PathBuf>,
    /// Deconvolutions to measure, or the guided restoration, with the PSF of each image's kernel and the border that the dataset was made with, or a
    /// scene that goes on where it has a margin; may be repeated
    #[arg(
        long,
        value_name = "METHOD",
        value_parser = RESTORATIONS,
        value_delimiter = ',',
        requires = "datasets",
        conflicts_with = "restored"
    )]
    method: Vec<RestorationMethod>,
    /// What to do where the capture is saturated; a row for each of several [default: restored]
    #[arg(
        long,
        value_name = "WHAT",
        value_parser = HIGHLIGHTS,
        value_delimiter = ',',
        requires = "datasets",
        conflicts_with = "restored"
    )]
    highlights: Vec<Highlights>,
    /// Arithmetic precision of the models; a row for each of several [default: f32]
    #[arg(long, value_name = "PRECISION", value_parser = PRECISIONS, value_delimiter = ',', requires = "model")]
    #[arg(conflicts_with = "restored")]
    precision: Vec<Precision>,
    /// Folder of restored images, instead of a dataset
    #[arg(long, value_name = "DIR", requires = "gt")]
    restored: Option<PathBuf>,
    /// Folder of the ground truth of the restored images
    #[arg(long, value_name = "DIR", requires = "restored", conflicts_with = "datasets")]
    gt: Option<PathBuf>,
    /// Measure only the I-th of N parts of the images, and write it (part-00002-of-00008.toml for 2/8); all parts may be
    /// measured at the same time, into one folder or several
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Join all parts, folders or files, to the results of one run
    #[arg(long, value_name = "PART", num_args = 1..)]
    #[arg(conflicts_with_all = ["shard", "metrics", "definition", "lpips_alexnet", "lpips_linear", "max_memory",
        "allow_missing", "device", "gt", "domain", "alpha", "x_max"])]
    merge: Vec<PathBuf>,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    metrics: MetricArgs,
    /// Measure highlights, flare and the rest of each image for themselves too (regions.csv)
    #[arg(long, requires = "datasets", conflicts_with = "restored")]
    regions: bool,
    /// Restore every image under the kernels of all rotations too, right or wrong (mismatch.json, .csv and .svg)
    #[arg(long, requires = "datasets", conflicts_with = "restored")]
    mismatch: bool,
    /// Measure flare too, and beside it that of the same scenes clipped at a monitor's white [default: 1]
    #[arg(long, value_name = "WHITE", requires = "datasets", conflicts_with = "restored")]
    #[arg(num_args = 0..=1, default_missing_value = "1")]
    ldr: Option<f32>,
    /// What the images of folders hold, where they do not say so themselves: srgb is decoded to linear light
    #[arg(long, value_name = "DOMAIN", value_parser = DOMAINS, requires = "restored", conflicts_with = "datasets")]
    domain: Option<DomainTag>,
    /// Irradiance that the tone mapping of folders' linear images maps to one half [default: as the files say, else 0.25]
    #[arg(long, value_name = "A", requires = "restored", conflicts_with = "datasets")]
    alpha: Option<f32>,
    /// Irradiance at which folders' linear images saturate [default: as the files say, else 500]
    #[arg(long, value_name = "X", requires = "restored", conflicts_with = "datasets")]
    x_max: Option<f32>,
    /// Part of the dataset to measure on
    #[arg(long, value_parser = SPLITS, default_value = "test", requires = "datasets", conflicts_with = "restored")]
    split: Split,
    /// Measure images of these kernels only, by their names: r+00,r+03 [default: all]
    #[arg(
        long,
        value_name = "NAME",
        value_delimiter = ',',
        requires = "datasets",
        conflicts_with = "restored"
    )]
    kernels: Vec<String>,
    /// Measure the first N triplets only
    #[arg(long, value_name = "N", requires = "datasets", conflicts_with = "restored",
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    limit: Option<usize>,
    /// Keep N of the restored images as pictures beside the results, evenly spread; of the first also the light, as .exr
    #[arg(long, value_name = "N", requires = "datasets", conflicts_with = "restored", default_value_t = 0)]
    pictures: usize,
    #[command(flatten)]
    device: DeviceArgs,
    /// Memory that one restoration may take: 2GiB, 500MB, …
    #[arg(long, value_name = "SIZE", default_value = "2GiB", value_parser = udc::core::bytes::parse_bytes)]
    #[arg(conflicts_with = "restored")]
    max_memory: u64,
    /// Leave out images that cannot be measured, and name them, instead of stopping
    #[arg(long)]
    allow_missing: bool,
    #[command(flatten)]
    dry_run: DryRunArgs,
}

impl EvalArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        if self.dry_run.dry_run && (!self.merge.is_empty() || self.restored.is_some()) {
            return Err(misuse("eval", "--dry-run is for datasets, whose images are restored: leave it out"));
        }
        if !self.merge.is_empty() {
            return self.join_parts(session);
        }
        let warn = |text: &str| session.warn(text);
        let listener = Listener { progress: &session.progress, warn: &warn };
        let backend = self.device.find(session)?;
        let measuring = self.metrics.config(self.allow_missing, backend)?;
        match (&self.restored, &self.gt) {
            (Some(restored), Some(gt)) => self.measure_folders((restored, gt), &measuring, listener, session),
            _ => self.compare(measuring, backend, listener, session),
        }
    }

    /// Measures the images of a folder.
    fn measure_folders(
        &self,
        (restored, gt): (&Path, &Path),
        measuring: &EvalConfig,
        listener: Listener<'_>,
        session: &Session,
    ) -> Result<()> {
        let domain = self.domain;
        let flags = ToneFlags { alpha: self.alpha, x_max: self.x_max };
        let folders = Folders::open(restored, gt, (domain, flags), self.allow_missing)?;
        if let Some(shard) = self.shard {
            self.prepare_part(shard, std::iter::empty(), session)?;
            let measurement = folders.measure(measuring, shard, listener)?;
            return self.write_part_of_folders(shard, folders.describe(measuring), measurement, session);
        }
        let names = files_of_evaluation(measuring.metrics.iter().map(Measure::metric));
        let outputs = ResultsFolder::prepare(&self.output, &names, session.overwrite)?;
        let findings = folders.measure(measuring, Shard::WHOLE, listener)?.into_findings()?;
        outputs.remove_earlier_pictures()?;
        self.write(&findings, None, outputs, session)
    }

    /// Measures restorations on datasets.
    fn compare(
        &self,
        measuring: EvalConfig,
        backend: Backend,
        listener: Listener<'_>,
        session: &Session,
    ) -> Result<()> {
        let roots = if self.dataset.is_empty() { &self.data } else { &self.dataset };
        check_distinct("dataset", roots)?;
        check_distinct("model", &self.model)?;
        let open = |root: &PathBuf| {
            let open = if self.allow_missing { Dataset::open_incomplete } else { Dataset::open };
            Ok((name_among(roots, root), open(root)?))
        };
        let datasets = roots.iter().map(open).collect::<Result<Vec<_>>>()?;
        for (_, dataset) in &datasets {
            session.warn_of_unfinished(dataset)?;
        }
        let candidates = self.candidates(backend, session)?;
        let config = self.config(measuring);
        let experiment = Experiment::new(&datasets, &candidates, &config, listener)?;
        if self.dry_run.dry_run {
            return self.dry_run.tell("eval", &experiment.estimate(&session.progress)?, session);
        }
        if let Some(shard) = self.shard {
            return self.compare_part(shard, &experiment, session);
        }
        let outputs = ResultsFolder::prepare(&self.output, &experiment.files(), session.overwrite)?;
        let findings = outputs.with_new_pictures(|folder| experiment.run(folder))?;
        let ldr = findings.ldr.as_ref().map(|(_, shown)| picture::grid(shown));
        self.write(&findings, ldr.as_deref(), outputs, session)
    }

    fn candidates(&self, backend: Backend, session: &Session) -> Result<Vec<Candidate>> {
        let precisions = if self.precision.is_empty() { &[Precision::F32][..] } else { &self.precision };
        let mut models = Vec::new();
        for path in &self.model {
            let model = Model::load(path)?.with_backend(backend);
            let name = name_among(&self.model, path);
            let of = |precision: &Precision| {
                let (model, notice) = in_precision(model.clone(), *precision);
                notice.iter().for_each(|notice| session.notice(notice));
                (precision.name_of(&name), model)
            };
            models.extend(precisions.iter().map(of));
        }
        Ok(Candidate::list(models, &self.method, &self.highlights, backend))
    }

    fn config(&self, measuring: EvalConfig) -> ExperimentConfig {
        let kernels = match &self.kernels[..] {
            [] => KernelChoice::All,
            names => KernelChoice::Only(names.to_vec()),
        };
        let (split, limit, max_memory) = (self.split, self.limit, self.max_memory);
        let shard = self.shard.unwrap_or_default();
        ExperimentConfig {
            measuring,
            images: ImagesConfig { split, kernels, limit, max_memory, shard },
            regions: self.regions,
            mismatch: self.mismatch,
            ldr: self.ldr,
            pictures: self.pictures,
        }
    }

    /// Writes and prints what was found; `ldr_picture` is that of scenes of a monitor's range.
    fn write(
        &self,
        findings: &Findings,
        ldr_picture: Option<&[u8]>,
        outputs: ResultsFolder<'_>,
        session: &Session,
    ) -> Result<()> {
        let Findings { evaluation, mismatch, ldr } = findings;
        outputs.remove_earlier_results()?;
        let results = Results::of(evaluation);
        let mut drawings = report::plots(&results);
        if let Some(mismatch) = mismatch {
            let [json, csv] = MISMATCH;
            outputs.write(json, mismatch.to_json().as_bytes())?;
            outputs.write(csv, mismatch.to_csv().as_bytes())?;
            drawings.extend(report::mismatch_plots(mismatch));
        }
        if let Some((compared, _)) = ldr {
            let [json, csv, png] = LDR;
            outputs.write(json, compared.to_json().as_bytes())?;
            outputs.write(csv, compared.to_csv().as_bytes())?;
            ldr_picture.map_or(Ok(()), |picture| outputs.write(png, picture))?;
            session.tell(compared.summary());
        }
        outputs.write_results(evaluation, &results)?;
        if evaluation.has_regions() {
            outputs.write(REGIONS, evaluation.regions_to_csv().as_bytes())?;
        }
        drawings.iter().try_for_each(|(name, svg)| outputs.write(name, svg.as_bytes()))?;
        if !evaluation.excluded.is_empty() {
            let count = evaluation.excluded.len();
            session.warn(format_args!("{count} images are excluded from all means; the table names them"));
        }
        if evaluation.has_several_curves() {
            session.warn(
                "the datasets differ in alpha or x-max, as the line below the table says: numbers of one cannot be compared with those \
                 of another",
            );
        }
        if evaluation.has_several_primaries() {
            let of = |measured: &Measured| {
                let dataset = measured.dataset.as_deref().unwrap_or_default();
                format!("{dataset} is of {}", Primaries::name_of(measured.primaries))
            };
            let of: Vec<String> = evaluation.measured.iter().map(of).collect();
            session.warn(format_args!(
                "the datasets differ in their red, green and blue: numbers of one cannot be compared with those of another ({})",
                of.join(", ")
            ));
        }
        let methods = results.methods.iter().map(|method| {
            json!({ "name": method.name, "dataset": method.dataset, "count": method.count, "mean": method.mean })
        });
        session.results_of(json!({
            "output": text_of(&self.output), "methods": methods.collect::<Vec<_>>(), "excluded": results.excluded.len(),
        }));
        session.tell(evaluation.to_markdown());
        session.tell(self.output.join(RESULTS[0]).display());
        Ok(())
    }
}
