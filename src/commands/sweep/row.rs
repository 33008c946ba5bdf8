//! A finished row of a sweep, and the file that remembers it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use udc::core::config::parse_toml;
use udc::core::error::{Error, Result};
use udc::core::metrics::Metric;
use udc::experiment::Evaluation;
use udc::io;

/// What remembers a row, within its run's folder. TOML returns every number as it was, infinite ones too, so that
/// a resumed sweep makes the same table.
const FILE: &str = "row.toml";

/// Means by the name of their metric.
pub(super) type Means = BTreeMap<String, f64>;

/// What a configuration cost and achieved.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) struct Row {
    pub(super) name: String,
    pub(super) parameters: u64,
    pub(super) gmac_published: f64,
    pub(super) gmac_evaluated: f64,
    pub(super) iterations: u64,
    /// Images that the means are over.
    pub(super) images: usize,
    /// Everything that decides these numbers, as JSON.
    pub(super) made_with: String,
    /// The bank behind the codes of the data; rows of older versions do not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) kernel_bank_sha256: Option<String>,
    pub(super) mean: Means,
    /// The means of the images before restoration.
    pub(super) degraded: Means,
    /// The means over the images of the single kernel, where the sweep has one and there are images of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) single: Option<Single>,
}

/// The part of the test set that one kernel made.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(super) struct Single {
    pub(super) images: usize,
    pub(super) mean: Means,
    /// The means before restoration.
    pub(super) degraded: Means,
}

impl Row {
    /// The row of an evaluation of the degraded images and one model, with the kernel whose images are averaged for
    /// themselves too.
    pub(super) fn of(name: &str, iterations: u64, evaluation: &Evaluation, single: Option<&str>) -> Self {
        let cost = evaluation.methods[1].cost.expect("the cost of networks is counted");
        let means = |method, kernel| -> Means {
            let values = evaluation.mean(method, kernel).unwrap_or_default();
            let named = |(metric, value): (&Metric, f64)| (metric.name().to_owned(), value);
            evaluation.metrics.iter().zip(values).map(named).collect()
        };
        let single = single.map(|kernel| Single {
            images: evaluation.of(1, Some(kernel)).count(),
            mean: means(1, Some(kernel)),
            degraded: means(0, Some(kernel)),
        });
        Self {
            name: name.to_owned(),
            parameters: cost.parameters,
            gmac_published: cost.gmac_published,
            gmac_evaluated: cost.gmac_evaluated,
            iterations,
            images: evaluation.count(1),
            made_with: String::new(),
            kernel_bank_sha256: None,
            mean: means(1, None),
            degraded: means(0, None),
            single: single.filter(|single| single.images > 0),
        }
    }

    /// Identity of the list of triplets that the row was made with.
    pub(super) fn data_sha256(&self) -> Option<String> {
        let made_with: Value = serde_json::from_str(&self.made_with).ok()?;
        made_with["data-sha256"].as_str().map(str::to_owned)
    }

    /// The row as JSON; a mean that is infinite is null.
    pub(super) fn to_json(&self) -> Value {
        let mut json = json!({
            "name": self.name, "parameters": self.parameters, "gmac-800x800": self.gmac_published,
            "gmac-evaluated": self.gmac_evaluated, "iterations": self.iterations, "images": self.images,
            "mean": self.mean, "degraded": self.degraded,
        });
        if let Some(single) = &self.single {
            json["single"] = json!(single);
        }
        json
    }

    /// The row of a run that was finished, if it was.
    pub(super) fn read(run: &Path) -> Result<Option<Self>> {
        let path = file(run);
        if !path.is_file() {
            return Ok(None);
        }
        let row = parse_toml(&io::read_text(&path)?);
        row.map(Some).map_err(|error| {
            Error::format(
                path,
                format!("is no row of a sweep ({error}); remove it, and it is measured again"),
            )
        })
    }

    pub(super) fn write(&self, run: &Path) -> Result<()> {
        let text = toml::to_string(self).expect("rows are plain data");
        io::write_atomically(&file(run), true, |file| file.write_all(text.as_bytes()))
    }

    /// Forgets that a run was finished.
    pub(super) fn remove(run: &Path) -> Result<()> {
        io::remove(&file(run))
    }
}

fn file(run: &Path) -> PathBuf {
    run.join(FILE)
}
