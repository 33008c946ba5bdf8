//! The table of a sweep, as its file `table.json` holds it, for people (Markdown) and for programs (CSV).

use serde::{Deserialize, Serialize};

use super::super::{Cost, Document, MetricValues, cell, markdown, quoted};
use crate::core::metrics::{Metric, MetricDefinition};

/// The rows of a sweep, and what they are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct SweepResults {
    /// The configurations that were trained and measured, in their order.
    pub rows: Vec<RowResults>,
    /// The configurations that failed.
    pub failed: Vec<FailedRow>,
    /// The kernel whose images are averaged for themselves too.
    pub single_kernel: Option<String>,
    /// Identity of the dataset's list of triplets.
    pub data_sha256: String,
    /// The metrics, in the order of tables.
    pub metrics: Vec<Metric>,
    /// What they were computed of.
    pub definition: MetricDefinition,
}

/// What a configuration cost and achieved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RowResults {
    /// The configuration's name.
    pub name: String,
    /// The cost of its network.
    #[serde(flatten)]
    pub cost: Cost,
    /// Steps of its training.
    pub iterations: u64,
    /// Images that the means are over.
    pub images: usize,
    /// The means over all of them.
    pub mean: MetricValues,
    /// The means before restoration.
    pub degraded: MetricValues,
    /// The means over the images of the single kernel, where the sweep has one and there are images of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub single: Option<SingleResults>,
}

/// The part of the test set that one kernel made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SingleResults {
    /// Its images.
    pub images: usize,
    /// The means over them.
    pub mean: MetricValues,
    /// The means before restoration.
    pub degraded: MetricValues,
}

/// A configuration that could not be trained, or measured.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FailedRow {
    /// The configuration's name.
    pub name: String,
    /// What went wrong.
    pub reason: String,
}

impl Document for SweepResults {
    const FORMAT: &'static str = "udc-sweep";
    const COMMAND: &'static str = "udc sweep --resume";
}

impl SweepResults {
    /// The table of the rows, the degraded images first, and the rows that failed; with columns of their own for the
    /// images of the single kernel.
    pub fn to_markdown(&self) -> String {
        let fixed =
            ["configuration", "params", "GMAC at 800²", "GMAC", "iterations", "images"].map(str::to_owned);
        let mut table: Vec<Vec<String>> = vec![fixed.into_iter().chain(self.headings()).collect()];
        if let Some(first) = self.rows.first() {
            let names = ["degraded", "–", "–", "–", "–"].map(str::to_owned).into_iter();
            let single = first.single.as_ref().map(|single| &single.degraded);
            let cells = self.cells(single, &first.degraded);
            table.push(names.chain([first.images.to_string()]).chain(cells).collect());
        }
        for row in &self.rows {
            let names = [
                row.name.clone(),
                row.cost.parameters.to_string(),
                format!("{:.2}", row.cost.gmac_published),
                format!("{:.2}", row.cost.gmac_evaluated),
                row.iterations.to_string(),
                row.images.to_string(),
            ];
            let cells = self.cells(row.single.as_ref().map(|single| &single.mean), &row.mean);
            table.push(names.into_iter().chain(cells).collect());
        }
        let mut text = markdown(&table);
        for FailedRow { name, reason } in &self.failed {
            text.push_str(&format!("\nFailed: {name}: {reason}\n"));
        }
        text
    }

    fn headings(&self) -> Vec<String> {
        let of = |what: String| self.metrics.iter().map(move |metric| format!("{}{what}", metric.heading()));
        match &self.single_kernel {
            Some(kernel) => of(format!(", {kernel}")).chain(of(", all kernels".to_owned())).collect(),
            None => of(String::new()).collect(),
        }
    }

    fn cells(&self, single: Option<&MetricValues>, all: &MetricValues) -> Vec<String> {
        let cells = |means: Option<&MetricValues>| -> Vec<String> {
            let value = |metric: Metric| means.and_then(|means| means.get(metric));
            self.metrics.iter().map(|&metric| cell(metric, value(metric))).collect()
        };
        let single = self.single_kernel.as_ref().map(|_| cells(single)).unwrap_or_default();
        [single, cells(Some(all))].concat()
    }

    /// One line a row, with all decimals; where there is a single kernel, the means over its images come last.
    pub fn to_csv(&self) -> String {
        let names =
            |prefix: &str| self.metrics.iter().map(|metric| format!("{prefix}{}", metric.name())).collect();
        let mut headings: Vec<Vec<String>> = vec![names(""), names("degraded_")];
        if let Some(kernel) = &self.single_kernel {
            headings.extend([names(&format!("{kernel}_")), names(&format!("degraded_{kernel}_"))]);
        }
        let headings: Vec<String> = headings.concat().iter().map(|name| quoted(name)).collect();
        let mut csv = format!(
            "configuration,parameters,gmac_800x800,gmac_evaluated,iterations,images,{}\n",
            headings.join(",")
        );
        for row in &self.rows {
            let RowResults {
                cost: Cost { parameters, gmac_published, gmac_evaluated },
                iterations,
                images,
                ..
            } = row;
            let mut means = vec![Some(&row.mean), Some(&row.degraded)];
            if self.single_kernel.is_some() {
                let of_single = row.single.as_ref();
                means
                    .extend([of_single.map(|single| &single.mean), of_single.map(|single| &single.degraded)]);
            }
            let value = |means: Option<&MetricValues>, metric: Metric| {
                means.and_then(|means| means.get(metric)).map(|value| value.to_string()).unwrap_or_default()
            };
            let values =
                means.iter().flat_map(|&of| self.metrics.iter().map(move |&metric| value(of, metric)));
            csv.push_str(&format!(
                "{},{parameters},{gmac_published},{gmac_evaluated},{iterations},{images},{}\n",
                quoted(&row.name),
                values.collect::<Vec<_>>().join(",")
            ));
        }
        csv
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn results() -> SweepResults {
        let values = |psnr: f64| -> MetricValues { [(Metric::Psnr, psnr)].into_iter().collect() };
        let row = |name: &str, single| RowResults {
            name: name.to_owned(),
            cost: Cost { parameters: 9, gmac_published: 0.5, gmac_evaluated: 0.25 },
            iterations: 6,
            images: 2,
            mean: values(30.0),
            degraded: values(20.0),
            single,
        };
        let single = SingleResults { images: 1, mean: values(f64::INFINITY), degraded: values(21.0) };
        SweepResults {
            rows: vec![row("plain", Some(single)), row("full,wide", None)],
            failed: vec![FailedRow { name: "wrong".to_owned(), reason: "row wrong: it is".to_owned() }],
            single_kernel: Some("r+00".to_owned()),
            data_sha256: "ab".to_owned(),
            metrics: vec![Metric::Psnr],
            definition: MetricDefinition::default(),
        }
    }

    #[test]
    fn tabulates_the_single_kernel_beside_all_and_names_what_failed() {
        let text = results().to_markdown();
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[0].ends_with("| images | PSNR (dB), r+00 | PSNR (dB), all kernels |"), "{text}");
        assert_eq!(lines[2], "| degraded | – | – | – | – | 2 | 21.00 | 20.00 |");
        assert_eq!(lines[3], "| plain | 9 | 0.50 | 0.25 | 6 | 2 | ∞ | 30.00 |");
        assert_eq!(lines[4], "| full,wide | 9 | 0.50 | 0.25 | 6 | 2 | – | 30.00 |");
        assert!(text.ends_with("\nFailed: wrong: row wrong: it is\n"), "{text}");
        let csv = results().to_csv();
        let lines: Vec<&str> = csv.lines().collect();
        assert!(lines[0].ends_with("images,psnr,degraded_psnr,r+00_psnr,degraded_r+00_psnr"), "{csv}");
        assert_eq!(lines[1], "plain,9,0.5,0.25,6,2,30,20,inf,21");
        assert_eq!(lines[2], "\"full,wide\",9,0.5,0.25,6,2,30,20,,");
    }

    #[test]
    fn the_file_is_read_as_it_was_written() {
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("table.json");
        std::fs::write(&path, results().to_json()).unwrap();
        assert_eq!(SweepResults::read(&path).unwrap(), results());
    }
}
