//! Turns restored images and their ground truth into scores, means and tables.

mod evaluation;
mod pairs;
mod tables;

pub use evaluation::{Evaluation, Exclusion, Method, Score};
pub use pairs::{FilePair, FolderPairs, pair_folders, read_tone_mapped};

use crate::core::error::{Error, Result};
use crate::core::image::ToneMappedImage;
use crate::core::metrics::{Metric, MetricDefinition};

/// What is measured, and what happens to images that cannot be.
#[derive(Clone, Debug, PartialEq)]
pub struct EvalConfig {
    /// The metrics, in the order of the tables.
    pub metrics: Vec<Metric>,
    /// What they are computed of.
    pub definition: MetricDefinition,
    /// Whether an image that cannot be measured is excluded by name instead of ending the evaluation.
    pub allow_missing: bool,
}

impl Default for EvalConfig {
    /// All metrics by the published definition, every image required.
    fn default() -> Self {
        let (metrics, definition) = (Metric::ALL.to_vec(), MetricDefinition::default());
        Self { metrics, definition, allow_missing: false }
    }
}

/// A scene with what each method made of it.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The clean image.
    pub ground_truth: ToneMappedImage,
    /// The images to compare with it, one a method.
    pub images: Vec<ToneMappedImage>,
}

/// What a sample is called in tables.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Label {
    /// The scene.
    pub id: String,
    /// The kernel that degraded it, where that is known.
    pub kernel: Option<String>,
}

impl std::fmt::Display for Label {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.kernel {
            Some(kernel) => write!(f, "{} through {kernel}", self.id),
            None => f.write_str(&self.id),
        }
    }
}

/// Measures samples one after another; each holds one image of each of `methods`, in their order.
///
/// # Errors
/// The first sample's that cannot be read or measured, unless such samples may be excluded;
/// [`Error::Unsupported`] when nothing is left to measure; [`Error::Interrupted`].
///
/// # Panics
/// When a sample does not hold one image for each method.
pub fn measure(
    config: &EvalConfig,
    methods: Vec<Method>,
    samples: impl IntoIterator<Item = (Label, Result<Sample>)>,
) -> Result<Evaluation> {
    let mut evaluation = Evaluation::new(config, methods);
    for (label, sample) in samples {
        match sample.and_then(|sample| scores_of(config, evaluation.methods.len(), &sample)) {
            Ok(scores) => evaluation.add(&label, scores),
            Err(Error::Interrupted) => return Err(Error::Interrupted),
            Err(error) if config.allow_missing => evaluation.exclude(&label, error.to_string()),
            Err(error) => return Err(Error::Unsupported(format!("{label}: {error}"))),
        }
    }
    if evaluation.scores.is_empty() {
        return Err(Error::Unsupported("no image is left to measure".to_owned()));
    }
    Ok(evaluation)
}

/// One row of metrics for each method.
fn scores_of(config: &EvalConfig, methods: usize, sample: &Sample) -> Result<Vec<Vec<f64>>> {
    assert_eq!(sample.images.len(), methods, "a sample holds one image for each method");
    let row = |image: &ToneMappedImage| {
        config.metrics.iter().map(|m| m.measure(image, &sample.ground_truth, &config.definition)).collect()
    };
    sample.images.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn flat(size: usize, value: f32) -> ToneMappedImage {
        ToneMappedImage::from_planes(Array3::from_elem((3, size, size), value)).unwrap()
    }

    fn sample(id: &str, size: usize, value: f32) -> (Label, Result<Sample>) {
        let sample = Sample { ground_truth: flat(16, 0.5), images: vec![flat(size, value)] };
        (Label { id: id.to_owned(), kernel: None }, Ok(sample))
    }

    fn methods() -> Vec<Method> {
        vec![Method { name: "restored".to_owned(), baseline: false }]
    }

    #[test]
    fn averages_over_images() {
        let config = EvalConfig { definition: MetricDefinition::float(), ..EvalConfig::default() };
        let evaluation = measure(&config, methods(), [sample("a", 16, 0.6), sample("b", 16, 0.51)]).unwrap();
        let mean = evaluation.mean(0, None).unwrap();
        assert!((mean[0] - 30.0).abs() < 1e-4, "{mean:?}");
    }

    #[test]
    fn names_the_sample_that_cannot_be_measured() {
        let samples = || [sample("good", 16, 0.6), sample("small", 15, 0.6)];
        let message = measure(&EvalConfig::default(), methods(), samples()).unwrap_err().to_string();
        assert!(message.starts_with("small: ") && message.contains("15 × 15"), "{message}");

        let tolerant = EvalConfig { allow_missing: true, ..EvalConfig::default() };
        let evaluation = measure(&tolerant, methods(), samples()).unwrap();
        assert_eq!((evaluation.scores.len(), evaluation.excluded.len()), (1, 1));
        assert_eq!(evaluation.excluded[0].id, "small");
        assert!(measure(&tolerant, methods(), [sample("small", 15, 0.6)]).is_err(), "nothing is left");
    }
}
