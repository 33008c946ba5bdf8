//! Draws an evaluation: each metric by rotation of the panel, and how it is distributed over the images.

use udc::core::metrics::Metric;
use udc::experiment::{Evaluation, Matrix};
use udc::report::chart::{Axes, Series, line_chart, standalone};
use udc::report::distribution::{Group, distribution_chart};
use udc::report::heat_map::{HeatMap, heat_map};

/// The files that hold a metric's plots.
pub(super) fn names(metric: Metric) -> [String; 2] {
    ["by-rotation", "distribution"].map(|what| format!("{}-{what}.svg", metric.name()))
}

/// The file that holds the matrix of a metric of the method of this number.
pub(super) fn name_of_matrix(metric: Metric, number: usize) -> String {
    format!("mismatch-{number}-{}.svg", metric.name())
}

/// The plots of an evaluation with the names of their files.
pub(super) fn draw(evaluation: &Evaluation) -> Vec<(String, String)> {
    let mut plots = Vec::new();
    for (index, metric) in evaluation.metrics.iter().enumerate() {
        let [by_rotation, distribution] = names(*metric);
        plots.extend(draw_by_rotation(evaluation, index).map(|svg| (by_rotation, svg)));
        let groups = (0..evaluation.methods.len()).map(|method| Group {
            name: label(evaluation, method),
            values: evaluation.of(method, None).map(|score| score.values[index]).collect(),
        });
        let svg = distribution_chart(&groups.collect::<Vec<_>>(), metric.heading());
        // What is equal everywhere has no value to draw.
        plots.extend(svg.starts_with("<svg").then(|| (distribution, standalone(&svg))));
    }
    plots
}

/// The number and the metric of the matrix that a file holds; none for other files.
fn matrix_of_file(file: &str) -> Option<(usize, &str)> {
    let (number, metric) = file.strip_prefix("mismatch-")?.strip_suffix(".svg")?.split_once('-')?;
    Some((number.parse().ok()?, metric))
}

/// Whether a file's name is that of a plot.
pub(super) fn is_plot(file: &str) -> bool {
    let is_of = |metric: Metric| names(metric).iter().any(|name| name == file);
    matrix_of_file(file).is_some() || Metric::ALL.into_iter().any(is_of)
}

/// The file and the drawing of a matrix; `number` tells methods apart.
pub(super) fn draw_matrix(matrix: &Matrix, number: usize) -> (String, String) {
    (name_of_matrix(matrix.metric, number), standalone(&heat_map_of(matrix)))
}

/// The drawing of a matrix within a page.
pub(in crate::commands) fn heat_map_of(matrix: &Matrix) -> String {
    heat_map(&HeatMap {
        row_label: "kernel of the image".to_owned(),
        column_label: format!(
            "{} of {} by the kernel that it is told",
            matrix.metric.heading(),
            matrix.method
        ),
        rows: matrix.simulated.clone(),
        columns: matrix.assumed.clone(),
        values: matrix.rows.clone(),
        decimals: matrix.metric.decimals(),
    })
}

fn draw_by_rotation(evaluation: &Evaluation, index: usize) -> Option<String> {
    let rotations: Vec<(&str, f64)> =
        (evaluation.rotations().into_iter()).filter_map(|(kernel, angle)| Some((kernel, angle?))).collect();
    if rotations.len() < 2 {
        return None;
    }
    let series = |method: usize| {
        let point = |(kernel, angle): &(&str, f64)| {
            evaluation.mean(method, Some(kernel)).map(|values| (*angle, values[index]))
        };
        let mut points: Vec<(f64, f64)> = rotations.iter().filter_map(point).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Series { name: label(evaluation, method), points }
    };
    let series: Vec<Series> = (0..evaluation.methods.len()).map(series).collect();
    let y = evaluation.metrics[index].heading().to_owned();
    let axes = Axes { x: "rotation of the panel in degrees".to_owned(), y, log_y: false };
    let svg = line_chart(&series, &axes);
    svg.starts_with("<svg").then(|| standalone(&svg))
}

fn label(evaluation: &Evaluation, method: usize) -> String {
    let method = &evaluation.methods[method];
    match &method.dataset {
        Some(dataset) => format!("{dataset}: {}", method.name),
        None => method.name.clone(),
    }
}
