//! `udc examples`, and a training on what it makes.

use std::fs;
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, LayerAttributes, WritableImage,
};

use super::common::{fail, succeed, udc};

pub(crate) const CONFIG: &str = r#"
iterations = 4
log-every = 1
[architecture]
kind = "guided"
condition = "none"
features = 3
[data]
crop = 32
batch = 2
accumulate = 1
[validation]
every = 2
images = 2
crop = 48
[checkpoint]
every = 4
[examples]
count = 6
validation-share = 0.34
side-px = 48
[examples.panels]
count = 2
validation = 1
psf-side-px = 31
[examples.scenes]
procedural-share = 1.0
"#;

fn prepare(folder: &Path) {
    fs::write(folder.join("config.toml"), CONFIG).unwrap();
}

#[test]
fn makes_examples_that_a_network_learns_from() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let run = |args: &[&str]| succeed(folder.path(), args);
    let said = run(&["examples", "config.toml", "-o", "examples", "--count", "5"]);
    assert!(said.contains("5 examples made; 1 are for validation"), "{said}");
    let said = run(&["examples", "config.toml", "-o", "examples", "--resume"]);
    assert!(said.contains("1 examples made, 5 were there; 2 are for validation"), "{said}");
    let said = run(&["train", "config.toml", "--data", "examples", "-o", "run"]);
    assert!(said.contains(" deconvolved,") && said.contains("trained for 4 iterations"), "{said}");
    let log = fs::read_to_string(folder.path().join("run/metrics.jsonl")).unwrap();
    let mut lines = log.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let validation = lines.rfind(|line| line["psnr"].is_number()).expect("it was validated");
    let tags = validation["tags"].as_object().expect("examples have tags");
    assert!(tags.contains_key("harder") || tags.contains_key("simulator"), "{validation}");
    // What was learned from is known by its contents, and its making is not the training's to record.
    let config = fs::read_to_string(folder.path().join("run/config.toml")).unwrap();
    assert!(!config.contains("[examples"), "{config}");
    run(&["train", "--data", "examples", "-o", "run", "--resume"]);
    run(&["examples", "config.toml", "-o", "examples", "--resume", "--count", "7"]);
    let said = fail(folder.path(), &["train", "--data", "examples", "-o", "run", "--resume"], 1);
    assert!(said.contains("other data than the run learned from"), "{said}");
}

/// A network is adapted to a panel: from a model of the same architecture, with examples of its own.
#[test]
fn a_network_is_adapted_to_one_panel() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let run = |args: &[&str]| succeed(folder.path(), args);
    run(&["psf", "--random", "3", "--size", "31", "-o", "psf.exr"]);
    run(&[
        "train",
        "config.toml",
        "--psf",
        "psf.exr",
        "--init",
        "guided",
        "-o",
        "adapted",
        "--set",
        "architecture.features=48",
    ]);
    assert!(folder.path().join("adapted/best.safetensors").is_file());
    let resumed = ["train", "--psf", "psf.exr", "-o", "adapted", "--resume", "--set", "iterations=5"];
    assert!(
        run(&resumed).contains("trained for 5 iterations"),
        "with the examples and settings that it began with"
    );
    let log = fs::read_to_string(folder.path().join("adapted/metrics.jsonl")).unwrap();
    let first: serde_json::Value = serde_json::from_str(log.lines().next().unwrap()).unwrap();
    assert!(first["iteration"] == 0 && first["psnr"].is_number(), "what it began with is measured: {first}");
    let said = run(&["info", "adapted/examples/panels/000.exr"]);
    assert!(said.contains("31 × 31"), "{said}");
    let scene = ["scenes", "-o", "views", "--count", "1", "--size", "64"];
    run(&scene);
    run(&["restore", "views", "--psf", "psf.exr", "--model", "adapted/best.safetensors", "-o", "restored/"]);
    let said =
        fail(folder.path(), &["train", "config.toml", "--psf", "psf.exr", "--data", "views", "-o", "x"], 2);
    assert!(said.contains("--data"), "{said}");
    let said =
        fail(folder.path(), &["train", "config.toml", "--data", "views", "--scenes", "v", "-o", "x"], 2);
    assert!(said.contains("--scenes") && said.contains("cannot be used with"), "{said}");
    // Another architecture than that of the network which it begins with, unless --init names one.
    let said = fail(folder.path(), &["train", "config.toml", "--psf", "psf.exr", "-o", "x"], 1);
    assert!(said.contains("another architecture"), "{said}");
    assert!(!folder.path().join("x").exists(), "nothing was made");
}

/// As every command that reads light does, and once for each file.
#[test]
fn what_the_file_of_a_panorama_says_and_is_not_heeded_is_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let config = CONFIG
        .replace("procedural-share = 1.0", "procedural-share = 0.5\nvalidation-panoramas = 1")
        .replace("count = 6", "count = 2");
    fs::write(folder.path().join("config.toml"), config).unwrap();
    for (name, aspect) in [("flat.exr", 1.0), ("wide.exr", 1.5)] {
        let samples: Vec<f32> = (0..16 * 32).map(|i| 0.2 + (i % 7) as f32).collect();
        let channel = |name: &str| AnyChannel::new(name, FlatSamples::F32(samples.clone()));
        let channels = AnyChannels::sort(["B", "G", "R"].map(channel).into_iter().collect());
        let mut image = Image::from_layer(Layer::new(
            (32, 16),
            LayerAttributes::default(),
            Encoding::FAST_LOSSLESS,
            channels,
        ));
        image.attributes.pixel_aspect = aspect;
        image.write().to_file(folder.path().join(name)).unwrap();
    }
    let make = ["examples", "config.toml", "--scenes", "flat.exr", "wide.exr", "-o", "examples"];
    let output = udc(folder.path(), &make);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert_eq!(said.matches("times as wide as high").count(), 1, "{said}");
    assert!(said.contains("wide.exr: its pixels are 1.5"), "{said}");
}

#[test]
fn refuses_what_it_cannot_make_examples_of_or_in() {
    let folder = tempfile::tempdir().unwrap();
    prepare(folder.path());
    let refusal = |args: &[&str]| fail(folder.path(), &[&["examples"], args].concat(), 1);
    fs::write(folder.path().join("plain.toml"), "iterations = 3").unwrap();
    assert!(refusal(&["plain.toml", "-o", "examples"]).contains("add a section [examples]"));
    assert!(refusal(&["config.toml", "-o", "."]).contains("something else than examples"));
    assert!(refusal(&["config.toml", "-o", "examples", "--count", "0"]).contains("examples.count"));
    let panoramas = CONFIG.replace("procedural-share = 1.0", "procedural-share = 0.0");
    fs::write(folder.path().join("panoramas.toml"), panoramas).unwrap();
    assert!(refusal(&["panoramas.toml", "-o", "examples"]).contains("--scenes"));
    fs::create_dir(folder.path().join("empty")).unwrap();
    fs::write(folder.path().join("empty/examples.toml"), "format = 3").unwrap();
    let said = fail(folder.path(), &["train", "config.toml", "--data", "empty", "-o", "run"], 1);
    assert!(said.contains("examples.toml: line 1"), "{said}");
}
