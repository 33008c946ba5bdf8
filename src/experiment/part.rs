//! The file of what one shard of an evaluation measured, and joining the files of all shards.
//!
//! It is TOML, which returns every number as it was, infinite ones too: the joined results are to the last digit those of
//! one run. Parts have names of their own, so that any number of shards may write into one folder.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::measurement::Measurement;
use super::pictures::FOLDER;
use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::core::shard::Shard;
use crate::io;
use crate::kernels::Isa;

const FORMAT: &str = "udc-evaluation-part";
const VERSION: u32 = 1;

/// What one shard measured, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub struct Part {
    format: String,
    version: u32,
    program: String,
    /// The set of instructions that networks computed with.
    instruction_set: String,
    /// Which part it is.
    pub shard: Shard,
    /// The pictures that it kept, within their folder.
    pub pictures: Vec<String>,
    /// Everything that decides the numbers, by what it is called.
    configuration: BTreeMap<String, String>,
    measurement: Measurement,
}

/// The names of what a shard writes into a folder that it may share with others.
#[derive(Clone, Debug)]
pub struct PartFiles {
    /// The numbers.
    pub part: String,
    /// What a monitor as the source would miss, as a picture.
    pub ldr: String,
}

/// Everything that the shards of an evaluation found.
#[derive(Clone, Debug)]
pub struct MergedParts {
    /// The numbers of all images, in their order.
    pub measurement: Measurement,
    /// Files of pictures.
    pub pictures: Vec<PathBuf>,
    /// The picture of what a monitor as the source would miss, where that was asked for.
    pub ldr: Option<PathBuf>,
    /// What may make the results others than those of one run.
    pub warnings: Vec<String>,
}

impl PartFiles {
    /// The names for a shard.
    pub fn of(shard: Shard) -> Self {
        let name =
            |what, extension| format!("{what}-{:05}-of-{:05}.{extension}", shard.index + 1, shard.count);
        Self { part: name("part", "toml"), ldr: name("ldr", "png") }
    }

    fn is_part(name: &str) -> bool {
        name.starts_with("part-") && name.ends_with(".toml") && name.contains("-of-")
    }
}

impl Part {
    /// The part of a shard; `configuration` is everything that decides the numbers, by what it is called.
    pub fn new(
        shard: Shard,
        configuration: BTreeMap<String, String>,
        pictures: Vec<String>,
        measurement: Measurement,
    ) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            program: concat!("udc ", env!("CARGO_PKG_VERSION")).to_owned(),
            instruction_set: Isa::current().name().to_owned(),
            shard,
            pictures,
            configuration,
            measurement,
        }
    }

    /// Writes it into a folder that is there.
    ///
    /// # Errors
    /// Those of [`io::write_atomically`].
    ///
    /// # Panics
    /// Never: parts are plain data.
    pub fn write(&self, folder: &Path, overwrite: bool) -> Result<()> {
        let text = toml::to_string(self).expect("parts are plain data");
        let path = folder.join(PartFiles::of(self.shard).part);
        io::write_atomically(&path, overwrite, |file| file.write_all(text.as_bytes()))
    }

    fn read(path: &Path) -> Result<Self> {
        let refuse =
            |reason: String| Error::format(path, format!("{reason}; make it anew with `udc eval --shard`"));
        let text = io::read_text(path)?;
        let table: toml::Table =
            parse_toml(&text).map_err(|reason| refuse(format!("is damaged ({reason})")))?;
        let format = table.get("format").and_then(toml::Value::as_str);
        let version = table.get("version").and_then(toml::Value::as_integer);
        if (format, version) != (Some(FORMAT), Some(i64::from(VERSION))) {
            return Err(refuse(format!("is no part of an evaluation in the layout {VERSION}")));
        }
        parse_toml(&text).map_err(|reason| refuse(format!("is damaged ({reason})")))
    }

    /// What two parts cannot differ in.
    fn first_differences(&self, other: &Self) -> Vec<String> {
        let mut keys: Vec<&String> = self.configuration.keys().chain(other.configuration.keys()).collect();
        keys.sort_unstable();
        keys.dedup();
        keys.retain(|key| self.configuration.get(*key) != other.configuration.get(*key));
        let program = (self.program != other.program).then(|| "program".to_owned());
        keys.into_iter().cloned().chain(program).collect()
    }
}

impl MergedParts {
    /// Joins the parts in folders and files.
    ///
    /// # Errors
    /// [`Error::Io`] or [`Error::Format`] when one cannot be read, or a folder has none; [`Error::Unsupported`] when parts
    /// are missing, or there twice, or were made otherwise.
    pub fn read(inputs: &[PathBuf]) -> Result<Self> {
        let mut parts = Vec::new();
        for path in io::without_repeats(find_parts(inputs)?) {
            let part = Part::read(&path)?;
            parts.push((path, part));
        }
        parts.sort_by_key(|(_, part)| (part.shard.count, part.shard.index));
        check(&parts)?;
        Ok(Self::join(parts))
    }

    fn join(parts: Vec<(PathBuf, Part)>) -> Self {
        let sets: Vec<&str> = parts.iter().map(|(_, part)| part.instruction_set.as_str()).collect();
        let other = sets.iter().find(|set| **set != sets[0]);
        let warnings = other.map(|other| {
            format!(
                "parts were computed with {} and with {other} instructions: numbers differ from those of one run by \
                 rounding; UDC_SIMD chooses one for all",
                sets[0]
            )
        });
        let warnings = warnings.into_iter().collect();
        let folder = |path: &Path| path.parent().unwrap_or(Path::new("")).to_owned();
        let pictures = parts.iter().flat_map(|(path, part)| {
            part.pictures.iter().map(move |name| folder(path).join(FOLDER).join(name))
        });
        let pictures = pictures.collect();
        // Of the first image with most flare, as in one run.
        let mut most: Option<(f64, PathBuf)> = None;
        for (path, part) in &parts {
            for image in part.measurement.ldr.iter().flat_map(|ldr| &ldr.images) {
                if most.as_ref().is_none_or(|(share, _)| image.hdr.flare_share > *share) {
                    most = Some((image.hdr.flare_share, folder(path).join(PartFiles::of(part.shard).ldr)));
                }
            }
        }
        let mut parts = parts.into_iter().map(|(_, part)| part.measurement);
        let mut measurement = parts.next().expect("checked: there is a part");
        parts.for_each(|part| measurement.go_on_with(part));
        Self { measurement, pictures, ldr: most.map(|(_, path)| path), warnings }
    }
}

/// The files of parts among files and in folders.
fn find_parts(inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for input in inputs {
        if !input.is_dir() {
            found.push(input.clone());
            continue;
        }
        let mut names = io::list_folder(input)?;
        names.retain(|name| PartFiles::is_part(name));
        if names.is_empty() {
            let reason = "holds no part of an evaluation (part-*.toml); `udc eval --shard` makes them";
            return Err(Error::format(input, reason));
        }
        found.extend(names.into_iter().map(|name| input.join(name)));
    }
    Ok(found)
}

/// Refuses anything but one part of each shard, all made in the same way.
fn check(parts: &[(PathBuf, Part)]) -> Result<()> {
    let refuse = |reason: String| Err(Error::Unsupported(reason));
    let Some((first_path, first)) = parts.first() else {
        return refuse("there is no part to merge".to_owned());
    };
    let count = first.shard.count;
    for pair in parts.windows(2) {
        let [(a, one), (b, two)] = pair else { continue };
        let (a, b) = (a.display(), b.display());
        if one.shard.count != two.shard.count {
            let (one, two) = (one.shard, two.shard);
            return refuse(format!("{a} is shard {one} and {b} is shard {two}; name parts of one division"));
        }
        if one.shard == two.shard {
            return refuse(format!("{a} and {b} are both shard {}; name one of them", one.shard));
        }
    }
    for (path, part) in parts {
        let differences = first.first_differences(part);
        if !differences.is_empty() {
            return refuse(format!(
                "{} and {} were made with another {}; make all parts with the same flags, on the same data",
                first_path.display(),
                path.display(),
                differences.join(", ")
            ));
        }
    }
    let is_there = |index: &usize| parts.iter().any(|(_, part)| part.shard.index == *index);
    let missing: Vec<String> =
        (0..count).filter(|index| !is_there(index)).map(|index| Shard { index, count }.to_string()).collect();
    if !missing.is_empty() {
        return refuse(format!(
            "{} of {count} parts are missing: {}; make each with `udc eval … --shard I/N`, and name all",
            missing.len(),
            missing.join(", ")
        ));
    }
    Ok(())
}
