//! Looks at a dataset: its lists, its files, and the images of an even choice of its triplets.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use ndarray::Array3;
use rayon::prelude::*;

use super::Findings;
use super::images::{Fault, Faults, Sizes, exceeds, read};
use crate::core::error::{Error, Result};
use crate::core::progress::Progress;
use crate::dataset::{Dataset, Split, Triplet};
use crate::io::{is_hidden, list_folder, list_unfinished, read_provenance, sha256_of_file};

/// Names that are told of several files.
const NAMED: usize = 3;

/// Whether a folder is meant to be a dataset.
pub(super) fn is_one(folder: &Path) -> bool {
    Dataset::is_one(folder)
}

/// Looks at a dataset, and returns it with the sizes of the images looked at where it can be opened; of its triplets at most
/// `limit` are read, all where it is none.
pub(super) fn look(
    root: &Path,
    limit: Option<usize>,
    (findings, progress): (&mut Findings, &Progress),
) -> Result<Option<(Dataset, Sizes)>> {
    let about = root.display().to_string();
    let dataset = match Dataset::open(root) {
        Ok(dataset) => dataset,
        Err(error) => {
            tell_of_unfinished(root, &[root.to_owned()], findings);
            let mend = "finish it with the flags of its `udc synth` and --resume, or copy it again";
            findings.refused(&about, "dataset-unreadable", &error, mend);
            return Ok(None);
        }
    };
    let folders = folders_of(&dataset);
    let all: Vec<_> = folders.iter().map(|folder| root.join(folder)).collect();
    tell_of_unfinished(root, &all, findings);
    if let Some(what) = dataset.unfinished()? {
        let mend = "finish it with the flags of its `udc synth` and --resume";
        findings.warn(&about, "dataset-unfinished", what, mend);
    }
    if let Some(what) = dataset.left_out()? {
        let mend = "add the codes of these kernels in a folder of their own, or take their images away";
        findings.warn(&about, "images-left-out", what, mend);
    }
    tell_of_gaps(&about, &dataset, findings);
    tell_of_unlisted(&about, &dataset, &folders, findings);
    tell_of_splits(&about, &dataset, findings);
    tell_of_twins(&about, &dataset, findings)?;
    if let Some(warning) = dataset.formation.scale_warning(None) {
        findings.warn(&about, "scale", warning, "make the dataset anew with one scale of light");
    }
    let chosen = evenly(&dataset.triplets, limit);
    let (faults, sizes) = look_at_images(&dataset, &chosen, progress)?;
    // The clean image of several triplets is looked at with each.
    faults.tell(&about, 2 * chosen.len(), findings);
    if faults.is_empty() {
        let sizes = if sizes.len() == 1 { "one size" } else { "several sizes" };
        let what = format!(
            "{} triplets; the images of {} were read: of {sizes}, linear, finite, as listed",
            dataset.triplets.len(),
            chosen.len()
        );
        findings.ok(&about, "dataset", what);
    }
    Ok(Some((dataset, sizes)))
}

/// At most so many of a list, spread evenly.
pub(super) fn evenly<T>(list: &[T], limit: Option<usize>) -> Vec<&T> {
    let count = limit.unwrap_or(usize::MAX).min(list.len());
    (0..count).map(|i| &list[i * list.len() / count]).collect()
}

/// The folders that images lie in, and the dataset's own.
fn folders_of(dataset: &Dataset) -> BTreeSet<String> {
    let parent = |name: &String| Path::new(name).parent().map(|folder| folder.to_string_lossy().into_owned());
    let named = dataset.triplets.iter().flat_map(|triplet| [&triplet.gt, &triplet.degraded]);
    named.filter_map(parent).chain([String::new()]).collect()
}

/// Tells of what killed runs left.
pub(super) fn tell_of_unfinished(root: &Path, folders: &[PathBuf], findings: &mut Findings) {
    let left: Vec<_> =
        folders.iter().flat_map(|folder| list_unfinished(folder).unwrap_or_default()).collect();
    if let Some(first) = left.first() {
        let what = format!(
            "{} temporary files are there, as of a run at work or a killed one: {}",
            left.len(),
            first.display()
        );
        let mend = "wait for the run, or go on with it (--resume), which removes those older than an hour; or remove them";
        findings.warn(root.display(), "leftovers", what, mend);
    }
}

/// Tells of scenes that lack kernels which others have.
fn tell_of_gaps(about: &str, dataset: &Dataset, findings: &mut Findings) {
    let mut scenes: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for triplet in &dataset.triplets {
        scenes.entry(&triplet.id).or_default().insert(&triplet.kernel);
    }
    let kernels: BTreeSet<&str> = scenes.values().flatten().copied().collect();
    let gaps: Vec<String> = scenes
        .iter()
        .filter(|(_, has)| has.len() < kernels.len())
        .map(|(scene, has)| {
            let lacks: Vec<&str> = kernels.difference(has).copied().collect();
            format!("{scene} lacks {}", lacks.join(", "))
        })
        .collect();
    if !gaps.is_empty() {
        let named = gaps.iter().take(NAMED).cloned().collect::<Vec<_>>().join("; ");
        let what =
            format!("{} of {} scenes are not there through every kernel: {named}", gaps.len(), scenes.len());
        let mend = "finish it with the flags of its `udc synth` and --resume";
        findings.warn(about, "triplets-incomplete", what, mend);
    }
    let unknown: BTreeSet<&str> = dataset
        .triplets
        .iter()
        .filter(|t| dataset.kernel_index(t).is_err())
        .map(|t| t.kernel.as_str())
        .collect();
    if let Some(kernel) = unknown.first() {
        let what = format!("triplets name the kernel {kernel}, which the bank has not");
        findings.fail(about, "kernel-unknown", what, "put the dataset's own kernels.safetensors back");
    }
}

/// Tells of images that no list names: nothing learns from them.
fn tell_of_unlisted(about: &str, dataset: &Dataset, folders: &BTreeSet<String>, findings: &mut Findings) {
    if dataset.config.is_none() {
        return;
    }
    let listed: BTreeSet<&str> = dataset
        .triplets
        .iter()
        .flat_map(|triplet| [triplet.gt.as_str(), triplet.degraded.as_str()])
        .collect();
    // Images of an archive that is listed are in it together with what is told of them.
    let names = list_folder(&dataset.root).unwrap_or_default();
    let archives = names.into_iter().filter(|name| name.ends_with(".tar") && !folders.contains(name));
    let mut unlisted: Vec<String> = archives.collect();
    for folder in folders.iter().filter(|folder| !folder.is_empty()) {
        let names = list_folder(&dataset.root.join(folder)).unwrap_or_default();
        let paths = names.iter().filter(|name| !is_hidden(name)).map(|name| format!("{folder}/{name}"));
        unlisted.extend(
            paths.filter(|path| !listed.contains(path.as_str()) && dataset.root.join(path).is_file()),
        );
    }
    if let Some(first) = unlisted.first() {
        let what = format!("{} files in its folders are in no list, the first is {first}", unlisted.len());
        let mend = "finish the dataset with the flags of its `udc synth` and --resume, which lists them; or remove them";
        findings.warn(about, "unlisted", what, mend);
    }
}

fn tell_of_splits(about: &str, dataset: &Dataset, findings: &mut Findings) {
    let has = |split: Split| dataset.triplets.iter().any(|triplet| triplet.split == split);
    if !has(Split::Train) {
        let mend = "to train, add a split: `udc synth SCENES --split train` with the same flags";
        findings.warn(about, "no-train-split", "it has nothing to learn from", mend);
    }
    if !has(Split::Test) && !has(Split::Val) {
        let what =
            "it has neither a test nor a val split: trainings are not validated, and nothing can be measured";
        let mend = "add one of other scenes: `udc synth SCENES --split test` with the same flags";
        findings.warn(about, "no-test-split", what, mend);
    }
}

/// Tells of scenes that are learned from and measured with, under two names: by the SHA-256 of their files.
fn tell_of_twins(about: &str, dataset: &Dataset, findings: &mut Findings) -> Result<()> {
    let mut scenes: BTreeMap<&str, &Triplet> = BTreeMap::new();
    for triplet in &dataset.triplets {
        scenes.entry(&triplet.id).or_insert(triplet);
    }
    let mut trained = BTreeMap::new();
    let mut others = Vec::new();
    for triplet in scenes.into_values() {
        let Some(sha256) = scene_sha256(dataset, triplet)? else { continue };
        match triplet.split {
            Split::Train => drop(trained.insert(sha256, &triplet.id)),
            Split::Test | Split::Val => others.push((sha256, triplet)),
        }
    }
    let twins: Vec<_> =
        others.iter().filter_map(|(sha256, other)| Some((trained.get(sha256)?, *other))).collect();
    if let Some((trained, other)) = twins.first() {
        let (count, split) = (twins.len(), other.split.name());
        let what = format!(
            "{count} scenes are in training and in another split under two names, the first as {trained} and as {} ({split}): what is \
             measured there was learned by heart",
            other.id
        );
        let mend = "take one of the two away, and make that split anew with --overwrite";
        findings.warn(about, "scene-in-two-splits", what, mend);
    }
    Ok(())
}

/// SHA-256 of a scene's file, as its list or its ground truth says it.
fn scene_sha256(dataset: &Dataset, triplet: &Triplet) -> Result<Option<String>> {
    if triplet.scene_sha256.is_some() || !dataset.root.join(&triplet.gt).is_file() {
        return Ok(triplet.scene_sha256.clone());
    }
    let made = read_provenance(&dataset.root.join(&triplet.gt))?;
    Ok(made.and_then(|made| Some(made.config.get("scene-sha256")?.as_str()?.to_owned())))
}

/// Reads the images of triplets; what is wrong with them, and their sizes.
fn look_at_images(dataset: &Dataset, triplets: &[&Triplet], progress: &Progress) -> Result<(Faults, Sizes)> {
    let bar = progress.bar(triplets.len() as u64, "triplets");
    let found = Mutex::new((Faults::default(), Sizes::new()));
    triplets.par_iter().try_for_each(|triplet| {
        progress.check()?;
        let mut faults = Faults::default();
        let size = look_at_pair(dataset, triplet, &mut faults);
        let mut found = found.lock().unwrap_or_else(PoisonError::into_inner);
        found.0.extend(faults);
        found.1.extend(size);
        bar.inc(1);
        Ok::<_, Error>(())
    })?;
    Ok(found.into_inner().unwrap_or_else(PoisonError::into_inner))
}

/// Reads a degraded image and its ground truth; returns the size where both could be read.
fn look_at_pair(dataset: &Dataset, triplet: &Triplet, faults: &mut Faults) -> Option<[usize; 2]> {
    let degraded_path = dataset.root.join(&triplet.degraded);
    if let Some(listed) = &triplet.sha256
        && sha256_of_file(&degraded_path).is_ok_and(|sha256| sha256 != *listed)
    {
        faults.note(Fault::HashDiffers, triplet.degraded.clone());
    }
    let clean = read(&dataset.root.join(&triplet.gt), &triplet.gt, faults);
    let degraded = read(&degraded_path, &triplet.degraded, faults);
    let (clean, degraded) = (clean?, degraded?);
    // Only degraded images are listed with what they hold.
    let scene = clean.provenance.as_ref().and_then(|made| made.config.get("scene")?.as_str());
    if scene.is_some_and(|scene| scene != triplet.id) {
        faults.note(Fault::OtherScene, triplet.gt.clone());
    }
    let size = |planes: &Array3<f32>| [planes.dim().1, planes.dim().2];
    let size = (size(&clean.planes), size(&degraded.planes));
    if size.0 != size.1 {
        faults.note(Fault::SizesDiffer, triplet.degraded.clone());
    } else if clean.planes == degraded.planes {
        faults.note(Fault::NotDegraded, triplet.degraded.clone());
    }
    if exceeds(&degraded, dataset.formation.x_max) {
        faults.note(Fault::AboveXMax, triplet.degraded.clone());
    }
    Some(size.1)
}
