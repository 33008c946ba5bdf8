//! The command line: what `--overwrite` and `--resume` do not take away, or put elsewhere, without a word.

use std::fs;
use std::path::{Path, PathBuf};

use udc::dataset::{Dataset, Split};

use super::common::{fail, succeed, udc};
use super::synth::{scratch, synth};

/// A scratch folder whose halls lie in a folder of their own.
fn divided() -> tempfile::TempDir {
    let scratch = scratch();
    fs::create_dir(scratch.path().join("halls")).unwrap();
    for name in ["hall_01.npy", "hall_02.npy"] {
        fs::rename(scratch.path().join("views").join(name), scratch.path().join("halls").join(name)).unwrap();
    }
    scratch
}

const HALLS: [&str; 5] = ["synth", "halls", "--bank", "bank.safetensors", "-o"];

/// Scenes and bytes of a dataset's split.
fn images(dataset: &Path, split: Split) -> Vec<(String, Vec<u8>, Vec<u8>)> {
    let dataset = Dataset::open(dataset).unwrap();
    let read = |path: &str| udc::io::read_bytes(&dataset.root.join(path)).unwrap();
    let triplets = dataset.split(split).unwrap();
    triplets.iter().map(|t| (t.id.clone(), read(&t.gt), read(&t.degraded))).collect()
}

/// Runs `udc`, which succeeds, and returns what it says on stderr.
fn told(folder: &Path, args: &[&str]) -> String {
    let output = udc(folder, args);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "udc {args:?} failed: {said}");
    said
}

#[test]
fn a_split_that_is_made_anew_leaves_the_other_one() {
    for storage in [&["--format", "npy"][..], &["--format", "npy", "--tar", "30KiB"]] {
        let scratch = divided();
        let (folder, root) = (scratch.path(), scratch.path().join("dataset"));
        let halls = |more: &[&str]| {
            succeed(folder, &[&HALLS[..], &["dataset", "--split", "test"], storage, more].concat())
        };
        synth(folder, "dataset", &[&["--split", "train"], storage].concat());
        halls(&[]);
        let (trained, tested) = (images(&root, Split::Train), images(&root, Split::Test));
        // The split that was added, then that of the run that began the dataset.
        assert!(halls(&["--overwrite"]).contains("6 images made"));
        assert_eq!((&images(&root, Split::Train), &images(&root, Split::Test)), (&trained, &tested));
        synth(folder, "dataset", &[&["--split", "train", "--overwrite"], storage].concat());
        assert_eq!((&images(&root, Split::Train), &images(&root, Split::Test)), (&trained, &tested));
        assert_eq!(Dataset::open(&root).unwrap().config.unwrap().division, "all train, test");
        // With fewer scenes, which are not scenes of the other split.
        fs::remove_file(folder.join("halls/hall_02.npy")).unwrap();
        halls(&["--overwrite"]);
        assert_eq!((&images(&root, Split::Train), &images(&root, Split::Test)[..]), (&trained, &tested[..3]));
        fs::rename(folder.join("halls/hall_01.npy"), folder.join("halls/park_01.npy")).unwrap();
        let args = [&HALLS[..], &["dataset", "--split", "test", "--overwrite"], storage].concat();
        assert!(fail(folder, &args, 1).contains("scene park_01 in its train split"));
        assert_eq!((&images(&root, Split::Train), &images(&root, Split::Test)[..]), (&trained, &tested[..3]));
    }
}

#[test]
fn a_split_that_would_be_lost_is_named() {
    let scratch = divided();
    let (folder, root) = (scratch.path(), scratch.path().join("dataset"));
    synth(folder, "dataset", &["--split", "train"]);
    let refused = |more: &[&str]| fail(folder, &[&HALLS[..], &["dataset", "--overwrite"], more].concat(), 1);
    let said = refused(&["--split", "test", "--x-max", "400"]);
    assert!(said.contains("would lose 9 images of its train split"), "{said}");
    assert!(said.contains("another formation.x-max") && said.contains("another folder"), "{said}");
    succeed(folder, &[&HALLS[..], &["dataset", "--split", "test"]].concat());
    let said = refused(&[]);
    assert!(said.contains("would lose 6 images of its test split"), "{said}");
    let said = refused(&["--split", "train", "--half"]);
    assert!(said.contains("would lose 6 images of its test split"), "{said}");
    let config = root.join("dataset.toml");
    let text = fs::read_to_string(&config).unwrap();
    fs::write(&config, "damaged").unwrap();
    let said = refused(&["--split", "test"]);
    assert!(said.contains("9 images of its train split") && said.contains("cannot be read"), "{said}");
    fs::write(&config, text).unwrap();
    let count = |split| images(&root, split).len();
    assert_eq!((count(Split::Train), count(Split::Test)), (9, 6));
    // What the run makes itself is replaced, by whatever flags.
    fs::remove_file(root.join("triplets-test.jsonl")).unwrap();
    synth(folder, "dataset", &["--split", "train", "--overwrite", "--x-max", "400"]);
    assert_eq!(images(&root, Split::Train).len(), 9);
}

#[test]
fn a_shard_that_voids_the_others_says_so() {
    let scratch = scratch();
    let synth = |shard: &str, more: &[&str]| {
        let args = ["synth", "views", "--bank", "bank.safetensors", "-o", "dataset", "--shard", shard];
        told(scratch.path(), &[&args[..], more].concat())
    };
    synth("1/2", &[]);
    synth("2/2", &[]);
    assert!(!synth("1/2", &["--overwrite"]).contains("warning"));
    let said = synth("1/2", &["--overwrite", "--x-max", "400"]);
    assert!(said.contains("warning: triplets-00002-of-00002.jsonl goes with its 6 images"), "{said}");
    assert!(!synth("2/2", &["--overwrite", "--x-max", "400"]).contains("goes with"));
}

/// Of the two panoramas, the hall is tested with; of four, the park too, by the ranks that their names have.
#[test]
fn scenes_that_move_to_another_split_are_told_of() {
    let scratch = scratch();
    let folder = scratch.path();
    let args = [
        "synth",
        "views",
        "--bank",
        "bank.safetensors",
        "-o",
        "dataset",
        "--test-fraction",
        "0.5",
        "--resume",
    ];
    let views = folder.join("views");
    let later = ["gate_01.npy", "tower_01.npy"].map(|name| views.join(name));
    assert!(!told(folder, &args).contains("another split"));
    assert!(!told(folder, &args).contains("another split"));
    for path in &later {
        fs::copy(views.join("hall_01.npy"), path).unwrap();
    }
    let said = told(folder, &args);
    assert!(said.contains("warning: 3 finished scenes are in another split than before"), "{said}");
    assert!(said.contains("park_01 from train to test; a network that was trained"), "{said}");
    later.iter().for_each(|path| fs::remove_file(path).unwrap());
    let said = told(folder, &args);
    assert!(said.contains("park_01 from test to train; a network that is trained now"), "{said}");
}

#[test]
fn a_dataset_does_not_replace_the_scenes_that_it_is_made_of() {
    let scratch = scratch();
    let folder = scratch.path();
    let lamp = fs::read(folder.join("views/park_01.npy")).unwrap();
    let refused = |scenes: &str, more: &[&str]| {
        let args = ["synth", scenes, "--psf", "psf.npy", "--format", "npy", "-o", "inout", "--overwrite"];
        let said = fail(folder, &[&args[..], more].concat(), 1);
        assert!(said.contains("holds the scene") && said.contains("name another folder"), "{said}");
        said
    };
    fs::create_dir(folder.join("inout")).unwrap();
    fs::rename(folder.join("views"), folder.join("inout/gt")).unwrap();
    refused("inout/gt", &["--x-max", "0.5"]);
    refused("inout/../inout/gt/park_01.npy", &["--tar", "1MiB"]);
    refused("inout/gt/", &["--dry-run"]);
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(folder.join("inout/gt/park_01.npy"), folder.join("park_01.npy")).unwrap();
        assert!(refused("park_01.npy", &[]).contains("the scene park_01.npy"));
    }
    assert_eq!(fs::read(folder.join("inout/gt/park_01.npy")).unwrap(), lamp);
    let others: Vec<PathBuf> =
        fs::read_dir(folder.join("inout")).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(others, [folder.join("inout/gt")]);
    // Beside its scenes, a dataset replaces nothing.
    let beside = ["synth", "inout/gt", "--psf", "psf.npy", "-o", "inout", "--overwrite"];
    succeed(folder, &beside);
    assert_eq!(fs::read(folder.join("inout/gt/park_01.npy")).unwrap(), lamp);
}

#[test]
fn scenes_of_the_archives_that_a_new_beginning_removes_are_not_read() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "packed", &["--format", "npy", "--tar", "1MiB"]);
    let archive = folder.join("packed/images-000000.tar");
    let before = fs::read(&archive).unwrap();
    let scene = "packed/images-000000.tar/hall_01.gt.npy";
    let said = fail(folder, &["synth", scene, "--psf", "psf.npy", "-o", "packed", "--overwrite"], 1);
    assert!(said.contains("holds the scene"), "{said}");
    assert_eq!(fs::read(&archive).unwrap(), before);
}

#[test]
fn images_that_an_earlier_run_left_are_told_of() {
    let scratch = tempfile::tempdir().unwrap();
    let scenes = |count: &str, more: &[&str]| {
        let args = ["scenes", "-o", "scenes", "--size", "16x32", "--kinds", "night", "--count", count];
        told(scratch.path(), &[&args[..], more].concat())
    };
    assert!(!scenes("4", &["--overwrite"]).contains("warning"));
    let said = scenes("2", &["--overwrite"]);
    assert!(said.contains("warning: scenes holds 2 images that this run does not make"), "{said}");
    assert!(said.contains("first night-s0-00002.exr"), "{said}");
    assert!(!scenes("4", &["--overwrite", "--shard", "1/2"]).contains("warning"));
    assert!(!scenes("4", &["--overwrite"]).contains("warning"));
    let crop = |views: &str, more: &[&str]| {
        let args = [
            "crop",
            "scenes/night-s0-00000.exr",
            "-o",
            "views",
            "--size",
            "8",
            "--views",
            views,
            "--overwrite",
        ];
        told(scratch.path(), &[&args[..], more].concat())
    };
    assert!(!crop("3", &[]).contains("warning"));
    let said = crop("2", &[]);
    assert!(
        said.contains("warning: views holds 1 images") && said.contains("night-s0-00000_03.exr"),
        "{said}"
    );
    assert!(!crop("3", &["--shard", "1/3"]).contains("warning"));
}

#[cfg(unix)]
#[test]
fn a_scene_that_is_a_link_to_nothing_is_not_left_out() {
    let scratch = scratch();
    std::os::unix::fs::symlink("/nowhere", scratch.path().join("views/park_09.npy")).unwrap();
    for scenes in ["views", "views/*.npy"] {
        let said = fail(scratch.path(), &["synth", scenes, "--psf", "psf.npy", "-o", "dataset"], 1);
        assert!(said.contains("views/park_09.npy") && said.contains("link"), "{said}");
    }
    assert!(!scratch.path().join("dataset").exists());
}

#[test]
fn what_two_paths_name_counts_once_and_is_not_written_over() {
    let scratch = scratch();
    let folder = scratch.path();
    for twice in [
        &["codes", "psf.npy", "views/../psf.npy", "--dim", "1", "-o", "twice.safetensors"][..],
        &["fuse", "psf.npy", "views/../psf.npy", "--exposures", "1,1/4", "-o", "twice.exr"],
    ] {
        let said = fail(folder, twice, 1);
        assert!(said.contains("names views/../psf.npy twice, as psf.npy too"), "{twice:?}: {said}");
    }
    for over in [
        &["fuse", "psf.npy", "--exposures", "1", "-o", "./psf.npy", "--overwrite"][..],
        &["psf", "--from", "psf.npy", "--turn", "1", "-o", "./psf.npy", "--overwrite"],
        &["codes", "--project", "bank.safetensors", "psf.npy", "-o", "./psf.npy", "--overwrite"],
    ] {
        let said = fail(folder, over, 1);
        assert!(said.contains("psf.npy would be read and written over"), "{over:?}: {said}");
    }
}

#[test]
fn nothing_is_both_kept_and_made_anew() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "dataset", &[]);
    let before = fs::read(folder.join("dataset/triplets.jsonl")).unwrap();
    for command in [
        &["synth", "views", "--bank", "bank.safetensors", "-o", "dataset"][..],
        &["scenes", "--count", "1", "--size", "16", "-o", "scenes"],
        &["crop", "panoramas", "-o", "views"],
    ] {
        let said = fail(folder, &[command, &["--resume", "--overwrite"]].concat(), 1);
        assert!(said.contains("--resume keeps what --overwrite replaces; pass one of them"), "{said}");
    }
    assert_eq!(fs::read(folder.join("dataset/triplets.jsonl")).unwrap(), before);
}
