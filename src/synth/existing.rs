//! Decides what a run may do in a folder that holds something already, and where it lists its triplets.
//!
//! A dataset has one list of triplets, `triplets.jsonl`, or one for each shard. A split that is added later has lists of
//! its own, `triplets-test.jsonl`, so that neither run touches what the other has made, not even one that begins anew;
//! `dataset.toml` names the added splits behind the division of the first run.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::core::error::{Error, Result};
use crate::core::primaries::Primaries;
use crate::core::shard::Shard;
use crate::dataset::{CONFIG_FILE, DatasetConfig, FIELD_FILE, Split, Triplet, TripletFiles};
use crate::io::{self, LineLog};

use super::archives::archives_of;
use super::list::listed;
use super::scenes::Scene;
use super::synthesis::Synthesis;

/// What to do about what is in the folder already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Refuse to touch it.
    Refuse,
    /// Keep finished triplets, make the others.
    Resume,
    /// The same, even where another process holds what this one is to write: one of a node that is gone, whose locks a
    /// network file system has kept, or one that goes on for nothing.
    TakeOver,
    /// Begin anew what this run makes; splits of other runs stay, or the run is refused.
    Overwrite,
}

/// Where a run writes in a dataset's folder.
pub(super) struct Place {
    root: PathBuf,
    shard: Shard,
    /// The split that this run adds to, or added to, a dataset that another run began.
    added: Option<Split>,
    /// The description of a dataset in which other runs have, or may have, parts, where it is to be written: with the split
    /// that this one adds, or of one of which it makes its part anew.
    pub(super) shared: Option<DatasetConfig>,
    /// Lists that a run which begins anew removes.
    outdated: Vec<String>,
    /// What goes that this run does not make again, in words for a warning.
    pub(super) warnings: Vec<String>,
}

impl Place {
    /// Finds the place of a run in a folder that is there, and checks that it may write there.
    ///
    /// # Errors
    /// [`Error::Config`] when the folder holds something else, a dataset that `existing` does not allow for, one made
    /// otherwise, scenes of this run in another split, or a split that a new beginning would remove and not make again.
    pub(super) fn find(root: &Path, synthesis: &Synthesis, existing: Existing) -> Result<Self> {
        let (root, shard) = (root.to_owned(), synthesis.shard);
        let (outdated, warnings) = (Vec::new(), Vec::new());
        let mut place = Self { root, shard, added: None, shared: None, outdated, warnings };
        let names = io::list_folder(&place.root)?;
        if existing == Existing::Overwrite {
            place.begin_anew(synthesis, &names)?;
        } else if names.contains(&CONFIG_FILE.to_owned()) {
            place.join(&DatasetConfig::read(&place.root)?, synthesis, existing, &names)?;
        } else if names.iter().any(|name| !io::is_hidden(name)) && !place.is_begun(&synthesis.config, &names)
        {
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
        let part = part_of(found, &synthesis.config);
        if let Some(Part { added, division }) = part {
            differences.retain(|key| key != "division");
            self.added = added;
            self.shared = (division != found.division).then(|| DatasetConfig { division, ..found.clone() });
        }
        if !differences.is_empty() {
            let keys = differences.join(", ");
            let reason = format!("was made with another {keys}; use the same flags, or name another folder");
            return self.refuse(&reason);
        }
        let is_beside = self.shard.count > 1 && !self.list().exists();
        if existing == Existing::Refuse && self.shared.is_none() && !is_beside {
            return self.refuse("holds a dataset; pass --resume to finish it or --overwrite to begin anew");
        }
        if let Some(other) = names.iter().find(|name| self.is_of_this_part(name) && !self.belongs(name)) {
            let reason = format!("was begun with other shards ({other}); use the same --shard count");
            return self.refuse(&reason);
        }
        self.check_other_shards(&synthesis.scenes, names)?;
        self.check_others(&synthesis.scenes, names)
    }

    /// Begins anew: the part that this run makes of a dataset that is otherwise made alike, else the whole dataset.
    fn begin_anew(&mut self, synthesis: &Synthesis, names: &[String]) -> Result<()> {
        let config = &synthesis.config;
        let found = DatasetConfig::read(&self.root).ok();
        let part = found.as_ref().and_then(|found| {
            let is_same = differing_keys(found, config).iter().all(|key| key == "division");
            part_of(found, config).filter(|_| is_same)
        });
        let is_same = part.is_some();
        if let Some(Part { added, division }) = part {
            self.added = added;
            self.shared = Some(DatasetConfig { division, ..config.clone() });
        }
        self.outdated = self.outdated_lists(&synthesis.scenes, names, is_same);
        self.check_nothing_is_lost(found.as_ref(), config)?;
        self.warnings.extend(self.left_behind(synthesis)?);
        let staying: Vec<String> =
            names.iter().filter(|name| !self.outdated.contains(name)).cloned().collect();
        self.check_others(&synthesis.scenes, &staying)
    }

    /// Refuses to remove splits that this run does not make, and tells of the parts of other shards that go.
    fn check_nothing_is_lost(&mut self, found: Option<&DatasetConfig>, config: &DatasetConfig) -> Result<()> {
        let own = only_split(&config.division);
        let mut lost: BTreeMap<Split, usize> = BTreeMap::new();
        for name in &self.outdated {
            let is_added = added_split_of(name).is_some();
            let triplets = listed(&self.root.join(name))?;
            for Triplet { split, .. } in &triplets {
                let is_made = own.map_or(!is_added && *split != Split::Val, |own| own == *split);
                *lost.entry(*split).or_default() += usize::from(!is_made);
            }
            if self.shard.is_part() && self.root.join(name) != self.list() && !triplets.is_empty() {
                let count = triplets.len();
                self.warnings.push(format!(
                    "{name} goes with its {count} images, which were made of other scenes, by other flags or in other \
                     shards: make every shard anew"
                ));
            }
        }
        lost.retain(|_, count| *count > 0);
        if lost.is_empty() {
            return Ok(());
        }
        let of_split =
            |(split, count): (&Split, &usize)| format!("{count} images of its {} split", split.name());
        let lost = lost.iter().map(of_split).collect::<Vec<_>>().join(" and ");
        let why = match found {
            Some(found) => {
                let is_part = part_of(found, config).is_some();
                let keys = differing_keys(found, config).into_iter();
                let keys: Vec<String> = keys.filter(|key| !is_part || key != "division").collect();
                format!("it was made with another {}", keys.join(", "))
            }
            None => format!("its {CONFIG_FILE} cannot be read"),
        };
        self.refuse(&format!(
            "would lose {lost}, which this run does not make again, for {why}; name another folder, use the same flags, or \
             remove this folder first"
        ))
    }

    /// Tells of images that only void lists name and that this run does not make, in words for a warning. They may be scenes of
    /// somebody's, and stay.
    fn left_behind(&self, synthesis: &Synthesis) -> Result<Option<String>> {
        let mut left: BTreeSet<String> = BTreeSet::new();
        for name in &self.outdated {
            let triplets = listed(&self.root.join(name))?;
            left.extend(triplets.into_iter().flat_map(|triplet| [triplet.gt, triplet.degraded]));
        }
        for path in synthesis.image_files() {
            left.remove(&path);
        }
        left.retain(|path| self.root.join(path).is_file());
        Ok(left.first().map(|first| {
            format!(
                "{} keeps {} images that its list named until now and that this run does not make, first {first}: remove them, \
                 unless something else needs them",
                self.root.display(),
                left.len()
            )
        }))
    }

    fn refuse<T>(&self, reason: &str) -> Result<T> {
        Err(Error::config("output", format!("{} {reason}", self.root.display())))
    }

    /// Whether the folder holds nothing but what a run writes before `dataset.toml`: the bank of this run, then its
    /// field. Another shard may be about to describe the dataset, or a run was killed there.
    fn is_begun(&self, config: &DatasetConfig, names: &[String]) -> bool {
        let field = Path::new(FIELD_FILE);
        let comes_first = |name: &str| {
            io::is_hidden(name)
                || [&config.bank, FIELD_FILE].contains(&name)
                || field.file_stem().is_some_and(|folder| folder == name)
        };
        let bank = io::bank_sha256(&self.root.join(&config.bank));
        bank.is_ok_and(|found| found == config.bank_sha256) && names.iter().all(|name| comes_first(name))
    }

    /// Refuses scenes that another shard was dealt.
    fn check_other_shards(&self, scenes: &[Scene], names: &[String]) -> Result<()> {
        for name in names.iter().filter(|name| self.is_of_another_shard(name)) {
            if let Some(Scene { id, .. }) = first_dealt_otherwise(scenes, &listed(&self.root.join(name))?) {
                let reason = format!(
                    "was begun with other scenes: {id} of this shard does not fit in beside {name}; give the same \
                     scenes, make the new ones in another folder, or make every shard anew with --overwrite"
                );
                return self.refuse(&reason);
            }
        }
        Ok(())
    }

    /// Refuses scenes and sources that another part of the dataset has, of whose lists `names` are, and a split that it has.
    fn check_others(&self, scenes: &[Scene], names: &[String]) -> Result<()> {
        let mut others: Vec<Triplet> = Vec::new();
        for name in names.iter().filter(|name| is_list(name) && !self.is_of_this_part(name)) {
            others.extend(listed(&self.root.join(name))?);
        }
        if let Some(split) = self.added
            && others.iter().any(|triplet| triplet.split == split)
        {
            let name = split.name();
            return self.refuse(&format!(
                "holds a {name} split of other flags; use those flags with --resume, or name another folder"
            ));
        }
        let ids: BTreeMap<&str, Split> = others.iter().map(|t| (t.id.as_str(), t.split)).collect();
        let sources: BTreeMap<&str, Split> = others.iter().map(|t| (t.source.as_str(), t.split)).collect();
        let has_own = names.iter().any(|name| self.root.join(name) == self.list());
        let own = if has_own { listed(&self.list())? } else { Vec::new() };
        let is_given = |triplet: &Triplet| scenes.iter().any(|scene| scene.id == triplet.id);
        let kept: Vec<&Triplet> = own.iter().filter(|triplet| !is_given(triplet)).collect();
        for Scene { id, source, split, .. } in scenes {
            if let Some(kept) = kept.iter().find(|kept| kept.source == *source && kept.split != *split) {
                let reason = format!(
                    "has scenes of {source} in its {} split, and scenes of one panorama stay together; give all scenes, \
                     as before, or make the new ones in another folder",
                    kept.split.name()
                );
                return self.refuse(&reason);
            }
            if let Some(split) = ids.get(id.as_str()) {
                let reason = format!(
                    "has a scene {id} in its {} split; rename the file, or name another folder",
                    split.name()
                );
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

    /// Whether a file lists triplets of the same part, made by another of as many shards.
    fn is_of_another_shard(&self, name: &str) -> bool {
        self.belongs(name) && self.root.join(name) != self.list()
    }

    /// The lists that are void when this run begins anew: every list of a dataset that was made otherwise, or that
    /// nobody can tell from one; else those of this run's part that are its own, of another number of shards, or of shards
    /// that other scenes were dealt to. Lists of shards that go on beside this run stay, and those of other splits.
    fn outdated_lists(&self, scenes: &[Scene], names: &[String], is_same: bool) -> Vec<String> {
        let goes_on = |name: &str| {
            self.is_of_another_shard(name)
                && listed(&self.root.join(name))
                    .is_ok_and(|listed| first_dealt_otherwise(scenes, &listed).is_none())
        };
        let stays = |name: &str| is_same && (!self.is_of_this_part(name) || goes_on(name));
        names.iter().filter(|name| is_list(name) && !stays(name)).cloned().collect()
    }

    /// Refuses lists that another run is writing: the one of this run, and those that it would remove.
    ///
    /// # Errors
    /// [`Error::Config`] naming the list.
    pub(super) fn check_free(&self) -> Result<()> {
        let outdated = self.outdated.iter().map(|name| self.root.join(name));
        for list in outdated.chain([self.list()]).filter(|list| list.is_file()) {
            if LineLog::open(&list)?.try_lock().is_err() {
                let name = list.file_name().unwrap_or_default().display();
                let reason = format!(
                    "has another run at work, which holds {name}; wait for its end, make another part with --shard, or pass \
                     --take-over if it is of a machine that is gone"
                );
                return self.refuse(&reason);
            }
        }
        Ok(())
    }

    /// Removes the lists of what a run that begins anew replaces, and their archives.
    pub(super) fn remove_lists(&self) -> Result<()> {
        let names = io::list_folder(&self.root)?;
        for list in &self.outdated {
            io::remove(&self.root.join(list))?;
            // One at work holds its list, and was refused.
            archives_of(Path::new(list), &names, &[])
                .try_for_each(|archive| io::remove(&self.root.join(archive)))?;
        }
        Ok(())
    }
}

/// The first of a shard's scenes that another shard has listed, or whose source has another use there: the scenes that
/// the shards share out have changed.
fn first_dealt_otherwise<'a>(scenes: &'a [Scene], listed: &[Triplet]) -> Option<&'a Scene> {
    let ids: BTreeSet<&str> = listed.iter().map(|triplet| triplet.id.as_str()).collect();
    let sources: BTreeMap<&str, Split> = listed.iter().map(|t| (t.source.as_str(), t.split)).collect();
    scenes.iter().find(|scene| {
        let split = sources.get(scene.source.as_str());
        ids.contains(scene.id.as_str()) || split.is_some_and(|split| *split != scene.split)
    })
}

/// What a run makes of a dataset that is there already.
struct Part {
    /// The split that it adds, or added; none for the run that began the dataset.
    added: Option<Split>,
    /// The division of the dataset, with this part.
    division: String,
}

/// The part of the dataset `found` that a run makes whose own dataset would be `wanted`: by their divisions alone. None where
/// the run makes several splits, and others began the dataset.
fn part_of(found: &DatasetConfig, wanted: &DatasetConfig) -> Option<Part> {
    let division = found.division.clone();
    if first_division(&division) == wanted.division {
        return Some(Part { added: None, division });
    }
    let split = only_split(&wanted.division)?;
    let is_there = added_splits(&division).contains(&split);
    let division = if is_there { division } else { format!("{division}, {}", split.name()) };
    Some(Part { added: Some(split), division })
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

/// The key of the scenes' red, green and blue in `dataset.toml`.
const PRIMARIES: &str = "scene-primaries";

/// The keys of `dataset.toml` in which two configurations differ, `formation.x-max` among them.
fn differing_keys(found: &DatasetConfig, wanted: &DatasetConfig) -> Vec<String> {
    let has_same_primaries = Primaries::are_same(found.scene_primaries, wanted.scene_primaries);
    let (mut found, mut wanted) = (flat_table(found), flat_table(wanted));
    if has_same_primaries {
        // Files round them.
        found.remove(PRIMARIES);
        wanted.remove(PRIMARIES);
    }
    // Another version of the program makes the same dataset, or the layout's version differs.
    found.remove("program");
    wanted.remove("program");
    let keys: BTreeSet<_> = found.keys().chain(wanted.keys()).collect();
    keys.into_iter().filter(|key| found.get(*key) != wanted.get(*key)).cloned().collect()
}

fn flat_table(config: &DatasetConfig) -> BTreeMap<String, toml::Value> {
    let table = toml::Table::try_from(config).expect("a configuration is a table");
    let flatten = |(key, value): (String, toml::Value)| match value {
        // Four places that are one thing.
        toml::Value::Table(inner) if key != PRIMARIES => {
            inner.into_iter().map(|(name, value)| (format!("{key}.{name}"), value)).collect()
        }
        value => vec![(key, value)],
    };
    table.into_iter().flat_map(flatten).collect()
}
