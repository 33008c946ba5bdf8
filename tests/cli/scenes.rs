//! `udc scenes`.

use std::path::{Path, PathBuf};

use ndarray::Array3;
use udc::core::image::Linear;
use udc::core::psf::Psf;
use udc::dataset::{Dataset, Split};
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed};

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn paints_scenes_that_synth_degrades() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let paint = ["scenes", "--count", "6", "--seed", "3", "--size", "32x40", "--margin", "4", "-o", "scenes"];
    let said = succeed(folder, &paint);
    assert!(said.contains("6 scenes, 32 × 40 pixels and a margin of 4"), "{said}");
    let painted = files(&folder.join("scenes"));
    assert_eq!(painted.len(), 6);
    let provenance = io::read_provenance(&painted[0]).unwrap().unwrap();
    assert_eq!((provenance.command.as_str(), &provenance.config["seed"]), ("scenes", &3.into()));
    assert_eq!(io::read_image::<Linear>(&painted[0]).unwrap().width(), 48);
    assert!(fail(folder, &paint, 1).contains("--overwrite"));

    let energy =
        Array3::from_shape_fn((3, 9, 9), |(_, y, x)| (-(y as f32 - 4.0).hypot(x as f32 - 4.0)).exp());
    let psf = Psf::from_energy(energy).unwrap();
    io::write_psf(&folder.join("psf.exr"), &psf, &WriteOptions::default()).unwrap();
    succeed(folder, &["synth", "scenes", "--psf", "psf.exr", "--test-fraction", "0.34", "-o", "dataset"]);
    let dataset = Dataset::open(&folder.join("dataset")).unwrap();
    let count = |split| dataset.triplets.iter().filter(|triplet| triplet.split == split).count();
    // Each scene is a source of its own, so that a third of six is two.
    assert_eq!((count(Split::Train), count(Split::Test)), (4, 2));
}

#[test]
fn parts_make_the_whole_and_other_seeds_other_scenes() {
    let scratch = tempfile::tempdir().unwrap();
    let paint = |folder: &str, more: &[&str]| {
        let args = ["scenes", "--count", "3", "--size", "24", "--format", "npy", "--half", "-o", folder];
        succeed(scratch.path(), &[&args[..], more].concat());
    };
    paint("whole", &[]);
    ["1/2", "2/2"].iter().for_each(|shard| paint("parts", &["--shard", shard, "--threads", "1"]));
    let contents = |folder: &str| {
        let read = |path: PathBuf| (path.file_name().unwrap().to_owned(), std::fs::read(&path).unwrap());
        files(&scratch.path().join(folder)).into_iter().map(read).collect::<Vec<_>>()
    };
    assert_eq!(contents("whole"), contents("parts"));
    paint("other", &["--seed", "1"]);
    assert!(contents("other").iter().all(|(_, bytes)| contents("whole").iter().all(|(_, old)| old != bytes)));
}

#[test]
fn refuses_sizes_that_are_none() {
    let scratch = tempfile::tempdir().unwrap();
    let refused = |size: &str, code: i32| {
        fail(scratch.path(), &["scenes", "--count", "1", "--size", size, "-o", "scenes"], code)
    };
    assert!(refused("large", 2).contains("expected 512 or 512x768, found `large`"));
    assert!(refused("8x900", 1).contains("16 to 8192 pixels"));
    assert!(!scratch.path().join("scenes").exists());
}

#[test]
fn shows_what_is_asked_for_in_turn() {
    let scratch = tempfile::tempdir().unwrap();
    let paint = ["scenes", "--count", "3", "--size", "24", "-o", "scenes"];
    succeed(scratch.path(), &[&paint[..], &["--kinds", "night,page"]].concat());
    let painted = files(&scratch.path().join("scenes"));
    let names: Vec<_> = painted.iter().map(|path| path.file_stem().unwrap().to_str().unwrap()).collect();
    assert_eq!(names, ["night-s0-00000", "night-s0-00002", "page-s0-00001"]);
    let provenance = io::read_provenance(&painted[2]).unwrap().unwrap();
    assert_eq!(provenance.config["kind"], "page");
    let refused = fail(scratch.path(), &[&paint[..], &["--kinds", "day"]].concat(), 2);
    assert!(refused.contains("lit-leaves"), "{refused}");
}

/// Where the list of all scenes would take more memory than there is.
#[test]
fn refuses_more_scenes_than_any_set_has() {
    let scratch = tempfile::tempdir().unwrap();
    let said = fail(scratch.path(), &["scenes", "--count", "1000000000000", "--size", "16", "-o", "s"], 2);
    assert!(said.contains("1..=1000000"), "{said}");
    assert!(!scratch.path().join("s").exists());
}

#[test]
fn going_on_makes_scenes_anew_that_were_cut_off() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let paint = ["scenes", "--count", "3", "--size", "24", "--format", "npy", "-o", "s"];
    succeed(folder, &paint);
    let painted = files(&folder.join("s"));
    let whole: Vec<_> = painted.iter().map(|path| std::fs::read(path).unwrap()).collect();
    std::fs::write(&painted[0], "").unwrap();
    std::fs::write(&painted[2], &whole[2][..200]).unwrap();
    let said = succeed(folder, &[&paint[..], &["--resume"]].concat());
    assert!(said.contains("1 of them were there, 2 were not written to their end"), "{said}");
    assert!(painted.iter().zip(whole).all(|(path, bytes)| std::fs::read(path).unwrap() == bytes));
}
