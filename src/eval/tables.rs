//! Turns scores into a table for people (Markdown) and one for programs (CSV).

use std::fmt::Write as _;

use super::Evaluation;
use crate::core::metrics::Metric;

impl Evaluation {
    /// One line an image and method: `method,id,kernel,psnr,…`.
    ///
    /// # Panics
    /// Never: writing to a string does not fail.
    pub fn to_csv(&self) -> String {
        let mut csv = String::from("method,id,kernel");
        self.metrics.iter().for_each(|metric| csv.extend([",", metric.name()]));
        for score in &self.scores {
            let name = &self.methods[score.method].name;
            let names =
                [name, &score.id, score.kernel.as_ref().unwrap_or(&String::new())].map(|text| quoted(text));
            write!(csv, "\n{}", names.join(",")).expect("strings take any text");
            score.values.iter().for_each(|value| write!(csv, ",{value}").expect("strings take any text"));
        }
        csv.push('\n');
        csv
    }

    /// The means over all images; each metric by kernel, where there are several; what was left out, and the
    /// definition.
    pub fn to_markdown(&self) -> String {
        let mut text = self.table_of_means();
        let kernels = self.kernels();
        if kernels.len() > 1 {
            for (i, metric) in self.metrics.iter().enumerate() {
                text.push_str(&self.table_by_kernel(i, *metric, &kernels));
            }
        }
        if !self.excluded.is_empty() {
            text.push_str(&format!("\nLeft out of every mean: {} images.\n", self.excluded.len()));
            for exclusion in &self.excluded {
                let kernel =
                    exclusion.kernel.as_ref().map(|kernel| format!(" through {kernel}")).unwrap_or_default();
                text.push_str(&format!("- {}{kernel}: {}\n", exclusion.id, exclusion.reason));
            }
        }
        text.push_str(&format!("\n{}\n", self.definition_in_words()));
        text
    }

    fn table_of_means(&self) -> String {
        let headings = self.metrics.iter().map(|metric| metric.heading().to_owned());
        let mut rows = vec![["method".to_owned(), "images".to_owned()].into_iter().chain(headings).collect()];
        for (method, described) in self.methods.iter().enumerate() {
            let values = self.cells(method, None, &self.metrics);
            let names = [described.name.clone(), self.count(method).to_string()];
            rows.push(names.into_iter().chain(values).collect());
        }
        markdown(&rows)
    }

    fn table_by_kernel(&self, index: usize, metric: Metric, kernels: &[&str]) -> String {
        let heading = std::iter::once("method".to_owned()).chain(kernels.iter().map(|&k| k.to_owned()));
        let mut rows = vec![heading.chain(["mean".to_owned()]).collect::<Vec<_>>()];
        for (method, described) in self.methods.iter().enumerate() {
            let columns = kernels.iter().map(|&kernel| Some(kernel)).chain([None]);
            let cells = columns.map(|kernel| self.cells(method, kernel, &self.metrics)[index].clone());
            rows.push(std::iter::once(described.name.clone()).chain(cells).collect());
        }
        format!("\n{} by kernel\n\n{}", metric.heading(), markdown(&rows))
    }

    fn cells(&self, method: usize, kernel: Option<&str>, metrics: &[Metric]) -> Vec<String> {
        match self.mean(method, kernel) {
            Some(values) => {
                let cell = |(metric, value): (&Metric, f64)| match value.is_finite() {
                    true => format!("{value:.*}", metric.decimals()),
                    false => "∞".to_owned(),
                };
                metrics.iter().zip(values).map(cell).collect()
            }
            None => vec!["–".to_owned(); metrics.len()],
        }
    }

    fn definition_in_words(&self) -> String {
        let definition = &self.definition;
        let rounding = if definition.quantise { "rounded to 8 bits" } else { "not rounded" };
        let border = match definition.border {
            0 => String::new(),
            border => format!(", {border} pixels cut from each side"),
        };
        format!(
            "Of tone-mapped images clamped to [0, 1], {rounding}{border}; peak 1. SSIM: {0} × {0} Gaussian window, \
             σ = {1}, whole windows only, mean of the channels.",
            definition.ssim_window, definition.ssim_sigma
        )
    }
}

/// A Markdown table with its first row as the heading, first column to the left, the others to the right.
fn markdown(rows: &[Vec<String>]) -> String {
    let line = |cells: &[String]| {
        let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let columns = rows[0].len();
    let rule = format!("|---|{}\n", "---:|".repeat(columns - 1));
    let body: String = rows[1..].iter().map(|row| line(row)).collect();
    line(&rows[0]) + &rule + &body
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{EvalConfig, Evaluation, Label, Method};

    fn evaluation() -> Evaluation {
        let methods = [("degraded", true), ("a,b|c", false)];
        let methods = methods.map(|(name, baseline)| Method { name: name.to_owned(), baseline }).to_vec();
        let mut evaluation = Evaluation::new(&EvalConfig::default(), methods);
        for (kernel, psnr) in [("r-03", 30.0), ("r+00", f64::INFINITY)] {
            let label = Label { id: "street".to_owned(), kernel: Some(kernel.to_owned()) };
            evaluation.add(&label, vec![vec![20.25, 0.5], vec![psnr, 0.91239]]);
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
        evaluation.exclude(&Label { id: "dark".to_owned(), kernel: None }, "is missing");
        let text = evaluation.to_markdown();
        assert!(text.starts_with("| method | images | PSNR (dB) | SSIM |\n|---|---:|---:|---:|\n"), "{text}");
        assert!(text.contains("| degraded | 2 | 20.25 | 0.5000 |"), "{text}");
        assert!(text.contains("| a,b\\|c | 30.00 | ∞ | ∞ |"), "{text}");
        assert!(text.contains("Left out of every mean: 1 images.\n- dark: is missing"), "{text}");
        assert!(text.contains("rounded to 8 bits"), "{text}");
    }
}
