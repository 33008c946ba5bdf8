//! What a run tells scripts: one JSON object a line, as `--json` writes it to stdout.
//!
//! Each line is a [`Line`]: `event` names its kind, `seconds` is the time since the run began, and the other keys are
//! the fields of the [`Event`] in kebab-case. Numbers that are not finite are `null`; paths are as the run names them. A
//! line is written whole and at once.
//!
//! The first line is `started`, the last one is `finished`, `interrupted` or `failed`. Where none of these comes, the
//! process was ended from outside: a script is not to take the run for done. Keys may be added, and kinds of events too;
//! neither changes its meaning unless [`SCHEMA`] does.
//!
//! ```
//! use udc::core::event::{Event, Line};
//! use std::path::Path;
//!
//! let line = Line { seconds: 0.25, event: Event::Item { path: Path::new("restored/a.exr") } };
//! assert_eq!(line.to_json(), r#"{"event":"item","path":"restored/a.exr","seconds":0.25}"#);
//! ```

use std::path::Path;

use serde::Serialize;
use serde_json::{Map, Value};

/// The version of the events: raised when a key is removed or means something else.
pub const SCHEMA: u32 = 1;

/// An event and when it was.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line<'a> {
    /// What happened.
    #[serde(flatten)]
    pub event: Event<'a>,
    /// Time since the run began.
    pub seconds: f64,
}

/// What happens in a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case", rename_all_fields = "kebab-case")]
pub enum Event<'a> {
    /// The run begins.
    Started {
        /// The subcommand: `synth`.
        command: &'a str,
        /// The program's version.
        version: &'a str,
        /// [`SCHEMA`].
        schema: u32,
        /// Number of threads.
        threads: usize,
        /// The instruction set that networks compute with: `avx512`, `avx2` or `portable`.
        instruction_set: &'a str,
        /// Every flag by its name, and arguments by theirs in lower case: what was given, or the default; a flag that has
        /// none and was not given is left out.
        configuration: Map<String, Value>,
    },
    /// A configuration file was read, settings and defaults resolved.
    Configured {
        /// What it says, as the run's folder records it.
        configuration: Value,
    },
    /// A part of the run begins: a command of the demo, a row of a sweep, a step that does not tell how far it is.
    Stage {
        /// What is done.
        what: &'a str,
    },
    /// So much of a piece of work is done. It is told when the work begins, when it is done, and between them at most twice
    /// a second; of work within work only the outer one.
    Progress {
        /// What is counted: `images`, `steps`, `pixels`, …
        unit: &'a str,
        /// How many are done, those of an earlier process included.
        done: u64,
        /// How many there are.
        total: u64,
        /// How many are done in a second at present; `null` until the first is.
        per_second: Option<f64>,
        /// How long the others take at this rate; `null` until the first is done.
        eta_seconds: Option<f64>,
        /// What else is known, by its key. Of a training: `iteration`, `loss` (of this step, as in the log), `loss-smoothed`,
        /// `learning-rate`, `gradient-norm`, `seconds-per-step`, `data-wait-share`, and once there was one, `validation`
        /// (the last line of the log with one) and `best` (`iteration`, `metric`, `value`).
        #[serde(flatten)]
        values: &'a Map<String, Value>,
    },
    /// A file was written whole, or a folder of files published; it may be replaced or removed later, as checkpoints are.
    Item {
        /// The file.
        #[serde(serialize_with = "as_text")]
        path: &'a Path,
    },
    /// Something was found out about one of several inputs.
    Found {
        /// The input.
        of: &'a str,
        /// What, by its key.
        #[serde(flatten)]
        values: Map<String, Value>,
    },
    /// Something may spoil a result.
    Warning {
        /// What, and what to do.
        message: &'a str,
    },
    /// The run did what it was asked for.
    Finished {
        /// Number of items.
        items: u64,
        /// Number of warnings.
        warnings: u64,
        /// The most memory that the process held at once, where the system tells.
        peak_memory_bytes: Option<u64>,
        /// What came out, by its key.
        results: Map<String, Value>,
    },
    /// The user asked the run to stop; what is finished stays.
    Interrupted {
        /// What stays, and how to go on.
        message: &'a str,
        /// Number of items.
        items: u64,
        /// The exit code.
        exit_code: u8,
    },
    /// The run failed.
    Failed {
        /// What was being done, what went wrong with it and why, in one line.
        message: &'a str,
        /// The same, one after another.
        causes: Vec<String>,
        /// Number of items.
        items: u64,
        /// The exit code: 1 for what went wrong, 2 for a command line that cannot be understood.
        exit_code: u8,
    },
}

impl Line<'_> {
    /// The line, without what ends it.
    ///
    /// # Panics
    /// Never: events are plain data.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).expect("events are plain data")
    }
}

fn as_text<S: serde::Serializer>(path: &Path, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&path.to_string_lossy())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn parsed(event: Event<'_>) -> Value {
        let text = Line { event, seconds: 1.5 }.to_json();
        assert!(!text.contains('\n'), "{text}");
        serde_json::from_str(&text).unwrap()
    }

    #[test]
    fn numbers_that_are_none_are_null() {
        let values = Map::from_iter([("loss".to_owned(), json!(f64::NAN))]);
        let progress = Event::Progress {
            unit: "steps",
            done: 1,
            total: 4,
            per_second: Some(f64::INFINITY),
            eta_seconds: None,
            values: &values,
        };
        let expected = json!({
            "event": "progress", "seconds": 1.5, "unit": "steps", "done": 1, "total": 4, "per-second": null,
            "eta-seconds": null, "loss": null,
        });
        assert_eq!(parsed(progress), expected);
    }

    #[test]
    fn names_are_in_kebab_case_and_texts_stay_on_their_line() {
        let failed =
            Event::Failed { message: "a\nb", causes: vec!["a\nb".to_owned()], items: 0, exit_code: 2 };
        let expected = json!({
            "event": "failed", "seconds": 1.5, "message": "a\nb", "causes": ["a\nb"], "items": 0, "exit-code": 2,
        });
        assert_eq!(parsed(failed), expected);
    }
}
