//! `udc sweep`.

mod row;
mod table;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::Args;
use serde_json::json;

use udc::core::error;
use udc::dataset::{Dataset, KernelChoice, Split};
use udc::experiment::EvalConfig;
use udc::io;
use udc::network::{Backend, Model};
use udc::restore::Highlights;
use udc::train::TrainConfig;

use super::eval::comparison::{Comparison, Extras, Images};
use super::eval::outputs::{Outputs, RESULTS};
use super::eval::pictures::Pictures;
use super::eval::restorer::Restorer;
use super::metrics::MetricArgs;
use super::train::{TrainArgs, configure};
use super::{Session, was_interrupted};
use row::Row;

/// Train and measure several configurations, and tabulate them
///
/// All are trained on the same data (but for data.kernels) with the same seed, and measured on the test split: on the
/// images of one kernel, and on those of all. The folder gets a run for each configuration, named after its file, and
/// table.md, table.csv and table.json of all. A configuration that fails is named at the end; the others are finished.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  udc sweep configs/ablation-*.toml --data dataset -o ablation\n  \
    udc sweep a.toml b.toml --data dataset -o sweep --set iterations=2000 --set data.crop=64\n  \
    udc sweep a.toml b.toml --data dataset -o sweep --set iterations=2000 --set data.crop=64 --resume")]
pub(crate) struct SweepArgs {
    /// Configurations, a row of the table each
    #[arg(required = true, value_name = "CONFIG")]
    configs: Vec<PathBuf>,
    /// Dataset of `udc synth`, or the published one
    #[arg(long, value_name = "DATASET")]
    data: PathBuf,
    /// Folder for the runs and the tables
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Change a key of every configuration; may be repeated
    #[arg(long, value_name = "KEY.PATH=VALUE")]
    set: Vec<String>,
    /// Keep finished rows, and go on with the others from their checkpoints
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    metrics: MetricArgs,
    /// Measure on the first N triplets of the test split only
    #[arg(long, value_name = "N", value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    limit: Option<usize>,
    /// Kernel whose images are measured for themselves too, beside those of all [default: r+00 where there is one]
    #[arg(long, value_name = "KERNEL")]
    single: Option<String>,
    /// Memory that one restoration may take: 2GiB, 500MB, …
    #[arg(long, value_name = "SIZE", default_value = "2GiB", value_parser = udc::restore::parse_bytes)]
    max_memory: u64,
    /// Burn backend to compute with: flex or ndarray
    #[arg(long, default_value = "flex", value_name = "NAME")]
    backend: Backend,
}

/// A configuration of the sweep.
struct Entry {
    name: String,
    path: PathBuf,
    config: TrainConfig,
}

impl SweepArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        if self.resume && session.overwrite {
            bail!("--resume keeps what --overwrite replaces; pass one of them");
        }
        let entries = self.entries()?;
        let dataset = Dataset::open(&self.data)?;
        dataset.split(Split::Test).context("the rows are measured on the test split")?;
        let sweep = Sweep {
            dataset: &dataset,
            data_sha256: dataset.triplets_sha256(),
            single: single_kernel(&dataset, self.single.as_deref())?,
            measuring: self.metrics.config(false)?,
            session,
            args: &self,
        };
        sweep.prepare_folder(&entries)?;
        let (mut rows, mut failed) = (Vec::new(), Vec::new());
        for entry in &entries {
            session.tell(format_args!("# {}", entry.name));
            match sweep.row(entry).with_context(|| format!("row {}", entry.name)) {
                Ok(row) => rows.push(row),
                Err(error) if was_interrupted(&error) => {
                    return Err(error.context("the sweep was interrupted; go on with --resume"));
                }
                Err(error) => {
                    session.warn(format_args!("{error:#}"));
                    failed.push((entry.name.clone(), format!("{error:#}")));
                }
            }
        }
        if !rows.is_empty() || !self.output.join("table.md").exists() {
            sweep.write_tables(&rows, &failed)?;
        }
        if failed.is_empty() {
            return Ok(());
        }
        let reasons: Vec<&str> = failed.iter().map(|(_, reason)| reason.as_str()).collect();
        bail!("{} of {} rows failed: {}", failed.len(), entries.len(), reasons.join("; "))
    }

    /// Reads every configuration before any is trained; all must have names of their own and one seed.
    fn entries(&self) -> Result<Vec<Entry>> {
        let mut names = BTreeSet::new();
        let mut entries: Vec<Entry> = Vec::new();
        for path in &self.configs {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            if !names.insert(name.clone()) {
                bail!("two configurations are called {name}; rows are named after their files, rename one");
            }
            let config = configure(&io::read_text(path)?, path, &self.set)?;
            if let Some(other) = entries.iter().find(|other| other.config.seed != config.seed) {
                bail!(
                    "{} has seed {first} and {name} has seed {}; a sweep compares runs of one seed: add --set seed={first}",
                    other.name,
                    config.seed,
                    first = other.config.seed
                );
            }
            entries.push(Entry { name, path: path.clone(), config });
        }
        Ok(entries)
    }
}

/// The kernel whose images are averaged for themselves too: the one that was asked for, else the unrotated one of a
/// dataset of several. Where all images are of one kernel, its means are those of all.
fn single_kernel(dataset: &Dataset, asked: Option<&str>) -> Result<Option<String>> {
    const UNROTATED: &str = "r+00";
    let name = asked.unwrap_or(UNROTATED).to_owned();
    let found = dataset.kernel_indices(&KernelChoice::Only(vec![name]), "--single");
    match (found, asked) {
        (Ok(found), _) if asked.is_some() || dataset.kernel_names().len() > 1 => {
            Ok(found.first().map(|&index| dataset.kernel_names()[index].clone()))
        }
        (Err(error), Some(_)) => Err(error.into()),
        _ => Ok(None),
    }
}

/// A sweep over one dataset.
struct Sweep<'a> {
    args: &'a SweepArgs,
    dataset: &'a Dataset,
    data_sha256: String,
    /// The kernel whose images are averaged for themselves too.
    single: Option<String>,
    measuring: EvalConfig,
    session: &'a Session,
}

impl Sweep<'_> {
    fn prepare_folder(&self, entries: &[Entry]) -> Result<()> {
        let folder = &self.args.output;
        let begun = entries.iter().find(|entry| folder.join(&entry.name).exists());
        if let (Some(entry), false, false) = (begun, self.args.resume, self.session.overwrite) {
            bail!(
                "{} has a row {} already; pass --resume to go on, --overwrite to begin anew, or name another folder",
                folder.display(),
                entry.name
            );
        }
        if self.args.resume {
            entries.iter().try_for_each(|entry| self.check_same_data(&folder.join(&entry.name)))?;
        }
        Ok(io::create_folder(folder)?)
    }

    /// Refuses to go on with a finished row of other data; the training refuses to with an unfinished one.
    fn check_same_data(&self, run: &Path) -> Result<()> {
        let Some(row) = Row::read(run)? else { return Ok(()) };
        let bank = self.dataset.bank_sha256();
        let parts = [
            ("data-sha256", row.data_sha256(), Some(self.data_sha256.as_str())),
            ("kernel-bank-sha256", row.kernel_bank_sha256.clone(), bank),
        ];
        // Rows of older versions do not say which bank they were made with.
        if let Some((part, was, is)) =
            parts.iter().find(|(_, was, is)| was.is_some() && was.as_deref() != *is)
        {
            bail!(
                "row {} was made with other data: {part} is {} and was {}; resume with its own data, or name another \
                 folder",
                row.name,
                is.unwrap_or("absent"),
                was.as_deref().unwrap_or("absent")
            );
        }
        Ok(())
    }

    /// Trains and measures a configuration, unless it is finished.
    fn row(&self, entry: &Entry) -> Result<Row> {
        let folder = self.args.output.join(&entry.name);
        let made_with = self.made_with(entry);
        if self.args.resume
            && let Some(row) = Row::read(&folder)?.filter(|row| row.made_with == made_with)
        {
            self.session.tell(format_args!("{}: finished before", entry.name));
            return Ok(row);
        }
        Row::remove(&folder)?;
        let outcome = self.training(entry, &folder).train(self.session)?;
        if outcome.interrupted {
            return Err(error::Error::Interrupted.into());
        }
        let kernel_bank_sha256 = self.dataset.bank_sha256().map(str::to_owned);
        let row = Row { made_with, kernel_bank_sha256, ..self.measure(entry, &folder, outcome.iteration)? };
        row.write(&folder)?;
        Ok(row)
    }

    fn training(&self, entry: &Entry, folder: &Path) -> TrainArgs {
        TrainArgs {
            config: Some(entry.path.clone()),
            data: self.args.data.clone(),
            bank: None,
            output: folder.to_owned(),
            set: self.args.set.clone(),
            init: None,
            resume: self.args.resume && folder.join("config.toml").is_file(),
            backend: self.args.backend,
        }
    }

    fn measure(&self, entry: &Entry, folder: &Path, iterations: u64) -> Result<Row> {
        let model = Model::load(&folder.join("model.safetensors"))?;
        let restorers = [
            Restorer::Nothing,
            Restorer::Network(entry.name.clone(), Box::new(model), Highlights::default()),
        ];
        let images = Images { split: Split::Test, kernels: KernelChoice::All, limit: self.args.limit };
        let comparison =
            Comparison::new(self.dataset, &restorers, &images, self.args.max_memory, self.session)?;
        let pictures = Pictures { folder: PathBuf::new(), count: 0, prefix: String::new() };
        let evaluation =
            comparison.measure(&self.measuring, &Extras { regions: false, pictures: &pictures })?;
        let results = folder.join("results");
        Outputs::prepare(&results, &RESULTS.map(str::to_owned), true)?.write_results(&evaluation)?;
        Ok(Row::of(&entry.name, iterations, &evaluation, self.single.as_deref()))
    }

    /// Everything that decides a row's numbers.
    fn made_with(&self, entry: &Entry) -> String {
        let metrics: Vec<_> = self.measuring.metrics.iter().map(|measure| measure.metric()).collect();
        let everything = json!({
            "config": entry.config, "data-sha256": self.data_sha256, "metrics": metrics,
            "definition": self.measuring.definition, "limit": self.args.limit, "single-kernel": self.single,
        });
        everything.to_string()
    }

    fn write_tables(&self, rows: &[Row], failed: &[(String, String)]) -> Result<()> {
        let metrics: Vec<_> = self.measuring.metrics.iter().map(|measure| measure.metric()).collect();
        let markdown = table::to_markdown(rows, failed, &metrics, self.single.as_deref());
        let json = json!({
            "rows": rows.iter().map(Row::to_json).collect::<Vec<_>>(),
            "failed": failed.iter().map(|(name, reason)| json!({"name": name, "reason": reason})).collect::<Vec<_>>(),
            "single-kernel": self.single,
            "data-sha256": self.data_sha256,
            "definition": self.measuring.definition,
        });
        // Tables are made of rows, which are kept: they may always be written anew.
        let names = ["table.md", "table.csv", "table.json"].map(str::to_owned);
        let outputs = Outputs::prepare(&self.args.output, &names, true)?;
        outputs.write("table.md", markdown.as_bytes())?;
        outputs.write("table.csv", table::to_csv(rows, &metrics, self.single.as_deref()).as_bytes())?;
        outputs.write("table.json", format!("{json:#}\n").as_bytes())?;
        self.session.tell(markdown);
        self.session.tell(self.args.output.join("table.md").display());
        Ok(())
    }
}
