//! `--dry-run` and `udc plan`: what is said beforehand, against what is there afterwards.

use std::fs;
use std::path::Path;

use serde_json::Value;

use super::common::{fail, succeed};
use super::train::prepare;

#[test]
fn a_study_is_told_from_other_configurations() {
    let study = Path::new(env!("CARGO_MANIFEST_DIR")).join("workflow/study.toml");
    let info = succeed(Path::new("."), &["info", study.to_str().unwrap()]);
    assert!(info.contains("udc plan") && info.contains("2 datasets, 4 trainings"), "{info}");
    let said = succeed(Path::new("."), &["doctor", study.to_str().unwrap()]);
    assert!(said.contains("a study") || said.contains("study, for"), "{said}");
}

/// What a command says beforehand, as JSON.
fn told(folder: &Path, args: &[&str]) -> Value {
    let before = names(folder);
    let said = succeed(folder, &[args, &["--dry-run", "--json"]].concat());
    assert_eq!(said.lines().count(), 1, "one object: {said}");
    assert_eq!(names(folder), before, "a dry run writes nothing");
    let told: Value = serde_json::from_str(&said).unwrap();
    assert_eq!(told["command"], args[0]);
    for key in ["disk-bytes", "memory-bytes", "seconds", "core-seconds"] {
        assert!(told[key].as_f64().unwrap() >= 0.0, "{key} of {said}");
    }
    told
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

fn bytes_below(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.map(|path| if path.is_dir() { bytes_below(&path) } else { path.metadata().unwrap().len() }).sum()
}

#[test]
fn commands_say_beforehand_what_they_make() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    succeed(folder, &["scenes", "-o", "scenes", "--count", "4", "--size", "32x32"]);
    succeed(folder, &["psf", "--random", "3", "--size", "33", "-o", "psf.exr"]);
    succeed(folder, &["codes", "psf.exr", "--angles=-3,0,3", "--dim", "2", "-o", "bank.safetensors"]);
    let synth = ["synth", "scenes", "--bank", "bank.safetensors", "--split", "test", "-o", "dataset"];
    let all = told(folder, &synth);
    assert_eq!((&all["items"], &all["unit"]), (&12.into(), &"images".into()));
    let part = told(folder, &[&synth[..], &["--shard", "2/4"]].concat());
    assert_eq!(part["items"], 3);
    succeed(folder, &synth);
    let found = bytes_below(&folder.join("dataset"));
    let most = all["disk-bytes"].as_u64().unwrap();
    assert!((found..4 * found).contains(&most), "at most {most} bytes, and there are {found}");

    let restore = [
        "restore",
        "dataset/degraded/r+00",
        "--psf",
        "psf.exr",
        "--method",
        "wiener",
        "--x-max",
        "500",
        "-o",
        "out/",
    ];
    assert_eq!(told(folder, &restore)["items"], 4);
    let said = succeed(folder, &[&restore[..], &["--dry-run", "--shard", "1/2"]].concat());
    assert!(
        said.starts_with("udc restore makes 2 images, at most ") && said.contains(" of memory, about "),
        "{said}"
    );
    let eval = ["eval", "dataset", "--method", "wiener", "-o", "results"];
    assert_eq!(told(folder, &eval)["items"], 12);
    let said = fail(folder, &[&synth[..], &["--shard", "5/5", "--dry-run"]].concat(), 1);
    assert!(said.contains("use fewer shards"), "{said}");
}

#[test]
fn a_training_says_beforehand_how_many_steps_it_makes() {
    let scratch = tempfile::tempdir().unwrap();
    prepare(scratch.path());
    let train = ["train", "config.toml", "--data", "dataset", "-o", "run", "--set", "data.cache-mib=0"];
    let all = told(scratch.path(), &train);
    assert_eq!((&all["items"], &all["unit"]), (&24.into(), &"steps".into()));
    succeed(scratch.path(), &train);
    let (most, found) = (all["disk-bytes"].as_u64().unwrap(), bytes_below(&scratch.path().join("run")));
    assert!(most >= found, "at most {most} bytes, and there are {found}");
}

/// A cache of a hundred gibibytes, of which eight small images take next to nothing.
#[test]
fn a_training_needs_no_more_memory_than_there_are_images_to_keep() {
    let scratch = tempfile::tempdir().unwrap();
    prepare(scratch.path());
    let train = ["train", "config.toml", "--data", "dataset", "-o", "run", "--set", "data.cache-mib=102400"];
    let memory = told(scratch.path(), &train)["memory-bytes"].as_u64().unwrap();
    assert!(memory < 8 << 30, "{memory} bytes");
}

/// Copies a small study and what it needs.
fn write_study(folder: &Path) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for (from, to) in [
        ("tests/cluster/study.toml", "study.toml"),
        ("tests/cluster/network.toml", "network.toml"),
        ("src/commands/demo/panel.toml", "panel.toml"),
    ] {
        fs::copy(root.join(from), folder.join(to)).unwrap();
    }
}

#[test]
fn settings_of_a_study_are_checked_before_anything_is_measured() {
    let scratch = tempfile::tempdir().unwrap();
    write_study(scratch.path());
    let study = scratch.path().join("study.toml");
    let text = fs::read_to_string(&study).unwrap();
    fs::write(&study, format!("{text}\n[training]\nset = [\"iterations=abc\"]\n")).unwrap();
    let said = fail(scratch.path(), &["plan", "study.toml", "-v"], 1);
    assert!(said.contains("network.toml") && said.contains("iterations"), "{said}");
    assert!(!said.contains("udc scenes"), "nothing was tried: {said}");
}

/// Sent to it alone, as by a scheduler: a terminal sends it to the commands that are tried as well.
#[test]
#[cfg(unix)]
fn a_plan_that_is_stopped_leaves_nothing() {
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};

    let scratch = tempfile::tempdir().unwrap();
    write_study(scratch.path());
    let before = names(scratch.path());
    let mut plan = Command::new(env!("CARGO_BIN_EXE_udc"))
        .args(["plan", "study.toml"])
        .current_dir(scratch.path())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let (begun, patience) = (Instant::now(), Duration::from_secs(120));
    while names(scratch.path()) == before && begun.elapsed() < patience {
        std::thread::sleep(Duration::from_millis(5));
    }
    std::thread::sleep(Duration::from_millis(100));
    let pid = plan.id().to_string();
    assert!(Command::new("kill").args(["-TERM", &pid]).status().unwrap().success());
    let asked = Instant::now();
    assert!(!plan.wait().unwrap().success());
    assert!(asked.elapsed() < patience / 4, "{:?}", asked.elapsed());
    assert_eq!(names(scratch.path()), before);
}

/// Times of a busy machine in a test say nothing: what is counted is checked.
#[test]
fn a_study_is_planned_from_a_little_of_it() {
    let scratch = tempfile::tempdir().unwrap();
    write_study(scratch.path());
    let before = names(scratch.path());
    let said = succeed(scratch.path(), &["plan", "study.toml", "--workers", "1,8,1000", "--json"]);
    assert_eq!(names(scratch.path()), before, "nothing stays");
    let plan: Value = serde_json::from_str(&said).unwrap();
    let stages: Vec<(&str, u64, u64)> = plan["stages"]
        .as_array()
        .unwrap()
        .iter()
        .map(|stage| {
            (
                stage["name"].as_str().unwrap(),
                stage["jobs"].as_u64().unwrap(),
                stage["items"].as_u64().unwrap(),
            )
        })
        .collect();
    let expected = [
        ("psf", 1, 1),
        ("codes", 1, 3),
        ("scenes", 8, 24),
        ("synth", 8, 72),
        ("train small", 1, 60),
        ("eval", 8, 24),
    ];
    assert_eq!(stages, expected);
    let hours = |index: usize| plan["workers"][index]["hours"].as_f64().unwrap();
    assert!(
        hours(0) > hours(1) && hours(1) == hours(2) && plan["machine-hours"].as_f64() > Some(0.0),
        "{said}"
    );

    let study = scratch.path().join("study.toml");
    fs::write(&study, fs::read_to_string(&study).unwrap().replace("[noise]", "[niose]")).unwrap();
    assert!(fail(scratch.path(), &["plan", "study.toml"], 1).contains("niose"));
}
