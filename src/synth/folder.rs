//! Writes a dataset folder so that it can be interrupted at any moment and resumed.
//!
//! `dataset.toml` and the bank come first, then for every scene its ground truth, its degraded images and, at
//! last, its lines in the list of triplets: what is listed is there.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use sha2::{Digest, Sha256};

use crate::core::dataset::{CONFIG_FILE, DatasetConfig, Triplet, TripletFiles};
use crate::core::error::{Error, Result};
use crate::core::io::{self, LineLog};
use crate::core::psf::hex;

use super::run::{BankFile, Synthesis};
use super::scenes::{Scene, Shard};

/// What to do about what is in the folder already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Refuse to touch it.
    Refuse,
    /// Keep finished triplets, make the others.
    Resume,
    /// Begin anew.
    Overwrite,
}

/// A dataset folder that is being written.
#[derive(Debug)]
pub(super) struct DatasetFolder {
    root: PathBuf,
    list: PathBuf,
    log: LineLog,
    /// Scenes and kernels.
    finished: BTreeSet<(String, String)>,
}

impl DatasetFolder {
    /// Prepares the folder: describes the dataset, stores its bank, and finds what is finished.
    ///
    /// # Errors
    /// [`Error::Config`] when the folder holds a dataset and `existing` does not allow for it, or one made
    /// otherwise; [`Error::Io`] when the folder cannot be written.
    pub(super) fn prepare(root: &Path, synthesis: &Synthesis, existing: Existing) -> Result<Self> {
        let Synthesis { config, bank_file, scenes, shard, .. } = synthesis;
        let shard = *shard;
        let list = root.join(TripletFiles::name(shard.index, shard.count));
        check_existing(root, config, &list, shard, existing)?;
        io::create_folder(root)?;
        if existing == Existing::Overwrite {
            remove_lists(root, shard)?;
        }
        describe(root, config, bank_file, existing == Existing::Overwrite)?;
        let log = LineLog::open(&list)?;
        let mut folder = Self { root: root.to_owned(), list, log, finished: BTreeSet::new() };
        match existing {
            Existing::Resume => folder.resume(scenes)?,
            Existing::Refuse | Existing::Overwrite => folder.restart_list(&[])?,
        }
        Ok(folder)
    }

    pub(super) fn root(&self) -> &Path {
        &self.root
    }

    /// Makes the folders of the images.
    pub(super) fn create_image_folders(&self, kernels: &[String]) -> Result<()> {
        io::create_folder(&self.root.join("gt"))?;
        kernels.iter().try_for_each(|name| io::create_folder(&self.root.join("degraded").join(name)))
    }

    /// Takes finished triplets up again; their scenes may have been divided anew since.
    fn resume(&mut self, scenes: &[Scene]) -> Result<()> {
        let by_id: BTreeMap<&str, &Scene> = scenes.iter().map(|scene| (scene.id.as_str(), scene)).collect();
        let mut triplets = finished_triplets(&self.root, &self.list)?;
        for triplet in &mut triplets {
            if let Some(scene) = by_id.get(triplet.id.as_str()) {
                triplet.split = scene.split;
                triplet.source = scene.source.clone();
            }
        }
        // A run that was killed may have left half a line behind: the list is written anew.
        self.restart_list(&triplets)?;
        for triplet in triplets {
            self.finished.insert((triplet.id, triplet.kernel));
        }
        Ok(())
    }

    fn restart_list(&mut self, triplets: &[Triplet]) -> Result<()> {
        let text: String = triplets.iter().map(|triplet| to_line(triplet) + "\n").collect();
        io::write_atomically(&self.list, true, |file| file.write_all(text.as_bytes()))?;
        self.log = LineLog::open(&self.list)?;
        Ok(())
    }

    /// Whether the triplet of a scene and a kernel is there and intact.
    pub(super) fn is_finished(&self, id: &str, kernel: &str) -> bool {
        self.finished.contains(&(id.to_owned(), kernel.to_owned()))
    }

    /// Lists triplets as finished.
    pub(super) fn record(&mut self, triplets: impl Iterator<Item = Triplet>) -> Result<()> {
        for triplet in triplets {
            self.log.append(&to_line(&triplet))?;
        }
        self.log.sync()
    }
}

/// SHA-256 of a file, in hexadecimal.
pub(super) fn sha256_of(path: &Path) -> Result<String> {
    Ok(hex(&Sha256::digest(io::read_bytes(path)?)))
}

fn to_line(triplet: &Triplet) -> String {
    serde_json::to_string(triplet).expect("triplets are plain data")
}

fn check_existing(
    root: &Path,
    config: &DatasetConfig,
    list: &Path,
    shard: Shard,
    existing: Existing,
) -> Result<()> {
    if existing == Existing::Overwrite || !root.is_dir() {
        return Ok(());
    }
    let refuse = |reason: String| Err(Error::config("output", format!("{} {reason}", root.display())));
    let names = io::list_folder(root)?;
    if !names.contains(&CONFIG_FILE.to_owned()) {
        let nothing_of_ours = names.iter().all(|name| name.starts_with('.'));
        return if nothing_of_ours {
            Ok(())
        } else {
            refuse("is not empty and holds no dataset; name another folder, or pass --overwrite".to_owned())
        };
    }
    let may_join = existing == Existing::Resume || (shard.count > 1 && !list.exists());
    if !may_join {
        return refuse("holds a dataset; pass --resume to finish it or --overwrite to begin anew".to_owned());
    }
    let differences = differing_keys(&DatasetConfig::read(root)?, config);
    if !differences.is_empty() {
        let keys = differences.join(", ");
        return refuse(format!("was made with another {keys}; use the same flags, or name another folder"));
    }
    match names.iter().find(|name| is_list(name) && !belongs_to(name, shard)) {
        Some(other) => refuse(format!("was begun with other shards ({other}); use the same --shard count")),
        None => Ok(()),
    }
}

fn is_list(name: &str) -> bool {
    name.starts_with("triplets") && name.ends_with(".jsonl")
}

fn belongs_to(name: &str, shard: Shard) -> bool {
    (0..shard.count).any(|index| TripletFiles::name(index, shard.count) == name)
}

/// Removes this run's list, and those of a dataset with another number of shards; the lists of runs that go
/// on beside this one stay.
fn remove_lists(root: &Path, shard: Shard) -> Result<()> {
    let own = TripletFiles::name(shard.index, shard.count);
    let names = io::list_folder(root)?.into_iter().filter(|name| is_list(name));
    names
        .filter(|name| *name == own || !belongs_to(name, shard))
        .try_for_each(|name| io::remove(&root.join(name)))
}

/// The keys of `dataset.toml` in which two configurations differ, `formation.x-max` among them.
fn differing_keys(found: &DatasetConfig, wanted: &DatasetConfig) -> Vec<String> {
    let (mut found, mut wanted) = (flat_table(found), flat_table(wanted));
    // Another version of the program makes the same dataset, or the layout's version differs.
    found.remove("program");
    wanted.remove("program");
    let keys: BTreeSet<_> = found.keys().chain(wanted.keys()).collect();
    keys.into_iter().filter(|key| found.get(*key) != wanted.get(*key)).cloned().collect()
}

fn flat_table(config: &DatasetConfig) -> BTreeMap<String, toml::Value> {
    let table = toml::Table::try_from(config).expect("a configuration is a table");
    let flatten = |(key, value): (String, toml::Value)| match value {
        toml::Value::Table(inner) => {
            inner.into_iter().map(|(name, value)| (format!("{key}.{name}"), value)).collect()
        }
        value => vec![(key, value)],
    };
    table.into_iter().flat_map(flatten).collect()
}

fn describe(root: &Path, config: &DatasetConfig, bank: &BankFile, overwrite: bool) -> Result<()> {
    let described = root.join(CONFIG_FILE).is_file();
    if overwrite || !described {
        let bank = bank.read()?;
        // Another shard may describe the same dataset at this moment, with the same words.
        io::write_atomically(&root.join(&config.bank), true, |file| file.write_all(&bank))?;
        let text = config.to_toml();
        io::write_atomically(&root.join(CONFIG_FILE), true, |file| file.write_all(text.as_bytes()))?;
    }
    Ok(())
}

/// The triplets of a list whose files are there, the degraded image with the recorded hash.
fn finished_triplets(root: &Path, list: &Path) -> Result<Vec<Triplet>> {
    if !list.is_file() {
        return Ok(Vec::new());
    }
    let text = io::read_text(list)?;
    let listed: Vec<Triplet> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    let intact = |triplet: &Triplet| {
        root.join(&triplet.gt).is_file()
            && sha256_of(&root.join(&triplet.degraded)).ok() == triplet.sha256
            && triplet.sha256.is_some()
    };
    Ok(listed.into_par_iter().filter(intact).collect())
}
