//! Puts `key.path=value` settings into a configuration's table, and says which keys there are.

use serde::Deserialize as _;
use strsim::levenshtein;

use super::TrainConfig;
use crate::core::error::{Error, Result};
use crate::dataset::{NoiseConfig, SensorConfig};

/// Puts settings over a table and reads the whole, as some are only right together; names the one that is wrong.
pub(super) fn put(table: &mut toml::Table, settings: &[String]) -> Result<TrainConfig> {
    let file = table.clone();
    settings.iter().try_for_each(|setting| apply(table, setting))?;
    let read = |table: toml::Table| TrainConfig::deserialize(table);
    let wrong = match read(table.clone()) {
        Ok(config) => return Ok(config),
        Err(error) => error,
    };
    // The one without which all is well, or else the first that makes a mistake.
    let holds = |settings: &[&[String]]| {
        let mut table = file.clone();
        settings.concat().iter().all(|setting| apply(&mut table, setting).is_ok()) && read(table).is_ok()
    };
    let blamed = (0..settings.len())
        .find(|&index| holds(&[&settings[..index], &settings[index + 1..]]))
        .or_else(|| (0..settings.len()).find(|&index| !holds(&[&settings[..=index]])))
        .unwrap_or_default();
    Err(Error::config(format!("--set {}", settings[blamed]), in_plain_words(wrong.message())))
}

/// Puts one `key.path=value` into a table; a section takes an inline table, which replaces it.
fn apply(table: &mut toml::Table, setting: &str) -> Result<()> {
    let wrong = |reason: String| Error::config(format!("--set {setting}"), reason);
    let Some((path, text)) = setting.split_once('=') else {
        return Err(wrong("expected key.path=value, such as optimizer.learning-rate=1e-4".to_owned()));
    };
    let known = [known_keys(), noise_keys()].concat();
    let inside = known.iter().find(|key| key.strip_prefix(path).is_some_and(|rest| rest.starts_with('.')));
    if inside.is_none() && !known.iter().any(|key| key == path) {
        return Err(wrong(format!(
            "there is no key {path}; near it are {}",
            nearest(path, &known).join(", ")
        )));
    }
    // What is no TOML value is text: `architecture.condition=none` needs no quotes.
    let parsed = format!("value = {text}").parse::<toml::Table>().ok();
    let value = parsed.and_then(|mut table| table.remove("value")).unwrap_or_else(|| text.into());
    if let Some(key) = inside.filter(|_| !value.is_table()) {
        return Err(wrong(format!(
            "{path} is a section; set a key of it, such as {key}, or a table in {{ }}"
        )));
    }
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

/// The keys of the kinds of noise that are not the default.
fn noise_keys() -> Vec<String> {
    let kinds = [NoiseConfig::Gaussian { sigma: 0.0 }, NoiseConfig::Sensor(SensorConfig::default())];
    let of_kind = |kind| keys(&toml::Table::try_from(kind).expect("configurations are plain data"));
    let names = kinds.into_iter().flat_map(of_kind).map(|(key, _)| key).filter(|key| key != "kind");
    // What a sensor may be told in place of its electrons.
    names.chain(["white-irradiance".to_owned()]).map(|key| format!("data.formation.noise.{key}")).collect()
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
    let edits = |path: &str, key: &str| levenshtein(path, key).min(1 + levenshtein(&leaf(path), &leaf(key)));
    let mut ranked: Vec<(usize, &String)> = known.iter().map(|key| (edits(path, key), key)).collect();
    ranked.sort();
    ranked.into_iter().take(3).map(|(_, key)| key.clone()).collect()
}
