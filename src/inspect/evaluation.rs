//! Describes the results of an evaluation: its methods with their means.

use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::text::write_lines;
use crate::core::error::Result;
use crate::core::metrics::Metric;
use crate::experiment::{Document as _, Measured, MetricValues, RESULTS, Results, cell, markdown};

/// What an evaluation found.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct EvaluationDescription {
    /// Every method, in the order of tables.
    pub methods: Vec<MethodDescription>,
    /// The metrics, in the order of tables.
    pub metrics: Vec<Metric>,
    /// What images of datasets were measured.
    pub datasets: Vec<Measured>,
}

/// The means of a method.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct MethodDescription {
    /// Its name in tables.
    pub name: String,
    /// The dataset that it was measured on, where there are several.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dataset: Option<String>,
    /// The number of images.
    pub images: usize,
    /// The means over them.
    pub mean: MetricValues,
}

/// The file of results that a path is, or that a folder holds.
pub(super) fn results_of(path: &Path) -> Option<PathBuf> {
    let [results, ..] = RESULTS;
    let file = path.join(results);
    if file.is_file() {
        return Some(file);
    }
    path.file_name().is_some_and(|name| name == results).then(|| path.to_owned())
}

impl EvaluationDescription {
    /// Reads a file of results.
    pub(super) fn read(file: &Path) -> Result<Self> {
        let Results { methods, definition, .. } = Results::read(file)?;
        let methods = methods.into_iter().map(|method| MethodDescription {
            name: method.name,
            dataset: method.dataset,
            images: method.count,
            mean: method.mean,
        });
        Ok(Self { methods: methods.collect(), metrics: definition.metrics, datasets: definition.datasets })
    }

    fn write(&self, text: &mut String) -> fmt::Result {
        writeln!(text, "results of an evaluation, for `udc report`")?;
        for Measured { dataset, alpha, x_max, margin, split, .. } in &self.datasets {
            let dataset = dataset.as_ref().map_or(String::new(), |name| format!("{name}: "));
            writeln!(
                text,
                "  {dataset}images to {} with, alpha {alpha}, x-max {x_max}, margin {margin}",
                split.name()
            )?;
        }
        let headings = ["method", "images"].map(str::to_owned).into_iter();
        let mut rows: Vec<Vec<String>> =
            vec![headings.chain(self.metrics.iter().map(|metric| metric.heading().to_owned())).collect()];
        for MethodDescription { name, dataset, images, mean } in &self.methods {
            let name = dataset.as_ref().map_or(name.clone(), |dataset| format!("{dataset}: {name}"));
            let values = self.metrics.iter().map(|&metric| cell(metric, mean.get(metric)));
            rows.push([name, images.to_string()].into_iter().chain(values).collect());
        }
        text.write_str(&markdown(&rows))
    }
}

impl fmt::Display for EvaluationDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_lines(f, |text| self.write(text))
    }
}
