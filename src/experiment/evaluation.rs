//! Keeps the scores of images and turns them into means.

use std::cmp::Ordering;

use serde::{Deserialize, Serialize};

use super::EvalConfig;
use super::measured::Measured;
use super::regions::Region;
use super::score::{ComparedMethod, Exclusion, Label, Score, pixelwise};
use super::tone::ToneSource;
use crate::core::error::{Error, Result};
use crate::core::metrics::{Measure, Metric, MetricDefinition, Pool};

/// All scores of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Evaluation {
    /// The metrics, in the order of the values.
    pub metrics: Vec<Metric>,
    /// Those that are taken over regions, in the order of their pools.
    pub regional: Vec<Metric>,
    /// What they were computed of.
    pub definition: MetricDefinition,
    /// The curve of images that were tone-mapped to be measured, where it was to be found out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tone: Option<ToneSource>,
    /// What images of datasets were measured, dataset after dataset.
    pub measured: Vec<Measured>,
    /// What was compared.
    pub methods: Vec<ComparedMethod>,
    /// The scores, image after image.
    pub scores: Vec<Score>,
    /// Heights and widths of the images that were measured, with the number of images of each.
    pub sizes: Vec<([usize; 2], usize)>,
    /// The images that are excluded from all means.
    pub excluded: Vec<Exclusion>,
}

/// The metrics of one region over all images of a method.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RegionMean {
    pub(super) region: Region,
    /// The images that have such pixels.
    pub(super) images: usize,
    /// Their number.
    pub(super) pixels: usize,
    /// One value for each regional metric; none without pixels.
    pub(super) values: Vec<Option<f64>>,
}

impl Evaluation {
    pub(super) fn new(config: &EvalConfig, methods: Vec<ComparedMethod>) -> Self {
        Self {
            metrics: config.metrics.iter().map(Measure::metric).collect(),
            regional: pixelwise(&config.metrics),
            definition: config.definition,
            tone: None,
            measured: Vec::new(),
            methods,
            scores: Vec::new(),
            sizes: Vec::new(),
            excluded: Vec::new(),
        }
    }

    /// Puts evaluations of several datasets into one, whose methods say which dataset they are of.
    ///
    /// # Panics
    /// Without any evaluation, or when they are of different metrics: broken invariants of the caller.
    pub fn join(named: Vec<(String, Self)>) -> Self {
        let mut named = named.into_iter();
        let (first, mut joined) = named.next().expect("there is an evaluation to join");
        joined.belong_to(&first);
        for (dataset, mut other) in named {
            assert_eq!((&joined.metrics, &joined.definition), (&other.metrics, &other.definition));
            other.belong_to(&dataset);
            let offset = joined.methods.len();
            other.scores.iter_mut().for_each(|score| score.method += offset);
            other.sizes.iter().for_each(|(size, count)| joined.count_size(*size, *count));
            joined.measured.extend(other.measured);
            joined.methods.extend(other.methods);
            joined.scores.extend(other.scores);
            joined.excluded.extend(other.excluded);
        }
        joined
    }

    /// Goes on with what was measured, in the same way, on the images that come next.
    pub(super) fn go_on_with(&mut self, next: Self) {
        next.sizes.iter().for_each(|(size, count)| self.count_size(*size, *count));
        self.scores.extend(next.scores);
        self.excluded.extend(next.excluded);
    }

    /// Refuses an evaluation without any image.
    ///
    /// # Errors
    /// [`Error::Unsupported`], naming the first image that was excluded.
    pub(super) fn check_any(self) -> Result<Self> {
        match (self.scores.first(), self.excluded.first()) {
            (Some(_), _) => Ok(self),
            (None, Some(Exclusion { id, reason, .. })) => {
                Err(Error::Unsupported(format!("no image is left to measure: {id} {reason}")))
            }
            (None, None) => Err(Error::Unsupported("there is no image to measure".to_owned())),
        }
    }

    fn belong_to(&mut self, dataset: &str) {
        self.measured.iter_mut().for_each(|measured| measured.dataset = Some(dataset.to_owned()));
        self.methods.iter_mut().for_each(|method| method.dataset = Some(dataset.to_owned()));
        self.excluded.iter_mut().for_each(|exclusion| exclusion.dataset = Some(dataset.to_owned()));
    }

    /// Adds the scores of one image, of this height and width, by every method.
    pub(super) fn add(&mut self, size: [usize; 2], scores: Vec<Score>) {
        self.count_size(size, 1);
        self.scores.extend(scores);
    }

    fn count_size(&mut self, size: [usize; 2], count: usize) {
        match self.sizes.iter_mut().find(|(known, _)| *known == size) {
            Some((_, images)) => *images += count,
            None => self.sizes.push((size, count)),
        }
    }

    /// Records an image that is excluded from all means.
    pub fn exclude(&mut self, label: &Label, reason: impl Into<String>) {
        let (id, kernel) = (label.id.clone(), label.kernel.clone());
        self.excluded.push(Exclusion { dataset: None, id, kernel, reason: reason.into() });
    }

    /// The kernels, in the order of [`Self::rotations`].
    pub fn kernels(&self) -> Vec<&str> {
        self.rotations().into_iter().map(|(kernel, _)| kernel).collect()
    }

    /// The kernels with their rotations in degrees, by which they are in order; where one has none, they are in the order
    /// in which they first come.
    pub fn rotations(&self) -> Vec<(&str, Option<f64>)> {
        let mut found: Vec<(&str, Option<f64>)> = Vec::new();
        for label in self.scores.iter().map(|score| &score.label) {
            if let Some(kernel) = label.kernel.as_deref()
                && !found.iter().any(|(known, _)| *known == kernel)
            {
                found.push((kernel, label.angle_deg));
            }
        }
        if found.iter().all(|(_, angle)| angle.is_some()) {
            found.sort_by(|(_, a), (_, b)| a.partial_cmp(b).unwrap_or(Ordering::Equal));
        }
        found
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

    /// The scores of a method, of the images of one kernel or of all.
    pub fn of<'a>(&'a self, method: usize, kernel: Option<&'a str>) -> impl Iterator<Item = &'a Score> {
        self.scores.iter().filter(move |score| {
            score.method == method && (kernel.is_none() || score.label.kernel.as_deref() == kernel)
        })
    }

    /// The metrics of each region over all images of a method; nothing unless regions were asked for.
    pub(super) fn regions(&self, method: usize) -> Vec<RegionMean> {
        let mean = |(index, region): (usize, Region)| {
            let of_region = || self.of(method, None).filter_map(move |score| score.regions.get(index));
            let pooled = |metric: usize| {
                let mut total = Pool::default();
                of_region().for_each(|score| total += score.pools[metric]);
                total.mean().map(|mean| self.regional[metric].of_mean(mean))
            };
            RegionMean {
                region,
                images: of_region().filter(|score| score.pixels > 0).count(),
                pixels: of_region().map(|score| score.pixels).sum(),
                values: (0..self.regional.len()).map(pooled).collect(),
            }
        };
        let asked = self.of(method, None).any(|score| !score.regions.is_empty());
        let regions = Region::ALL.into_iter().enumerate().filter(|_| asked);
        regions.map(mean).collect()
    }

    /// Whether parts of the images were measured each for itself.
    pub fn has_regions(&self) -> bool {
        self.scores.iter().any(|score| !score.regions.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::super::score::RegionScore;
    use super::*;

    fn evaluation() -> Evaluation {
        let methods = vec![ComparedMethod::baseline("degraded"), ComparedMethod::restored("model")];
        let mut evaluation = Evaluation::new(&EvalConfig::default(), methods);
        for (kernel, psnr) in [("r-03", 30.0), ("r+00", 32.0), ("r-03", 34.0)] {
            let label = Label { kernel: Some(kernel.to_owned()), ..Label::scene("street") };
            let score = |method, values| Score { label: label.clone(), method, values, regions: Vec::new() };
            evaluation.add([8, 9], vec![score(0, vec![psnr - 10.0, 0.5]), score(1, vec![psnr, 0.9])]);
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

    /// The first image may be missing under the first kernels.
    #[test]
    fn kernels_are_in_the_order_of_their_angles() {
        let methods = vec![ComparedMethod::baseline("degraded")];
        let mut evaluation = Evaluation::new(&EvalConfig::default(), methods);
        for (kernel, angle) in [("r+00", 0.0), ("r+03", 3.0), ("r-03", -3.0)] {
            let label =
                Label { kernel: Some(kernel.to_owned()), angle_deg: Some(angle), ..Label::scene("street") };
            evaluation
                .add([8, 9], vec![Score { label, method: 0, values: vec![30.0, 0.9], regions: Vec::new() }]);
        }
        assert_eq!(evaluation.kernels(), ["r-03", "r+00", "r+03"]);
    }

    #[test]
    fn datasets_keep_their_own_means_side_by_side() {
        let mut dim = evaluation();
        dim.scores.iter_mut().for_each(|score| score.values[0] -= 5.0);
        dim.exclude(&Label::scene("dark"), "is missing");
        let joined = Evaluation::join(vec![("day".to_owned(), evaluation()), ("night".to_owned(), dim)]);
        let means: Vec<f64> = (0..4).map(|method| joined.mean(method, None).unwrap()[0]).collect();
        assert_eq!(means, [22.0, 32.0, 17.0, 27.0]);
        assert_eq!(joined.methods[3].dataset.as_deref(), Some("night"));
        assert_eq!(joined.excluded[0].dataset.as_deref(), Some("night"));
        assert_eq!(joined.sizes, [([8, 9], 6)]);
    }

    /// Two images with regions of 1 and 3 pixels and squared errors of 0.04 and 0: pooled, not averaged.
    #[test]
    fn pools_regions_over_their_pixels() {
        let mut evaluation = evaluation();
        for (score, (pixels, error)) in
            evaluation.scores.iter_mut().zip([(0, 0.0), (1, 0.04), (0, 0.0), (3, 0.0)])
        {
            let pools = vec![Pool { sum: error, count: pixels as u64 }, Pool::default()];
            let of = |region| RegionScore { region, pixels, pools: pools.clone() };
            score.regions = Region::ALL.map(of).to_vec();
        }
        let regions = evaluation.regions(1);
        assert_eq!((regions[0].images, regions[0].pixels), (2, 4));
        assert!((regions[0].values[0].unwrap() - 20.0).abs() < 1e-9);
        assert_eq!(regions[0].values[1], None, "no pixel was pooled");
    }
}
