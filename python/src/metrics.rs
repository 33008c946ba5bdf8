//! Measures how near images are.

use pyo3::prelude::*;

use udc::core::metrics::{Measure, Metric, MetricDefinition};
use udc::core::tone::{ToneCurve, ToneFlags};

use crate::error::to_python;
use crate::source::{Notices, Source, choice, domain};
use crate::work::run;

/// What is measured, and how.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct MetricSettings {
    metric: String,
    definition: String,
    domain: Option<String>,
    alpha: f32,
    x_max: f32,
}

/// Compares an image with the ground truth, both tone-mapped.
#[pyfunction]
pub(crate) fn measure(
    py: Python<'_>,
    image: Source<'_>,
    ground_truth: Source<'_>,
    settings: MetricSettings,
) -> PyResult<(f64, Notices)> {
    let resolve = || {
        let metric = choice("metric", &settings.metric, &[("psnr", Metric::Psnr), ("ssim", Metric::Ssim)])?;
        let definitions = [("released", MetricDefinition::released()), ("float", MetricDefinition::float())];
        let definition = choice("definition", &settings.definition, &definitions)?;
        let curve = ToneCurve::new(settings.alpha, settings.x_max)?;
        Ok((metric, definition, curve, domain("domain", settings.domain.as_deref())?))
    };
    let (metric, definition, curve, domain) = resolve().map_err(|error| to_python(&error))?;
    let (image, ground_truth) = (image.own(None)?, ground_truth.own(None)?);
    run(py, |_| {
        let mut notices = Notices::new();
        let (image, _) = image.image(domain, ToneFlags::default(), &mut notices)?;
        let (ground_truth, _) = ground_truth.image(domain, ToneFlags::default(), &mut notices)?;
        let (image, ground_truth) = (image.into_tone_mapped(curve), ground_truth.into_tone_mapped(curve));
        Ok((Measure::of(metric).compare(&image, &ground_truth, &definition)?, notices))
    })
}
