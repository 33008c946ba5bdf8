//! Turns results into the blocks of a page's section: dataset, training, evaluation.

use serde::Deserialize;

use super::chart::{Axes, Series, line_chart};
use super::page::Block;
use super::plots;
use crate::core::error::{Error, Result};
use crate::core::metrics::Metric;
use crate::dataset::{Dataset, Split};
use crate::experiment::{MethodResults, MetricValues, Region, Results};

/// Counts a dataset's scenes and triplets by split, and says how its degraded images were formed.
pub fn dataset(name: &str, dataset: &Dataset) -> Vec<Block> {
    let row = |split: Split| {
        let triplets: Vec<_> = dataset.triplets.iter().filter(|triplet| triplet.split == split).collect();
        let distinct = |key: fn(&&crate::dataset::Triplet) -> String| {
            let mut keys: Vec<String> = triplets.iter().map(key).collect();
            keys.sort_unstable();
            keys.dedup();
            keys.len().to_string()
        };
        let (scenes, sources) = (distinct(|triplet| triplet.id.clone()), distinct(|t| t.source.clone()));
        vec![split.name().to_owned(), sources, scenes, triplets.len().to_string()]
    };
    let head = ["split", "sources", "scenes", "triplets"].map(str::to_owned).to_vec();
    let rows = [Split::Train, Split::Val, Split::Test].map(row).to_vec();
    let formation = serde_json::to_string_pretty(&dataset.formation).unwrap_or_default();
    vec![
        Block::Heading(format!("Dataset: {name}")),
        Block::Table(head, rows),
        Block::Fold("Formation of the degraded images".to_owned(), vec![Block::Listing(formation)]),
    ]
}

/// What is drawn of a line of a training's log.
#[derive(Deserialize)]
struct LogLine {
    iteration: Option<f64>,
    loss: Option<f64>,
    psnr: Option<f64>,
    learning_rate: Option<f64>,
}

/// Draws the loss of a training, and its validation where there is one, from the lines of its log.
///
/// # Errors
/// [`Error::Config`] naming the line that is not one of a log.
pub fn training(name: &str, log: &str) -> Result<Vec<Block>> {
    let mut loss = Series { name: "loss".to_owned(), points: Vec::new() };
    let mut psnr = Series { name: "validation".to_owned(), points: Vec::new() };
    let mut rate = Series { name: "learning rate".to_owned(), points: Vec::new() };
    let count = log.lines().count();
    for (index, line) in log.lines().enumerate() {
        let line: LogLine = match serde_json::from_str(line) {
            Ok(line) => line,
            // A run that was killed, or goes on, ends within one.
            Err(error) if index + 1 == count && error.is_eof() => break,
            Err(error) => {
                return Err(Error::config(format!("line {} of the log", index + 1), error.to_string()));
            }
        };
        let Some(iteration) = line.iteration else { continue };
        for (series, value) in
            [(&mut loss, line.loss), (&mut psnr, line.psnr), (&mut rate, line.learning_rate)]
        {
            series.points.extend(value.map(|value| (iteration, value)));
        }
    }
    let axes = |y: &str, log_y| Axes { x: "iteration".to_owned(), y: y.to_owned(), log_y };
    let mean = Series { name: "running mean".to_owned(), points: running_mean(&loss.points) };
    let mut blocks = vec![
        Block::Heading(format!("Training: {name}")),
        Block::Chart(
            line_chart(&[loss, mean], &axes("training loss", true)),
            "Loss of the batches that the log names: one every log-every iterations; logarithmic scale."
                .to_owned(),
        ),
    ];
    if !psnr.points.is_empty() {
        let chart = line_chart(&[psnr], &axes("PSNR in dB", false));
        blocks.push(Block::Chart(chart, "Validation on images that are not trained on.".to_owned()));
    }
    if rate.points.windows(2).any(|pair| (pair[0].1 - pair[1].1).abs() > 0.0) {
        let chart = line_chart(&[rate], &axes("learning rate", true));
        blocks.push(Block::Chart(chart, "The learning rate on the way; logarithmic scale.".to_owned()));
    }
    Ok(blocks)
}

/// The mean of each point with its neighbours, a twentieth of all points on either side.
fn running_mean(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let reach = points.len() / 20;
    let mean = |index: usize| {
        let window = &points[index.saturating_sub(reach)..points.len().min(index + reach + 1)];
        #[expect(clippy::cast_precision_loss, reason = "logs have far fewer than 2⁵³ lines")]
        let count = window.len() as f64;
        (points[index].0, window.iter().map(|point| point.1).sum::<f64>() / count)
    };
    (0..points.len()).map(mean).collect()
}

/// Shows an evaluation: the means of every method, PSNR by kernel, what was left out, and the definition.
pub fn evaluation(name: &str, results: &Results) -> Vec<Block> {
    let metrics = in_order_of_names(results.mean.metrics(), Metric::name);
    let headed = |first: &[&str]| {
        let headings = metrics.iter().map(|metric| metric.heading());
        first.iter().copied().chain(headings).map(str::to_owned).collect::<Vec<_>>()
    };
    let head = headed(&["method", "parameters", "GMAC at 800²", "images"]);
    let row = |method: &MethodResults| {
        let cost = match &method.cost {
            Some(cost) => [cost.parameters.to_string(), format!("{:.2}", cost.gmac_published)],
            None => ["–"; 2].map(str::to_owned),
        };
        let first = [method.label()].into_iter().chain(cost).chain([method.count.to_string()]);
        first.chain(means(&method.mean, &metrics)).collect()
    };
    let mut blocks = vec![
        Block::Heading(format!("Evaluation: {name}")),
        Block::Table(head, results.methods.iter().map(row).collect()),
    ];
    let regions: Vec<_> = results.methods.iter().flat_map(|method| regions_of(method, &metrics)).collect();
    if !regions.is_empty() {
        blocks.push(Block::Table(headed(&["method", "region", "pixels"]), regions));
    }
    if !results.excluded.is_empty() {
        blocks.push(Block::Text(format!("{} images are left out of every mean.", results.excluded.len())));
    }
    blocks.extend(psnr_by_kernel(results));
    // Through a value, so that the keys are in the order of their names.
    let definition = serde_json::to_value(&results.definition).unwrap_or_default();
    let listing = vec![Block::Listing(format!("{definition:#}"))];
    blocks.push(Block::Fold("Definition of the metrics".to_owned(), listing));
    blocks
}

/// A row for each region of a method's images.
fn regions_of(method: &MethodResults, metrics: &[Metric]) -> Vec<Vec<String>> {
    let names = in_order_of_names(method.regions.keys().copied(), Region::name);
    let row = |region: Region| {
        let found = &method.regions[&region];
        let first = [method.label(), region.name().to_owned(), found.pixels.to_string()];
        first.into_iter().chain(means(&found.mean, metrics)).collect()
    };
    names.into_iter().map(row).collect()
}

/// Pages show what has a name in the order of the names.
fn in_order_of_names<T: Copy>(things: impl Iterator<Item = T>, name: fn(T) -> &'static str) -> Vec<T> {
    let mut things: Vec<T> = things.collect();
    things.sort_by_key(|&thing| name(thing));
    things
}

fn means(of: &MetricValues, metrics: &[Metric]) -> Vec<String> {
    let cell = |&metric: &Metric| match of.get(metric) {
        Some(value) if value.is_finite() => format!("{value:.4}"),
        Some(_) => "∞".to_owned(),
        None => "–".to_owned(),
    };
    metrics.iter().map(cell).collect()
}

/// One line a method over the angles of the kernels, where the kernels are rotations.
fn psnr_by_kernel(results: &Results) -> Option<Block> {
    let mut series = plots::by_rotation(results, Metric::Psnr);
    series.retain(|one| one.points.iter().filter(|point| point.1.is_finite()).count() > 1);
    let axes =
        Axes { x: "rotation of the panel in degrees".to_owned(), y: "PSNR in dB".to_owned(), log_y: false };
    (!series.is_empty()).then(|| Block::Chart(line_chart(&series, &axes), "Mean PSNR by kernel.".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_running_mean_keeps_a_constant_and_smooths_noise() {
        let points: Vec<(f64, f64)> =
            (0..100).map(|i| (f64::from(i), if i % 2 == 0 { 1.0 } else { 3.0 })).collect();
        let mean = running_mean(&points);
        assert_eq!(mean.len(), 100);
        assert!(mean[20..80].iter().all(|point| (point.1 - 2.0).abs() < 0.1));
    }

    #[test]
    fn a_log_that_ends_within_a_line_is_drawn_to_the_line_before() {
        let whole = "{\"iteration\":1,\"loss\":0.5}\n{\"iteration\":2,\"loss\":0.25}\n";
        let cut = format!("{whole}{{\"iteration\":3,\"lo");
        assert_eq!(training("run", &cut).unwrap().len(), training("run", whole).unwrap().len());
        let damaged = format!("{{\"iterat\n{whole}");
        assert!(training("run", &damaged).unwrap_err().to_string().contains("line 1 of the log"));
    }

    #[test]
    fn tables_every_method_and_orders_kernels_by_angle() {
        let method = |name: &str, psnr: f64| {
            json!({"name": name, "baseline": false, "count": 2, "mean": {"psnr": psnr}, "images": [],
                   "parameters": 1234, "gmac-800x800": 23.255, "gmac-evaluated": 1.0,
                   "regions": {"flare": {"images": 2, "pixels": 99, "mean": {"psnr": psnr - 5.0}},
                               "rest": {"images": 0, "pixels": 0, "mean": {}}},
                   "kernels": {"r+12": {"psnr": psnr}, "r-12": {"psnr": psnr + 1.0}}})
        };
        let kernel = |name: &str, angle: f64| json!({"name": name, "angle-deg": angle});
        let definition = json!({"quantise": true, "border": 0, "ssim-window": 11, "ssim-sigma": 1.5, "domain": "<b>",
                                "peak": 1.0, "ssim-channels": "mean", "metrics": ["psnr"]});
        let results = json!({"method": "net", "images": [], "mean": {"psnr": 30.0}, "sizes": [], "excluded": [],
                             "methods": [method("degraded", 20.0), method("net", 30.0)], "definition": definition,
                             "kernels": [kernel("r-12", -12.0), kernel("r+12", 12.0)]});
        let blocks = evaluation("results", &serde_json::from_value(results).unwrap());
        let Some(Block::Table(head, rows)) = blocks.get(1) else { panic!("a table follows the heading") };
        assert_eq!(head[..], ["method", "parameters", "GMAC at 800²", "images", "PSNR (dB)"]);
        assert_eq!(rows[1], ["net", "1234", "23.25", "2", "30.0000"]);
        let Some(Block::Table(_, regions)) = blocks.get(2) else { panic!("regions follow") };
        assert_eq!(regions[2..], [["net", "flare", "99", "25.0000"], ["net", "rest", "0", "–"]]);
        assert!(blocks.iter().any(|block| matches!(block, Block::Chart(..))));
    }

    #[test]
    fn names_the_line_of_a_damaged_log() {
        let message = training("run", "{\"iteration\":1,\"loss\":0.5}\n{,}").unwrap_err().to_string();
        assert!(message.contains("line 2"), "{message}");
    }
}
