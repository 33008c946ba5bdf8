//! Turns scores into tables for people (Markdown) and for programs (CSV).

use super::evaluation::Evaluation;
use super::measured::Measured;
use super::score::Score;
use crate::core::metrics::Metric;
use crate::core::primaries::Primaries;
use crate::core::tone::ToneCurve;

impl Evaluation {
    /// One line an image and method: `method,id,kernel,psnr,…`, with the dataset first where there are several.
    pub fn to_csv(&self) -> String {
        let values = |score: &Score| score.values.iter().map(f64::to_string).collect::<Vec<_>>();
        let rows = self.scores.iter().map(|score| [self.names(score), values(score)].concat());
        self.csv(&self.metrics, &[], rows)
    }

    /// One line an image, method and region: `method,id,kernel,region,pixels,psnr,…`; a region without pixels
    /// has no value.
    pub fn regions_to_csv(&self) -> String {
        let rows = self.scores.iter().flat_map(|score| {
            score.regions.iter().map(|part| {
                let values = self.regional.iter().zip(&part.pools);
                let values = values.map(|(metric, pool)| match pool.mean() {
                    Some(mean) => metric.of_mean(mean).to_string(),
                    None => String::new(),
                });
                let part_names = [part.region.name().to_owned(), part.pixels.to_string()];
                self.names(score).into_iter().chain(part_names).chain(values).collect()
            })
        });
        self.csv(&self.regional, &["region", "pixels"], rows)
    }

    fn csv(&self, metrics: &[Metric], more: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
        let dataset = self.has_datasets().then_some("dataset");
        let names = dataset.into_iter().chain(["method", "id", "kernel"]).chain(more.iter().copied());
        let heading: Vec<&str> = names.chain(metrics.iter().map(|metric| metric.name())).collect();
        let lines = rows.map(|row| row.join(",") + "\n");
        heading.join(",") + "\n" + &lines.collect::<String>()
    }

    fn names(&self, score: &Score) -> Vec<String> {
        let method = &self.methods[score.method];
        let kernel = score.label.kernel.as_deref().unwrap_or_default();
        let dataset = self.has_datasets().then(|| method.dataset.as_deref().unwrap_or_default());
        dataset.into_iter().chain([&method.name, &score.label.id, kernel]).map(quoted).collect()
    }

    fn has_datasets(&self) -> bool {
        self.methods.iter().any(|method| method.dataset.is_some())
    }

    /// The means over all images, with what each method costs; each metric by kernel, and by region, where
    /// there are several; what was left out, and the definition.
    pub fn to_markdown(&self) -> String {
        let mut text = self.table_of_means();
        let kernels = self.kernels();
        if kernels.len() > 1 {
            for (i, metric) in self.metrics.iter().enumerate() {
                text.push_str(&self.table_by_kernel(i, *metric, &kernels));
            }
        }
        if self.has_regions() {
            text.push_str(&self.table_by_region());
        }
        if !self.excluded.is_empty() {
            text.push_str(&format!("\nLeft out of every mean: {} images.\n", self.excluded.len()));
            for exclusion in &self.excluded {
                let dataset = exclusion.dataset.as_ref().map(|dataset| format!("{dataset}: "));
                let kernel = exclusion.kernel.as_ref().map(|kernel| format!(" through {kernel}"));
                let [dataset, kernel] = [dataset, kernel].map(Option::unwrap_or_default);
                text.push_str(&format!("- {dataset}{}{kernel}: {}\n", exclusion.id, exclusion.reason));
            }
        }
        text.push_str(&format!("\n{}\n", self.definition_in_words()));
        text
    }

    fn table_of_means(&self) -> String {
        let has_cost = self.methods.iter().any(|method| method.cost.is_some());
        let costs = if has_cost { &["params", "GMAC at 800²", "GMAC"][..] } else { &[] };
        let headings = costs.iter().copied().chain(["images"]).map(str::to_owned);
        let metrics = self.metrics.iter().map(|metric| metric.heading().to_owned());
        let mut rows: Vec<Vec<String>> = vec![self.heading().chain(headings).chain(metrics).collect()];
        for method in 0..self.methods.len() {
            let costs = if has_cost { self.cost_cells(method).to_vec() } else { Vec::new() };
            let count = self.count(method).to_string();
            let cells = self.cells(method, None);
            rows.push(self.label(method).chain(costs).chain([count]).chain(cells).collect());
        }
        markdown(&rows)
    }

    fn cost_cells(&self, method: usize) -> [String; 3] {
        match &self.methods[method].cost {
            Some(cost) => [
                cost.parameters.to_string(),
                format!("{:.2}", cost.gmac_published),
                format!("{:.2}", cost.gmac_evaluated),
            ],
            None => ["–"; 3].map(str::to_owned),
        }
    }

    fn table_by_kernel(&self, index: usize, metric: Metric, kernels: &[&str]) -> String {
        let names = kernels.iter().copied().chain(["mean"]).map(str::to_owned);
        let mut rows: Vec<Vec<String>> = vec![self.heading().chain(names).collect()];
        for method in 0..self.methods.len() {
            let columns = kernels.iter().map(|&kernel| Some(kernel)).chain([None]);
            let cells = columns.map(|kernel| self.cells(method, kernel)[index].clone());
            rows.push(self.label(method).chain(cells).collect());
        }
        format!("\n{} by kernel\n\n{}", metric.heading(), markdown(&rows))
    }

    fn table_by_region(&self) -> String {
        let names = ["region", "images", "pixels"].map(str::to_owned);
        let metrics = self.regional.iter().map(|metric| metric.heading().to_owned());
        let mut rows: Vec<Vec<String>> = vec![self.heading().chain(names).chain(metrics).collect()];
        for method in 0..self.methods.len() {
            for part in self.regions(method) {
                let names = [part.region.name().to_owned(), part.images.to_string(), part.pixels.to_string()];
                let values =
                    self.regional.iter().zip(&part.values).map(|(metric, value)| cell(*metric, *value));
                rows.push(self.label(method).chain(names).chain(values).collect());
            }
        }
        format!("\nBy region, over all its pixels in all images\n\n{}", markdown(&rows))
    }

    /// The headings of what names a row.
    fn heading(&self) -> impl Iterator<Item = String> + use<> {
        let dataset = self.has_datasets().then_some("dataset");
        dataset.into_iter().chain(["method"]).map(str::to_owned)
    }

    /// What names the row of a method.
    fn label(&self, method: usize) -> impl Iterator<Item = String> + use<> {
        let described = &self.methods[method];
        let dataset = self.has_datasets().then(|| described.dataset.clone().unwrap_or_default());
        dataset.into_iter().chain([described.name.clone()])
    }

    fn cells(&self, method: usize, kernel: Option<&str>) -> Vec<String> {
        let values = self.mean(method, kernel);
        let cell = |(i, metric): (usize, &Metric)| cell(*metric, values.as_ref().map(|values| values[i]));
        self.metrics.iter().enumerate().map(cell).collect()
    }

    fn definition_in_words(&self) -> String {
        let definition = &self.definition;
        let rounding = if definition.quantise { "rounded to 8 bits" } else { "not rounded" };
        let border = match definition.border {
            0 => String::new(),
            border => format!(", {border} pixels cut from each side"),
        };
        let sizes =
            self.sizes.iter().map(|([height, width], images)| format!("{images} of {height} × {width}"));
        let sizes = sizes.collect::<Vec<_>>().join(", ");
        let tone = self.tone.map_or(String::new(), |tone| {
            let ToneCurve { alpha, x_max } = tone.curve;
            format!(
                " Linear ones are mapped by x / (x + {alpha}) of x up to {x_max}, as {} said; tone-mapped ones that say another \
                 curve are mapped back by it first, and those that say none are taken as they are.",
                tone.said_by.name()
            )
        });
        let datasets = self.curves_in_words();
        format!(
            "Of tone-mapped images ({sizes}) clamped to [0, 1], {rounding}{border}; peak 1. SSIM: {0} × {0} Gaussian \
             window, σ = {1}, whole windows only, mean of the channels.",
            definition.ssim_window, definition.ssim_sigma
        ) + &tone
            + &datasets
    }

    /// By which curves the images of datasets are tone-mapped; nothing without datasets.
    fn curves_in_words(&self) -> String {
        let Some(Measured { alpha, x_max, .. }) = self.measured.first() else { return String::new() };
        if !self.has_several_curves() {
            return format!(" Images of datasets are mapped by x / (x + {alpha}) of x up to {x_max}.");
        }
        let of = |Measured { dataset, alpha, x_max, .. }: &Measured| {
            format!("x / (x + {alpha}) of x up to {x_max} for {}", dataset.as_deref().unwrap_or_default())
        };
        let all: Vec<String> = self.measured.iter().map(of).collect();
        format!(" Images of datasets are mapped by {}.", all.join("; "))
    }

    /// Whether the images of datasets are of several primaries, so that their numbers cannot be compared.
    pub fn has_several_primaries(&self) -> bool {
        self.measured.windows(2).any(|pair| !Primaries::are_same(pair[0].primaries, pair[1].primaries))
    }

    /// Whether the images of datasets are tone-mapped by several curves, so that their numbers cannot be compared.
    #[expect(clippy::float_cmp, reason = "another curve is one by a bit")]
    pub fn has_several_curves(&self) -> bool {
        let is_other = |pair: &[Measured]| pair[0].alpha != pair[1].alpha || pair[0].x_max != pair[1].x_max;
        self.measured.windows(2).any(is_other)
    }
}

/// A value with the decimals that tables show of a metric; `–` without one.
pub fn cell(metric: Metric, value: Option<f64>) -> String {
    match value {
        Some(value) if value.is_finite() => format!("{value:.*}", metric.decimals()),
        Some(_) => "∞".to_owned(),
        None => "–".to_owned(),
    }
}

/// A Markdown table with its first row as the heading, first column to the left, the others to the right.
///
/// # Panics
/// Without any row, or column: broken invariants of the caller.
pub fn markdown(rows: &[Vec<String>]) -> String {
    let line = |cells: &[String]| {
        let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let columns = rows[0].len();
    let rule = format!("|---|{}\n", "---:|".repeat(columns - 1));
    let body: String = rows[1..].iter().map(|row| line(row)).collect();
    line(&rows[0]) + &rule + &body
}

/// A field of a line of CSV, in quotes where it needs them.
pub fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ComparedMethod, Cost, EvalConfig, Evaluation, Label, Score};

    #[test]
    fn fields_that_end_lines_are_quoted() {
        let quoted = ["a", "a,b", "a\nb", "a\rb", "a\"b"].map(super::quoted);
        assert_eq!(quoted, ["a", "\"a,b\"", "\"a\nb\"", "\"a\rb\"", "\"a\"\"b\""]);
    }

    fn evaluation() -> Evaluation {
        let methods = vec![ComparedMethod::baseline("degraded"), ComparedMethod::restored("a,b|c")];
        let mut evaluation = Evaluation::new(&EvalConfig::default(), methods);
        for (kernel, psnr) in [("r-03", 30.0), ("r+00", f64::INFINITY)] {
            let label = Label { kernel: Some(kernel.to_owned()), ..Label::scene("street") };
            let score = |method, values| Score { label: label.clone(), method, values, regions: Vec::new() };
            evaluation.add([8, 9], vec![score(0, vec![20.25, 0.5]), score(1, vec![psnr, 0.91239])]);
        }
        evaluation
    }

    #[test]
    fn writes_a_line_for_each_image_and_method() {
        let csv = evaluation().to_csv();
        let lines: Vec<&str> = csv.lines().collect();
        assert_eq!(lines[0], "method,id,kernel,psnr,ssim");
        assert_eq!(lines[1], "degraded,street,r-03,20.25,0.5");
        assert_eq!(lines[4], "\"a,b|c\",street,r+00,inf,0.91239");
    }

    #[test]
    fn tabulates_means_by_kernel_and_names_what_was_left_out() {
        let mut evaluation = evaluation();
        evaluation.exclude(&Label::scene("dark"), "is missing");
        let text = evaluation.to_markdown();
        assert!(text.starts_with("| method | images | PSNR (dB) | SSIM |\n|---|---:|---:|---:|\n"), "{text}");
        assert!(text.contains("| degraded | 2 | 20.25 | 0.5000 |"), "{text}");
        assert!(text.contains("| a,b\\|c | 30.00 | ∞ | ∞ |"), "{text}");
        assert!(text.contains("Left out of every mean: 1 images.\n- dark: is missing"), "{text}");
        assert!(text.contains("rounded to 8 bits"), "{text}");
    }

    #[test]
    fn says_what_networks_cost_and_which_dataset_a_row_is_of() {
        let mut evaluation = evaluation();
        evaluation.methods[1].cost =
            Some(Cost::of(3_804_617, &evaluation.sizes, |y, x| (y * x) as u64 * 1000));
        let joined = Evaluation::join(vec![("day".to_owned(), evaluation)]);
        let text = joined.to_markdown();
        let heading = "| dataset | method | params | GMAC at 800² | GMAC | images | PSNR (dB) | SSIM |\n";
        assert!(text.starts_with(heading), "{text}");
        assert!(text.contains("| day | degraded | – | – | – | 2 |"), "{text}");
        assert!(text.contains("| day | a,b\\|c | 3804617 | 0.64 | 0.00 | 2 |"), "{text}");
        assert!(joined.to_csv().starts_with("dataset,method,id,kernel,psnr,ssim\nday,degraded,street,"));
    }
}
