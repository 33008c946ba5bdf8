//! The results of an evaluation as its file `metrics.json` holds them, and as reports read them.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::document::Document;
use super::evaluation::Evaluation;
use super::measured::Measured;
use super::regions::Region;
use super::score::{ComparedMethod, Cost, Exclusion, Score};
use super::tone::{ToneSource, ToneSpeaker};
use super::values::MetricValues;
use crate::core::metrics::{Metric, MetricDefinition};
use crate::core::primaries::Primaries;

/// Everything that an evaluation found, and the definition of every number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Results {
    /// The name of the first method that is no baseline.
    pub method: String,
    /// That method's images.
    pub images: Vec<ImageResults>,
    /// Its means over them.
    pub mean: MetricValues,
    /// Every method, in the order of tables.
    pub methods: Vec<MethodResults>,
    /// The kernels of the images, in the order of their rotations.
    pub kernels: Vec<KernelResults>,
    /// The sizes of the images.
    pub sizes: Vec<SizeResults>,
    /// The images that are excluded from all means.
    pub excluded: Vec<Exclusion>,
    /// What the numbers are.
    pub definition: Definition,
}

/// One of the things that were compared.
///
/// Unknown keys are not refused here, nor in [`ImageResults`] and [`Definition`], where other structures lie open.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct MethodResults {
    /// Its name in tables.
    pub name: String,
    /// Whether it stands for "nothing was done".
    pub baseline: bool,
    /// The dataset that it was measured on, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dataset: Option<String>,
    /// What it costs, where that is counted.
    #[serde(flatten)]
    pub cost: Option<Cost>,
    /// The number of its images.
    pub count: usize,
    /// The means over all of them.
    pub mean: MetricValues,
    /// The means over the images of each kernel.
    pub kernels: BTreeMap<String, MetricValues>,
    /// Each of them.
    pub images: Vec<ImageResults>,
    /// The metrics over parts of the images, where they were asked for.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub regions: BTreeMap<Region, RegionResults>,
}

/// The metrics of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageResults {
    /// The scene.
    pub id: String,
    /// The kernel that degraded it, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kernel: Option<String>,
    /// The metrics.
    #[serde(flatten)]
    pub values: MetricValues,
}

/// The metrics of one region over all images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegionResults {
    /// The images that have such pixels.
    pub images: usize,
    /// Their number.
    pub pixels: usize,
    /// The metrics that there are pixels for.
    pub mean: MetricValues,
}

/// A kernel that degraded images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct KernelResults {
    /// Its name.
    pub name: String,
    /// Its rotation, where it has one.
    pub angle_deg: Option<f64>,
}

/// How many images have a size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SizeResults {
    /// Rows of pixels.
    pub height: usize,
    /// Columns of pixels.
    pub width: usize,
    /// The images.
    pub images: usize,
}

/// What the numbers of an evaluation are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct Definition {
    /// What the metrics are computed of.
    #[serde(flatten)]
    pub images: MetricDefinition,
    /// The values that are compared, in words.
    pub domain: String,
    /// The peak of PSNR.
    pub peak: f64,
    /// What is made of the channels' SSIM, in words.
    pub ssim_channels: String,
    /// The metrics, in the order of tables.
    pub metrics: Vec<Metric>,
    /// The curve of images that were tone-mapped to be measured, where it was to be found out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tone: Option<ToneDefinition>,
    /// What images of datasets were measured.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub datasets: Vec<Measured>,
    /// What the costs count, in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gmac: Option<String>,
    /// The regions in words, by their names.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub regions: Option<BTreeMap<String, String>>,
}

impl Definition {
    /// What decides whether its numbers can be compared with those of another: rounding, border, window, curves and other primaries
    /// than those of sRGB, in words.
    pub fn in_short(&self) -> String {
        let MetricDefinition { quantise, border, ssim_window, ssim_sigma } = self.images;
        let rounding = if quantise { "rounded to 8 bits" } else { "not rounded" };
        let of_folders = self.tone.iter().map(|tone| (tone.alpha, tone.x_max));
        let curves = of_folders.chain(self.datasets.iter().map(|measured| (measured.alpha, measured.x_max)));
        let curves: BTreeSet<String> =
            curves.map(|(alpha, x_max)| format!("alpha {alpha} and x-max {x_max}")).collect();
        let curves: Vec<String> = curves.into_iter().collect();
        let colours = self.datasets.iter().filter_map(|measured| measured.primaries);
        let colours: BTreeSet<String> =
            colours.map(|primaries| format!(", {}", Primaries::name_of(Some(primaries)))).collect();
        let colours: String = colours.into_iter().collect();
        format!(
            "{rounding}, border {border}, SSIM window {ssim_window} with sigma {ssim_sigma}, {}{colours}",
            if curves.is_empty() { "curve unknown".to_owned() } else { curves.join(", ") }
        )
    }
}

/// The curve that images of folders were tone-mapped by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct ToneDefinition {
    /// α of the curve.
    pub alpha: f32,
    /// x_max, at which it cuts.
    pub x_max: f32,
    /// Who said so.
    pub said_by: ToneSpeaker,
    /// What was done with images that were tone-mapped already, in words.
    pub tone_mapped_files: String,
}

impl Document for Results {
    const FORMAT: &'static str = "udc-evaluation";
    const COMMAND: &'static str = "udc eval";
}

impl Results {
    /// Gathers what an evaluation found.
    pub fn of(evaluation: &Evaluation) -> Self {
        let methods: Vec<MethodResults> =
            (0..evaluation.methods.len()).map(|method| MethodResults::of(evaluation, method)).collect();
        let first = &methods[evaluation.methods.iter().position(|method| !method.baseline).unwrap_or(0)];
        let size = |&([height, width], images): &([usize; 2], usize)| SizeResults { height, width, images };
        let kernel =
            |(name, angle_deg): (&str, Option<f64>)| KernelResults { name: name.to_owned(), angle_deg };
        Self {
            method: first.name.clone(),
            images: first.images.clone(),
            mean: first.mean.clone(),
            kernels: evaluation.rotations().into_iter().map(kernel).collect(),
            sizes: evaluation.sizes.iter().map(size).collect(),
            excluded: evaluation.excluded.clone(),
            definition: Definition::of(evaluation),
            methods,
        }
    }
}

impl MethodResults {
    fn of(evaluation: &Evaluation, method: usize) -> Self {
        let ComparedMethod { name, baseline, dataset, cost } = evaluation.methods[method].clone();
        let mean = |kernel| evaluation.mean(method, kernel).map(|values| named(&evaluation.metrics, values));
        let kernels = evaluation.kernels().into_iter();
        let kernels = kernels.filter_map(|kernel| Some((kernel.to_owned(), mean(Some(kernel))?)));
        let image = |score: &Score| ImageResults {
            id: score.label.id.clone(),
            kernel: score.label.kernel.clone(),
            values: named(&evaluation.metrics, score.values.iter().copied()),
        };
        let images: Vec<ImageResults> = evaluation.of(method, None).map(image).collect();
        let regions = evaluation.regions(method).into_iter().map(|part| {
            let there = evaluation.regional.iter().zip(part.values);
            let mean = there.filter_map(|(metric, value)| Some((*metric, value?))).collect();
            (part.region, RegionResults { images: part.images, pixels: part.pixels, mean })
        });
        Self {
            name,
            baseline,
            dataset,
            cost,
            count: images.len(),
            mean: mean(None).unwrap_or_default(),
            kernels: kernels.collect(),
            images,
            regions: regions.collect(),
        }
    }

    /// The name in charts: after its dataset's, where there are several.
    pub fn label(&self) -> String {
        match &self.dataset {
            Some(dataset) => format!("{dataset}: {}", self.name),
            None => self.name.clone(),
        }
    }
}

impl Definition {
    fn of(evaluation: &Evaluation) -> Self {
        let gmac = "10⁹ multiply-accumulates of all convolutions; gmac-evaluated: mean over the images";
        let counts_cost = evaluation.methods.iter().any(|method| method.cost.is_some());
        Self {
            images: evaluation.definition,
            domain: "tone-mapped, clamped to [0, 1]".to_owned(),
            peak: 1.0,
            ssim_channels: "mean of red, green and blue".to_owned(),
            metrics: evaluation.metrics.clone(),
            tone: evaluation.tone.map(ToneDefinition::from),
            datasets: evaluation.measured.clone(),
            gmac: counts_cost.then(|| gmac.to_owned()),
            regions: evaluation.has_regions().then(Region::definitions),
        }
    }
}

impl From<ToneSource> for ToneDefinition {
    fn from(ToneSource { curve, said_by }: ToneSource) -> Self {
        let tone_mapped_files = "mapped back by the curve that they say, if another, then by this one; those that say none \
                                 are taken as they are";
        Self {
            alpha: curve.alpha,
            x_max: curve.x_max,
            said_by,
            tone_mapped_files: tone_mapped_files.to_owned(),
        }
    }
}

fn named(metrics: &[Metric], values: impl IntoIterator<Item = f64>) -> MetricValues {
    metrics.iter().copied().zip(values).collect()
}

#[cfg(test)]
mod tests {
    use super::super::score::RegionScore;
    use super::super::{EvalConfig, Label};
    use super::*;
    use crate::core::metrics::Pool;
    use crate::core::tone::ToneCurve;
    use crate::dataset::{KernelChoice, Split};
    use serde_json::{Value, json};

    /// Two kernels, the second image equal to its ground truth, and regions of which one has no pixels.
    fn evaluation() -> Evaluation {
        let methods = vec![ComparedMethod::baseline("degraded"), ComparedMethod::restored("model")];
        let mut evaluation = Evaluation::new(&EvalConfig::default(), methods);
        for (kernel, angle, psnr) in
            [("r-03", -3.0, 30.0), ("r+00", 0.0, f64::INFINITY), ("r-03", -3.0, 34.0)]
        {
            let label =
                Label { kernel: Some(kernel.to_owned()), angle_deg: Some(angle), ..Label::scene("street") };
            let part = |region| {
                let count = if region == Region::Flare { 0 } else { 5 };
                let pool = |sum: f64| Pool { sum: sum * count as f64, count };
                RegionScore { region, pixels: count as usize, pools: vec![pool(0.01), pool(0.5)] }
            };
            let score = |method, values| Score {
                label: label.clone(),
                method,
                values,
                regions: Region::ALL.map(part).to_vec(),
            };
            evaluation.add([8, 9], vec![score(0, vec![20.0, 0.5]), score(1, vec![psnr, 0.875])]);
        }
        evaluation
    }

    /// An evaluation with everything that there may be.
    fn rich() -> Evaluation {
        let mut evaluation = evaluation();
        evaluation.exclude(&Label::scene("dark"), "is missing");
        evaluation.tone = Some(ToneSource { curve: ToneCurve::default(), said_by: ToneSpeaker::Nobody });
        evaluation.measured = vec![Measured {
            dataset: None,
            alpha: 0.3,
            x_max: 500.0,
            primaries: None,
            margin: 2,
            split: Split::Test,
            kernels: KernelChoice::Only(vec!["r+00".to_owned()]),
            limit: None,
        }];
        evaluation.methods[1].cost = Some(Cost { parameters: 7, gmac_published: 0.5, gmac_evaluated: 0.25 });
        Evaluation::join(vec![("day".to_owned(), evaluation)])
    }

    fn json_of(evaluation: &Evaluation) -> Value {
        serde_json::from_str(&Results::of(evaluation).to_json()).unwrap()
    }

    #[test]
    fn numbers_of_other_primaries_are_defined_otherwise() {
        let mut evaluation = rich();
        let of_srgb = Results::of(&evaluation).definition.in_short();
        evaluation.measured[0].primaries = Some(Primaries::BT2020);
        let of_bt2020 = Results::of(&evaluation).definition.in_short();
        assert_eq!(of_bt2020, of_srgb + ", BT.2020 primaries");
    }

    #[test]
    fn puts_the_first_method_that_did_something_on_top() {
        let json = json_of(&evaluation());
        assert_eq!(json["method"], "model");
        assert_eq!(json["mean"]["ssim"], 0.875);
        assert_eq!(json["images"].as_array().unwrap().len(), 3);
        assert_eq!(json["images"][1]["kernel"], "r+00");
        assert_eq!(json["methods"][1]["kernels"]["r-03"]["psnr"], 32.0);
        assert_eq!(json["kernels"][0], json!({"name": "r-03", "angle-deg": -3.0}));
        assert_eq!(json["definition"]["quantise"], true);
        assert_eq!(json["sizes"][0], json!({"height": 8, "width": 9, "images": 3}));
    }

    #[test]
    fn an_infinite_number_is_null_and_a_missing_one_absent() {
        let json = json_of(&evaluation());
        assert!(json["images"][1]["psnr"].is_null() && json["mean"]["psnr"].is_null());
        let regions = &json["methods"][1]["regions"];
        assert_eq!(regions["flare"], json!({"images": 0, "pixels": 0, "mean": {}}));
        assert_eq!(regions["rest"]["pixels"], 15);
        assert_eq!(regions["rest"]["mean"]["psnr"], 20.0);
    }

    #[test]
    fn the_file_is_read_as_it_was_written() {
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("metrics.json");
        for evaluation in [evaluation(), rich()] {
            let results = Results::of(&evaluation);
            std::fs::write(&path, results.to_json()).unwrap();
            assert_eq!(Results::read(&path).unwrap(), results);
        }
        let damaged = Results::of(&rich()).to_json().replacen("\"psnr\"", "\"pnsr\"", 1);
        std::fs::write(&path, damaged).unwrap();
        let message = Results::read(&path).unwrap_err().to_string();
        assert!(message.contains("metrics.json: is damaged") && message.contains("pnsr"), "{message}");
        assert!(message.ends_with("make it anew with `udc eval`"), "{message}");
    }
}
