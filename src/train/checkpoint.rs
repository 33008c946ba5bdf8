//! Turns a training's state into checkpoint folders and back, exactly.
//!
//! A checkpoint is a folder named after its iteration: `model.safetensors` to use, `state.safetensors` to go
//! on from. It gets its name when both files are complete.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

use super::instruction_sets::InstructionSets;
use super::optimizer::Moments;
use super::trainer::State;
use crate::core::error::{Error, Result};
use crate::core::psf::hex;
use crate::io::{self, FloatWidth, TensorData};
use crate::network::weights::{self, Weights, tensors};
use crate::network::{Architecture, Parameters, TensorValues};

const FORMAT: &str = "udc-training-state";
const VERSION: &str = "3";
/// The version whose states had no [`CHECKSUM`].
const WITHOUT_CHECKSUM: &str = "2";

/// The name of the SHA-256 of all else that a state holds.
const CHECKSUM: &str = "contents-sha256";

const STATE_FILE: &str = "state.safetensors";
const MODEL_FILE: &str = "model.safetensors";

/// What is put before the weights' names for each kind of tensor in a state.
const PARAMETERS: &str = "parameters/";
const FIRST: &str = "first-moment/";
const SECOND: &str = "second-moment/";
const AVERAGE: &str = "average/";

/// How the names of checkpoints end that are not complete.
const DRAFT: &str = ".partial";

/// What is put before the names of what the data are told apart by.
const DATA: &str = "data/";

/// The name of the instruction sets that a training computed with.
const INSTRUCTION_SETS: &str = "instruction-sets";

/// The best validation so far, by the metric that the configuration chose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Best {
    pub(super) iteration: u64,
    /// The metric's mean.
    pub(super) value: f64,
}

/// Everything that a training goes on from.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Checkpoint {
    pub(super) state: State,
    pub(super) best: Option<Best>,
    /// What the data are told apart by, part by part; nothing in states of older versions.
    pub(super) data: BTreeMap<String, String>,
    /// What the steps were computed with; nothing in states of older versions.
    pub(super) instruction_sets: Option<InstructionSets>,
}

/// The folder of a run's checkpoints.
#[derive(Clone, Debug)]
pub(super) struct Checkpoints {
    folder: PathBuf,
}

impl Checkpoints {
    pub(super) fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// The iterations that there are checkpoints of, in order.
    pub(super) fn iterations(&self) -> Result<Vec<u64>> {
        if !self.folder.is_dir() {
            return Ok(Vec::new());
        }
        let names = io::list_folder(&self.folder)?;
        let mut iterations: Vec<u64> = names.iter().filter_map(|name| name.parse().ok()).collect();
        iterations.sort_unstable();
        Ok(iterations)
    }

    /// Marks that the run has weights of its own from the start, until a checkpoint holds them.
    pub(super) fn await_first(&self) -> Result<()> {
        io::create_folder(&self.draft(0))
    }

    /// Whether a run was stopped before it kept the weights that it began with.
    pub(super) fn awaits_first(&self) -> Result<bool> {
        Ok(self.iterations()?.is_empty() && self.draft(0).is_dir())
    }

    /// The model of a checkpoint.
    pub(super) fn model(&self, iteration: u64) -> PathBuf {
        self.folder.join(iteration.to_string()).join(MODEL_FILE)
    }

    /// Where a checkpoint is written before it is complete.
    fn draft(&self, iteration: u64) -> PathBuf {
        self.folder.join(format!("{iteration}{DRAFT}"))
    }

    /// Removes checkpoints that an interrupted save left incomplete.
    pub(super) fn remove_unfinished(&self) -> Result<()> {
        if !self.folder.is_dir() {
            return Ok(());
        }
        let names = io::list_folder(&self.folder)?;
        let mut drafts = names.iter().filter(|name| name.ends_with(DRAFT));
        drafts.try_for_each(|name| io::remove(&self.folder.join(name)))
    }

    /// Saves a checkpoint, unless there is one of this iteration, and removes all but the latest `keep`.
    pub(super) fn save(&self, checkpoint: &Checkpoint, model: &Weights, keep: usize) -> Result<()> {
        let iteration = checkpoint.state.iteration;
        let path = self.folder.join(iteration.to_string());
        if !path.is_dir() {
            let draft = self.draft(iteration);
            io::remove(&draft)?;
            io::create_folder(&draft)?;
            weights::write(&draft.join(MODEL_FILE), model, false)?;
            checkpoint.write(&draft.join(STATE_FILE))?;
            io::publish(&draft, &path)?;
        }
        let iterations = self.iterations()?;
        let surplus = iterations.len().saturating_sub(keep);
        iterations[..surplus].iter().try_for_each(|old| io::remove(&self.folder.join(old.to_string())))
    }

    /// Reads the latest checkpoint, and clears away what an interrupted save left.
    ///
    /// One that is damaged is warned of, and gives way to the newest that is not: it will be made again.
    pub(super) fn latest(
        &self,
        architecture: &Architecture,
        warn: &dyn Fn(&str),
    ) -> Result<Option<Checkpoint>> {
        self.remove_unfinished()?;
        let mut damaged: Vec<(PathBuf, Error)> = Vec::new();
        for iteration in self.iterations()?.into_iter().rev() {
            let path = self.folder.join(iteration.to_string());
            match Checkpoint::read(&path.join(STATE_FILE), architecture) {
                Ok(checkpoint) => {
                    for (path, error) in damaged {
                        warn(&format!(
                            "{error}; it is removed, and the training goes on from iteration {iteration}"
                        ));
                        io::remove(&path)?;
                    }
                    return Ok(Some(checkpoint));
                }
                // What cannot be read now may be whole all the same.
                Err(Error::Io { action, path, source }) if source.kind() != ErrorKind::NotFound => {
                    return Err(Error::Io { action, path, source });
                }
                Err(error) => damaged.push((path, error)),
            }
        }
        damaged.into_iter().next().map_or(Ok(None), |(_, error)| Err(error))
    }
}

impl Checkpoint {
    fn write(&self, path: &Path) -> Result<()> {
        let State { iteration, parameters, moments, average } = &self.state;
        let mut tensors = named(PARAMETERS, parameters, parameters.iter().map(|p| &p.values));
        tensors.extend(named(FIRST, parameters, &moments.first));
        tensors.extend(named(SECOND, parameters, &moments.second));
        if let Some(average) = average {
            tensors.extend(named(AVERAGE, parameters, average.iter().map(|p| &p.values)));
        }
        let mut metadata = BTreeMap::from([
            ("format".to_owned(), FORMAT.to_owned()),
            ("version".to_owned(), VERSION.to_owned()),
            ("iteration".to_owned(), iteration.to_string()),
        ]);
        if let Some(best) = &self.best {
            // Rust's own text of a number returns it to the bit, so that a tie stays one after resuming.
            metadata.insert("best-iteration".to_owned(), best.iteration.to_string());
            metadata.insert("best-value".to_owned(), best.value.to_string());
        }
        if let Some(sets) = &self.instruction_sets {
            metadata.insert(INSTRUCTION_SETS.to_owned(), sets.to_string());
        }
        metadata.extend(self.data.iter().map(|(name, part)| (format!("{DATA}{name}"), part.clone())));
        let contents = tensors.iter().map(|(name, (shape, values))| (name, &shape[..], &values[..]));
        let checksum = contents_sha256(contents, &metadata);
        metadata.insert(CHECKSUM.to_owned(), checksum);
        io::write_safetensors(path, &tensors, &metadata, FloatWidth::Single, false)
    }

    fn read(path: &Path, architecture: &Architecture) -> Result<Self> {
        let tensors::TensorFile { mut tensors, mut metadata } = tensors::read(path)?;
        let checksum = metadata.remove(CHECKSUM);
        let damaged = || Error::format(path, "is no training state of this version of udc; start a new run");
        let entry = |key: &str| metadata.get(key).map(String::as_str);
        if entry("format") != Some(FORMAT) {
            return Err(damaged());
        }
        match (entry("version"), checksum) {
            (Some(WITHOUT_CHECKSUM), None) => {}
            (Some(VERSION), Some(checksum)) => {
                let contents =
                    tensors.iter().map(|(name, tensor)| (name, &tensor.shape[..], &tensor.values[..]));
                if contents_sha256(contents, &metadata) != checksum {
                    return Err(Error::format(path, "is damaged: it does not hold what its checksum is of"));
                }
            }
            _ => return Err(damaged()),
        }
        let iteration = entry("iteration").and_then(|text| text.parse().ok()).ok_or_else(damaged)?;
        let mut take = |prefix: &str| {
            let set = split_off(&mut tensors, prefix);
            Parameters::from_tensors(architecture, set)
                .map_err(|error| Error::format(path, error.to_string()))
        };
        let parameters = take(PARAMETERS)?;
        let moments = Moments { first: values(take(FIRST)?), second: values(take(SECOND)?) };
        let has_average = tensors.keys().any(|name| name.starts_with(AVERAGE));
        let average = if has_average {
            Some(Parameters::from_tensors(architecture, split_off(&mut tensors, AVERAGE))?)
        } else {
            None
        };
        let best = match (entry("best-iteration"), entry("best-value")) {
            (Some(iteration), Some(value)) => Some(Best {
                iteration: iteration.parse().map_err(|_| damaged())?,
                value: value.parse().map_err(|_| damaged())?,
            }),
            _ => None,
        };
        let part = |(key, part): (&String, &String)| Some((key.strip_prefix(DATA)?.to_owned(), part.clone()));
        let data = metadata.iter().filter_map(part).collect();
        let instruction_sets = entry(INSTRUCTION_SETS).map(InstructionSets::parse);
        Ok(Self { state: State { iteration, parameters, moments, average }, best, data, instruction_sets })
    }
}

/// SHA-256 of tensors, sorted by name, and of metadata, in hexadecimal.
fn contents_sha256<'a>(
    tensors: impl Iterator<Item = (&'a String, &'a [usize], &'a [f32])>,
    metadata: &BTreeMap<String, String>,
) -> String {
    let mut hash = Sha256::new();
    // With quotes around texts, and the number of values before them: nothing can pass for something else.
    hash.update(format!("{metadata:?}"));
    for (name, shape, values) in tensors {
        hash.update(format!("{name:?} {shape:?}"));
        for chunk in values.chunks(HASHED_AT_ONCE) {
            let bytes: Vec<u8> = chunk.iter().flat_map(|value| value.to_le_bytes()).collect();
            hash.update(bytes);
        }
    }
    hex(&hash.finalize())
}

/// Values whose bytes the first-level cache holds.
const HASHED_AT_ONCE: usize = 1 << 12;

/// Tensors shaped and named like the weights, each name with a prefix.
fn named<'a>(
    prefix: &str,
    parameters: &Parameters,
    values: impl IntoIterator<Item = &'a Vec<f32>>,
) -> BTreeMap<String, TensorData<'a>> {
    let name = |name: &str| format!("{prefix}{name}");
    let pairs = parameters.iter().zip(values);
    pairs.map(|(p, values)| (name(&p.name), (p.shape.clone(), Cow::Borrowed(&values[..])))).collect()
}

/// Takes the tensors of a prefix out, under the rest of their names.
fn split_off(tensors: &mut BTreeMap<String, TensorValues>, prefix: &str) -> BTreeMap<String, TensorValues> {
    let names: Vec<String> = tensors.keys().filter(|name| name.starts_with(prefix)).cloned().collect();
    let take = |name: String| tensors.remove(&name).map(|values| (name[prefix.len()..].to_owned(), values));
    names.into_iter().filter_map(take).collect()
}

fn values(parameters: Parameters) -> Vec<Vec<f32>> {
    parameters.into_iter().map(|p| p.values).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    use crate::network::{Initialisation, Model, Origin};

    fn checkpoint(iteration: u64, average: bool) -> (Checkpoint, Weights) {
        let architecture = Architecture { features: 1, filter_size: 3, ..Architecture::default() };
        let random = |seed| Parameters::random(&architecture, Initialisation::Paper, seed);
        let moments = Moments { first: values(random(2)), second: values(random(3)) };
        let average = average.then(|| random(4));
        let state = State { iteration, parameters: random(1), moments, average };
        let best = Some(Best { iteration: 3, value: 0.973_618_558_394_455_9 });
        let weights = Weights { parameters: random(1), architecture, origin: Origin::default() };
        let data = BTreeMap::from([("images-sha256".to_owned(), "ab".to_owned())]);
        let instruction_sets = Some(InstructionSets::parse("avx512 → portable"));
        (Checkpoint { state, best, data, instruction_sets }, weights)
    }

    #[test]
    fn a_state_is_read_back_exactly() {
        let folder = tempfile::tempdir().unwrap();
        for average in [false, true] {
            let checkpoints = Checkpoints::new(folder.path().join(average.to_string()));
            let (saved, model) = checkpoint(7, average);
            checkpoints.save(&saved, &model, 1).unwrap();
            assert_eq!(checkpoints.latest(&model.architecture, &no_warning).unwrap().unwrap(), saved);
        }
    }

    #[test]
    fn only_the_latest_are_kept_and_drafts_are_cleared() {
        let folder = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::new(folder.path().to_owned());
        for iteration in [9, 10, 100] {
            let (saved, model) = checkpoint(iteration, false);
            checkpoints.save(&saved, &model, 2).unwrap();
        }
        io::create_folder(&folder.path().join("200.partial")).unwrap();
        let (_, model) = checkpoint(0, false);
        let latest = checkpoints.latest(&model.architecture, &no_warning).unwrap().unwrap();
        assert_eq!(latest.state.iteration, 100);
        assert_eq!(io::list_folder(folder.path()).unwrap(), ["10", "100"]);
        assert!(Model::load(&folder.path().join("100").join(MODEL_FILE)).is_ok());
    }

    #[test]
    fn damaged_checkpoints_give_way_to_the_newest_that_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::new(folder.path().to_owned());
        for iteration in [1, 2, 3, 4] {
            let (saved, model) = checkpoint(iteration, false);
            checkpoints.save(&saved, &model, 9).unwrap();
        }
        let state = |iteration: &str| folder.path().join(iteration).join(STATE_FILE);
        std::fs::write(state("4"), "damaged").unwrap();
        std::fs::remove_file(state("3")).unwrap();
        let (_, model) = checkpoint(0, false);
        let warnings = RefCell::new(Vec::new());
        let warn = |text: &str| warnings.borrow_mut().push(text.to_owned());
        let latest = checkpoints.latest(&model.architecture, &warn).unwrap().unwrap();
        assert_eq!(latest.state.iteration, 2);
        assert_eq!(io::list_folder(folder.path()).unwrap(), ["1", "2"]);
        for (warning, iteration) in warnings.borrow().iter().zip(["4", "3"]) {
            assert!(warning.contains(&state(iteration).display().to_string()), "{warning}");
        }
        ["1", "2"].iter().for_each(|iteration| std::fs::write(state(iteration), "damaged").unwrap());
        assert!(checkpoints.latest(&model.architecture, &no_warning).is_err());
        assert_eq!(io::list_folder(folder.path()).unwrap(), ["1", "2"], "nothing is removed for nothing");
    }

    /// Wherever a byte is another, or the file ends.
    #[test]
    fn a_state_that_is_not_what_was_written_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(STATE_FILE);
        let (saved, model) = checkpoint(7, true);
        saved.write(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let read = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            Checkpoint::read(&path, &model.architecture)
        };
        for at in (0..bytes.len()).step_by(997) {
            let mut other = bytes.clone();
            other[at] ^= 1;
            assert!(read(&other).is_err(), "byte {at} of {}", bytes.len());
            assert!(read(&bytes[..at]).is_err(), "{at} bytes of {}", bytes.len());
        }
        let mut other = bytes.clone();
        *other.last_mut().unwrap() ^= 1;
        assert!(read(&other).unwrap_err().to_string().contains("is damaged: it does not hold"));
        assert_eq!(read(&bytes).unwrap(), saved);
    }

    fn no_warning(text: &str) {
        panic!("{text}");
    }

    #[test]
    fn a_model_is_no_state() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("model.safetensors");
        let (_, model) = checkpoint(0, false);
        weights::write(&path, &model, false).unwrap();
        let message = Checkpoint::read(&path, &model.architecture).unwrap_err().to_string();
        assert!(message.contains("is no training state"), "{message}");
    }
}
