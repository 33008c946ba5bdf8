//! Arranges the scores of restorations under right and wrong assumptions as a matrix: the kernel that an image
//! was simulated with by the kernel that the restoration was told.

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use super::document::Document;
use super::values::rows;
use super::{Evaluation, Exclusion};
use crate::core::metrics::Metric;

/// The matrices of every method and metric, as the file `mismatch.json` holds them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Mismatch {
    /// Method after method, one matrix a metric.
    pub matrices: Vec<Matrix>,
}

/// The mean of one metric for every simulated and every assumed kernel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
    #[serde(rename = "mean", deserialize_with = "rows")]
    pub rows: Vec<Vec<f64>>,
    /// Images of each row, which every column is a mean over.
    pub images: Vec<usize>,
    /// The images that are excluded from all means.
    pub excluded: Vec<Exclusion>,
}

impl Matrix {
    /// Takes the matrices, one a metric, out of an evaluation whose methods are the assumed kernels.
    pub fn of(method: &str, evaluation: &Evaluation) -> Vec<Self> {
        let kernels = evaluation.kernels();
        // In the order of the rows, so that what is right stands on the diagonal, however the bank is ordered.
        let place = |assumed: &usize| {
            let name = &evaluation.methods[*assumed].name;
            kernels.iter().position(|kernel| kernel == name).unwrap_or(kernels.len())
        };
        let mut columns: Vec<usize> = (0..evaluation.methods.len()).collect();
        columns.sort_by_key(place);
        let count = |kernel: &&str| evaluation.of(0, Some(kernel)).count();
        let matrix = |(index, metric): (usize, &Metric)| {
            let mean = |kernel: &str, assumed: usize| {
                evaluation.mean(assumed, Some(kernel)).map_or(f64::NAN, |values| values[index])
            };
            let row = |kernel: &&str| columns.iter().map(|assumed| mean(kernel, *assumed)).collect();
            Self {
                method: method.to_owned(),
                metric: *metric,
                simulated: kernels.iter().map(|&kernel| kernel.to_owned()).collect(),
                assumed: columns.iter().map(|assumed| evaluation.methods[*assumed].name.clone()).collect(),
                rows: kernels.iter().map(row).collect(),
                images: kernels.iter().map(count).collect(),
                excluded: evaluation.excluded.clone(),
            }
        };
        evaluation.metrics.iter().enumerate().map(matrix).collect()
    }

    fn check(&self) -> Result<(), String> {
        let (rows, columns) = (self.simulated.len(), self.assumed.len());
        if self.rows.len() != rows || self.rows.iter().any(|row| row.len() != columns) {
            return Err(format!("a matrix has not {rows} rows of {columns} means"));
        }
        if self.images.len() != rows {
            return Err(format!("a matrix of {rows} rows counts the images of {}", self.images.len()));
        }
        Ok(())
    }
}

impl Document for Mismatch {
    const FORMAT: &'static str = "udc-mismatch";
    const COMMAND: &'static str = "udc eval --mismatch";

    fn check(&self) -> Result<(), String> {
        self.matrices.iter().try_for_each(Matrix::check)
    }
}

impl Mismatch {
    /// Arranges evaluations whose methods are the assumed kernels, by the names of what restored.
    pub fn of<'a>(evaluations: impl Iterator<Item = (&'a str, &'a Evaluation)>) -> Self {
        let matrices = evaluations.flat_map(|(method, evaluation)| Matrix::of(method, evaluation));
        Self { matrices: matrices.collect() }
    }

    /// All matrices as lines `method,metric,simulated,assumed,images,mean`.
    ///
    /// # Panics
    /// Never: writing to a string does not fail.
    pub fn to_csv(&self) -> String {
        let mut csv = String::from("method,metric,simulated,assumed,images,mean\n");
        for matrix in &self.matrices {
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
    use super::super::{ComparedMethod, EvalConfig, Label, Score};
    use super::*;

    #[test]
    fn rows_are_simulated_and_columns_assumed() {
        let methods = ["r-03", "r+00"].map(ComparedMethod::restored).to_vec();
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
        let mismatch = Mismatch { matrices };
        let csv = mismatch.to_csv();
        assert!(csv.contains("net,psnr,r-03,r+00,2,21\n"), "{csv}");
    }

    /// As of a bank whose angles are in no order, of whose kernels one has no image.
    #[test]
    fn what_is_right_stands_on_the_diagonal() {
        let assumed = ["r+05", "r+10", "r-05", "r+00"];
        let methods = assumed.map(ComparedMethod::restored).to_vec();
        let mut evaluation = Evaluation::new(&EvalConfig::default(), methods);
        let simulated = ["r-05", "r+00", "r+05"];
        for kernel in simulated {
            let label = Label { kernel: Some(kernel.to_owned()), ..Label::scene("street") };
            let score = |(method, name): (usize, &&str)| Score {
                label: label.clone(),
                method,
                values: vec![if *name == kernel { 40.0 } else { 20.0 }, 0.5],
                regions: Vec::new(),
            };
            evaluation.add([8, 8], assumed.iter().enumerate().map(score).collect());
        }
        let matrix = &Matrix::of("net", &evaluation)[0];
        assert_eq!(matrix.assumed[..3], matrix.simulated[..]);
        assert_eq!(matrix.assumed[3], "r+10");
        for (place, row) in matrix.rows.iter().enumerate() {
            assert!(
                row.iter().enumerate().all(|(column, psnr)| (*psnr > 30.0) == (column == place)),
                "{row:?}"
            );
        }
    }

    #[test]
    fn a_file_of_matrices_is_read_as_it_was_written_or_refused() {
        let names = |names: [&str; 2]| names.map(str::to_owned).to_vec();
        let matrix = Matrix {
            method: "net".to_owned(),
            metric: Metric::Psnr,
            simulated: names(["r-03", "r+00"]),
            assumed: names(["r-03", "r+00"]),
            rows: vec![vec![31.25, f64::INFINITY], vec![21.5, 30.0]],
            images: vec![2, 1],
            excluded: Vec::new(),
        };
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("mismatch.json");
        let write_and_read = |matrix: &Matrix| {
            let text = Mismatch { matrices: vec![matrix.clone()] }.to_json();
            std::fs::write(&path, text).unwrap();
            Mismatch::read(&path)
        };
        assert_eq!(write_and_read(&matrix).unwrap().matrices, std::slice::from_ref(&matrix));
        let mut cut = matrix;
        cut.rows.pop();
        let message = write_and_read(&cut).unwrap_err().to_string();
        assert!(
            message.contains("2 rows of 2 means") && message.contains("udc eval --mismatch"),
            "{message}"
        );
    }
}
