//! `--json`: every long command tells scripts what it does, line by line, whether it succeeds, fails or is interrupted.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use serde_json::Value;
use udc::core::image::LinearImage;
use udc::io::{WriteOptions, write_image};

use super::common::udc;
use super::{examples, pose, train};

/// Runs `udc` with `--json` and checks what every stream of events keeps to; returns the events, and stderr.
pub(crate) fn events(folder: &Path, args: &[&str], code: i32) -> (Vec<Value>, String) {
    let output = udc(folder, &[args, &["--json"]].concat());
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "udc {args:?} said: {stderr}");
    let stdout = String::from_utf8(output.stdout).unwrap();
    let events = parse(&stdout);
    check(&events, args, code);
    (events, stderr)
}

fn parse(stdout: &str) -> Vec<Value> {
    assert!(stdout.ends_with('\n'), "the last line is whole: {stdout:?}");
    stdout
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line:?}")))
        .collect()
}

fn kind(event: &Value) -> &str {
    event["event"].as_str().unwrap()
}

fn check(events: &[Value], args: &[&str], code: i32) {
    let (first, last) = (events.first().unwrap(), events.last().unwrap());
    if code != 2 {
        assert_eq!((kind(first), &first["command"]), ("started", &Value::from(args[0])), "{first}");
        assert!(first["configuration"].is_object() && first["version"].is_string() && first["schema"] == 1);
    }
    match code {
        0 => assert_eq!(kind(last), "finished", "{last}"),
        code => {
            assert!(["failed", "interrupted"].contains(&kind(last)), "{last}");
            assert_eq!(last["exit-code"], code, "{last}");
            assert!(!last["message"].as_str().unwrap().is_empty());
        }
    }
    let ends = events.iter().filter(|event| ["finished", "failed", "interrupted"].contains(&kind(event)));
    assert_eq!(ends.count(), 1, "{args:?}");
    let times: Vec<f64> = events.iter().map(|event| event["seconds"].as_f64().unwrap()).collect();
    assert!(times.is_sorted(), "{times:?}");
    let items = events.iter().filter(|event| kind(event) == "item").count();
    assert_eq!(last.get("items").and_then(Value::as_u64), Some(items as u64), "{last}");
    for event in events {
        let keys = event.as_object().unwrap().keys();
        let is_kebab =
            |key: &String| key.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-');
        assert!(keys.clone().all(is_kebab), "{event}");
        if kind(event) == "progress" {
            assert!(
                event["done"].as_u64() <= event["total"].as_u64() && event["unit"].is_string(),
                "{event}"
            );
        }
    }
}

/// The last event of a kind.
fn last<'a>(events: &'a [Value], of_kind: &str) -> &'a Value {
    let found = events.iter().rfind(|event| kind(event) == of_kind);
    found.unwrap_or_else(|| panic!("no {of_kind} among {events:#?}"))
}

/// Checks that work of so many units was told to its end.
fn assert_done(events: &[Value], unit: &str, total: u64) {
    let is_end = |event: &&Value| event["unit"] == unit && event["done"] == total && event["total"] == total;
    assert!(events.iter().any(|event| is_end(&event)), "{total} {unit}: {events:#?}");
}

/// Checks that a file is told of, and there.
fn assert_item(folder: &Path, events: &[Value], path: &str) {
    let is_told = events.iter().any(|event| kind(event) == "item" && event["path"] == path);
    assert!(is_told && folder.join(path).exists(), "{path}: {events:#?}");
}

fn write_scene(path: &Path, height: usize, width: usize) {
    let value = |(c, y, x)| 0.2 + 0.1 * ((c * 7 + y * 3 + x * 5) % 11) as f32;
    let image = LinearImage::from_planes(Array3::from_shape_fn((3, height, width), value)).unwrap();
    write_image(path, &image, &WriteOptions::default()).unwrap();
}

/// From a PSF to a page: what each command makes, the next one takes.
#[test]
fn every_command_of_the_pipeline_tells_what_it_does() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let run = |args: &[&str]| events(folder, args, 0).0;

    let told = run(&["psf", "--random", "3", "--size", "31", "-o", "psf.exr"]);
    assert_item(folder, &told, "psf.exr");
    assert_eq!(told[0]["configuration"]["random"], "3");
    assert_eq!(last(&told, "finished")["results"]["height"], 31);
    assert!(told.iter().any(|event| event["unit"] == "wavelengths"), "{told:#?}");

    let told = run(&["codes", "psf.exr", "--angles=-3,0,3", "--dim", "2", "-o", "bank.safetensors"]);
    assert_eq!(last(&told, "finished")["results"]["kernels"], 3);
    let told = run(&["codes", "--project", "bank.safetensors", "psf.exr"]);
    assert_eq!(last(&told, "found")["fits"], true);

    let told = run(&["scenes", "-o", "scenes", "--count", "4", "--size", "48"]);
    assert_done(&told, "scenes", 4);
    assert_eq!(last(&told, "finished")["items"], 4);
    let synth = ["synth", "scenes", "--bank", "bank.safetensors", "--test-fraction", "0.3", "-o", "dataset"];
    let told = run(&synth);
    assert_done(&told, "images", 12);
    assert_eq!(last(&told, "configured")["configuration"]["x-max"], 500.0);
    assert_item(folder, &told, "dataset/dataset.toml");

    fs::write(folder.join("config.toml"), train::CONFIG).unwrap();
    let told = run(&["train", "config.toml", "--data", "dataset", "-o", "run"]);
    check_training(folder, &told);
    let told = run(&["sweep", "config.toml", "--data", "dataset", "-o", "sweep", "--set", "iterations=2"]);
    assert_eq!(last(&told, "finished")["results"]["rows"][0]["name"], "config");
    assert!(told.iter().any(|event| kind(event) == "stage" && event["what"] == "config"));

    let how = ["--method", "wiener", "--psf", "psf.exr", "-o", "restored/"];
    let told = run(&[&["restore", "dataset/degraded/r+00"][..], &how].concat());
    assert_done(&told, "images", 4);
    assert_eq!(told.iter().filter(|event| kind(event) == "found").count(), 4);
    let told = run(&["finish", "restored", "-o", "photos/"]);
    assert_done(&told, "images", 4);
    let told = run(&["tonemap", "scenes", "-o", "mapped/"]);
    assert_done(&told, "images", 4);

    let told = run(&["eval", "dataset", "--model", "run/model.safetensors", "-o", "results"]);
    let methods = &last(&told, "finished")["results"]["methods"];
    assert!(methods.as_array().unwrap().iter().all(|method| method["mean"]["psnr"].is_number()), "{methods}");
    let told = run(&["report", "psf.exr", "results", "-o", "report.html"]);
    assert_item(folder, &told, "report.html");
    let told = run(&["convert", "psf.exr", "psf.npy"]);
    assert_item(folder, &told, "psf.npy");
}

/// The numbers are those of the run's log.
fn check_training(folder: &Path, told: &[Value]) {
    assert_done(told, "steps", 24);
    assert_eq!(last(told, "configured")["configuration"]["iterations"], 24);
    let log = fs::read_to_string(folder.join("run/metrics.jsonl")).unwrap();
    let log: Vec<Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let step = log.iter().rfind(|line| line["loss"].is_number()).unwrap();
    let shown = last(told, "progress");
    assert_eq!((&shown["iteration"], &shown["loss"]), (&step["iteration"], &step["loss"]));
    assert_eq!(shown["learning-rate"], step["learning_rate"]);
    assert_eq!(&shown["validation"], log.iter().rfind(|line| line["psnr"].is_number()).unwrap());
    let best = log.iter().filter_map(|line| line["psnr"].as_f64()).fold(f64::MIN, f64::max);
    assert_eq!(shown["best"]["value"], best);
    assert!((0.0..=1.0).contains(&shown["data-wait-share"].as_f64().unwrap()), "{shown}");
    assert!(shown["seconds-per-step"].as_f64().unwrap() > 0.0 && shown["loss-smoothed"].is_number());
    assert_item(folder, told, "run/best.safetensors");
    let drafts =
        told.iter().filter(|event| event["path"].as_str().is_some_and(|path| path.contains(".partial")));
    assert_eq!(drafts.count(), 0, "what is not published is not told of");
    assert_eq!(last(told, "finished")["results"]["iteration"], 24);
}

#[test]
fn the_other_commands_tell_too() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let run = |args: &[&str]| events(folder, args, 0).0;
    write_scene(&folder.join("hall.exr"), 32, 64);
    let told = run(&["crop", "hall.exr", "-o", "views", "--size", "16", "--views", "3"]);
    assert_done(&told, "views", 3);

    for (name, scale) in [("a.npy", 1.0), ("b.npy", 0.25)] {
        let planes = Array3::from_elem((3, 8, 8), 0.8 * scale);
        let image = LinearImage::from_planes(planes).unwrap();
        write_image(&folder.join(name), &image, &WriteOptions::default()).unwrap();
    }
    let told = run(&["fuse", "a.npy", "b.npy", "--exposures", "1,1/4", "-o", "fused.exr"]);
    assert_eq!(last(&told, "finished")["results"]["exposures"], serde_json::json!([1.0, 0.25]));

    fs::write(folder.join("examples.toml"), examples::CONFIG).unwrap();
    let told = run(&["examples", "examples.toml", "-o", "examples", "--count", "3"]);
    assert_done(&told, "examples", 3);
    assert_eq!(last(&told, "configured")["configuration"]["count"], 3);

    pose::write_inputs(folder);
    let told = run(&["pose", "lamps.exr", "--psf", "psf.exr", "--x-max", "16", "-o", "pose.toml"]);
    assert!(last(&told, "found")["pose"]["turn-deg"].is_number());

    let told = run(&["bench", "--only", "nothing", "--size", "8", "--train", "1x8", "--patience", "0"]);
    assert_eq!(last(&told, "finished")["results"]["training-steps"][0]["batch"], "1×8²");
}

#[test]
fn every_command_tells_of_its_failure() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    for args in [
        &["demo", "-o", "there"][..],
        &["fuse", "absent.exr", "-o", "out.exr"],
        &["psf", "--display", "absent.toml", "-o", "out.exr"],
        &["codes", "absent.exr", "-o", "out.safetensors"],
        &["crop", "absent.hdr", "-o", "out"],
        &["scenes", "-o", "out", "--count", "1", "--size", "3"],
        &["synth", "absent", "--psf", "absent.exr", "-o", "out"],
        &["examples", "absent.toml", "-o", "out"],
        &["tonemap", "absent.exr", "-o", "out.exr"],
        &["train", "absent.toml", "--data", "absent", "-o", "out"],
        &["sweep", "absent.toml", "--data", "absent", "-o", "out"],
        &["pose", "absent.exr", "--psf", "absent.exr", "-o", "out.toml"],
        &["restore", "absent.exr", "--psf", "absent.exr", "-o", "out.exr"],
        &["eval", "absent", "-o", "out"],
        &["finish", "absent.exr", "-o", "out.png"],
        &["report", "absent.exr", "-o", "out.html"],
        &["convert", "absent.exr", "out.npy"],
    ] {
        fs::create_dir_all(folder.join("there")).unwrap();
        fs::write(folder.join("there/file"), "somebody's").unwrap();
        let (told, stderr) = events(folder, args, 1);
        let failed = last(&told, "failed");
        let causes = failed["causes"].as_array().unwrap();
        assert!(!causes.is_empty() && stderr.contains("error: "), "{failed} {stderr}");
        let said = failed["message"].as_str().unwrap();
        assert!(stderr.contains(said), "the same is told to people: {said} in {stderr}");
    }
    let (told, stderr) = events(folder, &["synth", "--bogus"], 2);
    assert!(told[0]["message"].as_str().unwrap().contains("--bogus") && stderr.contains("--bogus"));
    let (told, _) = events(folder, &["bench", "--train", "0x64"], 2);
    assert_eq!(told.len(), 1);
}

/// A file that fails does not stop the others, and the end says so.
#[test]
fn a_run_of_which_a_part_fails_tells_of_both() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    fs::create_dir(folder.join("images")).unwrap();
    write_scene(&folder.join("images/good ü.exr"), 8, 8);
    fs::write(folder.join("images/bad.exr"), "no image").unwrap();
    let (told, _) = events(folder, &["tonemap", "images", "-o", "mapped/"], 1);
    assert_item(folder, &told, "mapped/good ü.exr");
    assert!(last(&told, "warning")["message"].as_str().unwrap().contains("bad.exr"));
    assert_done(&told, "images", 2);
    assert_eq!(last(&told, "failed")["items"], 1);
}

#[test]
fn quiet_leaves_events_alone_and_people_read_stderr() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let scenes = ["scenes", "--count", "1", "--size", "16", "-o"];
    let (_, stderr) = events(folder, &[&scenes[..], &["a"]].concat(), 0);
    assert!(stderr.contains("a: 1 scenes"), "{stderr}");
    let (_, stderr) = events(folder, &[&scenes[..], &["b", "--quiet"]].concat(), 0);
    assert_eq!(stderr, "");
    let refused = udc(folder, &["man", "--json"]);
    assert_eq!((refused.status.code(), refused.stdout.is_empty()), (Some(2), true));
}

/// The files are the result: who stops to listen stops nothing.
#[test]
#[cfg(unix)]
fn a_closed_pipe_stops_the_telling_and_not_the_work() {
    use std::process::{Command, Stdio};
    let scratch = tempfile::tempdir().unwrap();
    let mut run = Command::new(env!("CARGO_BIN_EXE_udc"))
        .args(["scenes", "--count", "3", "--size", "16", "-o", "scenes", "--json"])
        .current_dir(scratch.path())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    drop(run.stdout.take());
    assert!(run.wait().unwrap().success());
    assert_eq!(fs::read_dir(scratch.path().join("scenes")).unwrap().count(), 3);
}

/// Stdout on a full disk is an error, after the work.
#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_below_stdout_is_told_in_the_end() {
    use std::process::Command;
    let scratch = tempfile::tempdir().unwrap();
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_udc"))
        .args(["scenes", "--count", "2", "--size", "16", "-o", "scenes", "--json"])
        .current_dir(scratch.path())
        .stdout(full)
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("writing to stdout"), "{stderr}");
    assert_eq!(fs::read_dir(scratch.path().join("scenes")).unwrap().count(), 2);
}

#[test]
#[cfg(unix)]
fn an_interrupt_is_told_as_one() {
    use std::io::{BufRead as _, BufReader};
    use std::process::{Command, Stdio};
    let scratch = tempfile::tempdir().unwrap();
    train::prepare(scratch.path());
    for args in [
        &["train", "config.toml", "--data", "dataset", "-o", "run", "--set", "iterations=1000000"][..],
        &["scenes", "--count", "100000", "--size", "16", "-o", "scenes", "--threads", "1"],
    ] {
        let mut run = Command::new(env!("CARGO_BIN_EXE_udc"))
            .args(args)
            .arg("--json")
            .current_dir(scratch.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(run.stdout.take().unwrap()).lines().map(Result::unwrap);
        let mut told: Vec<Value> = Vec::new();
        while told.last().is_none_or(|event| event["done"].as_u64().unwrap_or(0) == 0) {
            told.push(serde_json::from_str(&lines.next().expect("it goes on")).unwrap());
        }
        let pid = run.id().to_string();
        assert!(Command::new("kill").args(["-INT", &pid]).status().unwrap().success());
        told.extend(lines.map(|line| serde_json::from_str::<Value>(&line).unwrap()));
        assert_eq!(run.wait().unwrap().code(), Some(1));
        check(&told, args, 1);
        assert_eq!(kind(told.last().unwrap()), "interrupted", "{:?}", told.last());
    }
}
