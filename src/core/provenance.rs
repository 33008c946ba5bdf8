//! Says where a file came from: program version, command and resolved configuration.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::tone::ToneCurve;

/// The origin of a written file, kept inside of it as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Program and version: `udc 0.1.0`.
    pub program: String,
    /// The subcommand that wrote the file.
    pub command: String,
    /// The configuration that it ran with, every default resolved.
    pub config: Value,
    /// What was found on the way, such as the lamps of a capture: it follows from the configuration and the inputs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found: Option<Value>,
}

impl Provenance {
    /// Describes a run of `command` of this program with `config`.
    ///
    /// # Panics
    /// When `config` is a type that JSON cannot hold, such as a map with non-string keys.
    pub fn new(command: &str, config: &impl Serialize) -> Self {
        Self {
            program: concat!("udc ", env!("CARGO_PKG_VERSION")).to_owned(),
            command: command.to_owned(),
            config: serde_json::to_value(config).expect("configurations are plain data"),
            found: None,
        }
    }

    /// The same with what was found on the way.
    #[must_use]
    pub fn with_found(self, found: Value) -> Self {
        Self { found: Some(found), ..self }
    }

    /// Pixels by which a scene was made larger than the frame on each side, where its origin says so.
    pub fn margin(&self) -> Option<usize> {
        self.config.get("margin")?.as_u64()?.try_into().ok()
    }

    /// The tone curve that the file's origin says: that of its own values where these are tone-mapped, else the one that its
    /// light is to be shown or compared by.
    pub fn tone_curve(&self) -> Option<ToneCurve> {
        let Self { command, config, found, .. } = self;
        match command.as_str() {
            "synth" => curve_in(config.get("formation")?),
            // A copy keeps what was said of the original.
            "convert" => serde_json::from_value::<Self>(config.get("source")?.clone()).ok()?.tone_curve(),
            "restore" | "tonemap" => {
                let found = found.as_ref().and_then(|found| found.get(TONE));
                curve_in(found.or_else(|| config.get(TONE))?)
            }
            _ => None,
        }
    }

    /// The JSON text that files carry.
    ///
    /// # Panics
    /// Never: the fields are plain data.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).expect("provenance is plain data")
    }
}

/// The key of a tone curve among what a file was made with, and among what was found on the way, which goes before that.
const TONE: &str = "tone";

/// The curve that a value holds, perhaps among other things.
fn curve_in(value: &Value) -> Option<ToneCurve> {
    #[derive(Deserialize)]
    #[serde(default, rename_all = "kebab-case")]
    struct Stated {
        alpha: f32,
        x_max: f32,
    }
    impl Default for Stated {
        fn default() -> Self {
            let ToneCurve { alpha, x_max } = ToneCurve::default();
            Self { alpha, x_max }
        }
    }
    let Stated { alpha, x_max } = serde_json::from_value(value.clone()).ok()?;
    ToneCurve::new(alpha, x_max).ok()
}
