//! What was measured, before means are taken: of all images, or of those of one shard, which others join.

use serde::{Deserialize, Serialize};

use super::ldr::{LdrImage, LdrResults};
use super::matrix::Mismatch;
use super::run::Findings;
use super::score::MacCounts;
use super::{Comparison, Evaluation};
use crate::core::error::{Error, Result};

/// All numbers of an experiment, image by image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Measurement {
    /// Dataset after dataset.
    pub(super) datasets: Vec<MeasuredDataset>,
    /// The same images under every kernel, where that was asked for: what restored each.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) mismatch: Option<Vec<MeasuredMismatch>>,
    /// Scenes of a monitor's range, where they were asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) ldr: Option<MeasuredLdr>,
}

/// The scores on one dataset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) struct MeasuredDataset {
    /// The dataset's name in tables.
    pub(super) name: String,
    /// What was being done, for messages.
    pub(super) doing: String,
    /// The scores, without what the methods cost.
    pub(super) evaluation: Evaluation,
    /// What the methods cost.
    pub(super) costs: Vec<CountedMacs>,
}

/// What a method costs, where that is counted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CountedMacs {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) counts: Option<MacCounts>,
}

/// The scores of one restoration that was told every kernel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MeasuredMismatch {
    pub(super) method: String,
    pub(super) evaluation: Evaluation,
}

/// The numbers of scenes that were clipped at a monitor's white.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MeasuredLdr {
    pub(super) white: f32,
    pub(super) images: Vec<LdrImage>,
}

impl Measurement {
    /// The measurement of an evaluation alone; `doing` says in messages what was being done.
    pub fn of(evaluation: Evaluation, doing: String) -> Self {
        let costs = evaluation.methods.iter().map(|_| CountedMacs { counts: None }).collect();
        Self::of_dataset(MeasuredDataset { name: String::new(), doing, evaluation, costs })
    }

    pub(super) fn of_dataset(dataset: MeasuredDataset) -> Self {
        Self { datasets: vec![dataset], mismatch: None, ldr: None }
    }

    /// The number of images that were measured or left out.
    pub fn images(&self) -> usize {
        let of = |dataset: &MeasuredDataset| {
            let Evaluation { scores, methods, excluded, .. } = &dataset.evaluation;
            scores.len() / methods.len().max(1) + excluded.len()
        };
        self.datasets.iter().map(of).sum()
    }

    /// Goes on with the images that come next, which were measured in the same way.
    pub(super) fn go_on_with(&mut self, next: Self) {
        for (dataset, next) in self.datasets.iter_mut().zip(next.datasets) {
            dataset.evaluation.go_on_with(next.evaluation);
            for (costs, next) in dataset.costs.iter_mut().zip(next.costs) {
                if let (Some(counts), Some(next)) = (&mut costs.counts, next.counts) {
                    counts.add(next);
                }
            }
        }
        for (mismatch, next) in self.mismatch.iter_mut().flatten().zip(next.mismatch.into_iter().flatten()) {
            mismatch.evaluation.go_on_with(next.evaluation);
        }
        if let (Some(ldr), Some(next)) = (&mut self.ldr, next.ldr) {
            ldr.images.extend(next.images);
        }
    }

    /// Takes the means; no rows to look at come along.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when a dataset has no image that could be measured.
    pub fn into_findings(self) -> Result<Findings> {
        let mut evaluations =
            self.datasets.into_iter().map(MeasuredDataset::finish).collect::<Result<Vec<_>>>()?;
        let evaluation = match evaluations.len() {
            1 => evaluations.swap_remove(0).1,
            _ => Evaluation::join(evaluations),
        };
        let mismatch = self.mismatch.map(|evaluations| {
            Mismatch::of(evaluations.iter().map(|found| (found.method.as_str(), &found.evaluation)))
        });
        let ldr = self.ldr.map(|MeasuredLdr { white, images }| {
            (LdrResults::of(white, images, evaluation.definition), Vec::new())
        });
        Ok(Findings { evaluation, mismatch, ldr })
    }
}

impl MeasuredDataset {
    /// The scores of a comparison, and what its candidates cost.
    pub(super) fn of(name: &str, comparison: &Comparison<'_>, evaluation: Evaluation) -> Self {
        let costs = comparison.macs(&evaluation.sizes).into_iter().map(|counts| CountedMacs { counts });
        Self { name: name.to_owned(), doing: comparison.doing(), costs: costs.collect(), evaluation }
    }

    /// Takes the costs, and refuses to go on without any image.
    fn finish(self) -> Result<(String, Evaluation)> {
        let mut evaluation = self.evaluation.check_any().map_err(|error| match error {
            Error::Unsupported(reason) => Error::Unsupported(format!("{}: {reason}", self.doing)),
            other => other,
        })?;
        for (method, CountedMacs { counts }) in evaluation.methods.iter_mut().zip(self.costs) {
            method.cost = counts.map(|counts| counts.cost(&evaluation.sizes)).transpose()?;
        }
        Ok((self.name, evaluation))
    }
}
