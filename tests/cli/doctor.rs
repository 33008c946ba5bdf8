//! `udc doctor`: each thing that may be wrong is found, told by its name, and comes with what mends it.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use serde_json::Value;
use udc::codes::make_rotated_bank;
use udc::core::image::LinearImage;
use udc::core::psf::Psf;
use udc::dataset::Split;
use udc::io::{self, WriteOptions};
use udc::network::weights;
use udc::restore::{Pose, write_pose};

use super::common::{succeed, udc};
use super::{examples, train};

/// A PSF with a core off the centre, and a level of haze.
fn psf(side: usize, shift: f64, haze: f64) -> Psf {
    let middle = (side / 2) as f64;
    let light = |y: usize, x: usize| {
        let (dy, dx) = (y as f64 - middle, x as f64 - middle - shift);
        (-(dy * dy + dx * dx) / 2.0).exp() + 1e-3 * (-(dy * dy / 8.0 + dx * dx / 30.0)).exp() + haze
    };
    Psf::from_energy(Array3::from_shape_fn((3, side, side), |(_, y, x)| light(y, x) as f32)).unwrap()
}

fn write_planes(path: &Path, planes: Array3<f32>) {
    let options = io::PixelOptions { overwrite: true, ..io::PixelOptions::default() };
    io::write_pixels(path, &io::Pixels::of_planes(planes), options).unwrap();
}

fn scene(side: usize) -> Array3<f32> {
    Array3::from_shape_fn((3, side, side), |(c, y, x)| 0.2 + 0.1 * ((c + y * 3 + x * 5) % 7) as f32)
}

/// A folder with a PSF, its bank, scenes and a dataset of these.
fn prepare() -> tempfile::TempDir {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    io::write_psf(&folder.join("psf.exr"), &psf(15, 0.0, 0.0), &WriteOptions::default()).unwrap();
    let bank = make_rotated_bank(&psf(15, 0.0, 0.0), &[-20.0, 0.0, 20.0], 2).unwrap();
    io::write_bank(&folder.join("bank.safetensors"), &bank, false).unwrap();
    fs::create_dir(folder.join("views")).unwrap();
    for (name, light) in [("a_01", 1.0), ("b_01", 0.9), ("c_01", 0.8)] {
        let image = LinearImage::from_planes(scene(32).mapv(|value| light * value)).unwrap();
        io::write_image(&folder.join(format!("views/{name}.exr")), &image, &WriteOptions::default()).unwrap();
    }
    let synth = ["synth", "views", "--bank", "bank.safetensors", "--test-fraction", "0.4", "-o", "dataset"];
    succeed(folder, &synth);
    fs::write(folder.join("config.toml"), train::CONFIG).unwrap();
    scratch
}

/// What is found by `udc doctor` with these arguments, and its exit code.
fn examine(folder: &Path, args: &[&str]) -> (Vec<Value>, i32) {
    let output = udc(folder, &[&["doctor", "--json"], args].concat());
    let stderr = String::from_utf8_lossy(&output.stderr);
    let object: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {stderr}"));
    let findings = object["findings"].as_array().unwrap().clone();
    let errors = findings.iter().filter(|finding| finding["level"] == "error").count();
    assert_eq!(object["errors"], errors, "{object}");
    let code = output.status.code().unwrap();
    assert_eq!(code, i32::from(errors > 0), "{stderr}");
    for finding in &findings {
        assert_eq!(finding["mend"].is_string(), finding["level"] != "ok", "{finding}");
        if ["image", "configuration-and-data"].iter().any(|whole| finding["check"] == *whole) {
            let fails = |other: &&Value| other["level"] == "error" && other["about"] == finding["about"];
            let failed = findings.iter().find(fails);
            assert!(finding["level"] != "ok" || failed.is_none(), "{finding} and {failed:?}");
        }
    }
    (findings, code)
}

/// Checks that something is found, at a level, and that its text has a word.
fn assert_found(folder: &Path, args: &[&str], check: &str, level: &str, word: &str) {
    let (findings, _) = examine(folder, args);
    let found = findings.iter().find(|finding| finding["check"] == check && finding["level"] == level);
    let found = found.unwrap_or_else(|| panic!("no {level} {check}: {findings:#?}"));
    assert!(found["what"].as_str().unwrap().contains(word), "{found}");
}

#[test]
fn things_that_go_together_have_no_error() {
    let scratch = prepare();
    let folder = scratch.path();
    succeed(folder, &["train", "config.toml", "--data", "dataset", "-o", "run"]);
    let all =
        ["dataset", "bank.safetensors", "psf.exr", "config.toml", "run", "views", "--all", "-o", "new/run"];
    let (findings, code) = examine(folder, &all);
    assert_eq!(code, 0, "{findings:#?}");
    let is_ok =
        |check: &str| findings.iter().any(|finding| finding["check"] == check && finding["level"] == "ok");
    for check in [
        "instruction-set",
        "threads",
        "memory",
        "dataset",
        "bank",
        "psf",
        "configuration",
        "model",
        "image",
        "dataset-and-bank",
        "model-and-bank",
        "tone-curve",
        "psf-and-bank",
        "psf-and-images",
        "configuration-and-data",
        "configuration-and-model",
        "restoring-memory",
        "training-disk",
        "output-writable",
    ] {
        assert!(is_ok(check), "{check}: {findings:#?}");
    }
    let said = succeed(folder, &["doctor", "dataset"]);
    assert!(said.contains("dataset: ") && said.contains("0 errors"), "{said}");
    assert!(succeed(folder, &["doctor"]).contains("machine: "));
}

#[test]
fn what_is_wrong_with_a_psf_is_found() {
    let scratch = prepare();
    let folder = scratch.path();
    let write = |name: &str, planes: Array3<f32>| write_planes(&folder.join(name), planes);
    let planes = |psf: &Psf| psf.planes().to_owned();
    write("off.exr", planes(&psf(15, 3.0, 0.0)));
    assert_found(folder, &["--psf", "off.exr"], "psf-off-centre", "error", "3 px");
    write("sum.exr", planes(&psf(15, 0.0, 0.0)) * 2.0);
    assert_found(folder, &["--psf", "sum.exr"], "psf-sum", "warning", "2.0000");
    let mut negative = planes(&psf(15, 0.0, 0.0));
    negative.slice_mut(ndarray::s![.., 0, ..]).fill(-0.01);
    write("negative.exr", negative);
    assert_found(folder, &["--psf", "negative.exr"], "psf-negative", "warning", "negative");
    let mut broken = planes(&psf(15, 0.0, 0.0));
    broken[[1, 2, 3]] = f32::NAN;
    write("nan.exr", broken);
    assert_found(folder, &["--psf", "nan.exr"], "psf-unreadable", "error", "NaN");
    let hazy = planes(&psf(41, 0.0, 0.0)) + 1e-4;
    let sum = hazy.slice(ndarray::s![0, .., ..]).sum();
    write("background.exr", hazy / sum);
    assert_found(folder, &["--psf", "background.exr"], "psf-background", "warning", "background");
    write("hazy.exr", planes(&psf(15, 0.0, 1e-2)));
    assert_found(folder, &["hazy.exr"], "psf-cut-off", "warning", "border");
    let mut lopsided = planes(&psf(31, 0.0, 0.0));
    lopsided.slice_mut(ndarray::s![.., 14..17, 24..27]).fill(0.02);
    lopsided /= lopsided.slice(ndarray::s![0, .., ..]).sum();
    write("lopsided.exr", lopsided);
    assert_found(folder, &["lopsided.exr"], "psf-lopsided", "warning", "balances");
    write("point.exr", Array3::ones((3, 1, 1)));
    assert_found(folder, &["--psf", "point.exr"], "psf-trivial", "warning", "one pixel");
    fs::write(folder.join("cut.exr"), &fs::read(folder.join("psf.exr")).unwrap()[..300]).unwrap();
    assert_found(folder, &["--psf", "cut.exr"], "psf-unreadable", "error", "");
    assert_found(folder, &["absent.exr"], "unreadable", "error", "no such file");
    write("small.exr", scene(4));
    let large = psf(15, 0.0, 0.0);
    io::write_psf(&folder.join("large.exr"), &large, &WriteOptions::default()).unwrap();
    assert_found(folder, &["large.exr", "small.exr"], "psf-and-images", "warning", "4 × 4");
}

#[test]
fn what_is_wrong_with_a_bank_or_beside_it_is_found() {
    let scratch = prepare();
    let folder = scratch.path();
    let other = make_rotated_bank(&psf(15, 0.0, 0.0), &[-40.0, 0.0, 40.0], 1).unwrap();
    io::write_bank(&folder.join("other.safetensors"), &other, false).unwrap();
    assert_found(folder, &["dataset", "other.safetensors"], "dataset-and-bank", "error", "another bank");
    let mut bytes = fs::read(folder.join("bank.safetensors")).unwrap();
    let end = bytes.len() - 9;
    bytes[end] ^= 0x40;
    fs::write(folder.join("damaged.safetensors"), bytes).unwrap();
    assert_found(folder, &["--bank", "damaged.safetensors"], "bank-unreadable", "error", "");
    io::write_psf(&folder.join("wide.exr"), &psf(15, 0.0, 3e-3), &WriteOptions::default()).unwrap();
    assert_found(folder, &["wide.exr", "bank.safetensors"], "psf-and-bank", "error", "cannot describe");
    let mut same = io::read_bank(&folder.join("bank.safetensors")).unwrap();
    let first = same.codes.row(0).to_owned();
    same.codes.row_mut(1).assign(&first);
    io::write_bank(&folder.join("same.safetensors"), &same, false).unwrap();
    assert_found(folder, &["same.safetensors"], "bank-codes", "warning", "one code");
    let mut moved = io::read_bank(&folder.join("bank.safetensors")).unwrap();
    moved.psfs[1] = psf(15, 4.0, 0.0);
    io::write_bank(&folder.join("moved.safetensors"), &moved, false).unwrap();
    assert_found(folder, &["moved.safetensors"], "bank-off-centre", "warning", "off its centre");
    let pose =
        Pose { turn_deg: 0.1, scale: 0.0, turn_sigma_deg: 0.1, scale_sigma: 0.1, psf_sha256: "ab".into() };
    write_pose(&folder.join("pose.toml"), &pose, false).unwrap();
    assert_found(folder, &["pose.toml", "psf.exr"], "pose-and-psf", "error", "another PSF");
}

#[test]
fn what_is_wrong_with_the_images_of_a_dataset_is_found() {
    let scratch = prepare();
    let folder = scratch.path();
    let dataset = udc::dataset::Dataset::open(&folder.join("dataset")).unwrap();
    let triplet = dataset.triplets.iter().find(|triplet| triplet.split == Split::Train).unwrap();
    let place = folder.join("dataset").join(&triplet.degraded);
    let whole = fs::read(&place).unwrap();
    let find = |check: &str, level: &str, word: &str| {
        assert_found(folder, &["dataset", "--all"], check, level, word);
        fs::write(&place, &whole).unwrap();
    };
    fs::write(&place, &whole[..whole.len() / 2]).unwrap();
    find("image-unreadable", "error", &triplet.degraded);
    let mut planes = scene(32);
    planes[[0, 5, 5]] = f32::NAN;
    write_planes(&place, planes);
    find("not-finite", "error", &triplet.degraded);
    write_planes(&place, scene(32) * 1e4);
    find("above-x-max", "error", "x-max");
    write_planes(&place, scene(32));
    find("not-degraded", "warning", "same");
    write_planes(&place, scene(32));
    find("hash-differs", "error", "SHA-256");
    write_planes(&place, scene(31));
    find("sizes-differ", "error", "another size");
    write_planes(&place, Array3::zeros((3, 32, 32)));
    find("dark", "warning", "black");
    write_planes(&place, scene(32) - 0.3);
    find("negative", "warning", "negative");
    // A file is what it holds, whatever its name.
    let packed = folder.join("packed.npy");
    write_planes(&packed, Array3::from_elem((4, 32, 32), 0.5));
    fs::rename(&packed, &place).unwrap();
    find("channels", "error", "three channels");
    let image = udc::core::image::ToneMappedImage::from_planes(scene(32)).unwrap();
    io::write_image(&place, &image, &WriteOptions { overwrite: true, ..Default::default() }).unwrap();
    find("domain", "error", "linear");
    let others = dataset.triplets.iter().find(|other| other.id != triplet.id).unwrap();
    let gt = folder.join("dataset").join(&triplet.gt);
    let own = fs::read(&gt).unwrap();
    fs::copy(folder.join("dataset").join(&others.gt), &gt).unwrap();
    find("other-scene", "error", &triplet.gt);
    fs::write(&gt, own).unwrap();
    let (findings, code) = examine(folder, &["dataset", "--all"]);
    assert_eq!(code, 0, "it is whole again: {findings:#?}");
}

#[test]
fn what_is_wrong_with_the_files_of_a_dataset_is_found() {
    let scratch = prepare();
    let folder = scratch.path();
    let root = folder.join("dataset");
    fs::write(root.join("gt/.udc-abc.partial"), "half").unwrap();
    assert_found(folder, &["dataset"], "leftovers", "warning", ".udc-abc.partial");
    fs::copy(root.join("gt/a_01.exr"), root.join("gt/stray.exr")).unwrap();
    assert_found(folder, &["dataset"], "unlisted", "warning", "gt/stray.exr");
    let list = root.join("triplets.jsonl");
    let lines = fs::read_to_string(&list).unwrap();
    let without_first: String = lines.lines().skip(1).map(|line| format!("{line}\n")).collect();
    fs::write(&list, without_first).unwrap();
    assert_found(folder, &["dataset"], "triplets-incomplete", "warning", "lacks");
    let all_for = |split: &str| lines.replace("\"train\"", split).replace("\"test\"", split);
    fs::write(&list, all_for("\"train\"")).unwrap();
    assert_found(folder, &["dataset"], "no-test-split", "warning", "validated");
    fs::write(&list, all_for("\"test\"")).unwrap();
    assert_found(folder, &["dataset"], "no-train-split", "warning", "learn");
    fs::write(&list, lines.replacen("\"r+00\"", "\"r+77\"", 1)).unwrap();
    assert_found(folder, &["dataset"], "kernel-unknown", "error", "r+77");
    fs::write(&list, &lines).unwrap();
    fs::remove_file(root.join("gt/b_01.exr")).unwrap();
    assert_found(folder, &["dataset"], "dataset-unreadable", "error", "gt/b_01.exr");
    assert_found(folder, &["--data", "views"], "dataset-unreadable", "error", "no dataset");
}

#[test]
fn a_scene_that_is_learned_from_and_measured_with_is_found() {
    let scratch = prepare();
    let folder = scratch.path();
    let is_found = |findings: &[Value]| findings.iter().any(|f| f["check"] == "scene-in-two-splits");
    assert!(!is_found(&examine(folder, &["dataset"]).0));
    fs::create_dir(folder.join("more")).unwrap();
    fs::copy(folder.join("views/a_01.exr"), folder.join("more/other_01.exr")).unwrap();
    let synth = |views: &str, split: &str| {
        let common = ["--bank", "bank.safetensors", "--split", split, "-o", "twins"];
        succeed(folder, &[&["synth", views][..], &common].concat());
    };
    synth("views", "train");
    synth("more", "test");
    assert_found(folder, &["twins"], "scene-in-two-splits", "warning", "a_01");
    // As earlier versions listed it: the ground truths say it too.
    for name in ["triplets.jsonl", "triplets-test.jsonl"] {
        let list = folder.join("twins").join(name);
        let lines = fs::read_to_string(&list).unwrap();
        let without: String = lines
            .lines()
            .map(|line| {
                let mut triplet: Value = serde_json::from_str(line).unwrap();
                triplet.as_object_mut().unwrap().remove("scene_sha256");
                format!("{triplet}\n")
            })
            .collect();
        fs::write(&list, without).unwrap();
    }
    assert_found(folder, &["twins"], "scene-in-two-splits", "warning", "other_01");
}

#[test]
fn what_is_wrong_with_a_configuration_or_beside_it_is_found() {
    let scratch = prepare();
    let folder = scratch.path();
    let look = |change: (&str, &str), data: &[&str], check: &str, level: &str, word: &str| {
        assert!(train::CONFIG.contains(change.0), "{change:?}");
        fs::write(folder.join("changed.toml"), train::CONFIG.replace(change.0, change.1)).unwrap();
        assert_found(folder, &[&["--config", "changed.toml"], data].concat(), check, level, word);
    };
    look(("features", "featurs"), &[], "configuration", "error", "featurs");
    look(
        ("[data]", "[loss.perceptual]\nweight = 0.1\nfile = \"vgg.pth\"\n[data]"),
        &[],
        "configuration-file-missing",
        "error",
        "vgg.pth",
    );
    look(("every = 8", "every = 80"), &[], "never-validated", "warning", "80");
    look(("every = 5", "every = 50"), &[], "never-kept", "warning", "50");
    look(("crop = 16", "crop = 40"), &["dataset"], "crop-too-large", "error", "40");
    look(("code-dim = 2", "code-dim = 3"), &["dataset"], "configuration-and-data", "error", "code-dim");
    look(("[data]", "[data]\nkernels = [\"r+99\"]"), &["dataset"], "configuration-and-data", "error", "r+99");
    look(("[data]", "[data]\ncache-mib = 99999999"), &[], "training-memory", "warning", "GiB");
    fs::write(folder.join("file"), "").unwrap();
    assert_found(folder, &["-o", "file/run"], "output-writable", "error", "cannot write");
}

#[test]
fn what_is_wrong_with_a_model_or_a_run_is_found() {
    let scratch = prepare();
    let folder = scratch.path();
    succeed(folder, &["train", "config.toml", "--data", "dataset", "-o", "run"]);
    let model = "run/model.safetensors";
    let whole = fs::read(folder.join(model)).unwrap();
    fs::write(folder.join("cut.safetensors"), &whole[..whole.len() - 100]).unwrap();
    assert_found(folder, &["--model", "cut.safetensors"], "model-unreadable", "error", "");
    let mut infinite = whole.clone();
    let end = infinite.len() - 4;
    infinite[end..].copy_from_slice(&f32::INFINITY.to_le_bytes());
    fs::write(folder.join("infinite.safetensors"), infinite).unwrap();
    assert_found(folder, &["--model", "infinite.safetensors"], "model-unreadable", "error", "");
    let mut weights = weights::read(&folder.join(model)).unwrap();
    let is_weight = |name: &str| name.ends_with("weight");
    let last = weights.parameters.iter_mut().filter(|parameter| is_weight(&parameter.name)).last();
    last.expect("a network has weights").values.fill(0.0);
    weights::write(&folder.join("zero.safetensors"), &weights, false).unwrap();
    assert_found(folder, &["zero.safetensors"], "model-untrained", "warning", "not trained");
    assert_found(folder, &["guided"], "model", "ok", "finite");
    let bank = make_rotated_bank(&psf(15, 0.0, 0.0), &[-40.0, 0.0, 40.0], 2).unwrap();
    io::write_bank(&folder.join("other.safetensors"), &bank, false).unwrap();
    assert_found(folder, &[model, "other.safetensors"], "model-and-bank", "error", "another bank");
    let short = make_rotated_bank(&psf(15, 0.0, 0.0), &[-40.0, 0.0, 40.0], 1).unwrap();
    io::write_bank(&folder.join("short.safetensors"), &short, false).unwrap();
    assert_found(folder, &[model, "short.safetensors"], "code-length", "error", "codes of 2 numbers");
    let scaled = ["synth", "views", "--bank", "bank.safetensors", "--x-max", "16", "-o", "scaled"];
    succeed(folder, &scaled);
    assert_found(folder, &[model, "scaled"], "tone-curve", "warning", "x-max 16");
    fs::write(folder.join("wide.toml"), train::CONFIG.replace("features = 2", "features = 4")).unwrap();
    assert_found(folder, &[model, "wide.toml"], "configuration-and-model", "warning", "another network");
    fs::create_dir(folder.join("run/checkpoints/77.partial")).unwrap();
    assert_found(folder, &["run"], "leftovers", "warning", "77.partial");
    let log = folder.join("run/metrics.jsonl");
    fs::write(&log, "{\"iteration\":1,\"loss\":null}\n").unwrap();
    assert_found(folder, &["run"], "diverged", "error", "not finite");
    fs::remove_dir_all(folder.join("run/checkpoints")).unwrap();
    assert_found(folder, &["run"], "no-checkpoint", "warning", "no checkpoint");
}

#[test]
fn what_is_wrong_with_images_of_nobody_is_found() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let look = |planes: Array3<f32>, check: &str, level: &str| {
        write_planes(&folder.join("image.exr"), planes);
        assert_found(folder, &["image.exr"], check, level, "");
    };
    let mut broken = scene(8);
    broken[[2, 7, 7]] = f32::INFINITY;
    look(broken, "not-finite", "error");
    look(scene(8) - 0.3, "negative", "warning");
    look(Array3::zeros((3, 8, 8)), "dark", "warning");
    write_planes(&folder.join("image.png"), scene(8));
    assert_found(folder, &["image.png"], "domain-untold", "warning", "integers");
}

#[test]
fn what_is_wrong_with_examples_is_found() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    fs::write(folder.join("config.toml"), examples::CONFIG).unwrap();
    succeed(folder, &["examples", "config.toml", "-o", "examples", "--count", "3"]);
    assert_found(folder, &["examples", "config.toml"], "examples", "ok", "3 examples");
    assert_found(folder, &["examples", "config.toml"], "configuration-and-data", "ok", "");
    let text = succeed(folder, &["info", "examples"]);
    assert!(text.contains("examples, 3 of 3, 48 × 48") && text.contains("splits"), "{text}");
    let json: Value =
        serde_json::from_str(&succeed(folder, &["info", "examples/examples.toml", "--json"])).unwrap();
    assert_eq!((&json["kind"], &json["examples"]), (&Value::from("examples"), &Value::from(3)));

    let described = folder.join("examples/examples.toml");
    let text = fs::read_to_string(&described).unwrap();
    fs::write(&described, text.replace("count = 3", "count = 9")).unwrap();
    assert_found(folder, &["examples"], "examples-incomplete", "warning", "3 of 9");
    let first = folder.join("examples/000000.safetensors");
    let bytes = fs::read(&first).unwrap_or_else(|e| {
        panic!("{e}: {:?}", fs::read_dir(folder.join("examples")).unwrap().collect::<Vec<_>>())
    });
    fs::write(&first, &bytes[..bytes.len() / 2]).unwrap();
    assert_found(folder, &["examples", "--all"], "example-damaged", "error", "1 of 3");
    fs::write(&described, "format = 3").unwrap();
    assert_found(folder, &["--data", "examples"], "examples-unreadable", "error", "line 1");
}
