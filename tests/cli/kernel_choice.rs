//! Which kernels a training learns from and a measurement counts, and kernels of a panel that is turned.

use std::fs;
use std::path::Path;

use serde_json::Value;
use udc::core::psf::Psf;
use udc::dataset::DatasetConfig;
use udc::io;
use udc::network::Model;

use super::common::{fail, succeed};
use super::train::{CONFIG, prepare};

/// A dataset of two rotations, and the configurations of two rows: one of a single kernel, and one of all.
fn scratch() -> tempfile::TempDir {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    prepare(folder);
    let mut bank = io::read_bank(&folder.join("dataset/kernels.safetensors")).unwrap();
    bank.angles_deg = Some(vec![0.0, 3.0]);
    write_bank(folder, &bank);
    let list = folder.join("dataset/triplets.jsonl");
    let mut lines = fs::read_to_string(&list).unwrap();
    for (old, name, angle) in [("k01", "r+00", "0.0"), ("k02", "r+03", "3.0")] {
        let was = format!("\"kernel\":\"{old}\",\"angle_deg\":null");
        assert!(lines.contains(&was), "{lines}");
        lines = lines.replace(&was, &format!("\"kernel\":\"{name}\",\"angle_deg\":{angle}"));
    }
    fs::write(list, lines).unwrap();
    let plain = CONFIG.replace("code-dim", "condition = \"none\"\ncode-dim");
    let single = plain.replace("[data]", "[data]\nkernels = [\"r+00\"]");
    fs::write(folder.join("single.toml"), single).unwrap();
    fs::write(folder.join("varied.toml"), plain).unwrap();
    scratch
}

fn write_bank(folder: &Path, bank: &udc::core::kernel_code::KernelBank) {
    let root = folder.join("dataset");
    let path = root.join("kernels.safetensors");
    io::write_bank(&path, bank, true).unwrap();
    let mut config = DatasetConfig::read(&root).unwrap();
    config.bank_sha256 = io::bank_sha256(&path).unwrap();
    fs::write(root.join("dataset.toml"), config.to_toml()).unwrap();
}

fn train<'a>(config: &'a str, output: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["train", config, "--data", "dataset", "-o", output][..], more].concat()
}

fn json(folder: &Path, name: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(folder.join(name)).unwrap()).unwrap()
}

fn weights(folder: &Path, run: &str) -> Vec<Vec<f32>> {
    let model = udc::network::weights::read(&folder.join(run).join("model.safetensors")).unwrap();
    model.parameters.iter().map(|parameter| parameter.values.clone()).collect()
}

#[test]
fn a_training_on_one_kernel_never_reads_images_of_others() {
    let scratch = scratch();
    let folder = scratch.path();
    succeed(folder, &train("single.toml", "before", &[]));
    // Everything of the other kernel, whether to learn from or to validate with.
    for scene in 0..4 {
        fs::write(folder.join(format!("dataset/degraded/k02/scene{scene}.npy")), "damaged").unwrap();
    }
    succeed(folder, &train("single.toml", "after", &[]));
    for file in ["model.safetensors", "best.safetensors", "metrics.jsonl", "previews/24/1.png"] {
        let read = |run: &str| fs::read(folder.join(run).join(file)).unwrap();
        assert!(read("before") == read("after"), "{file} differs");
    }
    let said = fail(folder, &train("varied.toml", "varied", &[]), 1);
    assert!(said.contains("degraded/k02/"), "{said}");
    let model = Model::load(&folder.join("after/model.safetensors")).unwrap();
    assert_eq!(model.origin().training.as_ref().unwrap()["config"]["data"]["kernels"][0], "r+00");
}

#[test]
fn images_degraded_on_the_fly_are_of_the_chosen_kernels() {
    let scratch = scratch();
    let folder = scratch.path();
    let on_the_fly = ["--set", "data.degradation=on-the-fly", "--set", "validation.every=0"];
    succeed(folder, &train("single.toml", "before", &on_the_fly));
    succeed(folder, &train("varied.toml", "varied", &on_the_fly));
    let mut bank = io::read_bank(&folder.join("dataset/kernels.safetensors")).unwrap();
    bank.psfs[1] = Psf::from_energy(ndarray::Array3::ones((3, 3, 3))).unwrap();
    write_bank(folder, &bank);
    succeed(folder, &train("single.toml", "after", &on_the_fly));
    assert_eq!(weights(folder, "before"), weights(folder, "after"), "the other kernel is never drawn");
    succeed(folder, &train("varied.toml", "other", &on_the_fly));
    assert_ne!(weights(folder, "varied"), weights(folder, "other"), "it is drawn where it is not left out");
}

#[test]
fn the_ablation_table_has_the_single_kernel_beside_all_as_eval_measures_them() {
    let scratch = scratch();
    let folder = scratch.path();
    let sweep = ["sweep", "single.toml", "varied.toml", "--data", "dataset", "-o", "sweep"];
    let said = succeed(folder, &sweep);
    let heading = "| PSNR (dB), r+00 | SSIM, r+00 | PSNR (dB), all kernels | SSIM, all kernels |";
    assert!(said.lines().any(|line| line.ends_with(heading)), "{said}");
    let table = json(folder, "sweep/table.json");
    assert_eq!(table["single-kernel"], "r+00");
    for (row, name) in table["rows"].as_array().unwrap().iter().zip(["single", "varied"]) {
        let model = format!("sweep/{name}/model.safetensors");
        for (kernels, part) in [(&["--kernels", "r+00"][..], &row["single"]), (&[], row)] {
            let output = format!("{name}-{}", kernels.len());
            let eval = ["eval", "dataset", "--model", &model, "-o", &output];
            succeed(folder, &[&eval[..], kernels].concat());
            let measured = json(folder, &format!("{output}/metrics.json"));
            assert_eq!(part["mean"], measured["mean"], "{name} {kernels:?}");
            assert_eq!(part["degraded"], measured["methods"][0]["mean"], "{name} {kernels:?}");
        }
        assert_ne!(row["single"]["mean"], row["mean"]);
    }
    assert_ne!(weights(folder, "sweep/single"), weights(folder, "sweep/varied"));
    let csv = fs::read_to_string(folder.join("sweep/table.csv")).unwrap();
    let lines: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(lines[0][10..], ["r+00_psnr", "r+00_ssim", "degraded_r+00_psnr", "degraded_r+00_ssim"]);
    assert_eq!(lines[1][10], table["rows"][0]["single"]["mean"]["psnr"].to_string());
    // Another single kernel is another measurement of the same trainings.
    succeed(folder, &[&sweep[..], &["--resume", "--single", "r+03"]].concat());
    assert_eq!(json(folder, "sweep/table.json")["single-kernel"], "r+03");
    assert_eq!(json(folder, "sweep/table.json")["rows"][0]["mean"], table["rows"][0]["mean"]);
}

#[test]
fn a_kernel_that_there_is_not_is_answered_with_those_there_are() {
    let scratch = scratch();
    let folder = scratch.path();
    let known = "r+00, r+03; did you mean r+00?";
    let said = fail(folder, &train("varied.toml", "run", &["--set", "data.kernels=[\"r+01\"]"]), 1);
    assert!(said.contains("data.kernels: there is no kernel r+01") && said.contains(known), "{said}");
    let on_the_fly = ["--set", "data.degradation=on-the-fly", "--set", "data.kernels=r+01"];
    let said = fail(folder, &train("varied.toml", "run", &on_the_fly), 1);
    assert!(said.contains("data.kernels: there is no kernel r+01") && said.contains(known), "{said}");
    let said = fail(folder, &train("varied.toml", "run", &["--set", "data.kernels=[]"]), 2);
    assert!(said.contains("data.kernels: names no kernel"), "{said}");
    assert!(!folder.join("run").exists());
    let sweep = ["sweep", "varied.toml", "--data", "dataset", "-o", "sweep", "--single", "r+01"];
    let said = fail(folder, &sweep, 1);
    assert!(said.contains("--single: there is no kernel r+01") && said.contains(known), "{said}");
    let eval = ["eval", "dataset", "--method", "wiener", "--kernels", "r+01", "-o", "results"];
    let said = fail(folder, &eval, 1);
    assert!(said.contains("--kernels: there is no kernel r+01") && said.contains(known), "{said}");
}

#[test]
fn a_run_is_not_resumed_on_other_kernels() {
    let scratch = scratch();
    let folder = scratch.path();
    succeed(folder, &train("single.toml", "run", &["--set", "iterations=2"]));
    let resume = ["--resume", "--set", "iterations=3"];
    let said = fail(folder, &train("varied.toml", "run", &resume), 1);
    assert!(said.contains("data.kernels is \"all\" and was [\"r+00\"]"), "{said}");
    succeed(folder, &train("single.toml", "run", &resume));
}

/// Fine enough for orders, small enough to be quick.
const DISPLAY: &str = r#"
[sensor]
size-px = 41
[spectrum]
red = [[610.0, 1.0]]
green = [[530.0, 1.0]]
blue = [[465.0, 1.0]]
[display]
kind = "stripe"
pitch-um = 150.0
background-transmittance = 0.1
green = { shape = "rectangle", width-um = 60.0, height-um = 90.0, transmittance = 1.0 }
"#;

#[test]
fn the_kernels_of_a_simulated_panel_are_those_of_the_turned_panel() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    fs::write(folder.join("panel.toml"), DISPLAY).unwrap();
    let codes =
        ["codes", "--display", "panel.toml", "--angles=-6:6:6", "--dim", "2", "-o", "bank.safetensors"];
    succeed(folder, &codes);
    let bank = io::read_bank(&folder.join("bank.safetensors")).unwrap();
    assert_eq!(bank.angles_deg.as_deref(), Some(&[-6.0, 0.0, 6.0][..]));
    for (index, angle) in [-6, 0, 6].into_iter().enumerate() {
        let turned = DISPLAY.replace("[display]", &format!("[display]\nangle-deg = {angle}"));
        fs::write(folder.join("turned.toml"), turned).unwrap();
        succeed(folder, &["psf", "--display", "turned.toml", "-o", "psf.npy", "--overwrite"]);
        assert_eq!(bank.psfs[index], io::read_psf(&folder.join("psf.npy")).unwrap(), "{angle}°");
    }
    let origin = bank.origin.as_ref().unwrap();
    assert_eq!(origin["rotation"], "propagation");
    assert_eq!(origin["display"]["display"]["pitch-um"], 150.0);
    assert!(succeed(folder, &["info", "bank.safetensors"]).contains("rotation  by propagation"));
    // What is made of the bank says it too.
    io::write_bank(&folder.join("again.safetensors"), &bank, false).unwrap();
    let read = |name: &str| fs::read(folder.join(name)).unwrap();
    assert!(read("bank.safetensors") == read("again.safetensors"), "the bytes differ");
    let one = ["codes", "psf.npy", "--angles=-6:6:6", "--dim", "2", "-o", "one.safetensors"];
    succeed(folder, &one);
    assert!(succeed(folder, &["info", "one.safetensors"]).contains("rotation  by interpolation"));
}

#[test]
fn refuses_to_turn_what_looks_the_same_at_every_angle() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    fs::write(folder.join("bare.toml"), "[sensor]\nsize-px = 21\n").unwrap();
    fs::write(folder.join("panel.toml"), DISPLAY).unwrap();
    let said = fail(folder, &["codes", "--display", "bare.toml", "-o", "bank.safetensors"], 1);
    assert!(said.contains("bare.toml") && said.contains("nothing to turn"), "{said}");
    let few = ["codes", "--display", "panel.toml", "--angles=0,3", "--dim", "2", "-o", "bank.safetensors"];
    assert!(fail(folder, &few, 1).contains("smaller --dim"));
    let both = ["codes", "psf.exr", "--display", "panel.toml", "-o", "bank.safetensors"];
    assert!(fail(folder, &both, 2).contains("--display"));
    assert!(!folder.join("bank.safetensors").exists());
}

/// --size is of the PSFs that are simulated; a PSF that there is has its own.
#[test]
fn refuses_a_size_where_nothing_is_simulated() {
    let scratch = tempfile::tempdir().unwrap();
    let make = ["codes", "psf.exr", "-o", "bank.safetensors"];
    let project = ["codes", "psf.exr", "--project", "bank.safetensors"];
    for command in [&make[..], &project] {
        let said = fail(scratch.path(), &[command, &["--size", "21"]].concat(), 2);
        assert!(said.contains("--size") && said.contains("cannot be used with"), "{said}");
    }
}
