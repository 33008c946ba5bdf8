//! Puts `key.path=value` settings into a configuration's table, and says which keys there are.

use super::TrainConfig;
use crate::core::error::{Error, Result};
use crate::core::nearest::edits;

/// Puts one `key.path=value` into a table.
pub(super) fn apply(table: &mut toml::Table, setting: &str) -> Result<()> {
    let wrong = |reason: String| Error::config(format!("--set {setting}"), reason);
    let Some((path, text)) = setting.split_once('=') else {
        return Err(wrong("expected key.path=value, such as optimizer.learning-rate=1e-4".to_owned()));
    };
    let known = known_keys();
    if !known.iter().any(|key| key == path) {
        return Err(wrong(format!(
            "there is no key {path}; near it are {}",
            nearest(path, &known).join(", ")
        )));
    }
    // What is no TOML value is text: `architecture.condition=none` needs no quotes.
    let parsed = format!("value = {text}").parse::<toml::Table>().ok();
    let value = parsed.and_then(|mut table| table.remove("value")).unwrap_or_else(|| text.into());
    let mut parts: Vec<&str> = path.split('.').collect();
    let last = parts.pop().expect("splitting gives a part");
    let mut inner = table;
    for part in parts {
        let entry = inner.entry(part).or_insert_with(|| toml::Table::new().into());
        inner = entry.as_table_mut().ok_or_else(|| wrong(format!("{part} is no section")))?;
    }
    inner.insert(last.to_owned(), value);
    Ok(())
}

/// A message of the TOML reader without the names of Rust's types.
pub(super) fn in_plain_words(message: &str) -> String {
    const WORDS: [(&str, &str); 6] = [
        ("expected usize", "expected a whole number"),
        ("expected u64", "expected a whole number"),
        ("expected f64", "expected a number"),
        ("expected f32", "expected a number"),
        ("expected a boolean", "expected true or false"),
        ("expected a string", "expected text"),
    ];
    WORDS.iter().fold(message.to_owned(), |message, (name, words)| message.replace(name, words))
}

pub(super) fn known_keys() -> Vec<String> {
    let table = toml::Table::try_from(TrainConfig::default()).expect("configurations are plain data");
    keys(&table).into_iter().map(|(key, _)| key).collect()
}

/// All keys of a table with their values, as `section.key`.
pub(super) fn keys(table: &toml::Table) -> Vec<(String, String)> {
    let mut found = Vec::new();
    for (key, value) in table {
        match value {
            toml::Value::Table(inner) => {
                found.extend(keys(inner).into_iter().map(|(rest, value)| (format!("{key}.{rest}"), value)));
            }
            value => found.push((key.clone(), value.to_string())),
        }
    }
    found
}

/// The three known keys that take the fewest edits, counting those with the same last part as near.
fn nearest(path: &str, known: &[String]) -> Vec<String> {
    let leaf = |key: &str| key.rsplit('.').next().unwrap_or_default().to_owned();
    let mut ranked: Vec<(usize, &String)> =
        known.iter().map(|key| (edits(path, key).min(1 + edits(&leaf(path), &leaf(key))), key)).collect();
    ranked.sort();
    ranked.into_iter().take(3).map(|(_, key)| key.clone()).collect()
}
