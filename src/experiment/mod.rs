//! Turns restored images and their ground truth into scores, means and tables: of two folders, of candidates on datasets,
//! told right and wrong kernels, of scenes of a monitor's range, of trainings.

mod alike;
mod candidate;
mod comparison;
mod document;
mod estimate;
mod evaluation;
mod files;
mod flare;
mod folders;
mod ldr;
mod matrix;
mod measured;
mod measurement;
mod measures;
mod names;
mod pairs;
mod part;
mod pictures;
mod regions;
mod results;
mod run;
mod score;
mod sweep;
mod tables;
mod tone;
mod values;

pub use alike::Appearance;
pub use candidate::{Candidate, RestorationMethod};
pub use comparison::{Comparison, ImagesConfig};
pub use document::Document;
pub use evaluation::Evaluation;
pub use files::{LDR, MISMATCH, REGIONS, RESULTS, ResultsFolder, plot_of_matrix, plots_of};
pub use flare::Flare;
pub use folders::Folders;
pub use ldr::{Ldr, LdrDefinition, LdrImage, LdrResults, LdrRow, Ranges};
pub use matrix::{Matrix, Mismatch};
pub use measured::Measured;
pub use measurement::Measurement;
pub use measures::{measures, validation_measures};
pub use names::{name_among, name_of};
pub use pairs::{ComparedImage, FilePair, FolderPairs, pair_folders, read_tone_mapped};
pub use part::{MergedParts, Part, PartFiles};
pub use pictures::{FOLDER as PICTURES, KeptPictures, PictureName};
pub use regions::{Region, Regions};
pub use results::{
    Definition, ImageResults, KernelResults, MethodResults, RegionResults, Results, SizeResults,
    ToneDefinition,
};
pub use run::{Experiment, ExperimentConfig, Findings, files_of_evaluation};
pub use score::{ComparedMethod, Cost, Exclusion, Label, RegionScore, Score};
pub use sweep::{
    EarlierRows, FailedRow, RowResults, SingleResults, Sweep, SweepConfig, SweepEntry, SweepEvent,
    SweepResults,
};
pub use tables::{cell, markdown, quoted};
pub use tone::{ToneSource, ToneSpeaker};
pub use values::MetricValues;

use std::collections::BTreeMap;

use serde_json::json;

use crate::core::error::Result;
use crate::core::image::ToneMappedImage;
use crate::core::metrics::{Measure, Metric, MetricDefinition};
use crate::core::progress::Progress;

/// What is measured, and what happens to images that cannot be.
#[derive(Clone, Debug)]
pub struct EvalConfig {
    /// The metrics, in the order of the tables.
    pub metrics: Vec<Measure>,
    /// What they are computed of.
    pub definition: MetricDefinition,
    /// Whether an image that cannot be measured is excluded by name instead of ending the evaluation.
    pub allow_missing: bool,
}

impl Default for EvalConfig {
    /// PSNR and SSIM by the published definition, every image required.
    fn default() -> Self {
        let metrics = [Metric::Psnr, Metric::Ssim].map(Measure::of).to_vec();
        Self { metrics, definition: MetricDefinition::default(), allow_missing: false }
    }
}

impl EvalConfig {
    /// What decides the numbers, by what it is called.
    fn describe(&self) -> BTreeMap<String, String> {
        let Self { metrics, definition, allow_missing } = self;
        let metrics: Vec<Metric> = metrics.iter().map(Measure::metric).collect();
        [
            ("metrics", json!(metrics)),
            ("definition", json!(definition)),
            ("allow-missing", json!(allow_missing)),
        ]
        .map(|(key, value)| (key.to_owned(), value.to_string()))
        .into()
    }
}

/// Whom an experiment tells what happens.
#[derive(Clone, Copy)]
pub struct Listener<'a> {
    /// Where to report, and whom to ask whether to stop.
    pub progress: &'a Progress,
    /// Where warnings go.
    pub warn: &'a (dyn Fn(&str) + Sync),
}

/// A scene with what each method made of it.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The clean image.
    pub ground_truth: ToneMappedImage,
    /// The images to compare with it, one a method.
    pub images: Vec<ToneMappedImage>,
    /// Its parts, to be measured each for itself.
    pub regions: Option<Regions>,
}

/// Measures samples one after another; each holds one image of each of `methods`, in their order.
///
/// # Errors
/// The first sample's that cannot be read or measured, unless such samples may be excluded;
/// [`Error::Unsupported`](crate::core::error::Error::Unsupported) when nothing is left to measure;
/// [`Error::Interrupted`](crate::core::error::Error::Interrupted).
///
/// # Panics
/// When a sample does not hold one image for each method.
pub fn measure(
    config: &EvalConfig,
    methods: Vec<ComparedMethod>,
    samples: impl IntoIterator<Item = (Label, Result<Sample>)>,
) -> Result<Evaluation> {
    measure_part(config, methods, samples.into_iter().map(Ok))?.check_any()
}

/// Measures a part of the samples, which may be left without any. An error in place of a sample and its label is none of the
/// sample, as one of writing, and ends the measurement in any case.
fn measure_part(
    config: &EvalConfig,
    methods: Vec<ComparedMethod>,
    samples: impl IntoIterator<Item = Result<(Label, Result<Sample>)>>,
) -> Result<Evaluation> {
    let mut evaluation = Evaluation::new(config, methods);
    for sample in samples {
        let (label, sample) = sample?;
        match sample.and_then(|sample| scores_of(config, &evaluation, &label, &sample)) {
            Ok((size, scores)) => evaluation.add(size, scores),
            Err(error) if error.is_interrupt() => return Err(error),
            Err(error) if config.allow_missing => evaluation.exclude(&label, error.in_full()),
            Err(error) => return Err(error.while_doing(label.to_string())),
        }
    }
    Ok(evaluation)
}

/// Height and width of a sample, and one score for each method.
fn scores_of(
    config: &EvalConfig,
    evaluation: &Evaluation,
    label: &Label,
    sample: &Sample,
) -> Result<([usize; 2], Vec<Score>)> {
    assert_eq!(sample.images.len(), evaluation.methods.len(), "a sample holds one image for each method");
    let truth = &sample.ground_truth;
    let score = |(method, image): (usize, &ToneMappedImage)| {
        let values = config.metrics.iter().map(|m| m.compare(image, truth, &config.definition));
        let regions = match &sample.regions {
            Some(regions) => region_scores(config, image, truth, regions)?,
            None => Vec::new(),
        };
        Ok(Score { label: label.clone(), method, values: values.collect::<Result<_>>()?, regions })
    };
    let scores = sample.images.iter().enumerate().map(score).collect::<Result<_>>()?;
    Ok(([truth.height(), truth.width()], scores))
}

fn region_scores(
    config: &EvalConfig,
    image: &ToneMappedImage,
    truth: &ToneMappedImage,
    regions: &Regions,
) -> Result<Vec<RegionScore>> {
    let metrics = score::pixelwise(&config.metrics);
    let of_region = |region: Region| {
        let mask = regions.mask(region);
        let pool = |metric: &Metric| metric.pool(image, truth, &config.definition, Some(&mask));
        let pools = metrics.iter().map(pool).collect::<Result<_>>()?;
        Ok(RegionScore { region, pixels: regions.count(region), pools })
    };
    Region::ALL.into_iter().map(of_region).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::error::Error;
    use ndarray::Array3;

    fn flat(size: usize, value: f32) -> ToneMappedImage {
        ToneMappedImage::from_planes(Array3::from_elem((3, size, size), value)).unwrap()
    }

    fn sample(id: &str, size: usize, value: f32) -> (Label, Result<Sample>) {
        let sample = Sample { ground_truth: flat(16, 0.5), images: vec![flat(size, value)], regions: None };
        (Label::scene(id), Ok(sample))
    }

    fn methods() -> Vec<ComparedMethod> {
        vec![ComparedMethod::restored("restored")]
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
        let message = measure(&EvalConfig::default(), methods(), samples()).unwrap_err().in_full();
        assert!(message.starts_with("small: ") && message.contains("15 × 15"), "{message}");

        let tolerant = EvalConfig { allow_missing: true, ..EvalConfig::default() };
        let evaluation = measure(&tolerant, methods(), samples()).unwrap();
        assert_eq!((evaluation.scores.len(), evaluation.excluded.len()), (1, 1));
        assert_eq!(evaluation.excluded[0].id, "small");
        assert!(measure(&tolerant, methods(), [sample("small", 15, 0.6)]).is_err(), "nothing is left");
    }

    fn refused_by_the_system(action: &'static str) -> Error {
        Error::io(action, "a.exr", std::io::ErrorKind::PermissionDenied.into())
    }

    #[test]
    fn the_systems_reason_is_told() {
        let samples = || [sample("good", 16, 0.6), (Label::scene("a"), Err(refused_by_the_system("read")))];
        let said = measure(&EvalConfig::default(), methods(), samples()).unwrap_err().in_full();
        assert_eq!(said, "a: cannot read a.exr: permission denied");
        let tolerant = EvalConfig { allow_missing: true, ..EvalConfig::default() };
        let evaluation = measure(&tolerant, methods(), samples()).unwrap();
        assert_eq!(evaluation.excluded[0].reason, "cannot read a.exr: permission denied");
    }

    #[test]
    fn a_file_that_cannot_be_written_ends_what_leaves_images_out() {
        let tolerant = EvalConfig { allow_missing: true, ..EvalConfig::default() };
        let samples = [Ok(sample("good", 16, 0.6)), Err(refused_by_the_system("write"))];
        let said = measure_part(&tolerant, methods(), samples).unwrap_err().in_full();
        assert_eq!(said, "cannot write a.exr: permission denied");
    }
}
