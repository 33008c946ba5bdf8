//! Tests of folders of examples: who makes them decides nothing, and what is there stays.

use std::collections::BTreeMap;
use std::path::PathBuf;

use ndarray::Array3;

use super::*;
use crate::core::image::LinearImage;
use crate::core::psf::Psf;
use crate::examples::{CAPTURE, ExamplesFolder, GROUND_TRUTH};
use crate::io::WriteOptions;
use crate::network::Plane;

/// Small examples, half of which show panoramas where there are some.
fn config(panoramas: Vec<PathBuf>) -> ExamplesConfig {
    let mut config =
        ExamplesConfig { count: 8, validation_share: 0.25, side_px: 40, ..ExamplesConfig::default() };
    (config.panels.count, config.panels.validation, config.panels.psf_side_px) = (2, 1, 15);
    config.scenes.procedural_share = if panoramas.is_empty() { 1.0 } else { 0.5 };
    config.scenes.validation_panoramas = 1;
    config.scenes.panoramas = panoramas;
    config
}

fn make_shard(root: &Path, config: &ExamplesConfig, shard: &str, existing: Existing) -> Result<MadeExamples> {
    let set = ExampleSet { config: config.clone(), shard: shard.parse().unwrap() };
    set.make(root, existing, &Progress::default(), |_| {})
}

fn make(root: &Path, config: &ExamplesConfig, existing: Existing) -> Result<MadeExamples> {
    make_shard(root, config, "1/1", existing)
}

/// The bytes of every example and panel, and all records.
fn contents(root: &Path) -> (BTreeMap<String, Vec<u8>>, Vec<ExampleRecord>) {
    let records = ExamplesFolder::open(root).unwrap().records;
    let panels =
        io::list_folder(&root.join("panels")).unwrap().into_iter().map(|name| format!("panels/{name}"));
    let names = records.iter().map(ExampleRecord::file_name).chain(panels);
    (names.map(|name| (name.clone(), std::fs::read(root.join(name)).unwrap())).collect(), records)
}

fn panoramas(folder: &Path) -> Vec<PathBuf> {
    let write = |name: &str| {
        let path = folder.join(name);
        let planes = Array3::from_shape_fn((3, 16, 32), |(c, y, x)| {
            0.1 + ((c + 3 * y + 5 * x) % 11) as f32 / 10.0 + if (y, x) == (6, 9) { 500.0 } else { 0.0 }
        });
        io::write_image(&path, &LinearImage::from_planes(planes).unwrap(), &WriteOptions::default()).unwrap();
        path
    };
    ["a.npy", "b.npy"].map(write).into()
}

/// Two shards, one on one thread, and the second after the first.
#[test]
fn neither_shards_nor_threads_nor_an_end_in_between_change_an_example() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, parts] = ["whole", "parts"].map(|name| folder.path().join(name));
    let config = config(panoramas(folder.path()));
    let made = make(&whole, &config, Existing::Refuse).unwrap();
    assert_eq!(made, MadeExamples { made: 8, kept: 0, validation: 2 });
    let single = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let first = single.install(|| make_shard(&parts, &config, "1/2", Existing::Refuse)).unwrap();
    assert_eq!(first.made, 4);
    make_shard(&parts, &config, "2/2", Existing::Refuse).unwrap();
    assert_eq!(contents(&parts), contents(&whole));

    let (_, records) = contents(&whole);
    let has = |tag: &str| records.iter().any(|record| record.tags.iter().any(|t| t == tag));
    assert!(["harder", "simulator", "painted", "panorama"].into_iter().all(has), "{records:?}");
    std::fs::remove_file(parts.join(records[5].file_name())).unwrap();
    let again = make_shard(&parts, &config, "2/2", Existing::Resume).unwrap();
    assert_eq!((again.made, again.kept), (1, 3));
    assert_eq!(contents(&parts), contents(&whole));
}

#[test]
fn more_examples_may_be_asked_for_and_others_not() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("examples");
    let mut config = ExamplesConfig { count: 2, ..config(Vec::new()) };
    make(&root, &config, Existing::Refuse).unwrap();
    let message = make(&root, &config, Existing::Refuse).unwrap_err().to_string();
    assert!(message.contains("pass --resume"), "{message}");
    config.count = 3;
    let made = make(&root, &config, Existing::Resume).unwrap();
    assert_eq!((made.made, made.kept), (1, 2));
    let (before, _) = contents(&root);
    config.harder.share = 0.0;
    let message = make(&root, &config, Existing::Resume).unwrap_err().to_string();
    assert!(message.contains("another examples.harder.share"), "{message}");
    config.seed += 1;
    make(&root, &config, Existing::Overwrite).unwrap();
    assert!(contents(&root).0 != before, "another seed draws other examples");
    let message = make(folder.path(), &config, Existing::Overwrite).unwrap_err().to_string();
    assert!(message.contains("something else than examples"), "{message}");
}

/// Of more examples, and of two shards; what no list names is somebody else's.
#[test]
fn examples_of_a_run_before_are_gone_where_one_begins_anew() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("examples");
    let config = |count: usize| ExamplesConfig { count, ..config(Vec::new()) };
    make_shard(&root, &config(6), "1/2", Existing::Refuse).unwrap();
    make_shard(&root, &config(6), "2/2", Existing::Refuse).unwrap();
    let foreign = ["999999.safetensors", "notes.txt"].map(|name| root.join(name));
    foreign.iter().for_each(|file| std::fs::write(file, "somebody's").unwrap());
    make(&root, &config(2), Existing::Overwrite).unwrap();
    assert!(foreign.iter().all(|file| file.is_file()));
    let mut names = io::list_folder(&root).unwrap();
    names.retain(|name| name.ends_with(".safetensors"));
    let mut expected: Vec<String> = contents(&root).1.iter().map(ExampleRecord::file_name).collect();
    expected.push("999999.safetensors".to_owned());
    assert_eq!(names, expected);
}

#[test]
fn a_shard_that_begins_anew_leaves_what_others_make_of_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("examples");
    let mut config = ExamplesConfig { count: 4, ..config(Vec::new()) };
    ["1/2", "2/2", "1/2"].iter().for_each(|shard| {
        make_shard(&root, &config, shard, Existing::Overwrite).unwrap();
    });
    let found = ExamplesFolder::open(&root).unwrap();
    assert_eq!((found.records.len(), found.unfinished()), (4, None));
    let held = LineLog::open(&root.join(list_name(1, 2))).unwrap();
    held.try_lock().unwrap();
    config.seed += 1;
    let said = make_shard(&root, &config, "1/2", Existing::Overwrite).unwrap_err().to_string();
    assert!(said.contains("examples-02-of-02.jsonl") && said.contains("another process"), "{said}");
    drop(held);
    make_shard(&root, &config, "1/2", Existing::Overwrite).unwrap();
    let found = ExamplesFolder::open(&root).unwrap();
    assert!(
        found.unfinished().unwrap().starts_with("2 of 4 examples are in"),
        "the others are of another seed"
    );
}

/// Examples of one panel are seen through its PSF alone, for whatever they are, and those of another are others.
#[test]
fn a_panel_that_is_given_is_the_only_one() {
    let folder = tempfile::tempdir().unwrap();
    let [psf, other] = ["psf.exr", "other.exr"].map(|name| folder.path().join(name));
    let energy = |corner: f32| {
        Array3::from_shape_fn((3, 19, 17), |(_, y, x)| match (y, x) {
            (9, 8) => 8.0,
            (3, 3) => corner,
            _ => 0.0,
        })
    };
    for (path, corner) in [(&psf, 1.0), (&other, 2.0)] {
        io::write_psf(path, &Psf::from_energy(energy(corner)).unwrap(), &WriteOptions::default()).unwrap();
    }
    let mut config = config(Vec::new());
    config.panels.psf = Some(psf.clone());
    let root = folder.path().join("examples");
    make(&root, &config, Existing::Refuse).unwrap();
    let made = ExamplesFolder::open(&root).unwrap();
    assert_eq!(made.file.examples.panels.psf_side_px, 19);
    assert_eq!(made.records.len(), 8);
    assert!(made.records.iter().all(|record| record.panel == 0));
    assert_eq!(io::list_folder(&root.join("panels")).unwrap(), ["000.exr"]);
    assert_eq!(io::read_psf(&root.join("panels/000.exr")).unwrap(), io::read_psf(&psf).unwrap());
    config.panels.psf = Some(other);
    let message = make(&root, &config, Existing::Resume).unwrap_err().to_string();
    assert!(message.contains("another psf-sha256"), "{message}");
}

/// The same recipe with and without what makes it harder.
#[test]
fn a_harder_example_is_tagged_and_another() {
    let folder = tempfile::tempdir().unwrap();
    let folder_of = |share: f64| {
        let root = folder.path().join(share.to_string());
        let mut config = ExamplesConfig { count: 1, zero_border_share: 0.0, ..config(Vec::new()) };
        config.harder.share = share;
        make(&root, &config, Existing::Refuse).unwrap();
        let folder = ExamplesFolder::open(&root).unwrap();
        let tensors = folder.read(&folder.records[0]).unwrap();
        (folder.records[0].clone(), tensors)
    };
    let ((simulator, plain), (harder, other)) = (folder_of(0.0), folder_of(1.0));
    assert_eq!((simulator.panel, simulator.angle_deg), (harder.panel, harder.angle_deg));
    assert_eq!((simulator.tags[0].as_str(), harder.tags[0].as_str()), ("simulator", "harder"));
    assert!(simulator.stray_light.is_none() && harder.stray_light.is_some());
    assert_eq!(simulator.saturation[0], simulator.saturation[1]);
    assert!(harder.saturation[0] > harder.saturation[1]);
    assert_ne!(plain[CAPTURE], other[CAPTURE]);
    let names: Vec<&str> = plain.keys().map(String::as_str).collect();
    let mut expected = Plane::ALL.map(Plane::name).to_vec();
    expected.extend([CAPTURE, GROUND_TRUTH]);
    expected.sort_unstable();
    assert_eq!(names, expected);
    assert!(plain.values().all(|tensor| tensor.shape == [3, 40, 40]));
}

#[test]
fn an_interrupt_ends_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let interrupted = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(true));
    let set = ExampleSet { config: config(Vec::new()), shard: Shard::WHOLE };
    let found = set.make(folder.path(), Existing::Refuse, &Progress::new(None, interrupted), |_| {});
    assert!(matches!(found, Err(Error::Interrupted)), "{found:?}");
}
