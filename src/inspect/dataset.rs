//! Describes a dataset: counts what it holds.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;

use serde::Serialize;

use crate::core::error::Result;
use crate::dataset::{Dataset, FormationConfig, Split};

/// What a dataset holds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DatasetDescription {
    /// Whether the images were formed here, so that their PSFs are known.
    pub has_psfs: bool,
    /// Length of the kernel codes.
    pub code_dim: usize,
    /// How the images were formed.
    pub formation: FormationConfig,
    /// Number of captures without ground truth.
    pub real_captures: usize,
    /// What is missing of the synthesis.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unfinished: Option<String>,
    /// What each split holds, by its name.
    pub splits: BTreeMap<&'static str, SplitDescription>,
}

/// What one split holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SplitDescription {
    /// Number of the images that scenes were cut from.
    pub sources: usize,
    /// Number of scenes.
    pub scenes: usize,
    /// Number of triplets.
    pub triplets: usize,
    /// Number of triplets of each kernel.
    pub kernels: BTreeMap<String, usize>,
}

/// Whether a folder is a dataset, ours or the published one.
pub(super) fn is_dataset(folder: &Path) -> bool {
    Dataset::is_one(folder)
}

impl DatasetDescription {
    /// Counts what a folder holds.
    pub(super) fn read(folder: &Path) -> Result<Self> {
        let dataset = Dataset::open(folder)?;
        let splits: BTreeSet<_> = dataset.triplets.iter().map(|triplet| triplet.split).collect();
        Ok(Self {
            splits: splits
                .into_iter()
                .map(|split| (split.name(), SplitDescription::of(&dataset, split)))
                .collect(),
            has_psfs: dataset.bank.is_some(),
            code_dim: dataset.code_dim(),
            real_captures: dataset.real_captures.len(),
            unfinished: dataset.unfinished()?,
            formation: dataset.formation,
        })
    }
}

impl SplitDescription {
    fn of(dataset: &Dataset, split: Split) -> Self {
        let triplets: Vec<_> = dataset.triplets.iter().filter(|triplet| triplet.split == split).collect();
        let mut kernels = BTreeMap::new();
        for triplet in &triplets {
            *kernels.entry(triplet.kernel.clone()).or_default() += 1;
        }
        Self {
            sources: triplets.iter().map(|triplet| &triplet.source).collect::<BTreeSet<_>>().len(),
            scenes: triplets.iter().map(|triplet| &triplet.id).collect::<BTreeSet<_>>().len(),
            triplets: triplets.len(),
            kernels,
        }
    }
}

impl fmt::Display for DatasetDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "dataset")?;
        for (name, split) in &self.splits {
            writeln!(
                f,
                "  {name:<10}{} triplets (scenes {}, sources {}, kernels {})",
                split.triplets,
                split.scenes,
                split.sources,
                split.kernels.len()
            )?;
            let kernels: Vec<String> =
                split.kernels.iter().map(|(kernel, count)| format!("{kernel} {count}")).collect();
            writeln!(f, "  {:<10}{}", "", kernels.join("  "))?;
        }
        writeln!(f, "  codes of  {} numbers", self.code_dim)?;
        writeln!(f, "  PSFs      {}", if self.has_psfs { "in the bank" } else { "not distributed" })?;
        if let Some(what) = &self.unfinished {
            writeln!(f, "  warning   {what}")?;
        }
        if self.real_captures > 0 {
            writeln!(f, "  captures  {} without ground truth", self.real_captures)?;
        }
        let formation = serde_json::to_string(&self.formation).map_err(|_| fmt::Error)?;
        write!(f, "  formed by {formation}")
    }
}
