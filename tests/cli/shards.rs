//! `--shard I/N`: parts that several processes make at the same time are what one process makes.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use ndarray::Array3;
use udc::core::image::LinearImage;
use udc::core::psf::Psf;
use udc::io::{self, WriteOptions};

#[cfg(unix)]
use super::common::signal_after;
use super::common::{fail, succeed, udc};
use super::train::prepare;

/// Six small scenes, a PSF and a bank of two kernels.
fn scratch() -> tempfile::TempDir {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    succeed(folder, &["scenes", "-o", "scenes", "--count", "6", "--size", "32x40", "--half"]);
    let energy = Array3::from_shape_fn((3, 9, 9), |(c, y, x)| {
        let (dy, dx) = (y as f32 - 4.0, x as f32 - 4.0);
        (-(dy * dy + (1.0 + c as f32) * dx * dx) / 4.0).exp() + 1e-3
    });
    let psf = Psf::from_energy(energy).unwrap();
    io::write_psf(&folder.join("psf.exr"), &psf, &WriteOptions::default()).unwrap();
    succeed(folder, &["codes", "psf.exr", "--angles=-5,0", "--dim", "1", "-o", "bank.safetensors"]);
    scratch
}

fn dataset(folder: &Path) {
    let args = ["synth", "scenes", "--bank", "bank.safetensors", "--split", "test", "-o", "dataset"];
    succeed(folder, &args);
}

/// The contents of all files below a folder, by their names in it.
fn contents(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.strip_prefix(root).unwrap().to_owned(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

fn assert_same(one: &Path, other: &Path, least: usize) {
    let (one, other) = (contents(one), contents(other));
    assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>());
    assert!(one.len() >= least, "{} files", one.len());
    for (name, bytes) in one {
        assert!(other[&name] == bytes, "{} differs", name.display());
    }
}

fn start(folder: &Path, args: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_udc"))
        .args(args)
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn end(run: Child) {
    let ended = run.wait_with_output().unwrap();
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
}

/// Runs all shards at the same time, the last one first.
fn run_shards(folder: &Path, args: &[&str], count: usize) {
    let names: Vec<String> = (1..=count).rev().map(|index| format!("{index}/{count}")).collect();
    let runs: Vec<Child> =
        names.iter().map(|name| start(folder, &[args, &["--shard", name]].concat())).collect();
    runs.into_iter().for_each(end);
}

/// One run into `whole`, and so many shards into `parts`, which end with the same files.
fn assert_shards_make_the_same(folder: &Path, args: &[&str], counts: &[usize], least: usize) {
    succeed(folder, &[args, &["-o", "whole/"]].concat());
    for count in counts {
        let output = format!("parts{count}/");
        run_shards(folder, &[args, &["-o", &output]].concat(), *count);
        assert_same(&folder.join("whole"), &folder.join(output), least);
    }
}

#[test]
fn what_is_no_shard_is_refused_by_every_command() {
    let scratch = tempfile::tempdir().unwrap();
    let commands = [
        "scenes --count 3",
        "crop in",
        "synth in",
        "examples in",
        "restore in",
        "finish in",
        "eval in",
        "sweep in",
    ];
    for command in commands {
        for shard in ["0/8", "9/8", "1/0", "0/0", "8", "a/b", "-1/2", "1/2/3", ""] {
            let flag = format!("--shard={shard}");
            let args: Vec<&str> = command.split(' ').chain(["-o", "out", &flag]).collect();
            let said = fail(scratch.path(), &args, 2);
            assert!(said.contains("expected I/N with I from 1 to N"), "{command} {shard}: {said}");
        }
    }
    assert_eq!(contents(scratch.path()).len(), 0);
}

#[test]
fn shards_of_crop_cut_the_same_views() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    fs::create_dir(folder.join("panoramas")).unwrap();
    for (index, name) in ["beach", "straße 日本", "attic"].iter().enumerate() {
        let planes =
            Array3::from_shape_fn((3, 16, 32), |(c, y, x)| ((c + y * 3 + x * (5 + index)) % 11) as f32);
        let path = folder.join(format!("panoramas/{name}.exr"));
        io::write_image(&path, &LinearImage::from_planes(planes).unwrap(), &WriteOptions::default()).unwrap();
    }
    let crop = ["crop", "panoramas", "--size", "12", "--views", "3", "--margin", "2"];
    assert_shards_make_the_same(folder, &crop, &[2, 4, 9], 9);
    let said = fail(folder, &[&crop[..], &["-o", "more", "--shard", "1/10"]].concat(), 1);
    assert!(said.contains("1/10 is one of more shards than there are views; use at most 9"), "{said}");
    // A shard refuses to replace its own views, whatever others have made.
    let again = [&crop[..], &["-o", "parts4", "--shard", "2/4"]].concat();
    assert!(fail(folder, &again, 1).contains("--overwrite"));
    fs::remove_file(folder.join("parts4/attic_03.exr")).unwrap();
    succeed(folder, &[&again[..], &["--overwrite"]].concat());
    let said = succeed(folder, &[&crop[..], &["-o", "parts4", "--shard", "1/4", "--overwrite"]].concat());
    assert!(said.contains("2 views of 1 panoramas"), "{said}");
    let left = contents(&folder.join("parts4"));
    assert_eq!(left.len(), 9);
}

#[test]
fn shards_of_restore_and_finish_make_the_same_images() {
    let scratch = scratch();
    let folder = scratch.path();
    dataset(folder);
    fs::create_dir(folder.join("restored")).unwrap();
    let restore =
        ["restore", "dataset/degraded/r+00", "--psf", "psf.exr", "--method", "wiener", "--x-max", "500"];
    assert_shards_make_the_same(folder, &restore, &[2, 6], 6);
    let said = fail(folder, &[&restore[..], &["-o", "more/", "--shard", "7/7"]].concat(), 1);
    assert!(said.contains("more shards than there are images; use at most 6"), "{said}");
    assert!(!folder.join("more").exists());
    fs::rename(folder.join("whole"), folder.join("light")).unwrap();
    for count in [2, 6] {
        fs::remove_dir_all(folder.join(format!("parts{count}"))).unwrap();
    }
    assert_shards_make_the_same(folder, &["finish", "light", "--format", "jpg"], &[2, 4], 6);
}

/// As when a cluster begins a job again that still runs elsewhere.
#[test]
fn the_same_shard_twice_at_once_is_done_once() {
    let scratch = scratch();
    let folder = scratch.path();
    dataset(folder);
    let restore = [
        "restore",
        "dataset/degraded/r+00",
        "--psf",
        "psf.exr",
        "--method",
        "richardson-lucy",
        "--x-max",
        "500",
        "--resume",
    ];
    succeed(folder, &[&restore[..], &["-o", "whole/"]].concat());
    let twice: Vec<&str> = [&restore[..], &["-o", "parts/", "--shard"]].concat();
    let runs: Vec<Child> = ["1/2", "2/2", "1/2", "2/2", "1/2"]
        .iter()
        .map(|shard| start(folder, &[&twice[..], &[shard]].concat()))
        .collect();
    runs.into_iter().for_each(end);
    assert_same(&folder.join("whole"), &folder.join("parts"), 6);
}

/// The second one does not ask whether the first is at work, as where a file system has no locks, or keeps those of the dead.
#[test]
fn a_part_of_a_dataset_that_two_processes_make_at_once_is_whole() {
    let scratch = scratch();
    let folder = scratch.path();
    dataset(folder);
    let synth =
        ["synth", "scenes", "--bank", "bank.safetensors", "--split", "test", "-o", "parts", "--take-over"];
    let runs: Vec<Child> = ["1/2", "1/2", "2/2", "2/2", "1/2", "2/2"]
        .iter()
        .map(|shard| start(folder, &[&synth[..], &["--shard", shard]].concat()))
        .collect();
    runs.into_iter().for_each(end);
    let (mut whole, mut parts) = (contents(&folder.join("dataset")), contents(&folder.join("parts")));
    let lines = |found: &mut BTreeMap<PathBuf, Vec<u8>>| {
        let names: Vec<PathBuf> = found
            .keys()
            .filter(|name| name.extension().is_some_and(|ending| ending == "jsonl"))
            .cloned()
            .collect();
        let texts = names.iter().map(|name| String::from_utf8(found.remove(name).unwrap()).unwrap());
        let mut lines: Vec<String> =
            texts.flat_map(|text| text.lines().map(str::to_owned).collect::<Vec<_>>()).collect();
        lines.sort();
        (names.len(), lines)
    };
    let (one, listed) = lines(&mut whole);
    assert_eq!((one, listed.len()), (1, 12));
    assert_eq!(lines(&mut parts), (2, listed));
    assert!(whole == parts, "different bytes");
}

const EVAL: [&str; 8] = [
    "eval",
    "dataset",
    "--method",
    "wiener,richardson-lucy",
    "--highlights",
    "restored,keep",
    "--regions",
    "--mismatch",
];

#[test]
fn merged_parts_of_an_evaluation_are_one_evaluation() {
    let scratch = scratch();
    let folder = scratch.path();
    dataset(folder);
    let eval = [&EVAL[..], &["--ldr", "0.5", "--pictures", "3"]].concat();
    succeed(folder, &[&eval[..], &["-o", "whole"]].concat());
    for count in [1, 5, 12] {
        let (parts, merged) = (format!("parts{count}"), format!("merged{count}"));
        run_shards(folder, &[&eval[..], &["-o", &parts]].concat(), count);
        succeed(folder, &["eval", "--merge", &parts, "-o", &merged]);
        assert_same(&folder.join("whole"), &folder.join(&merged), 12);
    }
}

#[test]
fn parts_that_do_not_belong_together_are_not_merged() {
    let scratch = scratch();
    let folder = scratch.path();
    dataset(folder);
    let eval = |output: &str, more: &[&str]| {
        succeed(folder, &[&["eval", "dataset", "--method", "wiener", "-o", output], more].concat())
    };
    let merge = |parts: &[&str]| fail(folder, &[&["eval", "-o", "merged", "--merge"], parts].concat(), 1);
    eval("a", &["--shard", "1/3"]);
    eval("b", &["--shard", "3/3"]);
    assert!(merge(&["a", "b"]).contains("1 of 3 parts are missing: 2/3"));
    eval("c", &["--shard", "3/3"]);
    let said = merge(&["a", "b", "c"]);
    assert!(
        said.contains("b/part-00003-of-00003.toml and c/part-00003-of-00003.toml are both shard 3/3"),
        "{said}"
    );
    eval("d", &["--shard", "2/3", "--metrics", "psnr", "--kernels", "r+00"]);
    let said = merge(&["a", "b", "d"]);
    assert!(said.contains("made with another dataset dataset, kernels, metrics"), "{said}");
    eval("e", &["--shard", "1/2"]);
    assert!(merge(&["a", "e"]).contains("is shard 1/2 and"));
    assert!(merge(&["scenes"]).contains("holds no part of an evaluation"));
    let part = folder.join("a/part-00001-of-00003.toml");
    let text = fs::read_to_string(&part).unwrap();
    fs::write(&part, &text[..text.len() / 2]).unwrap();
    let said = merge(&["a", "b"]);
    assert!(said.contains("part-00001-of-00003.toml: is damaged") && said.contains("eval --shard"), "{said}");
    assert!(!folder.join("merged").exists());
    let of_folders = [["--gt", "gt"], ["--domain", "linear"], ["--alpha", "0.5"], ["--x-max", "16"]];
    for flag in [["--metrics", "psnr"], ["--device", "cpu"]].into_iter().chain(of_folders) {
        let said = fail(folder, &[&["eval", "--merge", "a", "-o", "merged"][..], &flag].concat(), 2);
        assert!(said.contains(flag[0]), "{said}");
    }
    assert!(fail(folder, &["eval", "dataset", "--merge", "a", "-o", "merged"], 2).contains("--merge"));
    let again = ["eval", "dataset", "--method", "wiener", "-o", "b", "--shard", "3/3"];
    assert!(fail(folder, &again, 1).contains("--overwrite"));
}

#[test]
fn shards_of_two_folders_are_measured_as_one_run() {
    let scratch = scratch();
    let folder = scratch.path();
    dataset(folder);
    fs::remove_file(folder.join("dataset/gt").join(first_of(&folder.join("dataset/gt")))).unwrap();
    let eval = ["eval", "--restored", "dataset/degraded/r+00", "--gt", "dataset/gt", "--allow-missing"];
    succeed(folder, &[&eval[..], &["-o", "whole"]].concat());
    run_shards(folder, &[&eval[..], &["-o", "parts"]].concat(), 3);
    succeed(folder, &["eval", "--merge", "parts", "-o", "merged"]);
    assert_same(&folder.join("whole"), &folder.join("merged"), 5);
    let table = fs::read_to_string(folder.join("merged/table.md")).unwrap();
    assert!(table.contains("Left out of every mean: 1 images"), "{table}");
}

fn first_of(folder: &Path) -> String {
    io::list_folder(folder).unwrap().remove(0)
}

#[test]
fn shards_of_a_sweep_make_the_rows_of_its_table() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    prepare(folder);
    let config = |condition: &str| {
        super::train::CONFIG.replace("code-dim", &format!("condition = \"{condition}\"\ncode-dim"))
    };
    fs::write(folder.join("plain.toml"), config("none")).unwrap();
    fs::write(folder.join("full.toml"), config("image+psf")).unwrap();
    let sweep = ["sweep", "plain.toml", "full.toml", "--data", "dataset", "--set", "iterations=4"];
    succeed(folder, &[&sweep[..], &["-o", "whole"]].concat());
    run_shards(folder, &[&sweep[..], &["-o", "parts"]].concat(), 2);
    assert!(!folder.join("parts/table.md").exists());
    let said = succeed(folder, &[&sweep[..], &["-o", "parts", "--resume"]].concat());
    assert!(said.contains("plain: finished before") && said.contains("full: finished before"), "{said}");
    for name in ["table.md", "table.csv", "table.json", "plain/row.toml", "full/model.safetensors"] {
        let read = |root: &str| fs::read(folder.join(root).join(name)).unwrap();
        assert!(read("whole") == read("parts"), "{name} differs");
    }
    let said = fail(folder, &[&sweep[..], &["-o", "more", "--shard", "1/3"]].concat(), 1);
    assert!(said.contains("more shards than there are configurations; use at most 2"), "{said}");
}

/// What is there of a dataset is measured, and that it is not all of it is told.
#[test]
fn a_dataset_that_lacks_a_part_is_told_of() {
    let scratch = scratch();
    let folder = scratch.path();
    let part = |shard: &str| {
        let synth = ["synth", "scenes", "--bank", "bank.safetensors", "--split", "test", "-o", "dataset"];
        succeed(folder, &[&synth[..], &["--shard", shard]].concat());
    };
    let told = || {
        let output = udc(folder, &["eval", "dataset", "--method", "wiener", "-o", "results", "--overwrite"]);
        assert!(output.status.success());
        let info = succeed(folder, &["info", "dataset"]);
        let doctor = String::from_utf8(udc(folder, &["doctor", "dataset"]).stdout).unwrap();
        [String::from_utf8(output.stderr).unwrap(), info, doctor]
    };
    part("1/3");
    part("3/3");
    for said in told() {
        assert!(said.contains("triplets-00002-of-00003.jsonl is not there"), "{said}");
    }
    part("2/3");
    assert!(told().iter().all(|said| !said.contains("not finished")), "{:?}", told());
}

/// A run that was killed leaves what says that it did not come to its end; going on with it takes that away.
#[cfg(unix)]
#[test]
fn a_dataset_of_a_killed_run_is_told_of() {
    let scratch = scratch();
    let folder = scratch.path();
    succeed(folder, &["scenes", "-o", "many", "--count", "60", "--size", "96"]);
    let synth = ["synth", "many", "--bank", "bank.safetensors", "--split", "test", "-o", "dataset"];
    let names = fs::read_dir(folder.join("many")).unwrap().map(|entry| entry.unwrap().file_name());
    let mut names: Vec<String> = names.map(|name| name.into_string().unwrap()).collect();
    names.sort();
    signal_after(folder, &synth, &format!("dataset/gt/{}", names[5]), "-KILL");
    let said = succeed(folder, &["info", "dataset"]);
    assert!(said.contains("the run that writes triplets.jsonl has not ended"), "{said}");
    succeed(folder, &[&synth[..], &["--resume"]].concat());
    assert!(!succeed(folder, &["info", "dataset"]).contains("has not ended"));
    let hidden = fs::read_dir(folder.join("dataset")).unwrap().map(|entry| entry.unwrap().file_name());
    assert!(hidden.into_iter().all(|name| !name.to_string_lossy().starts_with('.')));
}
