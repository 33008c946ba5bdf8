//! Lists the scenes of a dataset and divides them by source: no panorama is in two splits.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::core::error::{Error, Result};
use crate::core::primaries::Primaries;
use crate::core::provenance::Provenance;
use crate::dataset::Split;
use crate::io;

/// A clean image that a dataset is made of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Scene {
    /// Its name in the dataset: the file's name without extension.
    pub id: String,
    /// The file.
    pub path: PathBuf,
    /// What it was cut from: the panorama.
    pub source: String,
    /// What it is reserved for.
    pub split: Split,
    /// Pixels by which it is larger than the frame on each side, where the file says it, as those of `udc crop` do.
    pub margin: Option<usize>,
}

/// How the sources are divided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Division {
    /// This share of the sources is for testing, at least one of two or more; the rest is for training.
    TestFraction(f64),
    /// All scenes are for one use.
    All(Split),
}

impl fmt::Display for Division {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TestFraction(fraction) => write!(f, "test-fraction {fraction}"),
            Self::All(split) => write!(f, "all {}", split.name()),
        }
    }
}

/// Names the scenes in `paths`, finds their sources and divides these.
///
/// A source is what `udc crop` wrote into the file as its panorama, else the file's name up to its last `_`.
///
/// # Errors
/// [`Error::Config`] when two files have one name or the fraction is not within 0 and 1; [`Error::Io`] when a
/// file cannot be read.
pub fn list_scenes(paths: Vec<PathBuf>, division: Division, seed: u64) -> Result<Vec<Scene>> {
    let mut scenes: BTreeMap<String, Scene> = BTreeMap::new();
    for path in paths {
        let id = stem(&path);
        if let Some(other) = scenes.get(&id) {
            let reason = format!(
                "{} and {} are both named {id}; rename one of them",
                other.path.display(),
                path.display()
            );
            return Err(Error::config("scenes", reason));
        }
        let provenance = io::read_provenance(&path)?;
        let source = source_of(provenance.as_ref(), &id);
        let margin = provenance.as_ref().and_then(Provenance::margin);
        scenes.insert(id.clone(), Scene { id, path, source, split: Split::Train, margin });
    }
    let mut scenes: Vec<_> = scenes.into_values().collect();
    divide(&mut scenes, division, seed)?;
    Ok(scenes)
}

fn stem(path: &Path) -> String {
    io::stem_of_input(path)
}

/// The margin that scenes have around the frame: what was asked for, or what their files declare.
///
/// A view that was cut with a margin belongs to a frame of its own, so that no other margin will do. Files that say none
/// may have any: the frame is then their middle.
///
/// # Errors
/// [`Error::Config`] when files were cut with another margin than was asked for, or with several, or when some say one,
/// others say nothing, and nobody asked.
pub fn common_margin(declared: &[(&Path, Option<usize>)], asked: Option<usize>) -> Result<usize> {
    let cut = declared.iter().find_map(|(path, margin)| Some((path, margin.filter(|&margin| margin > 0)?)));
    let Some((cut, margin)) = cut else { return Ok(asked.unwrap_or(0)) };
    let (cut, refuse) = (cut.display(), |reason: String| Err(Error::config("margin", reason)));
    if let Some(asked) = asked.filter(|&asked| asked != margin) {
        let advice = format!("ask for that, or cut views with the margin of {asked}");
        return refuse(format!("is {asked}, and {cut} was cut with a margin of {margin} pixels; {advice}"));
    }
    let is_other = |(_, found): &&(&Path, Option<usize>)| match found {
        Some(other) => *other != margin,
        None => asked.is_none(),
    };
    let Some((path, other)) = declared.iter().find(is_other) else { return Ok(margin) };
    let path = path.display();
    match other {
        Some(other) => refuse(format!(
            "{cut} was cut with a margin of {margin} pixels, and {path} with {other}; make a dataset of each"
        )),
        None => refuse(format!(
            "{cut} was cut with a margin of {margin} pixels, and {path} does not say; if all were, ask for that margin"
        )),
    }
}

/// The red, green and blue that scenes have in common, by `read`, which finds those of a file that are others than sRGB's.
///
/// # Errors
/// [`Error::Config`] naming two files of different ones; else of reading a file.
pub fn common_primaries<'a>(
    paths: impl IntoIterator<Item = &'a Path>,
    read: impl Fn(&Path) -> Result<Option<Primaries>>,
) -> Result<Option<Primaries>> {
    let mut paths = paths.into_iter();
    let Some(first) = paths.next() else { return Ok(None) };
    let common = read(first)?;
    for path in paths {
        let found = read(path)?;
        if !Primaries::are_same(common, found) {
            let reason = format!(
                "{} is of {}, and {} of {}: make a dataset of each, or convert the scenes to one colour space",
                first.display(),
                Primaries::name_of(common),
                path.display(),
                Primaries::name_of(found)
            );
            return Err(Error::config("scenes", reason));
        }
    }
    Ok(common)
}

fn source_of(provenance: Option<&Provenance>, id: &str) -> String {
    let panorama = provenance.and_then(|provenance| provenance.config.get("panorama")?.as_str());
    let by_name = || id.rsplit_once('_').map_or(id, |(source, _)| source);
    panorama.unwrap_or_else(by_name).to_owned()
}

fn divide(scenes: &mut [Scene], division: Division, seed: u64) -> Result<()> {
    let fraction = match division {
        Division::All(split) => {
            scenes.iter_mut().for_each(|scene| scene.split = split);
            return Ok(());
        }
        Division::TestFraction(fraction) if (0.0..=1.0).contains(&fraction) => fraction,
        Division::TestFraction(fraction) => {
            let reason = format!("must be a share between 0 and 1, found {fraction}");
            return Err(Error::config("test-fraction", reason));
        }
    };
    let sources: BTreeSet<String> = scenes.iter().map(|scene| scene.source.clone()).collect();
    let mut ranked: Vec<_> = sources.into_iter().map(|source| (rank(&source, seed), source)).collect();
    ranked.sort_unstable();
    let count = test_count(ranked.len(), fraction);
    let tested: BTreeSet<_> = ranked.into_iter().take(count).map(|(_, source)| source).collect();
    for scene in scenes {
        scene.split = if tested.contains(&scene.source) { Split::Test } else { Split::Train };
    }
    Ok(())
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of the sources")]
fn test_count(sources: usize, fraction: f64) -> usize {
    let wanted = (sources as f64 * fraction).round() as usize;
    match sources {
        _ if fraction <= 0.0 => 0,
        _ if fraction >= 1.0 => sources,
        0 | 1 => 0,
        _ => wanted.clamp(1, sources - 1),
    }
}

/// A number that depends on the source and the seed only, so that a source's rank among the others stays.
fn rank(source: &str, seed: u64) -> [u8; 32] {
    let mut hash = Sha256::new();
    hash.update(seed.to_le_bytes());
    hash.update(source.as_bytes());
    hash.finalize().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenes(sources: usize, division: Division, seed: u64) -> Vec<Scene> {
        let mut scenes: Vec<_> = (0..3 * sources)
            .map(|i| Scene {
                id: format!("s{}_{i:02}", i / 3),
                path: PathBuf::new(),
                source: format!("s{}", i / 3),
                split: Split::Val,
                margin: None,
            })
            .collect();
        divide(&mut scenes, division, seed).unwrap();
        scenes
    }

    fn tested(scenes: &[Scene]) -> BTreeSet<&str> {
        let tested = scenes.iter().filter(|scene| scene.split == Split::Test);
        tested.map(|scene| scene.source.as_str()).collect()
    }

    #[test]
    fn a_margin_is_what_the_files_say_or_what_is_asked_for() {
        let found = |margins: &[Option<usize>], asked| {
            let files: Vec<_> = margins.iter().map(|&margin| (Path::new("a.exr"), margin)).collect();
            common_margin(&files, asked).map_err(|error| error.to_string())
        };
        assert_eq!(found(&[None, None], None), Ok(0));
        assert_eq!(found(&[None, Some(0)], Some(7)), Ok(7));
        assert_eq!(found(&[Some(64), Some(64)], None), Ok(64));
        assert_eq!(found(&[Some(64), None], Some(64)), Ok(64));
        let refused = |margins, asked| found(margins, asked).unwrap_err();
        assert!(refused(&[Some(64)], Some(0)).contains("is 0, and a.exr was cut with a margin of 64"));
        assert!(refused(&[Some(64), Some(32)], None).contains("with 32"));
        assert!(refused(&[Some(64), Some(0)], Some(64)).contains("with 0"));
        assert!(refused(&[Some(64), None], None).contains("does not say"));
    }

    #[test]
    fn scenes_have_their_primaries_in_common_or_are_named() {
        let found = |of: &[(&str, Option<Primaries>)]| {
            let read = |path: &Path| Ok(of.iter().find(|(name, _)| Path::new(name) == path).unwrap().1);
            common_primaries(of.iter().map(|(name, _)| Path::new(name)), read).map_err(|e| e.to_string())
        };
        let (p3, wide) = (Some(Primaries::DISPLAY_P3), Some(Primaries::BT2020));
        assert_eq!(found(&[("a", None), ("b", None)]), Ok(None));
        assert_eq!(found(&[("a", wide), ("b", wide)]), Ok(wide));
        let said = found(&[("a.exr", wide), ("b.exr", p3)]).unwrap_err();
        assert!(said.contains("a.exr is of BT.2020 primaries, and b.exr of Display P3 primaries"), "{said}");
        assert!(found(&[("a.exr", None), ("b.exr", p3)]).unwrap_err().contains("a.exr is of sRGB primaries"));
    }

    #[test]
    fn keeps_every_source_in_one_split() {
        let scenes = scenes(20, Division::TestFraction(0.15), 4);
        assert_eq!(tested(&scenes).len(), 3);
        for scene in &scenes {
            let expected = if tested(&scenes).contains(&*scene.source) { Split::Test } else { Split::Train };
            assert_eq!(scene.split, expected);
        }
    }

    #[test]
    fn two_sources_are_enough_for_a_test_split() {
        assert_eq!(tested(&scenes(2, Division::TestFraction(0.01), 0)).len(), 1);
        assert_eq!(tested(&scenes(2, Division::TestFraction(0.99), 0)).len(), 1);
        assert_eq!(tested(&scenes(1, Division::TestFraction(0.5), 0)).len(), 0);
        assert_eq!(tested(&scenes(5, Division::TestFraction(0.0), 0)).len(), 0);
        assert_eq!(tested(&scenes(5, Division::All(Split::Test), 0)).len(), 5);
    }

    #[test]
    fn the_division_follows_the_seed_and_nothing_else() {
        let divide = |seed| scenes(20, Division::TestFraction(0.3), seed);
        assert_eq!(divide(1), divide(1));
        assert_ne!(tested(&divide(1)), tested(&divide(2)));
    }

    #[test]
    fn refuses_two_files_of_one_name() {
        let folder = tempfile::tempdir().unwrap();
        let paths: Vec<_> = ["a/x.npy", "b/x.exr"].map(|name| folder.path().join(name)).into();
        for path in &paths {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"").unwrap();
        }
        let message = list_scenes(paths, Division::TestFraction(0.1), 0).unwrap_err().to_string();
        assert!(message.contains("both named x"), "{message}");
    }
}
