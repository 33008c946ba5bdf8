//! The folder of a run of `udc train`: what replaces it, what it is resumed with, and what is cleared away in it.

use std::fs;
use std::path::Path;

use udc::dataset::DatasetConfig;
use udc::io;

#[cfg(unix)]
use super::common::signal_after;
use super::common::{fail, succeed, udc};
use super::train::{losses, prepare, result, train};

/// Gives the dataset another bank, one triplet less, or both.
pub(crate) fn prepare_other_data(folder: &Path, bank: bool, triplets: bool) {
    let root = folder.join("dataset");
    if bank {
        let mut other = io::read_bank(&root.join("kernels.safetensors")).expect("the bank is there");
        other.codes *= 2.0;
        io::write_bank(&root.join("kernels.safetensors"), &other, true).expect("the bank is written");
        let mut config = DatasetConfig::read(&root).expect("the dataset is there");
        config.bank_sha256 = io::bank_sha256(&root.join("kernels.safetensors")).expect("the bank is there");
        fs::write(root.join("dataset.toml"), config.to_toml()).expect("the folder is writable");
    }
    if triplets {
        let lines = fs::read_to_string(root.join("triplets.jsonl")).expect("the list is there");
        let fewer: Vec<&str> = lines.lines().skip(1).collect();
        fs::write(root.join("triplets.jsonl"), fewer.join("\n")).expect("the folder is writable");
    }
}

/// Makes the dataset anew.
fn prepare_again(folder: &Path) {
    let _ = fs::remove_dir_all(folder.join("dataset"));
    prepare(folder);
}

#[test]
fn a_run_is_only_replaced_by_one_that_can_begin() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    train(folder, "run", &["--set", "iterations=2"]);
    let before = result(folder, "run");
    let run = ["train", "config.toml", "--data", "dataset", "-o", "run", "--overwrite"];
    let message = fail(folder, &[&run[..], &["--set", "data.crop=27"]].concat(), 1);
    assert!(message.contains("27 pixels do not fit"), "{message}");
    assert!(before == result(folder, "run"), "the old run is as it was");
    fs::create_dir_all(folder.join("run/previews/8")).unwrap();
    succeed(folder, &[&run[..], &["--set", "iterations=3"]].concat());
    assert!(!folder.join("run/previews").exists(), "previews go with their run");
    assert_eq!(losses(&result(folder, "run").1).len(), 3);
}

#[test]
fn a_run_is_not_resumed_on_other_data() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (bank, triplets, part) in [(true, false, "kernel-bank-sha256"), (false, true, "images-sha256")] {
        prepare_again(folder);
        train(folder, part, &["--set", "iterations=1"]);
        prepare_other_data(folder, bank, triplets);
        let resume = ["train", "--data", "dataset", "-o", part, "--resume", "--set", "iterations=2"];
        let message = fail(folder, &resume, 1);
        assert!(message.contains("other data") && message.contains(part), "{message}");
        assert_eq!(losses(&result(folder, part).1).len(), 1);
        prepare_again(folder);
        succeed(folder, &resume);
    }
}

#[test]
fn resumes_from_an_older_checkpoint_when_the_latest_is_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    train(folder, "whole", &[]);
    train(folder, "run", &[]);
    let state = "run/checkpoints/24/state.safetensors";
    let bytes = fs::read(folder.join(state)).unwrap();
    fs::write(folder.join(state), &bytes[..bytes.len() / 2]).unwrap();
    let output = udc(folder, &["train", "--data", "dataset", "-o", "run", "--resume"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains(state) && said.contains("from iteration 20"), "{said}");
    assert!(result(folder, "whole") == result(folder, "run"), "the bytes differ");
    assert_eq!(fs::read(folder.join(state)).unwrap(), bytes, "the checkpoint is made again");
}

#[test]
fn what_killed_runs_left_half_written_is_cleared_away() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    train(folder, "run", &["--set", "iterations=8"]);
    let run = folder.join("run");
    let left =
        [".udc-a1b2c3.partial", "previews/8/.udc-a1b2c3.partial", "checkpoints/9.partial/.udc-a.partial"];
    for more in ["--resume", "--overwrite"] {
        fs::create_dir_all(run.join("checkpoints/9.partial")).unwrap();
        left.iter().for_each(|name| fs::write(run.join(name), "half").unwrap());
        train(folder, "run", &["--set", "iterations=8", more]);
        for name in left {
            assert!(!run.join(name).exists(), "{name} after {more}");
        }
    }
}

#[cfg(unix)]
#[test]
fn a_run_that_is_to_terminate_writes_a_checkpoint_first() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let run = ["train", "config.toml", "--data", "dataset", "-o", "run"];
    let long = ["--set", "iterations=1000000", "--set", "checkpoint.every=1000000"];
    let (code, said) = signal_after(folder, &[&run[..], &long].concat(), "run/previews/8/2.png", "-TERM");
    assert!(code == Some(1) && said.contains("a checkpoint was written"), "{code:?} {said}");
    assert_eq!(io::list_folder(&folder.join("run/checkpoints")).unwrap().len(), 1);
}

/// As a run is left that was killed between its configuration and the checkpoint of the weights it began with.
#[test]
fn weights_that_a_run_began_with_are_never_lost_in_silence() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    train(folder, "first", &["--set", "iterations=1"]);
    let init = ["--init", "first/model.safetensors"];
    train(folder, "run", &[&init[..], &["--set", "iterations=1"]].concat());
    let whole = fs::read(folder.join("run/model.safetensors")).unwrap();
    for name in ["metrics.jsonl", "model.safetensors"] {
        fs::remove_file(folder.join("run").join(name)).unwrap();
    }
    fs::remove_dir_all(folder.join("run/checkpoints")).unwrap();
    fs::create_dir_all(folder.join("run/checkpoints/0.partial")).unwrap();
    let resume = ["train", "--data", "dataset", "-o", "run", "--resume"];
    let message = fail(folder, &resume, 1);
    assert!(message.contains("--init") && message.contains("without --resume"), "{message}");
    // Nothing is lost, so that the same command may simply be given again.
    train(folder, "run", &[&init[..], &["--set", "iterations=1"]].concat());
    assert!(whole == fs::read(folder.join("run/model.safetensors")).unwrap(), "the bytes differ");
}

#[test]
fn a_run_is_not_resumed_to_fewer_iterations_than_it_made() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    train(folder, "run", &["--set", "iterations=3"]);
    let before = fs::read(folder.join("run/config.toml")).unwrap();
    let resume = ["train", "--data", "dataset", "-o", "run", "--resume", "--set", "iterations=2"];
    let message = fail(folder, &resume, 1);
    assert!(message.contains("iterations: is 2, and the run has made 3 already"), "{message}");
    assert!(before == fs::read(folder.join("run/config.toml")).unwrap());
}
