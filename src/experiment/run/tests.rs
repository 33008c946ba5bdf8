//! Whole experiments on a dataset of two scenes, as a user of the library makes them.

use crate::experiment::RestorationMethod;
use std::cell::RefCell;
use std::fs;
use std::path::Path;

use ndarray::Array3;
use serde_json::json;

use super::*;
use crate::codes::make_rotated_bank;
use crate::core::image::LinearImage;
use crate::core::progress::Progress;
use crate::core::psf::Psf;
use crate::core::shard::Shard;
use crate::dataset::{CONFIG_FILE, DatasetConfig, FORMAT, FormationConfig, KernelChoice, Split, VERSION};
use crate::experiment::{
    EarlierRows, MethodResults, PICTURES, Region, Results, Sweep, SweepConfig, SweepEntry, SweepEvent,
};
use crate::io::{self, WriteOptions};
use crate::network::Backend;
use crate::restore::Highlights;
use crate::restore::deconvolution;
use crate::train::TrainConfig;

const SIDE: usize = 32;
const KERNELS: [(&str, f64); 2] = [("r-40", -40.0), ("r+00", 0.0)];

/// A lamp before a faint texture, as it is or seen through a panel that dims it.
fn write_image(path: &Path, share: f32) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let value =
        |(_, y, x)| if (y, x) == (16, 16) { 800.0 } else { 0.3 + ((y * 5 + x * 3) % 7) as f32 * 0.01 };
    let image = LinearImage::from_planes(Array3::from_shape_fn((3, SIDE, SIDE), value)).unwrap();
    let image: LinearImage = image.map_values(|value| share * value + 0.01);
    io::write_image(path, &image, &WriteOptions::default()).unwrap();
}

/// One scene to train on and one to test on, seen through two kernels.
fn write_dataset(root: &Path, margin: usize) -> Dataset {
    fs::create_dir(root).unwrap();
    let energy =
        |(_, y, x): (usize, usize, usize)| if y == 4 { 1.0 / (1.0 + x.abs_diff(4) as f32) } else { 0.0 };
    let psf = Psf::from_energy(Array3::from_shape_fn((3, 9, 9), energy)).unwrap();
    let bank = make_rotated_bank(&psf, &KERNELS.map(|(_, angle)| angle), 1).unwrap();
    let bank_file = root.join("kernels.safetensors");
    io::write_bank(&bank_file, &bank, false).unwrap();
    let config = DatasetConfig {
        format: FORMAT.to_owned(),
        version: VERSION,
        program: "udc".to_owned(),
        bank: "kernels.safetensors".to_owned(),
        bank_sha256: io::bank_sha256(&bank_file).unwrap(),
        field_sha256: None,
        scene_domain: None,
        scene_primaries: None,
        seed: 1,
        division: "test-fraction 0.5".to_owned(),
        image_format: "exr".to_owned(),
        archive_bytes: None,
        half: false,
        formation: FormationConfig { margin, ..FormationConfig::default() },
    };
    fs::write(root.join(CONFIG_FILE), toml::to_string(&config).unwrap()).unwrap();
    let mut lines = String::new();
    for (id, split) in [("street", "test"), ("room", "train")] {
        write_image(&root.join(format!("gt/{id}.exr")), 1.0);
        for (kernel, angle) in KERNELS {
            let degraded = format!("degraded/{kernel}/{id}.exr");
            write_image(&root.join(&degraded), 0.8);
            let line = json!({
                "id": id, "split": split, "gt": format!("gt/{id}.exr"), "degraded": degraded, "kernel": kernel,
                "angle_deg": angle, "source": id, "sha256": null,
            });
            lines += &format!("{line}\n");
        }
    }
    fs::write(root.join("triplets.jsonl"), lines).unwrap();
    Dataset::open(root).unwrap()
}

fn everything() -> ExperimentConfig {
    let (split, kernels) = (Split::Test, KernelChoice::All);
    ExperimentConfig {
        measuring: EvalConfig::default(),
        images: ImagesConfig { split, kernels, limit: None, max_memory: 1 << 30, shard: Shard::WHOLE },
        regions: true,
        mismatch: true,
        ldr: Some(1.0),
        pictures: 1,
    }
}

fn candidates() -> Vec<Candidate> {
    let highlights = [Highlights::default(), Highlights::Keep];
    Candidate::list(
        Vec::new(),
        &[RestorationMethod::Deconvolution(deconvolution::Method::RichardsonLucy)],
        &highlights,
        Backend::default(),
    )
}

#[test]
fn an_experiment_finds_everything_that_it_was_asked_for() {
    let scratch = tempfile::tempdir().unwrap();
    let datasets = [("day".to_owned(), write_dataset(&scratch.path().join("day"), 0))];
    let (candidates, config, progress) = (candidates(), everything(), Progress::default());
    let listener = Listener { progress: &progress, warn: &|text| panic!("warned: {text}") };
    let experiment = Experiment::new(&datasets, &candidates, &config, listener).unwrap();
    let results = scratch.path().join("results");
    let Findings { evaluation, mismatch, ldr } = experiment.run(&results).unwrap();

    let names: Vec<&str> = evaluation.methods.iter().map(|method| method.name.as_str()).collect();
    assert_eq!(names, ["degraded", "richardson-lucy", "richardson-lucy, highlights kept"]);
    assert_eq!(evaluation.rotations(), KERNELS.map(|(name, angle)| (name, Some(angle))));
    let found = Results::of(&evaluation);
    assert_eq!(found.methods[1].regions[&Region::Highlights].images, 2);
    // Told its own kernel, each image is restored as in the evaluation.
    let matrices = mismatch.unwrap().matrices;
    assert_eq!(matrices.len(), 4, "two candidates are told kernels, two metrics");
    for (index, (kernel, _)) in KERNELS.iter().enumerate() {
        assert_eq!(Some(matrices[0].rows[index][index]), found.methods[1].kernels[*kernel].get(Metric::Psnr));
    }
    let (ldr, shown) = ldr.unwrap();
    assert_eq!((ldr.images.len(), shown.len()), (2, 2));
    assert!(ldr.mean.ldr.unwrap().highlight_share < ldr.mean.hdr.unwrap().highlight_share);
    // Everything else is for the caller to write.
    let pictures = io::list_folder(&results.join(PICTURES)).unwrap();
    let files = experiment.files();
    assert_eq!(io::list_folder(&results).unwrap(), [PICTURES]);
    assert_eq!(pictures.len(), 8, "pictures and light of three methods and the ground truth of one image");
    assert!(pictures.iter().all(|name| files.contains(&format!("{PICTURES}/{name}"))), "{files:?}");
    let expected = ["metrics.json", "regions.csv", "mismatch-2-ssim.svg", "ldr.png"];
    assert!(expected.iter().all(|name| files.contains(&(*name).to_owned())), "{files:?}");
}

#[test]
fn says_before_the_work_what_cannot_be_done_and_warns_of_what_is_lost() {
    let scratch = tempfile::tempdir().unwrap();
    let named = |name: &str| (name.to_owned(), write_dataset(&scratch.path().join(name), 4));
    let datasets = [named("day"), named("night")];
    let (progress, warnings) = (Progress::default(), std::sync::Mutex::new(Vec::new()));
    let warn = |text: &str| warnings.lock().unwrap().push(text.to_owned());
    let listener = Listener { progress: &progress, warn: &warn };
    let refusal = |datasets: &[(String, Dataset)], candidates: &[Candidate], config: &ExperimentConfig| {
        Experiment::new(datasets, candidates, config, listener).err().unwrap().to_string()
    };
    assert!(refusal(&datasets, &candidates(), &everything()).contains("one dataset"));
    assert!(refusal(&datasets[..1], &[Candidate::Nothing], &everything()).contains("told kernels"));
    let black = ExperimentConfig { ldr: Some(0.0), ..everything() };
    assert!(refusal(&datasets[..1], &candidates(), &black).contains("positive irradiance"));
    let mut images = ImagesConfig { split: Split::Val, ..everything().images };
    let config = ExperimentConfig { images: images.clone(), ..everything() };
    assert!(refusal(&datasets[..1], &candidates(), &config).contains("no val split"));
    (images.split, images.kernels) = (Split::Test, KernelChoice::Only(vec!["r+90".to_owned()]));
    let config = ExperimentConfig { images, ..everything() };
    assert!(refusal(&datasets[..1], &candidates(), &config).contains("r+90"));
    assert!(warnings.lock().unwrap().is_empty());

    assert!(Experiment::new(&datasets[..1], &candidates(), &everything(), listener).is_ok());
    assert!(warnings.lock().unwrap()[0].contains("had a margin"), "{warnings:?}");
}

#[test]
fn several_datasets_stand_side_by_side_with_pictures_of_their_own() {
    let scratch = tempfile::tempdir().unwrap();
    let named = |name: &str| (name.to_owned(), write_dataset(&scratch.path().join(name), 0));
    let (datasets, progress) = ([named("day"), named("night")], Progress::default());
    let listener = Listener { progress: &progress, warn: &|_| () };
    let config = ExperimentConfig { mismatch: false, ldr: None, ..everything() };
    let experiment = Experiment::new(&datasets, &[Candidate::Nothing], &config, listener).unwrap();
    let findings = experiment.run(&scratch.path().join("results")).unwrap();
    let labels: Vec<String> =
        Results::of(&findings.evaluation).methods.iter().map(MethodResults::label).collect();
    assert_eq!(labels, ["day: degraded", "night: degraded"]);
    let pictures = io::list_folder(&scratch.path().join("results").join(PICTURES)).unwrap();
    assert!(pictures.contains(&"night_street_r-40.1-degraded.png".to_owned()), "{pictures:?}");
}

fn sweep_config(single: Option<&str>) -> SweepConfig {
    SweepConfig {
        measuring: EvalConfig::default(),
        limit: None,
        single: single.map(str::to_owned),
        max_memory: 1 << 30,
        backend: Backend::default(),
        earlier: EarlierRows::Refuse,
        shard: Shard::WHOLE,
    }
}

#[test]
fn a_sweep_names_the_rows_that_fail_and_refuses_what_cannot_be_compared() {
    let scratch = tempfile::tempdir().unwrap();
    let (folder, progress) = (scratch.path().join("sweep"), Progress::default());
    let dataset = write_dataset(&scratch.path().join("day"), 0);
    let listener = Listener { progress: &progress, warn: &|_| () };
    let config = sweep_config(None);
    let sweep = Sweep::new(&config, &dataset, &folder, listener).unwrap();
    let entry = |name: &str, seed: u64| {
        let config = TrainConfig { seed, ..TrainConfig::default() };
        SweepEntry { name: name.to_owned(), config }
    };
    let refusal = |entries: &[SweepEntry]| sweep.run(entries, &|_| ()).unwrap_err().to_string();
    assert!(refusal(&[entry("a", 1), entry("a", 1)]).contains("two configurations are called a"));
    assert!(refusal(&[entry("a", 1), entry("b", 2)]).contains("a has seed 1 and b has seed 2"));

    // The default network reads longer codes than the dataset has.
    let begun = RefCell::new(Vec::new());
    let note = |event: SweepEvent<'_>| {
        if let SweepEvent::Begins(name) = event {
            begun.borrow_mut().push(name.to_owned());
        }
    };
    let results = sweep.run(&[entry("a", 1), entry("b", 1)], &note).unwrap();
    assert_eq!(begun.into_inner(), ["a", "b"]);
    assert_eq!((results.rows.len(), results.failed.len()), (0, 2));
    assert!(results.failed[1].reason.starts_with("row b: architecture.code-dim: is 5"), "{results:?}");
    assert_eq!(results.single_kernel.as_deref(), Some("r+00"), "the unrotated one of two");
    fs::create_dir_all(folder.join("a")).unwrap();
    assert!(refusal(&[entry("a", 1)]).contains("has a row a already"));

    let unknown = sweep_config(Some("r+90"));
    assert!(Sweep::new(&unknown, &dataset, &folder, listener).is_err());
}
