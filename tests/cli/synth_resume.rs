//! `udc synth` in shards and several runs: what is there is kept, and nothing is mixed with what is of something else.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, SystemTime};

use ndarray::Array3;
use udc::core::image::{Linear, LinearImage};
use udc::dataset::{Dataset, Split};
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};
use super::synth::{contents, scratch, synth, write_field};

#[test]
fn shards_make_the_same_images_as_one_run() {
    let folder = scratch();
    synth(folder.path(), "whole", &["--noise", "gaussian:0.01"]);
    for shard in ["2/3", "1/3", "3/3"] {
        synth(folder.path(), "parts", &["--noise", "gaussian:0.01", "--shard", shard]);
    }
    let (whole, parts) = (folder.path().join("whole"), folder.path().join("parts"));
    assert_eq!(Dataset::open(&whole).unwrap().triplets, Dataset::open(&parts).unwrap().triplets);
    let images = |root: &Path| contents(&root.join("degraded"));
    assert!(images(&whole) == images(&parts), "different bytes");
    let message = fail(
        folder.path(),
        &[
            "synth",
            "views",
            "--bank",
            "bank.safetensors",
            "-o",
            "parts",
            "--noise",
            "gaussian:0.01",
            "--shard",
            "1/2",
        ],
        1,
    );
    assert!(message.contains("other shards"), "{message}");
}

#[test]
fn resumes_where_a_killed_run_left_off() {
    let folder = scratch();
    synth(folder.path(), "whole", &[]);
    synth(folder.path(), "killed", &[]);
    let killed = folder.path().join("killed");
    // What a kill may leave: half a line, files that are not listed, and, say, a damaged disk.
    let list = killed.join("triplets.jsonl");
    let text = fs::read_to_string(&list).unwrap();
    let lines: Vec<_> = text.lines().collect();
    fs::write(&list, format!("{}\n{}", lines[..8].join("\n"), &lines[8][..20])).unwrap();
    let damaged = killed.join("degraded/r+00").join(format!("{}.exr", "hall_01"));
    let mut bytes = fs::read(&damaged).unwrap();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    fs::write(&damaged, bytes).unwrap();
    fs::remove_file(killed.join("gt/park_03.exr")).unwrap();
    let said = synth(folder.path(), "killed", &["--resume"]);
    assert!(said.contains("8 images made, 7 were there"), "{said}");
    let dataset = Dataset::open(&killed).unwrap();
    assert_eq!(dataset.triplets, Dataset::open(&folder.path().join("whole")).unwrap().triplets);
    let images = |name: &str| contents(&folder.path().join(name).join("degraded"));
    assert!(images("whole") == images("killed"), "different bytes");
}

#[test]
fn overwriting_one_shard_with_other_flags_voids_the_others() {
    let folder = scratch();
    let shard = |index: &str, more: &[&str]| {
        synth(folder.path(), "dataset", &[&["--split", "train", "--shard", index], more].concat())
    };
    let made = |said: &str| said.lines().last().unwrap().to_owned();
    shard("1/2", &[]);
    shard("2/2", &[]);
    // With the same flags the other shard stays.
    shard("1/2", &["--overwrite"]);
    assert!(shard("2/2", &["--resume"]).contains("0 images made, 6 were there"));
    shard("1/2", &["--overwrite", "--x-max", "400"]);
    let said = made(&shard("2/2", &["--resume", "--x-max", "400"]));
    assert!(said.ends_with("6 images made"), "{said}");
    synth(folder.path(), "whole", &["--split", "train", "--x-max", "400"]);
    let images = |name: &str| contents(&folder.path().join(name).join("degraded"));
    assert!(images("whole") == images("dataset"), "different bytes");
    // Nor does anything stay of a dataset that cannot be read.
    fs::write(folder.path().join("dataset/dataset.toml"), "damaged").unwrap();
    shard("1/2", &["--overwrite", "--x-max", "400"]);
    let said = made(&shard("2/2", &["--resume", "--x-max", "400"]));
    assert!(said.ends_with("6 images made"), "{said}");
}

#[test]
fn shards_may_start_together_in_a_new_folder() {
    let folder = scratch();
    write_field(folder.path(), "field.toml", &["psf.npy", "psf.npy"]);
    let kernels = [&["--bank", "bank.safetensors"][..], &["--field", "field.toml"]];
    for (index, (kernels, images)) in kernels.into_iter().zip([15, 5]).enumerate() {
        let output = format!("dataset{index}");
        let shards = ["1/4", "2/4", "3/4", "4/4"].map(|shard| {
            let args = [&["synth", "views", "-o", &output, "--shard", shard][..], kernels].concat();
            Command::new(env!("CARGO_BIN_EXE_udc"))
                .args(args)
                .current_dir(folder.path())
                .stdout(Stdio::null())
                .stderr(Stdio::piped())
                .spawn()
                .unwrap()
        });
        for shard in shards {
            let ended = shard.wait_with_output().unwrap();
            assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
        }
        assert_eq!(Dataset::open(&folder.path().join(output)).unwrap().triplets.len(), images);
    }
}

#[test]
fn a_run_that_was_killed_before_it_described_the_dataset_is_taken_up() {
    let folder = scratch();
    write_field(folder.path(), "field.toml", &["psf.npy"]);
    for (output, more) in
        [("new", &[][..]), ("resumed", &["--resume"]), ("field", &["--field", "field.toml"])]
    {
        let root = folder.path().join(output);
        synth(folder.path(), output, more);
        for name in ["triplets.jsonl", "dataset.toml"] {
            fs::remove_file(root.join(name)).unwrap();
        }
        for name in ["gt", "degraded"] {
            fs::remove_dir_all(root.join(name)).unwrap();
        }
        fs::write(root.join(".udc-abcdef.partial"), "half").unwrap();
        synth(folder.path(), output, more);
        Dataset::open(&root).unwrap();
    }
    // A bank that is not this run's may be somebody's only copy.
    fs::create_dir(folder.path().join("banks")).unwrap();
    let bank = folder.path().join("banks/kernels.safetensors");
    succeed(folder.path(), &["codes", "psf.npy", "--angles=0,9", "--dim", "1", "-o", bank.to_str().unwrap()]);
    let args = ["synth", "views", "--bank", "bank.safetensors", "-o", "banks"];
    assert!(fail(folder.path(), &args, 1).contains("holds no dataset"));
}

#[test]
fn shards_do_not_share_out_other_scenes_than_they_began_with() {
    let folder = scratch();
    let flags = ["--split", "train", "--shard"];
    let root = folder.path().join("dataset");
    for shard in ["1/2", "2/2"] {
        synth(folder.path(), "dataset", &[&flags[..], &[shard]].concat());
    }
    // The first by name, so that all others are dealt to the other shard.
    let views = folder.path().join("views");
    fs::copy(views.join("park_01.npy"), views.join("arch_01.npy")).unwrap();
    for shard in ["1/2", "2/2"] {
        let args = ["synth", "views", "--bank", "bank.safetensors", "-o", "dataset", "--resume"];
        let said = fail(folder.path(), &[&args[..], &flags, &[shard]].concat(), 1);
        assert!(said.contains("begun with other scenes") && said.contains("--overwrite"), "{said}");
    }
    assert_eq!(Dataset::open(&root).unwrap().triplets.len(), 15);
    for shard in ["1/2", "2/2"] {
        synth(folder.path(), "dataset", &[&flags[..], &[shard, "--overwrite"]].concat());
    }
    assert_eq!(Dataset::open(&root).unwrap().triplets.len(), 18);
    // A scene behind all others changes nothing for them.
    fs::copy(views.join("park_01.npy"), views.join("zoo_01.npy")).unwrap();
    for shard in ["1/2", "2/2"] {
        synth(folder.path(), "dataset", &[&flags[..], &[shard, "--resume"]].concat());
    }
    assert_eq!(Dataset::open(&root).unwrap().triplets.len(), 21);
}

#[test]
fn resuming_makes_damaged_ground_truths_anew() {
    let folder = scratch();
    for (output, format) in [("exr", &[][..]), ("npy", &["--format", "npy"])] {
        synth(folder.path(), output, format);
        let path = folder.path().join(output).join(format!("gt/hall_02.{output}"));
        let whole = fs::read(&path).unwrap();
        fs::write(&path, &whole[..whole.len() - 500]).unwrap();
        let said = synth(folder.path(), output, &[format, &["--resume"]].concat());
        assert!(said.contains("3 images made, 12 were there"), "{said}");
        assert!(fs::read(&path).unwrap() == whole, "different bytes");
    }
}

#[test]
fn temporary_files_of_killed_runs_are_removed_when_they_are_old() {
    let folder = scratch();
    synth(folder.path(), "dataset", &[]);
    let root = folder.path().join("dataset");
    for flag in ["--resume", "--overwrite"] {
        let leave = |below: &str, hours: u64| {
            let path = root.join(below).join(format!(".udc-{hours}.partial"));
            let file = fs::File::create(&path).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(3600 * hours)).unwrap();
            path
        };
        let young = ["", "gt", "degraded/r+03"].map(|below| leave(below, 0));
        let old = ["", "gt", "degraded/r+03"].map(|below| leave(below, 2));
        synth(folder.path(), "dataset", &[flag]);
        assert!(young.iter().all(|path| path.exists()), "a run that goes on has lost a file");
        assert!(!old.iter().any(|path| path.exists()), "an abandoned file is still there");
    }
}

#[test]
fn refuses_to_resume_with_other_flags_or_to_replace_a_dataset() {
    let folder = scratch();
    synth(folder.path(), "dataset", &[]);
    let before = contents(&folder.path().join("dataset"));
    let base = ["synth", "views", "--bank", "bank.safetensors", "-o", "dataset"];
    let message = fail(folder.path(), &base, 1);
    assert!(message.contains("--resume") && message.contains("--overwrite"), "{message}");
    let other = [&base[..], &["--resume", "--x-max", "400", "--noise", "gaussian:1"]].concat();
    let message = fail(folder.path(), &other, 1);
    assert!(message.contains("formation.noise, formation.x-max"), "{message}");
    assert!(before == contents(&folder.path().join("dataset")), "the dataset was touched");
    synth(folder.path(), "dataset", &["--overwrite", "--x-max", "400"]);
    let dataset = Dataset::open(&folder.path().join("dataset")).unwrap();
    assert!((dataset.formation.x_max - 400.0).abs() < 1e-6);
}

#[test]
fn scenes_that_changed_are_not_mixed_with_what_they_were() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "dataset", &[]);
    let resume = ["synth", "views", "--bank", "bank.safetensors", "-o", "dataset", "--resume"];
    let lost = folder.join("dataset/degraded/r+00/park_01.exr");
    fs::remove_file(&lost).unwrap();
    let truth = fs::read(folder.join("dataset/gt/park_01.exr")).unwrap();
    fs::copy(folder.join("views/park_01.npy"), folder.join("kept.npy")).unwrap();
    fs::copy(folder.join("views/hall_01.npy"), folder.join("views/park_01.npy")).unwrap();
    let said = fail(folder, &resume, 1);
    assert!(said.contains("images of another views/park_01.npy") && said.contains("--overwrite"), "{said}");
    assert!(!lost.exists() && truth == fs::read(folder.join("dataset/gt/park_01.exr")).unwrap());
    fs::copy(folder.join("kept.npy"), folder.join("views/park_01.npy")).unwrap();
    assert!(succeed(folder, &resume).contains("1 images made"));
}

#[test]
fn a_panorama_is_not_divided_by_views_that_come_later() {
    let scratch = scratch();
    let folder = scratch.path();
    let some = |names: &[&'static str], more: &[&'static str]| {
        let common = ["--bank", "bank.safetensors", "-o", "dataset", "--test-fraction", "0.5"];
        [&["synth"][..], names, &common, more].concat()
    };
    succeed(folder, &some(&["views/park_01.npy", "views/hall_01.npy"], &[]));
    let of = |source: &str| {
        let triplets = Dataset::open(&folder.join("dataset")).unwrap().triplets;
        triplets.iter().find(|triplet| triplet.source == source).unwrap().split
    };
    let (park, hall) = (of("park"), of("hall"));
    assert_ne!(park, hall);
    // Alone, each panorama is trained with: the one that is tested with would be in both.
    let later = if park == Split::Test { "views/park_02.npy" } else { "views/hall_02.npy" };
    let said = fail(folder, &some(&[later], &["--resume"]), 1);
    assert!(said.contains("scenes of one panorama stay together"), "{said}");
    assert_eq!(Dataset::open(&folder.join("dataset")).unwrap().triplets.len(), 6);
}

/// Scenes whose images are all there, replaced by others: of other light, of another size, brighter than x_max.
#[test]
fn resume_refuses_scenes_that_were_replaced_although_all_their_images_are_there() {
    for format in ["exr", "npy"] {
        let scratch = scratch();
        let folder = scratch.path();
        synth(folder, "dataset", &["--format", format]);
        let before = contents(&folder.join("dataset"));
        let resume =
            ["synth", "views", "--bank", "bank.safetensors", "-o", "dataset", "--resume", "--format", format];
        let scene = folder.join("views/park_01.npy");
        let kept = io::read_image::<Linear>(&scene).unwrap();
        let replace = |planes: Array3<f32>| {
            let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
            io::write_image(&scene, &LinearImage::from_planes(planes).unwrap(), &options).unwrap();
        };
        assert!(succeed(folder, &resume).contains("0 images made, 15 were there"));
        let mut others = vec![kept.planes().mapv(|light| 0.5 * light), Array3::from_elem((3, 30, 24), 0.5)];
        // A lamp of another power, whose ground truth is clipped to the same: by the file's hash.
        others.push(kept.planes().mapv(|light| if light > 1000.0 { 2.0 * light } else { light }));
        for planes in others {
            replace(planes);
            let said = fail(folder, &resume, 1);
            assert!(
                said.contains("images of another views/park_01.npy") && said.contains("--overwrite"),
                "{said}"
            );
            assert!(contents(&folder.join("dataset")) == before, "{format}: nothing is touched");
        }
        replace(kept.planes().to_owned());
        assert!(succeed(folder, &resume).contains("0 images made, 15 were there"));
    }
}

/// Lists of earlier versions, which do not say it.
#[test]
fn resume_warns_where_scenes_are_known_by_their_ground_truth_only() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "dataset", &["--format", "npy"]);
    let list = folder.join("dataset/triplets.jsonl");
    let lines = fs::read_to_string(&list).unwrap();
    let without: String = lines
        .lines()
        .map(|line| {
            let mut triplet: serde_json::Value = serde_json::from_str(line).unwrap();
            triplet.as_object_mut().unwrap().remove("scene_sha256").expect("each line says it");
            format!("{triplet}\n")
        })
        .collect();
    fs::write(&list, without).unwrap();
    let args =
        ["synth", "views", "--bank", "bank.safetensors", "-o", "dataset", "--resume", "--format", "npy"];
    let output = udc(folder, &args);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("5 of the scenes"), "{said}");
    fs::write(&list, lines).unwrap();
    let output = udc(folder, &args);
    assert!(output.status.success() && !String::from_utf8_lossy(&output.stderr).contains("warning"));
}
