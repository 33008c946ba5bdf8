//! `udc sweep`.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::Args;

use udc::core::shard::Shard;
use udc::dataset::Dataset;
use udc::experiment::{
    Document as _, EarlierRows, Listener, ResultsFolder, Sweep, SweepConfig, SweepEntry, SweepEvent,
    SweepResults,
};
use udc::io;
use udc::network::Backend;

use super::Session;
use super::device::DeviceArgs;
use super::metrics::MetricArgs;
use super::train::configure;

/// The table in its formats.
const TABLES: [&str; 3] = ["table.md", "table.csv", "table.json"];

/// Train and measure several configurations, and tabulate them
///
/// All are trained on the same data (but for data.kernels) with the same seed, and measured on the test split: on the
/// images of one kernel, and on those of all. The folder gets a run for each configuration, named after its file, and
/// table.md, table.csv and table.json of all. A configuration that fails is named at the end; the others are finished.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  udc sweep configs/ablation-*.toml --data dataset -o ablation\n  \
    udc sweep a.toml b.toml --data dataset -o sweep --set iterations=2000 --set data.crop=64\n  \
    udc sweep a.toml b.toml --data dataset -o sweep --set iterations=2000 --set data.crop=64 --resume\n  \
    udc sweep a.toml b.toml --data dataset -o sweep --shard 2/2")]
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
    /// Train and measure only the I-th of N parts of the configurations; all parts may run at the same time, into one
    /// folder, and a last run with --resume makes the table
    #[arg(long, value_name = "I/N", default_value = "1/1")]
    shard: Shard,
    #[command(flatten)]
    metrics: MetricArgs,
    /// Measure on the first N triplets of the test split only
    #[arg(long, value_name = "N", value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    limit: Option<usize>,
    /// Kernel whose images are measured for themselves too, beside those of all [default: r+00 where there is one]
    #[arg(long, value_name = "KERNEL")]
    single: Option<String>,
    /// Memory that one restoration may take: 2GiB, 500MB, …
    #[arg(long, value_name = "SIZE", default_value = "2GiB", value_parser = udc::core::bytes::parse_bytes)]
    max_memory: u64,
    #[command(flatten)]
    device: DeviceArgs,
    /// Burn backend to compute with on the CPU: flex or ndarray
    #[arg(long, default_value = "flex", value_name = "NAME")]
    backend: Backend,
}

impl SweepArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        session.check_resume(self.resume)?;
        let earlier = match (self.resume, session.overwrite) {
            (true, _) => EarlierRows::Resume,
            (false, true) => EarlierRows::Replace,
            (false, false) => EarlierRows::Refuse,
        };
        let entries = self.entries()?;
        let backend = self.device.find_or(self.backend, session)?;
        let config = SweepConfig {
            measuring: self.metrics.config(false, backend)?,
            limit: self.limit,
            single: self.single,
            max_memory: self.max_memory,
            backend,
            earlier,
            shard: self.shard,
        };
        let dataset = Dataset::open(&self.data)?;
        session.warn_of_unfinished(&dataset)?;
        let warn = |text: &str| session.warn(text);
        let listener = Listener { progress: &session.progress, warn: &warn };
        let sweep = Sweep::new(&config, &dataset, &self.output, listener)?;
        let results = sweep.run(&entries, &|event| match event {
            SweepEvent::Begins(name) => {
                session.stage(name);
                session.tell(format_args!("# {name}"));
            }
            SweepEvent::WasFinished(name) => session.tell(format_args!("{name}: finished before")),
            SweepEvent::Trains(parameters) => session.detail(format_args!("{parameters} parameters")),
        })?;
        session.results_of(serde_json::from_str(&results.to_json())?);
        if self.shard.is_part() {
            let folder = self.output.display();
            session.tell(format_args!(
                "{folder}: rows of shard {}; when all shards are done, the same command with --resume and without --shard \
                 makes the table",
                self.shard
            ));
        } else if !results.rows.is_empty() || !self.output.join(TABLES[0]).exists() {
            write_tables(&results, &self.output, session)?;
        }
        if results.failed.is_empty() {
            return Ok(());
        }
        let reasons: Vec<&str> = results.failed.iter().map(|row| row.reason.as_str()).collect();
        let all = results.rows.len() + reasons.len();
        bail!("{} of {all} rows failed: {}", reasons.len(), reasons.join("; "))
    }

    /// Reads every configuration before any is trained.
    fn entries(&self) -> Result<Vec<SweepEntry>> {
        let entry = |path: &PathBuf| {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            Ok(SweepEntry { name, config: configure(&io::read_configuration(path)?, path, &self.set)? })
        };
        self.configs.iter().map(entry).collect()
    }
}

fn write_tables(results: &SweepResults, folder: &Path, session: &Session) -> Result<()> {
    let markdown = results.to_markdown();
    // Tables are made of rows, which are kept: they may always be written anew.
    let outputs = ResultsFolder::prepare(folder, &TABLES.map(str::to_owned), true)?;
    for (name, text) in TABLES.iter().zip([&markdown, &results.to_csv(), &results.to_json()]) {
        outputs.write(name, text.as_bytes())?;
    }
    session.tell(markdown);
    session.tell(folder.join(TABLES[0]).display());
    Ok(())
}
