//! A folder of examples: `examples.toml` says how they were made, `examples-I-of-N.jsonl` lists what a shard has made,
//! `NNNNNN.safetensors` holds an example, `panels/` the PSFs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::config::ExamplesConfig;
use super::panoramas::PanoramaFile;
use super::record::ExampleRecord;
use crate::core::config::parse_toml;
use crate::core::error::{Error, Result};
use crate::core::psf::hex;
use crate::io::{self, HalfTensors};
use crate::network::Plane;

/// The file that says how the examples of a folder were made.
pub const EXAMPLES_FILE: &str = "examples.toml";

/// The value of `format` in it.
const FORMAT: &str = "udc-examples";

/// The layout that this program writes and reads.
const VERSION: u32 = 1;

/// The contents of `examples.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct ExamplesFile {
    /// Always `udc-examples`.
    pub format: String,
    /// The layout's version.
    pub version: u32,
    /// The program that wrote the folder.
    pub program: String,
    /// The planes that every example holds beside capture and ground truth.
    pub planes: Vec<String>,
    /// The SHA-256 of the PSF of the only panel, where one is given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub psf_sha256: Option<String>,
    /// What decided the examples.
    pub examples: ExamplesConfig,
    /// The panoramas that views were cut out of.
    #[serde(default)]
    pub panoramas: Vec<PanoramaFile>,
}

impl ExamplesFile {
    pub(super) fn new(
        examples: ExamplesConfig,
        psf_sha256: Option<String>,
        panoramas: Vec<PanoramaFile>,
    ) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            program: concat!("udc ", env!("CARGO_PKG_VERSION")).to_owned(),
            planes: Plane::ALL.map(|plane| plane.name().to_owned()).into(),
            psf_sha256,
            examples,
            panoramas,
        }
    }

    /// Reads the file of a folder.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be read; [`Error::Format`] when it is damaged or of another version.
    pub fn read(root: &Path) -> Result<Self> {
        let path = root.join(EXAMPLES_FILE);
        let found: Self =
            parse_toml(&io::read_text(&path)?).map_err(|reason| Error::format(&path, reason))?;
        if (found.format.as_str(), found.version) != (FORMAT, VERSION) {
            let reason = format!(
                "is {} of version {}; this program reads {FORMAT} of version {VERSION}",
                found.format, found.version
            );
            return Err(Error::format(&path, reason));
        }
        Ok(found)
    }

    pub(super) fn write(&self, root: &Path) -> Result<()> {
        let text = toml::to_string(self).expect("configurations are plain data");
        io::write_atomically(&root.join(EXAMPLES_FILE), true, |file| file.write_all(text.as_bytes()))
    }

    /// The first key that makes the examples of one folder others than those of another: neither their number nor where
    /// panoramas and PSF lie does.
    pub(super) fn first_difference(&self, other: &Self) -> Option<String> {
        let comparable = |file: &Self| {
            let mut file = file.clone();
            (file.program, file.examples.count, file.examples.scenes.panoramas) =
                (String::new(), 0, Vec::new());
            file.examples.panels.psf = None;
            file.panoramas.iter_mut().for_each(|panorama| panorama.path = PathBuf::new());
            toml::Value::try_from(file).expect("configurations are plain data")
        };
        difference("", &comparable(self), &comparable(other))
    }
}

/// The first key of two tables whose values differ, in full.
fn difference(key: &str, one: &toml::Value, other: &toml::Value) -> Option<String> {
    let (Some(one), Some(other)) = (one.as_table(), other.as_table()) else {
        return (one != other).then(|| key.to_owned());
    };
    let below = |name: &String| if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
    let mut names = one.keys().chain(other.keys());
    names.find_map(|name| match (one.get(name), other.get(name)) {
        (Some(one), Some(other)) => difference(&below(name), one, other),
        _ => Some(below(name)),
    })
}

/// The list of one shard.
pub(super) fn list_name(index: usize, count: usize) -> String {
    format!("examples-{:02}-of-{count:02}.jsonl", index + 1)
}

/// The lists of all shards in a folder.
pub(super) fn lists(root: &Path) -> Result<Vec<String>> {
    let mut names = io::list_folder(root)?;
    names.retain(|name| name.starts_with("examples-") && name.ends_with(".jsonl"));
    Ok(names)
}

/// The examples that a list names and that are there; lines that a killed run left unfinished are skipped.
pub(super) fn listed(root: &Path, list: &str) -> Result<Vec<ExampleRecord>> {
    let text = io::read_text(&root.join(list))?;
    let records = text.lines().filter_map(|line| serde_json::from_str(line).ok());
    Ok(records
        .filter(|record: &ExampleRecord| record.has_number() && root.join(record.file_name()).is_file())
        .collect())
}

/// A folder of examples that can be read.
#[derive(Clone, Debug)]
pub struct ExamplesFolder {
    /// The folder.
    pub root: PathBuf,
    /// How they were made.
    pub file: ExamplesFile,
    /// What there is, by name.
    pub records: Vec<ExampleRecord>,
}

impl ExamplesFolder {
    /// Whether a folder holds examples.
    pub fn is_one(folder: &Path) -> bool {
        folder.join(EXAMPLES_FILE).is_file()
    }

    /// Opens a folder.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be read; [`Error::Format`] when it is damaged, or no example was finished.
    pub fn open(root: &Path) -> Result<Self> {
        let file = ExamplesFile::read(root)?;
        let mut records = BTreeMap::new();
        for list in lists(root)? {
            for record in listed(root, &list)? {
                records.insert(record.id.clone(), record);
            }
        }
        if records.is_empty() {
            return Err(Error::format(root, "no example is finished; make them with `udc examples`"));
        }
        Ok(Self { root: root.to_owned(), file, records: records.into_values().collect() })
    }

    /// How many of the examples that are to be made are there, where some are missing, in words for a warning.
    pub fn unfinished(&self) -> Option<String> {
        let (made, wanted) = (self.records.len(), self.file.examples.count);
        (made < wanted).then(|| {
            format!(
                "{} of {wanted} examples are in {}: finish them with the flags of their `udc examples` and --resume",
                made,
                self.root.display()
            )
        })
    }

    /// Reads an example: tone-mapped images `[3, height, width]` by name.
    ///
    /// # Errors
    /// As [`io::read_half_tensors`].
    pub fn read(&self, record: &ExampleRecord) -> Result<HalfTensors> {
        io::read_half_tensors(&self.root.join(record.file_name()))
    }

    /// SHA-256 of how the examples were made, and of which there are.
    ///
    /// # Panics
    /// Never: both are plain data.
    pub fn sha256(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(toml::to_string(&self.file).expect("configurations are plain data"));
        for record in &self.records {
            hash.update(record.to_line());
        }
        hex(&hash.finalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Split;

    fn file() -> ExamplesFile {
        let panorama = PanoramaFile {
            name: "hall".to_owned(),
            path: "a/hall.hdr".into(),
            sha256: "ab".to_owned(),
            split: Split::Train,
        };
        ExamplesFile::new(ExamplesConfig::default(), Some("cd".to_owned()), vec![panorama])
    }

    #[test]
    fn returns_from_its_file() {
        let folder = tempfile::tempdir().unwrap();
        file().write(folder.path()).unwrap();
        assert_eq!(ExamplesFile::read(folder.path()).unwrap(), file());
        assert!(ExamplesFolder::is_one(folder.path()));
        let message = ExamplesFolder::open(folder.path()).unwrap_err().to_string();
        assert!(message.contains("no example is finished"), "{message}");
    }

    #[test]
    fn only_what_decides_examples_makes_a_difference() {
        let changed = |change: fn(&mut ExamplesFile)| {
            let mut other = file();
            change(&mut other);
            file().first_difference(&other)
        };
        assert_eq!(changed(|file| file.examples.count = 9), None);
        assert_eq!(changed(|file| file.panoramas[0].path = "b/hall.hdr".into()), None);
        assert_eq!(changed(|file| file.examples.panels.psf = Some("b/psf.exr".into())), None);
        assert_eq!(changed(|file| file.psf_sha256 = None).unwrap(), "psf-sha256");
        assert_eq!(
            changed(|file| file.examples.sensor.usual_share = 0.5).unwrap(),
            "examples.sensor.usual-share"
        );
        assert_eq!(changed(|file| file.panoramas[0].sha256.push('c')).unwrap(), "panoramas");
    }
}
