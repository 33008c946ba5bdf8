//! `udc eval`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::{ArgGroup, Args, ValueEnum};

use udc::core::dataset::{Dataset, Split, Triplet};
use udc::core::io::{self, DomainTag};
use udc::core::metrics::{Metric, MetricDefinition};
use udc::core::tone::ToneCurve;
use udc::eval::{self, EvalConfig, Evaluation, FilePair, Label, Method, Sample};
use udc::network::Model;

use super::Session;

/// Measure models on a dataset, or restored images against ground truth
///
/// Writes metrics.json (with the definition of every number), metrics.csv and table.md, and prints the table.
/// Images of two folders are paired by their names without extension.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new("images").required(true).args(["dataset", "restored"]))]
#[command(after_help = "Examples:\n  udc eval dataset --model run/model.safetensors -o results\n  \
    udc eval --restored restored --gt clean -o results")]
pub(crate) struct EvalArgs {
    /// Dataset to restore and measure
    #[arg(value_name = "DATASET")]
    dataset: Option<PathBuf>,
    /// Models to measure, .safetensors or .pth; several make several rows
    #[arg(long, value_name = "MODEL", num_args = 1.., requires = "dataset")]
    model: Vec<PathBuf>,
    /// Folder of restored images, instead of a dataset
    #[arg(long, value_name = "DIR", requires = "gt")]
    restored: Option<PathBuf>,
    /// Folder of the ground truth of the restored images
    #[arg(long, value_name = "DIR", requires = "restored")]
    gt: Option<PathBuf>,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Metrics to compute
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [MetricArg::Psnr, MetricArg::Ssim])]
    metrics: Vec<MetricArg>,
    /// Round images to 8 bits first, as the published evaluation does, or not
    #[arg(long, value_enum, default_value_t = DefinitionArg::Released)]
    definition: DefinitionArg,
    /// What the images of folders hold, where they do not say so themselves
    #[arg(long, value_enum, requires = "restored")]
    domain: Option<DomainArg>,
    /// Part of the dataset to measure on
    #[arg(long, value_enum, default_value_t = SplitArg::Test, requires = "dataset")]
    split: SplitArg,
    /// Measure the first N triplets only
    #[arg(long, value_name = "N", requires = "dataset",
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    limit: Option<usize>,
    /// Leave out images that cannot be measured, and name them, instead of stopping
    #[arg(long)]
    allow_missing: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MetricArg {
    Psnr,
    Ssim,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DefinitionArg {
    Released,
    Float,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum DomainArg {
    Linear,
    ToneMapped,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum SplitArg {
    Train,
    Test,
    Val,
}

impl EvalArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let outputs = Outputs::prepare(&self.output, session)?;
        let evaluation = match (&self.dataset, &self.restored, &self.gt) {
            (Some(dataset), ..) => self.measure_models(session, dataset)?,
            (None, Some(restored), Some(gt)) => self.measure_folders(session, restored, gt)?,
            _ => bail!("name a dataset, or two folders with --restored and --gt"),
        };
        outputs.write(&evaluation, session)?;
        if !evaluation.excluded.is_empty() {
            session.warn(format_args!(
                "{} images are in no mean; the table names them",
                evaluation.excluded.len()
            ));
        }
        session.say(evaluation.to_markdown())?;
        session.say(self.output.join("metrics.json").display())
    }

    fn measure_folders(&self, session: &Session, restored: &Path, gt: &Path) -> Result<Evaluation> {
        let found = eval::pair_folders(restored, gt)?;
        if let (Some((id, fault)), false) = (found.unmatched.first(), self.allow_missing) {
            let count = found.unmatched.len();
            bail!(
                "{count} images have no partner; {id} {fault}; add them, or leave them out with --allow-missing"
            );
        }
        let domain = self.domain.map(DomainTag::from);
        let bar = session.progress.bar(found.pairs.len() as u64, "images");
        let read = |pair: &FilePair| {
            session.progress.check()?;
            bar.inc(1);
            let read = |path| eval::read_tone_mapped(path, domain, &ToneCurve::default());
            Ok(Sample { ground_truth: read(&pair.ground_truth)?, images: vec![read(&pair.restored)?] })
        };
        let label = |id: &str| Label { id: id.to_owned(), kernel: None };
        let method = Method { name: name_of(restored), baseline: false };
        let samples = found.pairs.iter().map(|pair| (label(&pair.id), read(pair)));
        let mut evaluation = eval::measure(&self.config(), vec![method], samples)
            .with_context(|| format!("measuring {} against {}", restored.display(), gt.display()))?;
        for (id, fault) in &found.unmatched {
            evaluation.exclude(&label(id), *fault);
        }
        bar.finish_and_clear();
        Ok(evaluation)
    }

    fn measure_models(&self, session: &Session, root: &Path) -> Result<Evaluation> {
        let dataset = Dataset::open(root)?;
        let models: Vec<Model> = self.model.iter().map(|path| Model::load(path)).collect::<Result<_, _>>()?;
        let mut triplets = dataset.split(self.split.into())?;
        triplets.truncate(self.limit.unwrap_or(triplets.len()));
        let curve = dataset.formation.curve()?;
        let bar = session.progress.bar(triplets.len() as u64, "triplets");
        let restore = |triplet: &Triplet| {
            session.progress.check()?;
            let degraded = curve.tone_map(&dataset.read_degraded(triplet)?);
            let mut images = vec![degraded.clone()];
            for model in &models {
                let uses_code = model.architecture().condition.uses_code();
                let code = uses_code.then(|| dataset.code(triplet)).transpose()?;
                images.push(model.restore(&degraded, code.as_ref())?);
            }
            bar.inc(1);
            Ok(Sample { ground_truth: curve.tone_map(&dataset.read_ground_truth(triplet)?), images })
        };
        let label =
            |triplet: &Triplet| Label { id: triplet.id.clone(), kernel: Some(triplet.kernel.clone()) };
        let baseline = Method { name: "degraded".to_owned(), baseline: true };
        let named = self.model.iter().map(|path| Method { name: name_of(path), baseline: false });
        let samples = triplets.iter().map(|triplet| (label(triplet), restore(triplet)));
        let evaluation =
            eval::measure(&self.config(), std::iter::once(baseline).chain(named).collect(), samples)
                .with_context(|| format!("measuring on {}", root.display()))?;
        bar.finish_and_clear();
        Ok(evaluation)
    }

    fn config(&self) -> EvalConfig {
        let definition = match self.definition {
            DefinitionArg::Released => MetricDefinition::released(),
            DefinitionArg::Float => MetricDefinition::float(),
        };
        let asked = |metric: &Metric| self.metrics.iter().any(|&asked| Metric::from(asked) == *metric);
        let metrics = Metric::ALL.into_iter().filter(asked).collect();
        EvalConfig { metrics, definition, allow_missing: self.allow_missing }
    }
}

/// The three files of the results.
struct Outputs {
    json: PathBuf,
    csv: PathBuf,
    table: PathBuf,
}

impl Outputs {
    /// Makes the folder and checks, before the work starts, that the files may be written.
    fn prepare(folder: &Path, session: &Session) -> Result<Self> {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("creating the folder {}", folder.display()))?;
        let [json, csv, table] = ["metrics.json", "metrics.csv", "table.md"].map(|name| folder.join(name));
        [&json, &csv, &table].into_iter().try_for_each(|path| io::check_output(path, session.overwrite))?;
        Ok(Self { json, csv, table })
    }

    fn write(&self, evaluation: &Evaluation, session: &Session) -> Result<()> {
        let json = format!("{:#}\n", evaluation.to_json());
        let files =
            [(&self.json, json), (&self.csv, evaluation.to_csv()), (&self.table, evaluation.to_markdown())];
        for (path, text) in files {
            io::write_atomically(path, session.overwrite, |file| file.write_all(text.as_bytes()))?;
        }
        Ok(())
    }
}

/// What a model or a folder is called in tables: its name, with its folder's where the name says little.
fn name_of(path: &Path) -> String {
    let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let own = name(path).unwrap_or_else(|| path.display().to_string());
    match path.parent().and_then(name) {
        Some(folder) if own == "model.safetensors" => format!("{folder}/{own}"),
        _ => own,
    }
}

impl From<MetricArg> for Metric {
    fn from(metric: MetricArg) -> Self {
        match metric {
            MetricArg::Psnr => Self::Psnr,
            MetricArg::Ssim => Self::Ssim,
        }
    }
}

impl From<DomainArg> for DomainTag {
    fn from(domain: DomainArg) -> Self {
        match domain {
            DomainArg::Linear => Self::Linear,
            DomainArg::ToneMapped => Self::ToneMapped,
        }
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
