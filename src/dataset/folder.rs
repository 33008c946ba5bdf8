//! Our own dataset folder: `dataset.toml`, `kernels.safetensors` and `triplets*.jsonl`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::io;

use super::config::{DatasetConfig, FORMAT, VERSION};
use super::{Dataset, Split, Triplet, check_path};

/// The file that describes a dataset.
pub const CONFIG_FILE: &str = "dataset.toml";

/// The kernel bank of a dataset.
pub const BANK_FILE: &str = "kernels.safetensors";

/// The PSFs over the frame, in a dataset whose PSF changes there.
pub const FIELD_FILE: &str = "field.toml";

pub(super) fn open(root: &Path) -> Result<Dataset> {
    let mut config = DatasetConfig::read(root)?;
    let bank_path = root.join(&config.bank);
    let sha256 = io::bank_sha256(&bank_path)?;
    if !io::is_bank_of_sha256(&bank_path, &config.bank_sha256)? {
        let reason = format!(
            "is not the kernel bank of this dataset (the SHA-256 of its header and codes is {sha256}, {CONFIG_FILE} \
             records {}); put the original back or synthesise again",
            config.bank_sha256
        );
        return Err(Error::format(bank_path, reason));
    }
    // The identity that models and restorations know a bank by.
    config.bank_sha256 = sha256;
    let bank = io::read_bank(&bank_path)?;
    let kernels = (0..bank.len()).map(|index| bank.kernel_name(index)).collect();
    let codes = (0..bank.len()).map(|index| bank.code(index).to_owned()).collect();
    Ok(Dataset {
        root: root.to_owned(),
        formation: config.formation.clone(),
        config: Some(config),
        bank: Some(bank),
        triplets: TripletFiles::find(root)?.read_all()?,
        real_captures: Vec::new(),
        kernels,
        codes,
    })
}

impl DatasetConfig {
    /// Reads `dataset.toml` of the folder `root`.
    ///
    /// # Errors
    /// [`Error::Format`] with the line and column of what is wrong, or naming an unknown format or version.
    pub fn read(root: &Path) -> Result<Self> {
        let path = root.join(CONFIG_FILE);
        let text = io::read_text(&path)?;
        let table: toml::Table = parse_toml(&text).map_err(|reason| Error::format(&path, reason))?;
        if table.get("format").and_then(toml::Value::as_str) != Some(FORMAT) {
            return Err(Error::format(&path, format!("does not say format = \"{FORMAT}\"")));
        }
        let version = table.get("version").and_then(toml::Value::as_integer);
        if version != Some(i64::from(VERSION)) {
            let found = version.map_or("none".to_owned(), |version| version.to_string());
            let reason = format!("has version {found}; this program reads version {VERSION}");
            return Err(Error::format(&path, reason));
        }
        let config: Self = parse_toml(&text).map_err(|reason| Error::format(&path, reason))?;
        check_path("bank", &config.bank).map_err(|reason| Error::format(&path, reason))?;
        config.formation.curve().map_err(|error| Error::format(&path, error.to_string()))?;
        Ok(config)
    }

    /// The text of `dataset.toml`.
    ///
    /// # Panics
    /// Never: the fields are plain data.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a dataset's configuration is plain data")
    }
}

/// How the name of a mark ends that a list is being written.
const BEGUN: &str = ".begun";

/// What was added, the part from 1 and the number of parts, of a list's name without "triplets" and extension.
fn part_of(stem: &str) -> (&str, usize, usize) {
    let numbers = || {
        let (rest, count) = stem.rsplit_once("-of-")?;
        let (added, part) = rest.rsplit_once('-')?;
        Some((added, part.parse().ok()?, count.parse().ok()?))
    };
    numbers().unwrap_or((stem, 1, 1))
}

/// The files that list a dataset's triplets: `triplets.jsonl`, or one for each shard.
#[derive(Clone, Debug)]
pub struct TripletFiles {
    root: PathBuf,
    names: Vec<String>,
    /// Lists whose runs have not come to their ends.
    begun: BTreeSet<String>,
}

impl TripletFiles {
    /// Finds every list of triplets in the folder `root`.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder cannot be listed.
    pub fn find(root: &Path) -> Result<Self> {
        let found = io::list_folder(root)?;
        let is_list = |name: &str| name.starts_with("triplets") && name.ends_with(".jsonl");
        let begun_list = |name: &String| Some(name.strip_prefix('.')?.strip_suffix(BEGUN)?.to_owned());
        let begun = found.iter().filter_map(begun_list).filter(|name| is_list(name)).collect();
        let names = found.into_iter().filter(|name| is_list(name)).collect();
        Ok(Self { root: root.to_owned(), names, begun })
    }

    /// The mark beside a list that it is being written: there from the beginning of a run to its end, so that it stays behind
    /// one that was stopped or killed.
    pub fn mark_of(list: &Path) -> PathBuf {
        let name = list.file_name().unwrap_or_default().to_string_lossy();
        list.with_file_name(format!(".{name}{BEGUN}"))
    }

    /// What is missing of the synthesis: lists that are not there, and those of runs that have not come to their ends. Nothing
    /// where one division into shards is whole, whatever other runs left.
    pub fn unfinished(&self) -> Vec<String> {
        // By what was added and the number of parts: the lists that are there, those that are finished among them.
        let mut divisions: BTreeMap<&str, BTreeMap<usize, BTreeMap<usize, &str>>> = BTreeMap::new();
        for name in &self.names {
            let stem = name.trim_start_matches("triplets").trim_end_matches(".jsonl");
            let (added, part, count) = part_of(stem);
            divisions.entry(added).or_default().entry(count).or_default().insert(part, name);
        }
        let lacks_of = |(added, divisions): (&&str, &BTreeMap<usize, BTreeMap<usize, &str>>)| {
            let lacks = |(&count, lists): (&usize, &BTreeMap<usize, &str>)| -> Vec<String> {
                let lack = |part| match lists.get(&part) {
                    None => Some(format!("triplets{added}-{part:05}-of-{count:05}.jsonl is not there")),
                    Some(name) => self
                        .begun
                        .contains(*name)
                        .then(|| format!("the run that writes {name} has not ended")),
                };
                (1..=count).filter_map(lack).collect()
            };
            divisions.iter().map(lacks).min_by_key(Vec::len).unwrap_or_default()
        };
        divisions.iter().flat_map(lacks_of).collect()
    }

    /// The name of the list that shard `index` (from 0) of `count` writes; a split that is `added` to a dataset has
    /// lists of its own.
    pub fn name(added: Option<Split>, index: usize, count: usize) -> String {
        let added = added.map_or(String::new(), |split| format!("-{}", split.name()));
        if count == 1 {
            format!("triplets{added}.jsonl")
        } else {
            format!("triplets{added}-{:05}-of-{count:05}.jsonl", index + 1)
        }
    }

    /// The names that were found.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Reads the triplets of all lists, ordered by split, scene and kernel.
    ///
    /// # Errors
    /// [`Error::Format`] naming the line that is no triplet, a triplet that is listed twice, a source that
    /// is in two splits, or the absence of any triplet.
    pub fn read_all(&self) -> Result<Vec<Triplet>> {
        let mut triplets = Vec::new();
        for name in &self.names {
            triplets.extend(read_list(&self.root.join(name))?);
        }
        if triplets.is_empty() {
            let reason = "lists no triplets; finish the synthesis with `udc synth --resume`";
            return Err(Error::format(&self.root, reason));
        }
        // The order of kernels within a scene is the order of their angles, then of their names.
        triplets.sort_by(|a, b| {
            let by_scene = (a.split, &a.id).cmp(&(b.split, &b.id));
            let angle = |triplet: &Triplet| triplet.angle_deg.unwrap_or(0.0);
            by_scene.then(angle(a).total_cmp(&angle(b))).then_with(|| a.kernel.cmp(&b.kernel))
        });
        self.check_unique(&triplets)?;
        self.check_splits(&triplets)?;
        Ok(triplets)
    }

    fn check_splits(&self, triplets: &[Triplet]) -> Result<()> {
        let mut splits = BTreeMap::new();
        for triplet in triplets {
            let first = *splits.entry(&triplet.source).or_insert(triplet.split);
            if first != triplet.split {
                let (source, split) = (&triplet.source, triplet.split.name());
                let reason = format!("has source {source} in the splits {} and {split}", first.name());
                return Err(Error::format(&self.root, reason));
            }
        }
        Ok(())
    }

    fn check_unique(&self, triplets: &[Triplet]) -> Result<()> {
        let mut seen = BTreeSet::new();
        for triplet in triplets {
            if !seen.insert((&triplet.id, &triplet.kernel)) {
                let reason = format!("lists the triplet {} of kernel {} twice", triplet.id, triplet.kernel);
                return Err(Error::format(&self.root, reason));
            }
        }
        Ok(())
    }
}

fn read_list(path: &Path) -> Result<Vec<Triplet>> {
    let text = io::read_text(path)?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(index, line)| {
            let number = index + 1;
            let triplet: Triplet = serde_json::from_str(line).map_err(|error| {
                let reason = "after an interrupted synthesis, finish it with `udc synth --resume`";
                Error::format(path, format!("line {number} is no triplet ({error}); {reason}"))
            })?;
            triplet.check_paths().map_err(|reason| Error::format(path, format!("line {number} {reason}")))?;
            Ok(triplet)
        })
        .collect()
}
