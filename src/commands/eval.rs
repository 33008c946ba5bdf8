//! `udc eval`.

pub(super) mod comparison;
mod folders;
mod ldr;
pub(super) mod outputs;
pub(super) mod pictures;
pub(super) mod plots;
pub(super) mod restorer;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::{ArgGroup, Args, ValueEnum};
use serde_json::json;

use udc::core::error;
use udc::core::metrics::Measure;
use udc::dataset::{Dataset, KernelChoice, Split};
use udc::experiment::{EvalConfig, Evaluation, Matrix, ToneFlags};
use udc::io::DomainTag;
use udc::network::Model;
use udc::restore::Highlights;

use super::Session;
use super::domain::DomainArg;
use super::highlights::HighlightsArg;
use super::method::MethodArg;
use super::metrics::MetricArgs;
use super::precision::PrecisionArg;
use comparison::{Comparison, Extras, Images};
use folders::Folders;
use ldr::Ldr;
use outputs::Outputs;
use pictures::Pictures;
use restorer::Restorer;

/// Measure models and deconvolutions on datasets, or restored images against ground truth
///
/// Writes metrics.json (with the definition of every number), metrics.csv, table.md and plots (SVG), and prints the
/// table. Rows are the degraded images, every model and every method, on every dataset; each image is restored
/// under its own kernel. Images of two folders are paired by their names without extension.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("images").required(true).args(["dataset", "restored"]))]
#[command(after_help = "Examples:\n  udc eval dataset --model run/model.safetensors -o results\n  \
    udc eval dataset --model a/model.safetensors b/model.safetensors --method wiener --method constrained \
    --regions --mismatch --ldr -o results\n  \
    udc eval dataset --model model.safetensors --highlights network,blend,keep --regions -o results\n  \
    udc eval --restored restored --gt clean -o results")]
pub(crate) struct EvalArgs {
    /// Datasets to restore and measure
    #[arg(value_name = "DATASET")]
    dataset: Vec<PathBuf>,
    /// Models to measure, .safetensors or .pth
    #[arg(long, value_name = "MODEL", num_args = 1.., requires = "dataset", conflicts_with = "restored")]
    model: Vec<PathBuf>,
    /// Deconvolutions to measure, with the PSF of each image's kernel and the border that the dataset was made with, or a
    /// scene that goes on where it has a margin; may be repeated
    #[arg(
        long,
        value_enum,
        value_name = "METHOD",
        value_delimiter = ',',
        requires = "dataset",
        conflicts_with = "restored"
    )]
    method: Vec<MethodArg>,
    /// What to do where the capture is saturated; a row for each of several [default: network]
    #[arg(
        long,
        value_enum,
        value_name = "WHAT",
        value_delimiter = ',',
        requires = "dataset",
        conflicts_with = "restored"
    )]
    highlights: Vec<HighlightsArg>,
    /// What the models multiply; a row for each of several [default: f32]
    #[arg(long, value_enum, value_name = "PRECISION", value_delimiter = ',', requires = "model")]
    #[arg(conflicts_with = "restored")]
    precision: Vec<PrecisionArg>,
    /// Folder of restored images, instead of a dataset
    #[arg(long, value_name = "DIR", requires = "gt")]
    restored: Option<PathBuf>,
    /// Folder of the ground truth of the restored images
    #[arg(long, value_name = "DIR", requires = "restored")]
    gt: Option<PathBuf>,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    metrics: MetricArgs,
    /// Measure highlights, flare and the rest of each image for themselves too (regions.csv)
    #[arg(long, requires = "dataset", conflicts_with = "restored")]
    regions: bool,
    /// Restore every image under the kernels of all rotations too, right or wrong (mismatch.json, .csv and .svg)
    #[arg(long, requires = "dataset", conflicts_with = "restored")]
    mismatch: bool,
    /// Measure flare too, and beside it that of the same scenes clipped at a monitor's white [default: 1]
    #[arg(long, value_name = "WHITE", requires = "dataset", conflicts_with = "restored")]
    #[arg(num_args = 0..=1, default_missing_value = "1")]
    ldr: Option<f32>,
    /// What the images of folders hold, where they do not say so themselves: srgb is decoded to linear light
    #[arg(long, value_enum, requires = "restored", conflicts_with = "dataset")]
    domain: Option<DomainArg>,
    /// Irradiance that the tone mapping of folders' linear images maps to one half [default: as the files say, else 0.25]
    #[arg(long, value_name = "A", requires = "restored", conflicts_with = "dataset")]
    alpha: Option<f32>,
    /// Irradiance at which folders' linear images saturate [default: as the files say, else 500]
    #[arg(long, value_name = "X", requires = "restored", conflicts_with = "dataset")]
    x_max: Option<f32>,
    /// Part of the dataset to measure on
    #[arg(long, value_enum, default_value_t = SplitArg::Test, requires = "dataset", conflicts_with = "restored")]
    split: SplitArg,
    /// Measure images of these kernels only, by their names: r+00,r+03 [default: all]
    #[arg(
        long,
        value_name = "NAME",
        value_delimiter = ',',
        requires = "dataset",
        conflicts_with = "restored"
    )]
    kernels: Vec<String>,
    /// Measure the first N triplets only
    #[arg(long, value_name = "N", requires = "dataset", conflicts_with = "restored",
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    limit: Option<usize>,
    /// Keep N of the restored images as pictures beside the results, evenly spread
    #[arg(long, value_name = "N", requires = "dataset", conflicts_with = "restored", default_value_t = 0)]
    pictures: usize,
    /// Memory that one restoration may take: 2GiB, 500MB, …
    #[arg(long, value_name = "SIZE", default_value = "2GiB", value_parser = udc::core::bytes::parse_bytes)]
    #[arg(conflicts_with = "restored")]
    max_memory: u64,
    /// Leave out images that cannot be measured, and name them, instead of stopping
    #[arg(long)]
    allow_missing: bool,
}

/// The files, beside plots, that an evaluation writes when it is asked for them: the regions' numbers; a mismatch's
/// matrices; what a monitor as the source would miss.
const REGIONS_CSV: &str = "regions.csv";
pub(super) const MISMATCH: [&str; 2] = ["mismatch.json", "mismatch.csv"];
const LDR: [&str; 3] = ["ldr.json", "ldr.csv", "ldr.png"];

#[derive(Clone, Copy, Debug, ValueEnum)]
enum SplitArg {
    Train,
    Test,
    Val,
}

impl EvalArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let config = self.metrics.config(self.allow_missing)?;
        match (&self.restored, &self.gt) {
            (Some(restored), Some(gt)) => {
                let domain = self.domain.map(DomainTag::from);
                let flags = ToneFlags { alpha: self.alpha, x_max: self.x_max };
                let folders = Folders::open(restored, gt, (domain, flags), self.allow_missing)?;
                let outputs = self.outputs(&config, 0, &[], session)?;
                let evaluation = folders.measure(&config, session)?;
                outputs.remove_earlier_pictures()?;
                outputs.remove_earlier_results()?;
                self.finish(&evaluation, &outputs, session)
            }
            _ => self.compare(&config, session),
        }
    }

    fn images(&self) -> Images {
        let kernels = match &self.kernels[..] {
            [] => KernelChoice::All,
            names => KernelChoice::Only(names.to_vec()),
        };
        Images { split: self.split.into(), kernels, limit: self.limit }
    }

    /// Measures restorations on datasets.
    fn compare(&self, config: &EvalConfig, session: &Session) -> Result<()> {
        if self.dataset.len() > 1 && (self.mismatch || self.ldr.is_some()) {
            bail!("--mismatch and --ldr are of one dataset; run them for each");
        }
        let datasets: Vec<Dataset> =
            self.dataset.iter().map(|root| Dataset::open(root)).collect::<error::Result<_>>()?;
        let restorers = self.restorers(session)?;
        let images = self.images();
        let comparisons: Vec<Comparison<'_>> = datasets
            .iter()
            .map(|dataset| Comparison::new(dataset, &restorers, &images, self.max_memory, session))
            .collect::<Result<_>>()?;
        let told = restorers.iter().filter(|restorer| restorer.knows_the_kernel()).count();
        if self.mismatch && told == 0 {
            bail!(
                "--mismatch tells wrong kernels to what is told kernels: add a --model that takes codes, or a --method"
            );
        }
        let ldr = self.ldr.map(|white| Ldr::new(&comparisons[0], white)).transpose()?;
        let outputs = self.outputs(config, told, &comparisons, session)?;
        outputs.remove_earlier_pictures()?;
        let mut evaluations = Vec::new();
        for comparison in &comparisons {
            let name = self.name_of_dataset(&comparison.dataset.root);
            let pictures = self.pictures(&name);
            let extras = Extras { regions: self.regions, pictures: &pictures };
            evaluations.push((name, comparison.measure(config, &extras)?));
        }
        let evaluation = match evaluations.len() {
            1 => evaluations.swap_remove(0).1,
            _ => Evaluation::join(evaluations),
        };
        let matrices = self.mismatch.then(|| comparisons[0].mismatch(config)).transpose()?;
        let compared = ldr.map(|ldr| ldr.measure(config.definition)).transpose()?;
        outputs.remove_earlier_results()?;
        if let Some(matrices) = matrices {
            self.write_mismatch(&matrices, &outputs)?;
        }
        if let Some(compared) = compared {
            let [json, csv, png] = LDR;
            outputs.write(json, format!("{:#}\n", compared.to_json()).as_bytes())?;
            outputs.write(csv, compared.to_csv().as_bytes())?;
            outputs.write(png, compared.to_png())?;
            session.tell(compared.summary());
        }
        self.finish(&evaluation, &outputs, session)
    }

    fn name_of_dataset(&self, root: &Path) -> String {
        name_among(&self.dataset, root)
    }

    fn restorers(&self, session: &Session) -> Result<Vec<Restorer>> {
        let mut restorers = vec![Restorer::Nothing];
        let asked: Vec<Highlights> = self.highlights.iter().map(|&highlights| highlights.into()).collect();
        let treatments = if asked.is_empty() { vec![Highlights::default()] } else { asked };
        let precisions = if self.precision.is_empty() { &[PrecisionArg::F32][..] } else { &self.precision };
        for path in &self.model {
            let model = Model::load(path)?;
            for &precision in precisions {
                let (name, model) = (
                    precision.name_of(&name_among(&self.model, path)),
                    precision.apply(model.clone(), session),
                );
                let of = |&highlights| Restorer::Network(name.clone(), Box::new(model.clone()), highlights);
                restorers.extend(treatments.iter().map(of));
            }
        }
        for &method in &self.method {
            restorers
                .extend(treatments.iter().map(|&highlights| Restorer::Deconvolution(method, highlights)));
        }
        Ok(restorers)
    }

    /// Makes the folder, after checking that every file that may be written may be; `told` counts the
    /// restorations that are told the kernel.
    fn outputs<'a>(
        &'a self,
        config: &EvalConfig,
        told: usize,
        comparisons: &[Comparison<'_>],
        session: &Session,
    ) -> Result<Outputs<'a>> {
        let mut names = outputs::RESULTS.map(str::to_owned).to_vec();
        names.extend(self.regions.then(|| REGIONS_CSV.to_owned()));
        let metrics = || config.metrics.iter().map(Measure::metric);
        names.extend(metrics().flat_map(plots::names));
        if self.mismatch {
            let plots =
                (1..=told).flat_map(|number| metrics().map(move |m| plots::name_of_matrix(m, number)));
            names.extend(plots);
            names.extend(MISMATCH.map(str::to_owned));
        }
        if self.ldr.is_some() {
            names.extend(LDR.map(str::to_owned));
        }
        for comparison in comparisons {
            let pictures = self.pictures(&self.name_of_dataset(&comparison.dataset.root));
            let files = comparison.picture_files(&pictures);
            names.extend(files.map(|file| format!("{}/{file}", pictures::FOLDER)));
        }
        Outputs::prepare(&self.output, &names, session.overwrite)
    }

    fn write_mismatch(&self, matrices: &[Matrix], outputs: &Outputs<'_>) -> Result<()> {
        let [json, csv] = MISMATCH;
        let of_each: Vec<_> = matrices.iter().map(Matrix::to_json).collect();
        outputs.write(json, format!("{:#}\n", json!({"matrices": of_each})).as_bytes())?;
        outputs.write(csv, Matrix::to_csv(matrices).as_bytes())?;
        let mut methods: Vec<&str> = Vec::new();
        for matrix in matrices {
            if methods.last() != Some(&matrix.method.as_str()) {
                methods.push(&matrix.method);
            }
            let (name, svg) = plots::draw_matrix(matrix, methods.len());
            outputs.write(&name, svg.as_bytes())?;
        }
        Ok(())
    }

    /// Writes and prints an evaluation.
    fn finish(&self, evaluation: &Evaluation, outputs: &Outputs<'_>, session: &Session) -> Result<()> {
        outputs.write_results(evaluation)?;
        if self.regions {
            outputs.write(REGIONS_CSV, evaluation.regions_to_csv().as_bytes())?;
        }
        for (name, svg) in plots::draw(evaluation) {
            outputs.write(&name, svg.as_bytes())?;
        }
        if !evaluation.excluded.is_empty() {
            session.warn(format_args!(
                "{} images are in no mean; the table names them",
                evaluation.excluded.len()
            ));
        }
        session.tell(evaluation.to_markdown());
        session.tell(self.output.join("metrics.json").display());
        Ok(())
    }

    fn pictures(&self, dataset: &str) -> Pictures {
        let prefix = if self.dataset.len() > 1 {
            format!("{}_", dataset.replace(['/', '\\'], "-"))
        } else {
            String::new()
        };
        Pictures { folder: self.output.join(pictures::FOLDER), count: self.pictures, prefix }
    }
}

/// What a model or a folder is called in tables: its name, with its folder's where the name says little.
/// The name of a file or folder, or its path where another of them has the same name.
fn name_among(all: &[PathBuf], path: &Path) -> String {
    let name = name_of(path);
    match all.iter().filter(|other| name_of(other) == name).count() {
        1 => name,
        _ => path.to_string_lossy().into_owned(),
    }
}

fn name_of(path: &Path) -> String {
    let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let own = name(path).unwrap_or_else(|| path.display().to_string());
    match path.parent().and_then(name) {
        Some(folder) if own == "model.safetensors" => format!("{folder}/{own}"),
        _ => own,
    }
}

impl From<SplitArg> for Split {
    fn from(split: SplitArg) -> Self {
        match split {
            SplitArg::Train => Self::Train,
            SplitArg::Test => Self::Test,
            SplitArg::Val => Self::Val,
        }
    }
}
