//! Keeps the scores of images and turns them into means and JSON.

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::{EvalConfig, Label};
use crate::core::metrics::{Metric, MetricDefinition};

/// One of the things that are compared: a model, a method, or the degraded image itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Method {
    /// Its name in tables.
    pub name: String,
    /// Whether it stands for "nothing was done", to compare with.
    pub baseline: bool,
}

/// The metrics of one image.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    /// The scene.
    pub id: String,
    /// The kernel that degraded it, where that is known.
    pub kernel: Option<String>,
    /// Index of the method that made the image.
    pub method: usize,
    /// One value a metric.
    pub values: Vec<f64>,
}

/// An image that could not be measured, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Exclusion {
    /// The scene.
    pub id: String,
    /// The kernel, where that is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kernel: Option<String>,
    /// What was wrong.
    pub reason: String,
}

/// All scores of an evaluation.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// The metrics, in the order of the values.
    pub metrics: Vec<Metric>,
    /// What they were computed of.
    pub definition: MetricDefinition,
    /// What was compared.
    pub methods: Vec<Method>,
    /// The scores, image after image.
    pub scores: Vec<Score>,
    /// The images that are in no mean.
    pub excluded: Vec<Exclusion>,
}

impl Evaluation {
    pub(super) fn new(config: &EvalConfig, methods: Vec<Method>) -> Self {
        let (metrics, definition) = (config.metrics.clone(), config.definition);
        Self { metrics, definition, methods, scores: Vec::new(), excluded: Vec::new() }
    }

    pub(super) fn add(&mut self, label: &Label, rows: Vec<Vec<f64>>) {
        self.scores.extend(rows.into_iter().enumerate().map(|(method, values)| Score {
            id: label.id.clone(),
            kernel: label.kernel.clone(),
            method,
            values,
        }));
    }

    /// Records an image that is in no mean.
    pub fn exclude(&mut self, label: &Label, reason: impl Into<String>) {
        let (id, kernel) = (label.id.clone(), label.kernel.clone());
        self.excluded.push(Exclusion { id, kernel, reason: reason.into() });
    }

    /// The kernels, in the order in which they first come.
    pub fn kernels(&self) -> Vec<&str> {
        let mut kernels = Vec::new();
        for kernel in self.scores.iter().filter_map(|score| score.kernel.as_deref()) {
            if !kernels.contains(&kernel) {
                kernels.push(kernel);
            }
        }
        kernels
    }

    /// The mean of each metric over the images of a method, of one kernel or of all; none without images.
    pub fn mean(&self, method: usize, kernel: Option<&str>) -> Option<Vec<f64>> {
        let rows: Vec<_> = self.of(method, kernel).map(|score| &score.values).collect();
        let mean = |i: usize| rows.iter().map(|values| values[i]).sum::<f64>() / rows.len() as f64;
        (!rows.is_empty()).then(|| (0..self.metrics.len()).map(mean).collect())
    }

    /// Number of images of a method.
    pub fn count(&self, method: usize) -> usize {
        self.of(method, None).count()
    }

    fn of<'a>(&'a self, method: usize, kernel: Option<&'a str>) -> impl Iterator<Item = &'a Score> {
        self.scores.iter().filter(move |score| {
            score.method == method && (kernel.is_none() || score.kernel.as_deref() == kernel)
        })
    }

    /// Everything as JSON: `images` and `mean` of the first method that is no baseline (with `method` naming
    /// it), the same of every method under `methods`, `excluded`, and the `definition`. A value that is
    /// infinite (the PSNR of equal images) is null.
    pub fn to_json(&self) -> Value {
        let methods: Vec<Value> = (0..self.methods.len()).map(|method| self.method_to_json(method)).collect();
        let first = self.methods.iter().position(|method| !method.baseline).unwrap_or(0);
        json!({
            "method": self.methods[first].name,
            "images": methods[first]["images"],
            "mean": methods[first]["mean"],
            "methods": methods,
            "excluded": self.excluded,
            "definition": self.definition_to_json(),
        })
    }

    fn definition_to_json(&self) -> Value {
        let mut definition = json!(self.definition);
        definition["domain"] = json!("tone-mapped, clamped to [0, 1]");
        definition["peak"] = json!(1.0);
        definition["ssim-channels"] = json!("mean of red, green and blue");
        definition["metrics"] = json!(self.metrics);
        definition
    }

    fn method_to_json(&self, method: usize) -> Value {
        let image = |score: &Score| {
            let mut image = Map::new();
            image.insert("id".to_owned(), json!(score.id));
            if let Some(kernel) = &score.kernel {
                image.insert("kernel".to_owned(), json!(kernel));
            }
            image.extend(self.named(&score.values));
            Value::Object(image)
        };
        let images: Vec<Value> = self.of(method, None).map(image).collect();
        let mean = |kernel| self.mean(method, kernel).map(|values| self.named(&values));
        let kernels: Map<String, Value> =
            self.kernels().into_iter().map(|kernel| (kernel.to_owned(), json!(mean(Some(kernel))))).collect();
        json!({
            "name": self.methods[method].name,
            "baseline": self.methods[method].baseline,
            "count": images.len(),
            "mean": mean(None),
            "kernels": kernels,
            "images": images,
        })
    }

    fn named(&self, values: &[f64]) -> Map<String, Value> {
        self.metrics
            .iter()
            .zip(values)
            .map(|(metric, value)| (metric.name().to_owned(), json!(value)))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluation() -> Evaluation {
        let methods = [("degraded", true), ("model", false)];
        let methods = methods.map(|(name, baseline)| Method { name: name.to_owned(), baseline }).to_vec();
        let mut evaluation = Evaluation::new(&EvalConfig::default(), methods);
        for (kernel, psnr) in [("r-03", 30.0), ("r+00", 32.0), ("r-03", 34.0)] {
            let label = Label { id: "street".to_owned(), kernel: Some(kernel.to_owned()) };
            evaluation.add(&label, vec![vec![psnr - 10.0, 0.5], vec![psnr, 0.9]]);
        }
        evaluation
    }

    #[test]
    fn averages_by_kernel_and_over_all() {
        let evaluation = evaluation();
        assert_eq!(evaluation.kernels(), ["r-03", "r+00"]);
        assert_eq!(evaluation.mean(1, Some("r-03")).unwrap()[0], 32.0);
        assert_eq!(evaluation.mean(0, None).unwrap()[0], 22.0);
        assert_eq!(evaluation.mean(0, Some("r+90")), None);
    }

    #[test]
    fn puts_the_first_method_that_did_something_on_top() {
        let json = evaluation().to_json();
        assert_eq!(json["method"], "model");
        assert_eq!(json["mean"]["psnr"], 32.0);
        assert_eq!(json["images"].as_array().unwrap().len(), 3);
        assert_eq!(json["images"][1]["kernel"], "r+00");
        assert_eq!(json["methods"][0]["kernels"]["r-03"]["psnr"], 22.0);
        assert_eq!(json["definition"]["quantise"], true);
    }

    #[test]
    fn writes_an_infinite_value_as_null() {
        let mut evaluation = evaluation();
        evaluation.scores[1].values[0] = f64::INFINITY;
        let json = evaluation.to_json();
        assert!(json["images"][0]["psnr"].is_null() && json["mean"]["psnr"].is_null());
    }
}
