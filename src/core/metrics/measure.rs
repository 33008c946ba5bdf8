//! A metric together with what computes it, so that lists of metrics can be passed around.

use std::fmt;
use std::sync::Arc;

use super::{Metric, MetricDefinition};
use crate::core::error::Result;
use crate::core::image::ToneMappedImage;

/// Compares an image with its ground truth.
type Compare = dyn Fn(&ToneMappedImage, &ToneMappedImage, &MetricDefinition) -> Result<f64> + Send + Sync;

/// A metric that is ready to compare images, with the weights that it may need.
#[derive(Clone)]
pub struct Measure {
    metric: Metric,
    compare: Arc<Compare>,
}

impl Measure {
    /// Puts a metric and its computation together.
    pub fn new(
        metric: Metric,
        compare: impl Fn(&ToneMappedImage, &ToneMappedImage, &MetricDefinition) -> Result<f64>
        + Send
        + Sync
        + 'static,
    ) -> Self {
        Self { metric, compare: Arc::new(compare) }
    }

    /// A metric that needs nothing but the two images.
    pub fn of(metric: Metric) -> Self {
        Self::new(metric, move |image, ground_truth, definition| {
            let pool = metric.pool(image, ground_truth, definition, None)?;
            Ok(metric.of_mean(pool.mean().unwrap_or(f64::NAN)))
        })
    }

    /// Which metric it is.
    pub fn metric(&self) -> Metric {
        self.metric
    }

    /// Compares `image` with `ground_truth`.
    ///
    /// # Errors
    /// [`Error::Shape`](crate::core::error::Error::Shape) when the images differ in size or are too small.
    pub fn compare(
        &self,
        image: &ToneMappedImage,
        ground_truth: &ToneMappedImage,
        definition: &MetricDefinition,
    ) -> Result<f64> {
        (self.compare)(image, ground_truth, definition)
    }
}

impl fmt::Debug for Measure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Measure").field(&self.metric).finish()
    }
}
