//! Reads the weights of recognition networks by their torchvision names.

use std::collections::BTreeMap;
use std::path::Path;

use crate::core::error::{Error, Result};
use crate::network::TensorValues;
use crate::network::weights::read_tensors;

/// A file of weights that the user has to bring along.
pub(super) struct Source {
    /// The network, as messages name it.
    pub(super) network: &'static str,
    /// Where the file is published, and in which layout.
    pub(super) origin: &'static str,
}

impl Source {
    /// Reads the tensors of the given names and shapes; others in the file are left alone.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read; [`Error::Format`] when it is missing, or a tensor is missing or
    /// of another shape.
    pub(super) fn read(&self, path: &Path, wanted: &[(String, Vec<usize>)]) -> Result<Vec<Vec<f32>>> {
        if !path.is_file() {
            let reason = format!("there is no such file; it should be {}", self.describe());
            return Err(Error::format(path, reason));
        }
        let mut tensors = read_tensors(path, &|name| wanted.iter().any(|(known, _)| known == name))?;
        let take = |(name, shape): &(String, Vec<usize>)| self.take(path, &mut tensors, name, shape);
        wanted.iter().map(take).collect()
    }

    fn take(
        &self,
        path: &Path,
        tensors: &mut BTreeMap<String, TensorValues>,
        name: &str,
        shape: &[usize],
    ) -> Result<Vec<f32>> {
        match tensors.remove(name) {
            Some(found) if found.shape == shape => Ok(found.values),
            other => {
                let found = other.map_or_else(|| "none".to_owned(), |found| format!("{:?}", found.shape));
                let reason = format!(
                    "expected a tensor {name} of shape {shape:?}, found {found}; the file should be {}",
                    self.describe()
                );
                Err(Error::format(path, reason))
            }
        }
    }

    /// What the file should be.
    pub(super) fn describe(&self) -> String {
        format!("the weights of {}: {}", self.network, self.origin)
    }
}
