//! Arranges the scores of restorations under right and wrong assumptions as a matrix: the kernel that an image
//! was simulated with by the kernel that the restoration was told.

use std::fmt::Write as _;

use serde_json::{Value, json};

use super::{Evaluation, Exclusion};
use crate::core::metrics::Metric;

/// The mean of one metric for every simulated and every assumed kernel.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    /// What restored.
    pub method: String,
    /// What was measured.
    pub metric: Metric,
    /// The kernels that the images were simulated with, a row each.
    pub simulated: Vec<String>,
    /// The kernels that the restoration was told, a column each.
    pub assumed: Vec<String>,
    /// The means, row by row.
    pub rows: Vec<Vec<f64>>,
    /// Images of each row, which every column is a mean over.
    pub images: Vec<usize>,
    /// The images that are in no mean.
    pub excluded: Vec<Exclusion>,
}

impl Matrix {
    /// Takes the matrices, one a metric, out of an evaluation whose methods are the assumed kernels.
    pub fn of(method: &str, evaluation: &Evaluation) -> Vec<Self> {
        let kernels = evaluation.kernels();
        let count = |kernel: &&str| evaluation.of(0, Some(kernel)).count();
        let matrix = |(index, metric): (usize, &Metric)| {
            let mean = |kernel: &str, assumed: usize| {
                evaluation.mean(assumed, Some(kernel)).map_or(f64::NAN, |values| values[index])
            };
            let row = |kernel: &&str| (0..evaluation.methods.len()).map(|j| mean(kernel, j)).collect();
            Self {
                method: method.to_owned(),
                metric: *metric,
                simulated: kernels.iter().map(|&kernel| kernel.to_owned()).collect(),
                assumed: evaluation.methods.iter().map(|assumed| assumed.name.clone()).collect(),
                rows: kernels.iter().map(row).collect(),
                images: kernels.iter().map(count).collect(),
                excluded: evaluation.excluded.clone(),
            }
        };
        evaluation.metrics.iter().enumerate().map(matrix).collect()
    }

    /// The matrix as JSON; a mean that is infinite is null.
    pub fn to_json(&self) -> Value {
        json!({
            "method": self.method, "metric": self.metric, "simulated": self.simulated, "assumed": self.assumed,
            "mean": self.rows, "images": self.images, "excluded": self.excluded,
        })
    }

    /// The matrices of a file that `udc eval --mismatch` wrote; a mean that is null is infinite.
    ///
    /// # Errors
    /// What is not as [`to_json`](Self::to_json) writes it.
    pub fn list_from_json(file: &Value) -> Result<Vec<Self>, String> {
        let matrices = file["matrices"].as_array().ok_or("lists no matrices")?;
        matrices.iter().map(Self::from_json).collect()
    }

    fn from_json(json: &Value) -> Result<Self, String> {
        let names = |key: &str| {
            let list = json[key].as_array().ok_or_else(|| format!("has no list `{key}`"))?;
            list.iter()
                .map(|name| {
                    name.as_str().map(str::to_owned).ok_or_else(|| format!("has a `{key}` that is no name"))
                })
                .collect::<Result<Vec<_>, _>>()
        };
        let (simulated, assumed) = (names("simulated")?, names("assumed")?);
        let metric = serde_json::from_value(json["metric"].clone()).map_err(|_| "has an unknown metric")?;
        let rows = json["mean"].as_array().ok_or("has no list `mean`")?;
        let value = |value: &Value| match value {
            Value::Null => Ok(f64::INFINITY),
            value => value.as_f64().ok_or("has a mean that is no number"),
        };
        let row =
            |row: &Value| row.as_array().ok_or("has a row that is no list")?.iter().map(value).collect();
        let rows: Vec<Vec<f64>> = rows.iter().map(row).collect::<Result<_, &str>>()?;
        if rows.len() != simulated.len() || rows.iter().any(|row| row.len() != assumed.len()) {
            return Err(format!("has not {} rows of {} means", simulated.len(), assumed.len()));
        }
        let images = json["images"].as_array().map_or(&[][..], Vec::as_slice).iter();
        let images = images.filter_map(|count| usize::try_from(count.as_u64()?).ok()).collect();
        let method = json["method"].as_str().ok_or("has no method")?.to_owned();
        Ok(Self { method, metric, simulated, assumed, rows, images, excluded: Vec::new() })
    }

    /// All matrices as lines `method,metric,simulated,assumed,images,mean`.
    ///
    /// # Panics
    /// Never: writing to a string does not fail.
    pub fn to_csv(matrices: &[Self]) -> String {
        let mut csv = String::from("method,metric,simulated,assumed,images,mean\n");
        for matrix in matrices {
            let method = super::tables::quoted(&matrix.method);
            for (row, (simulated, images)) in matrix.simulated.iter().zip(&matrix.images).enumerate() {
                for (assumed, mean) in matrix.assumed.iter().zip(&matrix.rows[row]) {
                    let metric = matrix.metric.name();
                    writeln!(csv, "{method},{metric},{simulated},{assumed},{images},{mean}")
                        .expect("strings take any text");
                }
            }
        }
        csv
    }
}

#[cfg(test)]
mod tests {
    use super::super::{EvalConfig, Label, Method, Score};
    use super::*;

    #[test]
    fn rows_are_simulated_and_columns_assumed() {
        let methods = ["r-03", "r+00"].map(Method::restored).to_vec();
        let mut evaluation = Evaluation::new(&EvalConfig::default(), methods);
        for (kernel, right, wrong) in [("r-03", 30.0, 20.0), ("r+00", 21.0, 31.0), ("r-03", 32.0, 22.0)] {
            let label = Label { kernel: Some(kernel.to_owned()), ..Label::scene("street") };
            let score = |method, psnr| Score {
                label: label.clone(),
                method,
                values: vec![psnr, 0.5],
                regions: Vec::new(),
            };
            evaluation.add([8, 8], vec![score(0, right), score(1, wrong)]);
        }
        let matrices = Matrix::of("net", &evaluation);
        assert_eq!(matrices.len(), 2, "one a metric");
        assert_eq!(matrices[0].rows, [[31.0, 21.0], [21.0, 31.0]]);
        assert_eq!(matrices[0].images, [2, 1]);
        let csv = Matrix::to_csv(&matrices);
        assert!(csv.contains("net,psnr,r-03,r+00,2,21\n"), "{csv}");
        assert_eq!(matrices[1].to_json()["mean"][1][0], 0.5);

        let file = json!({"matrices": matrices.iter().map(Matrix::to_json).collect::<Vec<_>>()});
        assert_eq!(Matrix::list_from_json(&file).unwrap(), matrices);
        let mut cut = file.clone();
        cut["matrices"][0]["mean"].as_array_mut().unwrap().pop();
        assert!(Matrix::list_from_json(&cut).unwrap_err().contains("2 rows of 2 means"));
    }
}
