//! `udc eval`.

mod pictures;
mod subject;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::{ArgGroup, Args, ValueEnum};

use udc::core::dataset::Split;
use udc::core::io::{self, DomainTag};
use udc::core::metrics::{Metric, MetricDefinition};
use udc::eval::{EvalConfig, Evaluation};

use super::Session;
use pictures::Pictures;
use subject::Subject;

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
    /// Keep N of the restored images as pictures beside the results, evenly spread
    #[arg(long, value_name = "N", requires = "dataset", default_value_t = 0)]
    pictures: usize,
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
        let subject = self.open()?;
        subject.warnings().into_iter().for_each(|warning| session.warn(warning));
        let outputs = Outputs::prepare(&self.output, session)?;
        let evaluation = subject.measure(&self.config(), &self.pictures(), session)?;
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

    fn open(&self) -> Result<Subject> {
        match (&self.dataset, &self.restored, &self.gt) {
            (Some(dataset), ..) => Subject::dataset(dataset, &self.model, self.split.into(), self.limit),
            (None, Some(restored), Some(gt)) => {
                Subject::folders(restored, gt, self.domain.map(DomainTag::from), self.allow_missing)
            }
            _ => bail!("name a dataset, or two folders with --restored and --gt"),
        }
    }

    fn pictures(&self) -> Pictures {
        Pictures { folder: self.output.join("pictures"), count: self.pictures }
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
