//! Describes a folder of examples: counts what was made, and of what.

use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use std::path::Path;

use serde::Serialize;

use super::text::write_lines;
use crate::core::error::Result;
use crate::examples::{ExampleRecord, ExamplesConfig, ExamplesFolder};

/// What a folder of examples holds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExamplesDescription {
    /// Number of examples that are there.
    pub examples: usize,
    /// Number of examples that were asked for.
    pub wanted: usize,
    /// Number of examples of each split.
    pub splits: BTreeMap<&'static str, usize>,
    /// Number of examples of each tag that validations are scored by.
    pub tags: BTreeMap<String, usize>,
    /// Number of panels that captures were made through.
    pub panels: usize,
    /// Number of panoramas that views were cut out of.
    pub panoramas: usize,
    /// What each example holds beside capture and ground truth.
    pub planes: Vec<String>,
    /// How they were made.
    pub made_by: ExamplesConfig,
    /// How models refer to them.
    pub sha256: String,
}

impl ExamplesDescription {
    /// Counts what a folder holds.
    pub(super) fn read(root: &Path) -> Result<Self> {
        let folder = ExamplesFolder::open(root)?;
        let sha256 = folder.sha256();
        let ExamplesFolder { file, records, .. } = folder;
        let panels = count(records.iter().map(|record| record.panel)).len();
        Ok(Self {
            examples: records.len(),
            wanted: file.examples.count,
            splits: count(records.iter().map(|record| record.split.name())),
            tags: count(records.iter().flat_map(|record: &ExampleRecord| record.tags.iter().cloned())),
            panels,
            panoramas: file.panoramas.len(),
            planes: file.planes,
            made_by: file.examples,
            sha256,
        })
    }

    fn write(&self, text: &mut String) -> fmt::Result {
        let side = self.made_by.side_px;
        writeln!(text, "examples, {} of {}, {side} × {side}", self.examples, self.wanted)?;
        let counts = |counts: Vec<(&str, usize)>| -> String {
            counts.iter().map(|(name, count)| format!("{name} {count}")).collect::<Vec<_>>().join("  ")
        };
        writeln!(text, "  splits    {}", counts(self.splits.iter().map(|(name, n)| (*name, *n)).collect()))?;
        writeln!(
            text,
            "  tags      {}",
            counts(self.tags.iter().map(|(name, n)| (name.as_str(), *n)).collect())
        )?;
        writeln!(
            text,
            "  made of   {} panels, {} panoramas, seed {}",
            self.panels, self.panoramas, self.made_by.seed
        )?;
        writeln!(text, "  planes    {}", self.planes.join(" "))?;
        writeln!(text, "  sha256    {}", self.sha256)
    }
}

impl fmt::Display for ExamplesDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_lines(f, |text| self.write(text))
    }
}

/// How often each of several things comes.
fn count<T: Ord>(things: impl Iterator<Item = T>) -> BTreeMap<T, usize> {
    let mut counts = BTreeMap::new();
    things.for_each(|thing| *counts.entry(thing).or_insert(0) += 1);
    counts
}
