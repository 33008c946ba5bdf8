//! Trains several configurations on the same data, measures them, and tabulates them.

mod row;
mod table;

use std::path::Path;

use serde_json::json;

use super::measurement::{MeasuredDataset, Measurement};
use super::{
    Candidate, Comparison, EvalConfig, Findings, ImagesConfig, KeptPictures, Listener, RESULTS, Results,
    ResultsFolder, validation_measures,
};
use crate::core::error::{Error, Result};
use crate::core::metrics::{Measure, Metric};
use crate::core::shard::Shard;
use crate::dataset::{Dataset, KernelChoice, Split};
use crate::io;
use crate::network::{Backend, Model};
use crate::restore::Highlights;
use crate::train::{Outcome, Start, TrainConfig, Training, TrainingSet};
use row::Row;

pub use table::{FailedRow, RowResults, SingleResults, SweepResults};

/// The name of the kernel that is not turned.
const UNROTATED: &str = "r+00";

/// A configuration of a sweep, which becomes a row of its table.
#[derive(Clone, Debug)]
pub struct SweepEntry {
    /// Its name, and that of its run's folder.
    pub name: String,
    /// How it is trained.
    pub config: TrainConfig,
}

/// What is done with rows that are there already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EarlierRows {
    /// There may be none.
    Refuse,
    /// They are made anew.
    Replace,
    /// Finished ones are kept, and the others go on from their checkpoints.
    Resume,
}

/// How a sweep trains and measures.
#[derive(Clone, Debug)]
pub struct SweepConfig {
    /// What is measured.
    pub measuring: EvalConfig,
    /// At most the first so many triplets of the test split are measured on.
    pub limit: Option<usize>,
    /// The kernel whose images are measured for themselves too; the unrotated one of several, unless it is said.
    pub single: Option<String>,
    /// Bytes that one restoration may take.
    pub max_memory: u64,
    /// Where trainings compute.
    pub backend: Backend,
    /// What is done with rows that are there already.
    pub earlier: EarlierRows,
    /// Whose configurations are trained and measured; the table is made of the rows of all.
    pub shard: Shard,
}

/// What a sweep says on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SweepEvent<'a> {
    /// A configuration's turn has come.
    Begins(&'a str),
    /// Its row was finished before.
    WasFinished(&'a str),
    /// A network of so many weights is trained.
    Trains(u64),
}

/// A sweep over one dataset, in a folder of its own.
pub struct Sweep<'a> {
    config: &'a SweepConfig,
    dataset: &'a Dataset,
    data_sha256: String,
    /// The kernel whose images are averaged for themselves too.
    single: Option<String>,
    folder: &'a Path,
    listener: Listener<'a>,
}

impl<'a> Sweep<'a> {
    /// Checks that the dataset can be measured on.
    ///
    /// # Errors
    /// [`Error::Config`] for a single kernel that there is not; [`Error::Format`] without a test split.
    pub fn new(
        config: &'a SweepConfig,
        dataset: &'a Dataset,
        folder: &'a Path,
        listener: Listener<'a>,
    ) -> Result<Self> {
        let split = dataset.split(Split::Test);
        split.map_err(|error| error.while_doing("the rows are measured on the test split"))?;
        let single = single_kernel(dataset, config.single.as_deref())?;
        Ok(Self { config, dataset, data_sha256: dataset.triplets_sha256(), single, folder, listener })
    }

    /// Trains and measures every configuration of the shard; one that fails does not keep the others from being finished.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when configurations have one name, or several seeds, or earlier rows are in the way or of
    /// other data; [`Error::Interrupted`], with what to do next before it.
    pub fn run(&self, entries: &[SweepEntry], on_event: &dyn Fn(SweepEvent<'_>)) -> Result<SweepResults> {
        check_comparable(entries)?;
        self.config.shard.check(entries.len(), "configurations")?;
        let entries = self.config.shard.choose(entries.iter().collect());
        self.prepare_folder(&entries)?;
        let (mut rows, mut failed) = (Vec::new(), Vec::new());
        for entry in entries {
            on_event(SweepEvent::Begins(&entry.name));
            let row = self.row(entry, on_event);
            match row.map_err(|error| error.while_doing(format!("row {}", entry.name))) {
                Ok(row) => rows.push(row.results()),
                Err(error) if error.is_interrupt() => {
                    return Err(error.while_doing("the sweep was interrupted; go on with --resume"));
                }
                Err(error) => {
                    let reason = error.in_full();
                    (self.listener.warn)(&reason);
                    failed.push(FailedRow { name: entry.name.clone(), reason });
                }
            }
        }
        Ok(SweepResults {
            rows,
            failed,
            single_kernel: self.single.clone(),
            data_sha256: self.data_sha256.clone(),
            metrics: self.metrics(),
            definition: self.config.measuring.definition,
        })
    }

    fn metrics(&self) -> Vec<Metric> {
        self.config.measuring.metrics.iter().map(Measure::metric).collect()
    }

    fn prepare_folder(&self, entries: &[&SweepEntry]) -> Result<()> {
        let begun = entries.iter().find(|entry| self.folder.join(&entry.name).exists());
        if let (Some(entry), EarlierRows::Refuse) = (begun, self.config.earlier) {
            return Err(Error::Unsupported(format!(
                "{} has a row {} already; pass --resume to go on, --overwrite to begin anew, or name another folder",
                self.folder.display(),
                entry.name
            )));
        }
        if self.resumes() {
            entries.iter().try_for_each(|entry| self.check_same_data(&self.folder.join(&entry.name)))?;
        }
        io::create_folder(self.folder)
    }

    fn resumes(&self) -> bool {
        self.config.earlier == EarlierRows::Resume
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
        let Some((part, was, is)) = parts.iter().find(|(_, was, is)| was.is_some() && was.as_deref() != *is)
        else {
            return Ok(());
        };
        Err(Error::Unsupported(format!(
            "row {} was made with other data: {part} is {} and was {}; resume with its own data, or name another folder",
            row.name,
            is.unwrap_or("absent"),
            was.as_deref().unwrap_or("absent")
        )))
    }

    /// Trains and measures a configuration, unless it is finished.
    fn row(&self, entry: &SweepEntry, on_event: &dyn Fn(SweepEvent<'_>)) -> Result<Row> {
        let folder = self.folder.join(&entry.name);
        let made_with = self.made_with(entry);
        if self.resumes()
            && let Some(row) = Row::read(&folder)?.filter(|row| row.made_with == made_with)
        {
            on_event(SweepEvent::WasFinished(&entry.name));
            return Ok(row);
        }
        Row::remove(&folder)?;
        let outcome = self.train(&entry.config, &folder, on_event)?;
        if outcome.interrupted {
            return Err(Error::Interrupted);
        }
        let kernel_bank_sha256 = self.dataset.bank_sha256().map(str::to_owned);
        let row = Row { made_with, kernel_bank_sha256, ..self.measure(entry, &folder, outcome.iteration)? };
        row.write(&folder)?;
        Ok(row)
    }

    fn train(
        &self,
        config: &TrainConfig,
        folder: &Path,
        on_event: &dyn Fn(SweepEvent<'_>),
    ) -> Result<Outcome> {
        let start = match self.config.earlier {
            EarlierRows::Resume if folder.join("config.toml").is_file() => Start::Resume,
            EarlierRows::Replace => Start::Replace(None),
            _ => Start::New(None),
        };
        let set = TrainingSet::open(&self.dataset.root, None, config)?;
        on_event(SweepEvent::Trains(config.architecture.parameters()));
        let training = Training {
            config,
            set: &set,
            measures: &validation_measures(&config.validation, self.config.backend)?,
            backends: self.config.backend.into(),
            progress: self.listener.progress,
            warn: self.listener.warn,
        };
        training.run(folder, start)
    }

    fn measure(&self, entry: &SweepEntry, folder: &Path, iterations: u64) -> Result<Row> {
        let SweepConfig { measuring, limit, max_memory, backend, .. } = self.config;
        let model = Model::load(&folder.join("model.safetensors"))?.with_backend(*backend);
        let network = Candidate::Network(entry.name.clone(), Box::new(model), Highlights::default());
        let candidates = [Candidate::Nothing, network];
        let (split, kernels) = (Split::Test, KernelChoice::All);
        let (limit, max_memory, shard) = (*limit, *max_memory, Shard::WHOLE);
        let images = ImagesConfig { split, kernels, limit, max_memory, shard };
        let comparison = Comparison::new(self.dataset, &candidates, &images, self.listener)?;
        let evaluation = comparison.evaluate(measuring, false, &KeptPictures::default())?;
        let measured = MeasuredDataset::of("", &comparison, evaluation);
        let Findings { evaluation, .. } = Measurement::of_dataset(measured).into_findings()?;
        let results = folder.join("results");
        ResultsFolder::prepare(&results, &RESULTS.map(str::to_owned), true)?
            .write_results(&evaluation, &Results::of(&evaluation))?;
        Ok(Row::of(&entry.name, iterations, &evaluation, self.single.as_deref()))
    }

    /// Everything that decides a row's numbers.
    fn made_with(&self, entry: &SweepEntry) -> String {
        let everything = json!({
            "config": entry.config, "data-sha256": self.data_sha256, "metrics": self.metrics(),
            "definition": self.config.measuring.definition, "limit": self.config.limit, "single-kernel": self.single,
        });
        everything.to_string()
    }
}

/// Refuses configurations whose rows could not be told apart, or compared.
fn check_comparable(entries: &[SweepEntry]) -> Result<()> {
    for (index, entry) in entries.iter().enumerate() {
        let SweepEntry { name, config } = entry;
        if entries[..index].iter().any(|other| other.name == *name) {
            return Err(Error::Unsupported(format!(
                "two configurations are called {name}; rows are named after their files, rename one"
            )));
        }
        if let Some(other) = entries[..index].iter().find(|other| other.config.seed != config.seed) {
            return Err(Error::Unsupported(format!(
                "{} has seed {first} and {name} has seed {}; a sweep compares runs of one seed: add --set seed={first}",
                other.name,
                config.seed,
                first = other.config.seed
            )));
        }
    }
    Ok(())
}

/// The kernel whose images are averaged for themselves too: the one that was asked for, else the unrotated one of a
/// dataset of several. Where all images are of one kernel, its means are those of all.
fn single_kernel(dataset: &Dataset, asked: Option<&str>) -> Result<Option<String>> {
    let name = asked.unwrap_or(UNROTATED).to_owned();
    let found = dataset.kernel_indices(&KernelChoice::Only(vec![name]), "--single");
    match (found, asked) {
        (Ok(found), _) if asked.is_some() || dataset.kernel_names().len() > 1 => {
            Ok(found.first().map(|&index| dataset.kernel_names()[index].clone()))
        }
        (Err(error), Some(_)) => Err(error),
        _ => Ok(None),
    }
}
