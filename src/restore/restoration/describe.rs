//! Says how captures are restored, for provenance: whatever changes a result, and nothing else.

use serde_json::{Value, json};

use super::super::precision::precision_of;
use super::{How, Restoration};
use crate::core::psf::Psf;

impl Restoration {
    /// The method with every setting resolved, for provenance; its files are told by their contents.
    pub fn describe(&self) -> Value {
        let mut description = match &self.how {
            How::Network(model) => json!({
                "model-sha256": self.model_sha256, "code": self.kernel.describe(), "tile": self.tile,
                "precision": precision_of(model).name(), "highlights": self.highlights,
                "guided": self.guided, "border": self.guided.map(|_| self.border),
                "psf-sha256": self.kernel.psf().filter(|_| self.reads_planes()).map(Psf::sha256),
            }),
            How::Deconvolution(config) => {
                let mut config = json!(config);
                if self.asks_for_levels {
                    // Those of each capture.
                    config["saturation"] = Value::Null;
                }
                if self.suits_alpha() {
                    config["alpha"] = Value::Null;
                }
                json!({
                    "psf-sha256": self.kernel.psf().map(Psf::sha256), "deconvolution": config,
                    "finds-levels": self.asks_for_levels, "highlights": self.highlights,
                })
            }
        };
        if self.suits_alpha() {
            description["alpha"] = json!("suited");
        }
        if let Some(noise) = &self.noise {
            description["noise"] = json!(noise);
        }
        description
    }
}
