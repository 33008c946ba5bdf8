//! Keeps results as JSON files that say what they hold and in which layout.

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

use crate::core::error::{Error, Result};
use crate::io;

/// Results that are kept as a JSON file, which says what it holds under `format` and in which layout under `version`.
///
/// An infinite number is null.
///
/// # Accuracy
/// Numbers are written with all their digits, and read within one unit of the last of 53 bits.
pub trait Document: Serialize + DeserializeOwned {
    /// The value of `format` in every such file.
    const FORMAT: &'static str;

    /// The layout that this program writes, and the only one that it reads.
    const VERSION: u64 = 1;

    /// What writes such a file, for messages.
    const COMMAND: &'static str;

    /// Refuses what has the right types and contradicts itself.
    ///
    /// # Errors
    /// What is wrong.
    fn check(&self) -> Result<(), String> {
        Ok(())
    }

    /// The text of the file.
    ///
    /// # Panics
    /// Never: results are plain data.
    fn to_json(&self) -> String {
        let mut file = serde_json::to_value(self).expect("results are plain data");
        file["format"] = json!(Self::FORMAT);
        file["version"] = json!(Self::VERSION);
        format!("{file:#}\n")
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be read; [`Error::Format`] when it is damaged, of another layout, or something else.
    fn read(path: &Path) -> Result<Self> {
        parse(&io::read_text(path)?)
            .map_err(|reason| Error::format(path, format!("{reason}; make it anew with `{}`", Self::COMMAND)))
    }
}

fn parse<T: Document>(text: &str) -> Result<T, String> {
    let damaged = |error: serde_json::Error| format!("is damaged ({error})");
    let mut file: Map<String, Value> = serde_json::from_str(text).map_err(damaged)?;
    let (format, version) = (file.remove("format"), file.remove("version"));
    let version = version.ok_or("says no version: an earlier one of this program wrote it")?;
    if format.as_ref().is_none_or(|format| format != T::FORMAT) {
        return Err(format!("says that it is {} and not {}", json!(format), T::FORMAT));
    }
    if version != T::VERSION {
        return Err(format!("has the layout {version}, and this program reads {}", T::VERSION));
    }
    let document: T = serde_json::from_value(Value::Object(file)).map_err(damaged)?;
    document.check().map_err(|reason| format!("is damaged ({reason})"))?;
    Ok(document)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Count {
        count: u32,
    }

    impl Document for Count {
        const FORMAT: &'static str = "udc-count";
        const COMMAND: &'static str = "udc count";

        fn check(&self) -> Result<(), String> {
            if self.count == 0 { Err("counts nothing".to_owned()) } else { Ok(()) }
        }
    }

    #[test]
    fn says_what_is_wrong_with_which_file_and_what_to_do() {
        let scratch = tempfile::tempdir().unwrap();
        let path = scratch.path().join("count.json");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            Count::read(&path)
        };
        let count = Count { count: 3 };
        assert_eq!(read(&count.to_json()).unwrap(), count);
        for (text, expected) in [
            ("{\"count\": 3}", "says no version"),
            (
                "{\"count\": 3, \"format\": \"udc-count\", \"version\": 2}",
                "has the layout 2, and this program reads 1",
            ),
            ("{\"count\": 3, \"format\": \"udc-results\", \"version\": 1}", "not udc-count"),
            ("{\"count\": 3, \"fo", "is damaged (EOF"),
            ("[]", "is damaged"),
            ("{\"count\": -3, \"format\": \"udc-count\", \"version\": 1}", "is damaged (invalid value"),
            ("{\"format\": \"udc-count\", \"version\": 1}", "missing field `count`"),
            ("{\"count\": 3, \"of\": 1, \"format\": \"udc-count\", \"version\": 1}", "unknown field `of`"),
            ("{\"count\": 0, \"format\": \"udc-count\", \"version\": 1}", "is damaged (counts nothing)"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(
                message.starts_with(&path.display().to_string()) && message.contains(expected),
                "{message}"
            );
            assert!(message.ends_with("; make it anew with `udc count`"), "{message}");
        }
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(Count::read(&path), Err(Error::Io { .. })));
    }
}
