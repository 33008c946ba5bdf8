//! `udc demo`.

use std::fs;

use super::common::{fail, succeed};
use super::json_events::events;

/// The steps that the demo prints before it runs them, in their order.
const STEPS: [&str; 9] = ["psf", "fuse", "codes", "synth", "restore", "train", "eval", "report", "The page"];

/// The largest that a training's configuration can hold.
#[test]
fn refuses_a_seed_that_a_later_step_could_not_take() {
    let scratch = tempfile::tempdir().unwrap();
    let said = fail(scratch.path(), &["demo", "--quick", "--seed", "18446744073709551615", "-o", "demo"], 2);
    assert!(said.contains("9223372036854775807"), "{said}");
    assert!(!scratch.path().join("demo").exists());
}

#[test]
fn the_demo_goes_through_the_whole_pipeline_to_its_page() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    // Scripts are told of all steps as one run.
    let (told, said) = events(folder, &["demo", "--quick", "-o", "demo"], 0);
    let page = &told.last().unwrap()["results"]["report"];
    assert!(page.as_str().is_some_and(|page| page.ends_with("report.html")), "{page}");
    let mut rest = said.as_str();
    for step in STEPS {
        let line = if step.starts_with("The") { step.to_owned() } else { format!("$ udc {step} ") };
        let at = rest.find(&line).unwrap_or_else(|| panic!("no {line:?} in its place: {said}"));
        rest = &rest[at..];
    }
    let demo = folder.join("demo");
    for file in [
        "psf/measured.exr",
        "bank.safetensors",
        "dataset/dataset.toml",
        "photograph.jpg",
        "run/best.safetensors",
        "report.html",
    ] {
        assert!(demo.join(file).is_file(), "{file}: {said}");
    }
    let metrics = fs::read_to_string(demo.join("results/metrics.json")).unwrap();
    let metrics: serde_json::Value = serde_json::from_str(&metrics).unwrap();
    let images = metrics["images"].as_array().unwrap();
    // Two scenes to test on, each through three kernels.
    assert!(images.len() >= 6 && images.iter().all(|image| image["id"].is_string()), "{metrics}");
    let page = fs::read_to_string(demo.join("report.html")).unwrap();
    assert!(page.contains("<svg") && page.contains("data:image/"), "pictures and charts");

    // What is printed is what can be typed: the last command again, to another page.
    let line = said.lines().find(|line| line.starts_with("$ udc report ")).unwrap();
    let again = line.replace("report.html", "again.html");
    let args: Vec<&str> = again.trim_start_matches("$ udc ").split(' ').collect();
    succeed(folder, &args);
    assert!(demo.join("again.html").is_file());
    assert!(fail(folder, &["demo", "--quick", "-o", "demo"], 1).contains("--overwrite"));
}
