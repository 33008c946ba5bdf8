//! Turns the rows of a sweep into tables.

use udc::core::metrics::Metric;
use udc::experiment::{cell, markdown, quoted};

use super::row::{Means, Row};

/// What the columns of the means are of: the single kernel where there is one, and all.
struct Columns<'a> {
    metrics: &'a [Metric],
    single: Option<&'a str>,
}

impl Columns<'_> {
    fn headings(&self) -> Vec<String> {
        let of = |what: String| self.metrics.iter().map(move |metric| format!("{}{what}", metric.heading()));
        match self.single {
            Some(kernel) => of(format!(", {kernel}")).chain(of(", all kernels".to_owned())).collect(),
            None => of(String::new()).collect(),
        }
    }

    fn cells(&self, single: Option<&Means>, all: &Means) -> Vec<String> {
        let cells = |means: Option<&Means>| -> Vec<String> {
            let value = |metric: &Metric| means.map(|means| means[metric.name()]);
            self.metrics.iter().map(|metric| cell(*metric, value(metric))).collect()
        };
        let single = self.single.map(|_| cells(single)).unwrap_or_default();
        [single, cells(Some(all))].concat()
    }
}

/// The table of the rows, the degraded images first, and the rows that failed; with columns of their own for the images
/// of the kernel `single`.
pub(super) fn to_markdown(
    rows: &[Row],
    failed: &[(String, String)],
    metrics: &[Metric],
    single: Option<&str>,
) -> String {
    let columns = Columns { metrics, single };
    let fixed =
        ["configuration", "params", "GMAC at 800²", "GMAC", "iterations", "images"].map(str::to_owned);
    let mut table: Vec<Vec<String>> = vec![fixed.into_iter().chain(columns.headings()).collect()];
    if let Some(first) = rows.first() {
        let names = ["degraded", "–", "–", "–", "–"].map(str::to_owned).into_iter();
        let single = first.single.as_ref().map(|single| &single.degraded);
        let cells = columns.cells(single, &first.degraded);
        table.push(names.chain([first.images.to_string()]).chain(cells).collect());
    }
    for row in rows {
        let names = [
            row.name.clone(),
            row.parameters.to_string(),
            format!("{:.2}", row.gmac_published),
            format!("{:.2}", row.gmac_evaluated),
            row.iterations.to_string(),
            row.images.to_string(),
        ];
        let cells = columns.cells(row.single.as_ref().map(|single| &single.mean), &row.mean);
        table.push(names.into_iter().chain(cells).collect());
    }
    let mut text = markdown(&table);
    for (name, reason) in failed {
        text.push_str(&format!("\nFailed: {name}: {reason}\n"));
    }
    text
}

/// One line a row, with all decimals; where there is a kernel `single`, the means over its images come last.
pub(super) fn to_csv(rows: &[Row], metrics: &[Metric], single: Option<&str>) -> String {
    let names = |prefix: &str| metrics.iter().map(|metric| format!("{prefix}{}", metric.name())).collect();
    let mut headings: Vec<Vec<String>> = vec![names(""), names("degraded_")];
    if let Some(kernel) = single {
        headings.extend([names(&format!("{kernel}_")), names(&format!("degraded_{kernel}_"))]);
    }
    let headings: Vec<String> = headings.concat().iter().map(|name| quoted(name)).collect();
    let mut csv = format!(
        "configuration,parameters,gmac_800x800,gmac_evaluated,iterations,images,{}\n",
        headings.join(",")
    );
    for row in rows {
        let Row { parameters, gmac_published, gmac_evaluated, iterations, images, .. } = row;
        let name = quoted(&row.name);
        let mut means = vec![Some(&row.mean), Some(&row.degraded)];
        if single.is_some() {
            let of_single = row.single.as_ref();
            means.extend([of_single.map(|single| &single.mean), of_single.map(|single| &single.degraded)]);
        }
        let value = |means: &Option<&Means>, metric: &Metric| {
            means.map(|m| m[metric.name()].to_string()).unwrap_or_default()
        };
        let values: Vec<String> =
            means.iter().flat_map(|means| metrics.iter().map(move |metric| value(means, metric))).collect();
        csv.push_str(&format!(
            "{name},{parameters},{gmac_published},{gmac_evaluated},{iterations},{images},{}\n",
            values.join(",")
        ));
    }
    csv
}
