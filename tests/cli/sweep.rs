//! `udc sweep`.

use std::fs;
use std::path::Path;

use serde_json::Value;

use super::common::{fail, succeed};
use super::run_folder::prepare_other_data;
use super::train::{CONFIG, kill_after_lines, prepare};

/// A dataset and the configurations of two rows, with and without the kernel code.
fn scratch() -> tempfile::TempDir {
    let scratch = tempfile::tempdir().unwrap();
    prepare(scratch.path());
    let config =
        |condition: &str| CONFIG.replace("code-dim", &format!("condition = \"{condition}\"\ncode-dim"));
    fs::write(scratch.path().join("plain.toml"), config("none")).unwrap();
    fs::write(scratch.path().join("full.toml"), config("image+psf")).unwrap();
    scratch
}

const SWEEP: [&str; 5] = ["sweep", "plain.toml", "full.toml", "--data", "dataset"];

fn sweep<'a>(output: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&SWEEP[..], &["-o", output], more].concat()
}

fn read(folder: &Path, name: &str) -> String {
    fs::read_to_string(folder.join(name)).unwrap()
}

#[test]
fn tabulates_configurations_trained_on_the_same_data() {
    let scratch = scratch();
    let folder = scratch.path();
    let said = succeed(folder, &sweep("sweep", &["--set", "iterations=6"]));
    assert!(said.contains("| degraded | – | – | – | – | 2 |"), "{said}");
    assert_eq!(read(folder, "sweep/table.md").lines().count(), 5, "heading, rule and three rows");
    let table: Value = serde_json::from_str(&read(folder, "sweep/table.json")).unwrap();
    for (row, name) in table["rows"].as_array().unwrap().iter().zip(["plain", "full"]) {
        assert_eq!((&row["name"], &row["iterations"]), (&Value::from(name), &Value::from(6)));
        let model = format!("sweep/{name}/model.safetensors");
        // The row's numbers are those of `udc eval`.
        let results = format!("again-{name}");
        succeed(folder, &["eval", "dataset", "--model", &model, "-o", &results]);
        let again: Value = serde_json::from_str(&read(folder, &format!("{results}/metrics.json"))).unwrap();
        assert_eq!(row["mean"], again["mean"], "{name}");
        assert_eq!(row["parameters"], again["methods"][1]["parameters"], "{name}");
        assert_eq!(row["degraded"], again["methods"][0]["mean"], "{name}");
    }
    assert!(table["rows"][0]["parameters"].as_u64() < table["rows"][1]["parameters"].as_u64());
    let csv = read(folder, "sweep/table.csv");
    assert!(csv.starts_with("configuration,parameters,gmac_800x800,") && csv.lines().count() == 3, "{csv}");
}

#[test]
fn a_killed_sweep_keeps_its_rows_and_ends_with_the_same_table() {
    let scratch = scratch();
    let folder = scratch.path();
    succeed(folder, &sweep("whole", &[]));
    kill_after_lines(folder, &sweep("killed", &[]), "killed/full/metrics.jsonl", 12);
    let said = succeed(folder, &sweep("killed", &["--resume"]));
    assert!(said.contains("plain: finished before"), "{said}");
    assert_eq!(read(folder, "whole/table.json"), read(folder, "killed/table.json"));
    let model = |sweep: &str| fs::read(folder.join(sweep).join("full/model.safetensors")).unwrap();
    assert!(model("whole") == model("killed"), "the bytes differ");
    let said = succeed(folder, &sweep("killed", &["--resume"]));
    assert!(said.contains("full: finished before"), "{said}");
    // Another measurement of finished trainings measures again and trains no further.
    let said = succeed(folder, &sweep("killed", &["--resume", "--limit", "1"]));
    assert!(!said.contains("finished before") && said.contains("| 24 | 1 |"), "{said}");
}

#[test]
fn names_a_row_that_failed_and_finishes_the_others() {
    let scratch = scratch();
    let folder = scratch.path();
    let wrong = read(folder, "full.toml").replace("code-dim = 2", "code-dim = 3");
    fs::write(folder.join("wrong.toml"), wrong).unwrap();
    let sweep =
        ["sweep", "wrong.toml", "plain.toml", "--data", "dataset", "-o", "sweep", "--set", "iterations=2"];
    let said = fail(folder, &sweep, 1);
    assert!(said.contains("1 of 2 rows failed") && said.contains("row wrong") && said.contains("codes of 2"));
    let table: Value = serde_json::from_str(&read(folder, "sweep/table.json")).unwrap();
    assert_eq!((&table["rows"][0]["name"], &table["failed"][0]["name"]), (&"plain".into(), &"wrong".into()));
    assert!(read(folder, "sweep/table.md").contains("\nFailed: wrong: "));
}

#[test]
fn rows_are_not_resumed_on_other_data() {
    let scratch = scratch();
    let folder = scratch.path();
    let plain = ["sweep", "plain.toml", "--data", "dataset", "-o", "sweep", "--set", "iterations=2"];
    succeed(folder, &plain);
    prepare_other_data(folder, true, false);
    let said = fail(folder, &[&plain[..], &["--resume"]].concat(), 1);
    assert!(said.contains("row plain was made with other data: kernel-bank-sha256 is"), "{said}");
    prepare_other_data(folder, false, true);
    let said = fail(folder, &[&plain[..], &["--resume"]].concat(), 1);
    assert!(said.contains("row plain was made with other data: data-sha256 is"), "{said}");
    assert!(folder.join("sweep/plain/row.toml").is_file(), "the row is kept");
}

#[test]
fn refuses_rows_that_cannot_be_compared() {
    let scratch = scratch();
    let folder = scratch.path();
    fs::write(folder.join("seeded.toml"), format!("seed = 5\n{CONFIG}")).unwrap();
    let said = fail(folder, &["sweep", "plain.toml", "seeded.toml", "--data", "dataset", "-o", "sweep"], 1);
    assert!(
        said.contains("plain has seed 0 and seeded has seed 5") && said.contains("--set seed=0"),
        "{said}"
    );
    let said = fail(folder, &["sweep", "plain.toml", "plain.toml", "--data", "dataset", "-o", "sweep"], 1);
    assert!(said.contains("two configurations are called plain"), "{said}");
    let said = fail(folder, &sweep("sweep", &["--set", "data.crop=large"]), 2);
    assert!(said.contains("--set data.crop=large: "), "{said}");
    assert!(!folder.join("sweep").exists());
    fs::create_dir_all(folder.join("sweep/full")).unwrap();
    let said = fail(folder, &sweep("sweep", &[]), 1);
    assert!(said.contains("--resume") && said.contains("--overwrite"), "{said}");
    assert!(fail(folder, &["sweep", "--data", "dataset", "-o", "x"], 2).contains("CONFIG"));
}

#[test]
fn a_sweep_without_a_row_leaves_the_tables_as_they_are() {
    let scratch = scratch();
    let folder = scratch.path();
    let plain = ["sweep", "plain.toml", "--data", "dataset", "-o", "sweep", "--set", "iterations=2"];
    succeed(folder, &plain);
    let before = read(folder, "sweep/table.md");
    fail(folder, &[&plain[..], &["--resume", "--set", "seed=9"]].concat(), 1);
    assert_eq!(read(folder, "sweep/table.md"), before);
}
