//! Describes an array that is no image: its axes and values.

use std::fmt;
use std::path::Path;

use serde::Serialize;

use super::text::number;
use crate::io::read_array;

/// An array that is no image.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ArrayDescription {
    /// Its axes.
    pub shape: Vec<usize>,
    /// The smallest value.
    pub min: f64,
    /// The largest value.
    pub max: f64,
    /// The values, of a small array.
    pub values: Option<Vec<f64>>,
}

/// Arrays up to this length are described by all of their values.
const SMALL_ARRAY: usize = 64;

impl ArrayDescription {
    /// Describes the array that a file holds, if it holds one with values.
    pub(super) fn read(path: &Path) -> Option<Self> {
        let array = read_array(path).ok().filter(|array| !array.is_empty())?;
        let (min, max) =
            array.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), &v| (min.min(v), max.max(v)));
        let values = (array.len() <= SMALL_ARRAY).then(|| array.iter().copied().collect());
        Some(Self { shape: array.shape().to_vec(), min, max, values })
    }
}

impl fmt::Display for ArrayDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "NumPy array {:?}, from {} to {}", self.shape, number(self.min), number(self.max))?;
        if let Some(values) = &self.values {
            let values: Vec<String> = values.iter().map(|&value| number(value)).collect();
            write!(f, "\n  {}", values.join(" "))?;
        }
        Ok(())
    }
}
