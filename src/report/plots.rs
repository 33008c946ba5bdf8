//! Draws what an experiment found: each metric by rotation of the panel, how it is distributed over the images, and the
//! matrices of right and wrong kernels.

use super::chart::{Axes, Series, line_chart, standalone};
use super::distribution::{Group, distribution_chart};
use super::heat_map::{HeatMap, heat_map};
use crate::core::metrics::Metric;
use crate::experiment::{Matrix, MethodResults, Mismatch, Results, plot_of_matrix, plots_of};

/// The plots of an evaluation with the names of their files; what has no value to draw is left out.
pub fn plots(results: &Results) -> Vec<(String, String)> {
    let mut plots = Vec::new();
    for &metric in &results.definition.metrics {
        let [by_rotation, distribution] = plots_of(metric);
        plots.extend(draw_by_rotation(results, metric).map(|svg| (by_rotation, svg)));
        let group = |method: &MethodResults| Group {
            name: method.label(),
            values: method.images.iter().filter_map(|image| image.values.get(metric)).collect(),
        };
        let groups: Vec<Group> = results.methods.iter().map(group).collect();
        plots.extend(drawing(distribution_chart(&groups, metric.heading())).map(|svg| (distribution, svg)));
    }
    plots
}

/// The drawings of all matrices with the names of their files.
pub fn mismatch_plots<'a>(mismatch: &'a Mismatch) -> Vec<(String, String)> {
    let mut methods: Vec<&str> = Vec::new();
    let plot = |matrix: &'a Matrix| {
        let Matrix { method, metric, .. } = matrix;
        if methods.last() != Some(&method.as_str()) {
            methods.push(method);
        }
        (plot_of_matrix(*metric, methods.len()), standalone(&heat_map_of(matrix)))
    };
    mismatch.matrices.iter().map(plot).collect()
}

/// The drawing of a matrix within a page.
pub(super) fn heat_map_of(matrix: &Matrix) -> String {
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

fn draw_by_rotation(results: &Results, metric: Metric) -> Option<String> {
    let series = by_rotation(results, metric);
    let is_turned = results.kernels.iter().filter(|kernel| kernel.angle_deg.is_some()).count() > 1;
    let y = metric.heading().to_owned();
    let axes = Axes { x: "rotation of the panel in degrees".to_owned(), y, log_y: false };
    is_turned.then(|| line_chart(&series, &axes)).and_then(drawing)
}

/// The means of every method by the rotations of the kernels that have one.
pub(super) fn by_rotation(results: &Results, metric: Metric) -> Vec<Series> {
    let series = |method: &MethodResults| {
        let mut points: Vec<(f64, f64)> = Vec::new();
        for kernel in &results.kernels {
            let mean = method.kernels.get(&kernel.name).and_then(|mean| mean.get(metric));
            points.extend(kernel.angle_deg.zip(mean));
        }
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        Series { name: method.label(), points }
    };
    results.methods.iter().map(series).collect()
}

/// A file of its own, unless there was nothing to draw.
fn drawing(svg: String) -> Option<String> {
    svg.starts_with("<svg").then(|| standalone(&svg))
}
