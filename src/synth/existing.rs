//! Decides what a run may do in a folder that holds something already, and where it lists its triplets.
//!
//! A dataset has one list of triplets, `triplets.jsonl`, or one for each shard. A split that is added later has lists of
//! its own, `triplets-test.jsonl`, so that neither run touches what the other has made; `dataset.toml` names the added
//! splits behind the division of the first run.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::core::dataset::{CONFIG_FILE, DatasetConfig, Split, Triplet, TripletFiles};
use crate::core::error::{Error, Result};
use crate::core::io;

use super::folder::listed;
use super::run::Synthesis;
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

/// Where a run writes in a dataset's folder.
pub(super) struct Place {
    root: PathBuf,
    shard: Shard,
    /// The split that this run adds to, or added to, a dataset that another run began.
    added: Option<Split>,
    /// The dataset's description with the added split, where it does not name it yet.
    pub(super) extended: Option<DatasetConfig>,
}

impl Place {
    /// Finds the place of a run, and checks that it may write there.
    ///
    /// # Errors
    /// [`Error::Config`] when the folder holds something else, a dataset that `existing` does not allow for, one made
    /// otherwise, or scenes of this run in another split.
    pub(super) fn find(root: &Path, synthesis: &Synthesis, existing: Existing) -> Result<Self> {
        let mut place = Self { root: root.to_owned(), shard: synthesis.shard, added: None, extended: None };
        if existing == Existing::Overwrite || !root.is_dir() {
            return Ok(place);
        }
        let names = io::list_folder(root)?;
        if names.contains(&CONFIG_FILE.to_owned()) {
            place.join(&DatasetConfig::read(root)?, synthesis, existing, &names)?;
        } else if names.iter().any(|name| !name.starts_with('.')) {
            return place
                .refuse("is not empty and holds no dataset; name another folder, or pass --overwrite");
        }
        Ok(place)
    }

    /// Joins a dataset that is there: takes up a run, runs beside other shards, or adds a split.
    fn join(
        &mut self,
        found: &DatasetConfig,
        synthesis: &Synthesis,
        existing: Existing,
        names: &[String],
    ) -> Result<()> {
        let mut differences = differing_keys(found, &synthesis.config);
        let splits = added_splits(&found.division);
        if first_division(&found.division) != synthesis.config.division
            && let Some(split) = only_split(&synthesis.config.division)
        {
            self.added = Some(split);
            if !splits.contains(&split) {
                let division = format!("{}, {}", found.division, split.name());
                self.extended = Some(DatasetConfig { division, ..found.clone() });
            }
        }
        if self.added.is_some() || first_division(&found.division) == synthesis.config.division {
            differences.retain(|key| key != "division");
        }
        if !differences.is_empty() {
            let keys = differences.join(", ");
            let reason = format!("was made with another {keys}; use the same flags, or name another folder");
            return self.refuse(&reason);
        }
        let is_beside = self.shard.count > 1 && !self.list().exists();
        if existing == Existing::Refuse && self.extended.is_none() && !is_beside {
            return self.refuse("holds a dataset; pass --resume to finish it or --overwrite to begin anew");
        }
        if let Some(other) = names.iter().find(|name| self.is_of_this_part(name) && !self.belongs(name)) {
            let reason = format!("was begun with other shards ({other}); use the same --shard count");
            return self.refuse(&reason);
        }
        self.check_others(&synthesis.scenes, names)
    }

    fn refuse<T>(&self, reason: &str) -> Result<T> {
        Err(Error::config("output", format!("{} {reason}", self.root.display())))
    }

    /// Refuses scenes and sources that another part of the dataset has, and a split that it has.
    fn check_others(&self, scenes: &[Scene], names: &[String]) -> Result<()> {
        let mut others: Vec<Triplet> = Vec::new();
        for name in names.iter().filter(|name| is_list(name) && !self.is_of_this_part(name)) {
            others.extend(listed(&self.root.join(name))?);
        }
        if let Some(split) = self.added
            && others.iter().any(|triplet| triplet.split == split)
        {
            let name = split.name();
            return self
                .refuse(&format!("holds a {name} split of other flags; use those flags with --resume"));
        }
        let ids: BTreeMap<&str, Split> = others.iter().map(|t| (t.id.as_str(), t.split)).collect();
        let sources: BTreeMap<&str, Split> = others.iter().map(|t| (t.source.as_str(), t.split)).collect();
        for Scene { id, source, .. } in scenes {
            if let Some(split) = ids.get(id.as_str()) {
                let reason = format!("has a scene {id} in its {} split; rename the file", split.name());
                return self.refuse(&reason);
            }
            if let Some(split) = sources.get(source.as_str()) {
                let reason = format!(
                    "has scenes of {source} in its {} split, and scenes of one panorama stay together; leave {id} out, \
                     or rename files of another panorama <panorama>_<nn>",
                    split.name()
                );
                return self.refuse(&reason);
            }
        }
        Ok(())
    }

    /// The list that this run writes.
    pub(super) fn list(&self) -> PathBuf {
        self.root.join(TripletFiles::name(self.added, self.shard.index, self.shard.count))
    }

    /// Whether a file lists triplets of the same part: the first run's, or those of the added split.
    fn is_of_this_part(&self, name: &str) -> bool {
        is_list(name) && added_split_of(name) == self.added
    }

    fn belongs(&self, name: &str) -> bool {
        let count = self.shard.count;
        (0..count).any(|index| TripletFiles::name(self.added, index, count) == name)
    }

    /// Removes this run's list, those of a dataset with another number of shards, and those of added splits; the lists
    /// of runs that go on beside this one stay.
    pub(super) fn remove_lists(&self) -> Result<()> {
        let own = self.list();
        let paths = io::list_folder(&self.root)?.into_iter().filter(|name| is_list(name));
        paths
            .filter(|name| self.root.join(name) == own || !self.belongs(name))
            .try_for_each(|name| io::remove(&self.root.join(name)))
    }
}

const SPLITS: [Split; 3] = [Split::Train, Split::Test, Split::Val];

/// The division of the run that began a dataset.
fn first_division(division: &str) -> &str {
    division.split(", ").next().unwrap_or(division)
}

/// The splits that were added to it.
fn added_splits(division: &str) -> Vec<Split> {
    division.split(", ").skip(1).filter_map(split_of_name).collect()
}

/// The one split of a division that has no other.
fn only_split(division: &str) -> Option<Split> {
    split_of_name(division.strip_prefix("all ")?)
}

fn split_of_name(name: &str) -> Option<Split> {
    SPLITS.into_iter().find(|split| split.name() == name)
}

fn is_list(name: &str) -> bool {
    name.starts_with("triplets") && name.ends_with(".jsonl")
}

/// The added split whose triplets a list holds; none for the lists of the first run.
fn added_split_of(list: &str) -> Option<Split> {
    let of = |split: &Split| {
        let rest = list.strip_prefix("triplets-").and_then(|rest| rest.strip_prefix(split.name()));
        rest.is_some_and(|rest| rest.starts_with(['.', '-']))
    };
    SPLITS.into_iter().find(of)
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
