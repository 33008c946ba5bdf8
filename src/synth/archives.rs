//! Keeps a dataset's images in tar archives, a sample each scene, as WebDataset reads them: `a.gt.npy`, `a.r+00.npy`, `a.json`.
//!
//! What an archive holds is listed when the archive has its name. A killed run loses the archive that it was writing, and its
//! images are made again.

use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::core::error::Result;
use crate::dataset::{Split, Triplet};
use crate::io::{self, ArchiveWriter};

/// How lists of triplets are named, and the archives of what they list.
const LIST: [&str; 2] = ["triplets", ".jsonl"];
const ARCHIVE: [&str; 2] = ["images", ".tar"];

/// Digits of an archive's number.
const DIGITS: usize = 6;

/// The archives that one run writes.
#[derive(Debug)]
pub(super) struct Archives {
    root: PathBuf,
    stem: String,
    /// Numbers that no archive of this run's part has.
    numbers: Range<u32>,
    /// Bytes of members from which on another archive is begun.
    full_bytes: u64,
    current: Option<ArchiveWriter>,
    /// What the current one holds, its paths without the archive's.
    unlisted: Vec<Triplet>,
}

/// What WebDataset tells of a sample beside its images.
#[derive(Serialize)]
struct Sample<'a> {
    id: &'a str,
    split: Split,
    source: &'a str,
    kernels: Vec<SampleKernel<'a>>,
}

#[derive(Serialize)]
struct SampleKernel<'a> {
    kernel: &'a str,
    angle_deg: Option<f64>,
    code: Vec<f32>,
}

impl Archives {
    /// Those beside the list `list` in the folder `root`, behind those that are there.
    pub(super) fn new(root: &Path, list: &Path, full_bytes: u64) -> Result<Self> {
        let stem = stem_of_list(list);
        let names = io::list_folder(root)?;
        let first = names.iter().filter_map(|name| number_of(name, &stem)).max().map_or(0, |last| last + 1);
        let (root, numbers) = (root.to_owned(), first..u32::MAX);
        Ok(Self { root, stem, numbers, full_bytes, current: None, unlisted: Vec::new() })
    }

    /// Appends a file to the current archive.
    pub(super) fn append(&mut self, name: &str, contents: &[u8]) -> Result<()> {
        let writer = match &mut self.current {
            Some(writer) => writer,
            None => {
                let first = self.root.join(name_of(&self.stem, self.numbers.start));
                self.current.insert(ArchiveWriter::create(&first)?)
            }
        };
        writer.append(name, contents)
    }

    /// Keeps triplets for the list, of which the current archive holds the images.
    pub(super) fn hold(&mut self, triplets: impl Iterator<Item = Triplet>) {
        self.unlisted.extend(triplets);
    }

    /// Ends a scene with what is told of it; `code` has the codes of kernels. Returns what is to be listed, if the current archive
    /// is full with that.
    pub(super) fn end_scene(
        &mut self,
        id: &str,
        code: impl Fn(&Triplet) -> Vec<f32>,
    ) -> Result<Vec<Triplet>> {
        let made: Vec<&Triplet> = self.unlisted.iter().filter(|triplet| triplet.id == id).collect();
        if let Some(Triplet { split, source, .. }) = made.first() {
            let kernels = made.iter().map(|triplet| SampleKernel {
                kernel: &triplet.kernel,
                angle_deg: triplet.angle_deg,
                code: code(triplet),
            });
            let sample = Sample { id, split: *split, source, kernels: kernels.collect() };
            let text = serde_json::to_vec(&sample).expect("a sample is plain data");
            self.append(&format!("{}.json", key_of(id)), &text)?;
        }
        let is_full = self.current.as_ref().is_some_and(|archive| archive.bytes() >= self.full_bytes);
        if is_full { self.finish() } else { Ok(Vec::new()) }
    }

    /// Gives the current archive its name; returns what is to be listed of it.
    pub(super) fn finish(&mut self) -> Result<Vec<Triplet>> {
        let Some(archive) = self.current.take() else { return Ok(Vec::new()) };
        let (root, stem) = (&self.root, &self.stem);
        let written = archive.finish((&mut self.numbers).map(|number| root.join(name_of(stem, number))))?;
        let name = written.file_name().unwrap_or_default().to_string_lossy();
        let mut listed = std::mem::take(&mut self.unlisted);
        for triplet in &mut listed {
            triplet.gt = format!("{name}/{}", triplet.gt);
            triplet.degraded = format!("{name}/{}", triplet.degraded);
        }
        Ok(listed)
    }
}

/// The name of a file of a scene in an archive: the scene's, up to the first dot, which ends what WebDataset takes for a key.
pub(super) fn member_of(id: &str, rest: &str) -> String {
    format!("{}.{rest}", key_of(id))
}

fn key_of(id: &str) -> String {
    id.replace('%', "%25").replace('.', "%2E")
}

/// The archives of a list among the names in its folder, but for those that some triplet is in.
pub(super) fn archives_of<'a>(
    list: &Path,
    names: &'a [String],
    kept: &'a [Triplet],
) -> impl Iterator<Item = &'a String> {
    let stem = stem_of_list(list);
    let is_kept = |name: &str| {
        let of = |path: &str| path.strip_prefix(name).is_some_and(|rest| rest.starts_with('/'));
        kept.iter().any(|triplet| of(&triplet.gt) || of(&triplet.degraded))
    };
    names.iter().filter(move |name| number_of(name, &stem).is_some() && !is_kept(name))
}

/// Whether a file of a dataset's folder is named as an archive of images.
pub(super) fn is_archive(name: &str) -> bool {
    let [before, after] = ARCHIVE;
    name.starts_with(before) && name.ends_with(after)
}

fn stem_of_list(list: &Path) -> String {
    let name = list.file_name().unwrap_or_default().to_string_lossy();
    let [before, after] = LIST;
    let part = name.strip_prefix(before).and_then(|rest| rest.strip_suffix(after)).unwrap_or_default();
    format!("{}{part}", ARCHIVE[0])
}

fn name_of(stem: &str, number: u32) -> String {
    format!("{stem}-{number:0DIGITS$}{}", ARCHIVE[1])
}

fn number_of(name: &str, stem: &str) -> Option<u32> {
    let digits = name.strip_prefix(stem)?.strip_prefix('-')?.strip_suffix(ARCHIVE[1])?;
    (digits.len() >= DIGITS && digits.bytes().all(|c| c.is_ascii_digit())).then(|| digits.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn archives_are_named_after_their_list() {
        let names =
            ["images-000001.tar", "images-00001-of-00008-000002.tar", "images-test-000000.tar", "x.tar"];
        let names = names.map(str::to_owned);
        let of = |list: &str| archives_of(Path::new(list), &names, &[]).cloned().collect::<Vec<_>>();
        assert_eq!(of("triplets.jsonl"), names[..1]);
        assert_eq!(of("triplets-00001-of-00008.jsonl"), names[1..2]);
        assert_eq!(of("data/triplets-test.jsonl"), names[2..3]);
        assert_eq!(number_of(&name_of("images", 1_234_567), "images"), Some(1_234_567));
    }

    /// What stands before the first dot is the key of a sample.
    #[test]
    fn no_two_scenes_have_one_key() {
        let keys = ["a", "a.b", "a%2Eb", "a%b"].map(|id| member_of(id, "gt.exr"));
        assert_eq!(keys, ["a.gt.exr", "a%2Eb.gt.exr", "a%252Eb.gt.exr", "a%25b.gt.exr"]);
    }
}
