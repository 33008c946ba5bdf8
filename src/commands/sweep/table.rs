//! Turns the rows of a sweep into tables.

use udc::core::metrics::Metric;
use udc::eval::{cell, markdown, quoted};

use super::row::{Means, Row};

/// The table of the rows, the degraded images first, and the rows that failed.
pub(super) fn to_markdown(rows: &[Row], failed: &[(String, String)], metrics: &[Metric]) -> String {
    let fixed =
        ["configuration", "params", "GMAC at 800²", "GMAC", "iterations", "images"].map(str::to_owned);
    let headings = metrics.iter().map(|metric| metric.heading().to_owned());
    let mut table: Vec<Vec<String>> = vec![fixed.into_iter().chain(headings).collect()];
    if let Some(first) = rows.first() {
        let names = ["degraded", "–", "–", "–", "–"].map(str::to_owned).into_iter();
        table.push(names.chain([first.images.to_string()]).chain(cells(&first.degraded, metrics)).collect());
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
        table.push(names.into_iter().chain(cells(&row.mean, metrics)).collect());
    }
    let mut text = markdown(&table);
    for (name, reason) in failed {
        text.push_str(&format!("\nFailed: {name}: {reason}\n"));
    }
    text
}

/// One line a row, with all decimals.
pub(super) fn to_csv(rows: &[Row], metrics: &[Metric]) -> String {
    let names: Vec<&str> = metrics.iter().map(|metric| metric.name()).collect();
    let degraded = names.iter().map(|name| format!("degraded_{name}")).collect::<Vec<_>>();
    let mut csv = format!(
        "configuration,parameters,gmac_800x800,gmac_evaluated,iterations,images,{},{}\n",
        names.join(","),
        degraded.join(",")
    );
    for row in rows {
        let Row { parameters, gmac_published, gmac_evaluated, iterations, images, .. } = row;
        let name = quoted(&row.name);
        let values =
            |means: &Means| names.iter().map(|name| means[*name].to_string()).collect::<Vec<_>>().join(",");
        let (mean, degraded) = (values(&row.mean), values(&row.degraded));
        csv.push_str(&format!(
            "{name},{parameters},{gmac_published},{gmac_evaluated},{iterations},{images},{mean},{degraded}\n"
        ));
    }
    csv
}

fn cells(means: &Means, metrics: &[Metric]) -> Vec<String> {
    metrics.iter().map(|metric| cell(*metric, Some(means[metric.name()]))).collect()
}
