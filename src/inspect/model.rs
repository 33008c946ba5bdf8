//! Describes a network, and a network with its weights.

use std::fmt;
use std::path::Path;

use serde::Serialize;
use serde_json::Value;

use crate::core::error::Result;
use crate::network::{Architecture, weights};

/// A network and what it costs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NetworkDescription {
    /// Its configuration.
    pub architecture: Value,
    /// What it reads beside the image, by name.
    pub planes: Vec<&'static str>,
    /// Number of trainable numbers.
    pub parameters: u64,
    /// Multiply-accumulates for an image of 800 × 800 pixels.
    pub macs_800: u64,
}

impl From<&Architecture> for NetworkDescription {
    fn from(architecture: &Architecture) -> Self {
        Self {
            architecture: architecture.to_json(),
            planes: architecture.planes().iter().map(|plane| plane.name()).collect(),
            parameters: architecture.parameters(),
            macs_800: architecture.macs(800, 800),
        }
    }
}

/// A network's weights.
#[derive(Clone, Debug, Serialize)]
pub struct ModelDescription {
    /// The network.
    #[serde(flatten)]
    pub network: NetworkDescription,
    /// What the file says of its training.
    pub training: Option<Value>,
    /// The kernel bank whose codes it was trained with.
    pub kernel_bank_sha256: Option<String>,
    /// What the file says, as it is told to people.
    #[serde(skip)]
    file: weights::Description,
}

impl ModelDescription {
    /// Describes a weight file after checking all of it.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let file = weights::describe(path)?;
        Ok(Self {
            network: (&file.architecture).into(),
            training: file.origin.training.clone(),
            kernel_bank_sha256: file.origin.kernel_bank_sha256.clone(),
            file,
        })
    }
}

impl fmt::Display for ModelDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.file.fmt(f)
    }
}
