//! Makes the examples of a folder: each once, whatever was made before, by however many runs beside each other.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use rayon::prelude::*;

use super::config::ExamplesConfig;
use super::example::{Example, Ingredients};
use super::folder::{EXAMPLES_FILE, ExamplesFile, list_name, listed, lists};
use super::panels::{PANELS, Panels};
use super::panoramas::list_panoramas;
use super::recipe::Recipe;
use super::record::ExampleRecord;
use crate::core::error::{Error, Result};
use crate::core::progress::Progress;
use crate::core::shard::Shard;
use crate::dataset::Split;
use crate::io::{self, FloatWidth, LineLog};
use crate::synth::Existing;

/// Examples that each thread has to make before what was made is listed: few enough for their memory, and so many that no
/// thread waits long for the last.
const EXAMPLES_PER_THREAD: usize = 4;

/// How long a temporary file is left alone after its last change: it may be of a shard that goes on.
const ABANDONED_AFTER: Duration = Duration::from_secs(60 * 60);

/// Examples that are to be made.
#[derive(Clone, Debug)]
pub struct ExampleSet {
    /// What they are made of.
    pub config: ExamplesConfig,
    /// Which part of them.
    pub shard: Shard,
}

/// What was done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MadeExamples {
    /// Number of examples that were made.
    pub made: usize,
    /// Number of those that were there.
    pub kept: usize,
    /// Number of all of them that are for validation.
    pub validation: usize,
}

impl ExampleSet {
    /// Makes the examples in a folder, telling `on_warning` of what may spoil them; an interrupt keeps what is finished.
    ///
    /// # Errors
    /// [`Error::Config`] for a configuration out of range; [`Error::Unsupported`] when the folder holds something that
    /// `existing` does not allow for, or examples that were made otherwise; [`Error::Interrupted`] after an interrupt; those
    /// of reading panoramas, of simulating panels and of writing files.
    pub fn make(
        &self,
        root: &Path,
        existing: Existing,
        progress: &Progress,
        on_warning: impl FnMut(String),
    ) -> Result<MadeExamples> {
        self.config.validate()?;
        let (config, psf_sha256) = self.config.resolved()?;
        let (panoramas, doubts) = list_panoramas(&self.config)?;
        doubts.into_iter().for_each(on_warning);
        let file = ExamplesFile::new(config, psf_sha256, panoramas);
        let (mut log, finished) = self.prepare(root, &file, existing)?;
        let (config, panoramas) = (&file.examples, &file.panoramas);
        let ingredients = Ingredients { config, panoramas, panels: Panels::new(root, config) };
        let all = (self.shard.index..config.count).step_by(self.shard.count);
        let recipes: Vec<Recipe> = all.map(|index| ingredients.recipe(index)).collect();
        let validation = recipes.iter().filter(|recipe| recipe.split == Split::Val).count();
        let (kept, todo): (Vec<_>, Vec<_>) =
            recipes.into_iter().partition(|recipe| finished.contains(&recipe.id()));
        self.simulate_panels(&ingredients.panels, &todo, progress)?;
        let bar = progress.bar((kept.len() + todo.len()) as u64, "examples");
        bar.start_at(kept.len() as u64);
        for recipes in todo.chunks(EXAMPLES_PER_THREAD * rayon::current_num_threads()) {
            let make = |recipe: &Recipe| {
                let record = ingredients.make(recipe, progress).and_then(|example| write(root, example));
                bar.inc(1);
                record.map_err(|error| match error.is_interrupt() {
                    true => Error::Interrupted,
                    false => error.while_doing(format!("making example {}", recipe.id())),
                })
            };
            let made: Vec<Result<ExampleRecord>> = recipes.par_iter().map(make).collect();
            // What was finished beside a failure is kept.
            made.iter().flatten().try_for_each(|record| log.append(&record.to_line()))?;
            log.sync()?;
            made.into_iter().collect::<Result<Vec<_>>>()?;
        }
        bar.finish_and_clear();
        Ok(MadeExamples { made: todo.len(), kept: kept.len(), validation })
    }

    /// Says how the folder's examples are made, and finds those that are there; opens the list of this shard.
    fn prepare(
        &self,
        root: &Path,
        file: &ExamplesFile,
        existing: Existing,
    ) -> Result<(LineLog, BTreeSet<String>)> {
        io::create_folder(root)?;
        // Shards that start together come here one after the other.
        let _turn = io::lock_folder(root);
        let list = list_name(self.shard.index, self.shard.count);
        let path = root.join(&list);
        self.check_place(root, &list, existing)?;
        if existing == Existing::Overwrite {
            self.begin_anew(root, file)?;
        }
        describe(root, file)?;
        // Let go again where the list is written anew; nobody else comes here meanwhile.
        if existing != Existing::TakeOver {
            LineLog::open(&path)?.try_lock()?;
        }
        io::remove_unfinished(root, ABANDONED_AFTER)?;
        io::remove_unfinished(&root.join(PANELS), ABANDONED_AFTER)?;
        // A run that was killed may have left half a line.
        let own = listed(root, &list)?;
        let text: String = own.iter().map(|record| record.to_line() + "\n").collect();
        let log = LineLog::replace(&path, &text)?;
        let mut finished = BTreeSet::new();
        for list in lists(root)? {
            finished.extend(listed(root, &list)?.into_iter().map(|record| record.id));
        }
        Ok((log, finished))
    }

    /// Removes what this run makes anew: all that is there, but for what other shards make of the same.
    fn begin_anew(&self, root: &Path, file: &ExamplesFile) -> Result<()> {
        let is_same = ExamplesFile::read(root).is_ok_and(|found| found.first_difference(file).is_none());
        let is_beside = |list: &String| {
            let is_other =
                |index: usize| index != self.shard.index && *list == list_name(index, self.shard.count);
            is_same && (0..self.shard.count).any(is_other)
        };
        let lists = lists(root)?;
        let (beside, outdated): (Vec<_>, Vec<_>) = lists.iter().partition(|list| is_beside(list));
        // One that a run is writing is not to be taken away from it.
        outdated.iter().try_for_each(|list| LineLog::open(&root.join(list))?.try_lock())?;
        let mut kept = BTreeSet::new();
        for list in beside.iter() {
            kept.extend(listed(root, list)?.into_iter().map(|record| record.id));
        }
        for list in &outdated {
            // Before the list: of a run that is killed here, the next one finds the rest.
            let examples = listed(root, list)?.into_iter().filter(|record| !kept.contains(&record.id));
            examples.map(|record| root.join(record.file_name())).try_for_each(|file| io::remove(&file))?;
            io::remove(&root.join(list))?;
        }
        if !beside.is_empty() {
            return file.write(root);
        }
        io::remove(&root.join(PANELS))?;
        io::remove(&root.join(EXAMPLES_FILE))
    }

    /// Simulates the panels that examples are seen through, one after the other: each takes all threads. Shards that run
    /// beside each other begin with different ones, and find the others made.
    fn simulate_panels(&self, panels: &Panels<'_>, todo: &[Recipe], progress: &Progress) -> Result<()> {
        let wanted: BTreeSet<usize> = todo.iter().map(|recipe| recipe.panel).collect();
        let bar = progress.bar(wanted.len() as u64, "panels");
        let is_own = |panel: &usize| panel % self.shard.count == self.shard.index;
        let (own, others): (Vec<usize>, Vec<usize>) = wanted.into_iter().partition(is_own);
        for panel in own.into_iter().chain(others) {
            progress.check()?;
            panels.make(panel, progress)?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(())
    }

    /// Refuses a folder that holds something else, or examples that may not be touched.
    fn check_place(&self, root: &Path, list: &str, existing: Existing) -> Result<()> {
        let refuse = |reason: &str| Err(Error::Unsupported(format!("{} {reason}", root.display())));
        let names = io::list_folder(root)?;
        let is_ours = names.iter().any(|name| name == EXAMPLES_FILE);
        if !is_ours && names.iter().any(|name| !io::is_hidden(name)) {
            return refuse("holds something else than examples; name another folder");
        }
        let is_beside = self.shard.count > 1 && !names.iter().any(|name| name == list);
        if existing == Existing::Refuse && is_ours && !is_beside {
            return refuse("holds examples; pass --resume to finish them, or --overwrite to begin anew");
        }
        Ok(())
    }
}

/// Writes `examples.toml`, or checks that the one which is there says the same; their number may grow.
fn describe(root: &Path, file: &ExamplesFile) -> Result<()> {
    if !root.join(EXAMPLES_FILE).is_file() {
        return file.write(root);
    }
    let found = ExamplesFile::read(root)?;
    if let Some(key) = found.first_difference(file) {
        return Err(Error::Unsupported(format!(
            "{} was made with another {key}; use the same configuration and panoramas, or name another folder",
            root.display()
        )));
    }
    if found.examples.count < file.examples.count { file.write(root) } else { Ok(()) }
}

fn write(root: &Path, Example { tensors, record }: Example) -> Result<ExampleRecord> {
    let metadata = [("example".to_owned(), record.to_line())].into();
    let path = root.join(record.file_name());
    io::write_safetensors(&path, &tensors, &metadata, FloatWidth::Half, true)?;
    Ok(record)
}

#[cfg(test)]
mod tests;
