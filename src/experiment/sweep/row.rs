//! A finished row of a sweep, and the file that remembers it.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::super::{Cost, Evaluation, MetricValues};
use super::table::{RowResults, SingleResults};
use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::core::metrics::Metric;
use crate::io;

/// What remembers a row, within its run's folder. TOML returns every number as it was, infinite ones too, so that
/// a resumed sweep makes the same table.
const FILE: &str = "row.toml";

/// What a configuration cost and achieved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    pub(super) mean: MetricValues,
    /// The means of the images before restoration.
    pub(super) degraded: MetricValues,
    /// The means over the images of the single kernel, where the sweep has one and there are images of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) single: Option<SingleResults>,
}

impl Row {
    /// The row of an evaluation of the degraded images and one model, with the kernel whose images are averaged for
    /// themselves too.
    pub(super) fn of(name: &str, iterations: u64, evaluation: &Evaluation, single: Option<&str>) -> Self {
        let cost = evaluation.methods[1].cost.expect("the cost of networks is counted");
        let means = |method, kernel| -> MetricValues {
            let values = evaluation.mean(method, kernel).unwrap_or_default();
            let named = |(metric, value): (&Metric, f64)| (*metric, value);
            evaluation.metrics.iter().zip(values).map(named).collect()
        };
        let single = single.map(|kernel| SingleResults {
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

    /// What the sweep's table holds of it.
    pub(super) fn results(&self) -> RowResults {
        let Self { parameters, gmac_published, gmac_evaluated, .. } = *self;
        RowResults {
            name: self.name.clone(),
            cost: Cost { parameters, gmac_published, gmac_evaluated },
            iterations: self.iterations,
            images: self.images,
            mean: self.mean.clone(),
            degraded: self.degraded.clone(),
            single: self.single.clone(),
        }
    }

    /// Identity of the list of triplets that the row was made with.
    pub(super) fn data_sha256(&self) -> Option<String> {
        let made_with: Value = serde_json::from_str(&self.made_with).ok()?;
        made_with["data-sha256"].as_str().map(str::to_owned)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_read_as_it_was_written_and_as_earlier_versions_wrote_it() {
        let values =
            |psnr: f64| -> MetricValues { [(Metric::Psnr, psnr), (Metric::Ssim, 0.1)].into_iter().collect() };
        let row = Row {
            name: "plain".to_owned(),
            parameters: 9,
            gmac_published: 0.1,
            gmac_evaluated: 0.2,
            iterations: 6,
            images: 2,
            made_with: "{\"data-sha256\":\"ab\"}".to_owned(),
            kernel_bank_sha256: Some("cd".to_owned()),
            mean: values(f64::INFINITY),
            degraded: values(1.0 / 3.0),
            single: Some(SingleResults { images: 1, mean: values(0.7), degraded: values(20.0) }),
        };
        let scratch = tempfile::tempdir().unwrap();
        row.write(scratch.path()).unwrap();
        assert_eq!(Row::read(scratch.path()).unwrap().as_ref(), Some(&row));
        assert_eq!(row.data_sha256().as_deref(), Some("ab"));

        let earlier = "name = \"plain\"\nparameters = 9\ngmac-published = 0.1\ngmac-evaluated = 0.2\niterations = 6\n\
                       images = 2\nmade-with = \"\"\n\n[mean]\npsnr = inf\nssim = 0.1\n\n[degraded]\npsnr = 20.0\n";
        std::fs::write(file(scratch.path()), earlier).unwrap();
        let read = Row::read(scratch.path()).unwrap().unwrap();
        assert_eq!((read.mean, read.kernel_bank_sha256, read.single), (row.mean, None, None));

        Row::remove(scratch.path()).unwrap();
        assert_eq!(Row::read(scratch.path()).unwrap(), None);
        std::fs::write(file(scratch.path()), "name = 3").unwrap();
        let message = Row::read(scratch.path()).unwrap_err().to_string();
        assert!(message.contains("row.toml: is no row") && message.contains("remove it"), "{message}");
    }
}
