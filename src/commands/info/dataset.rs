//! Counts what a dataset holds.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

use anyhow::Result;
use serde::Serialize;

use udc::dataset::{Dataset, FormationConfig};

/// What a dataset holds.
#[derive(Debug, Serialize)]
#[serde(tag = "kind", rename = "dataset")]
pub(super) struct DatasetSummary {
    /// Whether the images were formed here, so that their PSFs are known.
    has_psfs: bool,
    /// Length of the kernel codes.
    code_dim: usize,
    formation: FormationConfig,
    real_captures: usize,
    splits: BTreeMap<&'static str, SplitSummary>,
}

/// What one split holds.
#[derive(Debug, Serialize)]
struct SplitSummary {
    sources: usize,
    scenes: usize,
    triplets: usize,
    kernels: BTreeMap<String, usize>,
}

/// Whether a folder is a dataset, ours or the published one.
pub(super) fn is_dataset(folder: &Path) -> bool {
    folder.join("dataset.toml").is_file() || folder.join("synthetic_data").is_dir()
}

pub(super) fn summarise(folder: &Path) -> Result<DatasetSummary> {
    let dataset = Dataset::open(folder)?;
    let names: BTreeSet<_> = dataset.triplets.iter().map(|triplet| triplet.split).collect();
    let splits = names.into_iter().map(|split| {
        let triplets: Vec<_> = dataset.triplets.iter().filter(|triplet| triplet.split == split).collect();
        let mut kernels = BTreeMap::new();
        for triplet in &triplets {
            *kernels.entry(triplet.kernel.clone()).or_default() += 1;
        }
        let summary = SplitSummary {
            sources: triplets.iter().map(|triplet| &triplet.source).collect::<BTreeSet<_>>().len(),
            scenes: triplets.iter().map(|triplet| &triplet.id).collect::<BTreeSet<_>>().len(),
            triplets: triplets.len(),
            kernels,
        };
        (split.name(), summary)
    });
    Ok(DatasetSummary {
        splits: splits.collect(),
        has_psfs: dataset.bank.is_some(),
        code_dim: dataset.code_dim(),
        real_captures: dataset.real_captures.len(),
        formation: dataset.formation,
    })
}

impl DatasetSummary {
    /// Lines of text for people.
    pub(super) fn render(&self) -> Result<String> {
        let mut text = "dataset\n".to_owned();
        for (name, split) in &self.splits {
            writeln!(
                text,
                "  {name:<10}{} triplets (scenes {}, sources {}, kernels {})",
                split.triplets,
                split.scenes,
                split.sources,
                split.kernels.len()
            )?;
            let kernels: Vec<String> =
                split.kernels.iter().map(|(kernel, count)| format!("{kernel} {count}")).collect();
            writeln!(text, "  {:<10}{}", "", kernels.join("  "))?;
        }
        writeln!(text, "  codes of  {} numbers", self.code_dim)?;
        writeln!(text, "  PSFs      {}", if self.has_psfs { "in the bank" } else { "not distributed" })?;
        if self.real_captures > 0 {
            writeln!(text, "  captures  {} without ground truth", self.real_captures)?;
        }
        write!(text, "  formed by {}", serde_json::to_string(&self.formation)?)?;
        Ok(text)
    }
}
