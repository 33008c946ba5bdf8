//! Numbers by their metric, as files of results hold them.

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer, Serialize};

use crate::core::metrics::Metric;

/// A number for each metric that there is one of.
///
/// In JSON an infinite number, such as the PSNR of equal images, is null; TOML holds it as it is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct MetricValues(#[serde(deserialize_with = "numbers")] BTreeMap<Metric, f64>);

impl MetricValues {
    /// The number of a metric; none where there is none.
    pub fn get(&self, metric: Metric) -> Option<f64> {
        self.0.get(&metric).copied()
    }

    /// The metrics that there are numbers of.
    pub fn metrics(&self) -> impl Iterator<Item = Metric> {
        self.0.keys().copied()
    }
}

impl FromIterator<(Metric, f64)> for MetricValues {
    fn from_iter<I: IntoIterator<Item = (Metric, f64)>>(numbers: I) -> Self {
        Self(numbers.into_iter().collect())
    }
}

/// Reads a number that is infinite where null stands for it.
pub(super) fn number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}

/// Reads rows of such numbers.
pub(super) fn rows<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Vec<f64>>, D::Error> {
    let rows: Vec<Vec<Option<f64>>> = Vec::deserialize(deserializer)?;
    let finished =
        |row: Vec<Option<f64>>| row.into_iter().map(|value| value.unwrap_or(f64::INFINITY)).collect();
    Ok(rows.into_iter().map(finished).collect())
}

fn numbers<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<Metric, f64>, D::Error> {
    let numbers: BTreeMap<Metric, Option<f64>> = BTreeMap::deserialize(deserializer)?;
    Ok(numbers.into_iter().map(|(metric, value)| (metric, value.unwrap_or(f64::INFINITY))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn infinite_and_missing_numbers_come_back_as_they_were() {
        let values: MetricValues =
            [(Metric::Psnr, f64::INFINITY), (Metric::Lpips, 0.125)].into_iter().collect();
        let json = serde_json::to_string(&values).unwrap();
        assert_eq!(json, "{\"psnr\":null,\"lpips\":0.125}");
        assert_eq!(serde_json::from_str::<MetricValues>(&json).unwrap(), values);
        let toml = toml::to_string(&values).unwrap();
        assert_eq!(toml::from_str::<MetricValues>(&toml).unwrap(), values);
        assert_eq!((values.get(Metric::Psnr), values.get(Metric::Ssim)), (Some(f64::INFINITY), None));
        assert!(serde_json::from_str::<MetricValues>("{\"mse\":1.0}").is_err(), "there is no such metric");
    }
}
