use std::fs;

use ndarray::{Array1, Array3};
use sha2::{Digest, Sha256};

use super::*;
use crate::core::psf::{Psf, hex};
use crate::io::WriteOptions;

const NAME: &str = "PANEL_new";

fn write_image(path: &Path, value: f32) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let image = LinearImage::from_planes(Array3::from_elem((3, 4, 5), value)).unwrap();
    io::write_image(path, &image, &WriteOptions::default()).unwrap();
}

/// The published layout with one scene in each split; `split_folders` as its scripts write the inputs.
fn published(root: &Path, split_folders: bool) {
    for (split, scene) in [("train", "1"), ("test", "2")] {
        write_image(&root.join(format!("synthetic_data/GT/{split}/{scene}.npy")), 1.0);
        for i in 1..=9u8 {
            let below = if split_folders { format!("{split}/") } else { String::new() };
            let path = root.join(format!("synthetic_data/input/{NAME}_{i}/{below}{scene}.npy"));
            write_image(&path, f32::from(i));
        }
    }
    let codes = root.join("PSF/kernel_code");
    fs::create_dir_all(&codes).unwrap();
    for i in 1..=9u8 {
        let code = Array1::from_elem(5, f64::from(i)).mapv(|v| v as f32).into_dyn();
        io::write_array(&codes.join(format!("{NAME}_code_{i}.npy")), &code, false).unwrap();
    }
    write_image(&root.join("real_data/input/capture.npy"), 1.0);
}

fn message(result: Result<Dataset>) -> String {
    result.unwrap_err().to_string()
}

#[test]
fn reads_the_published_layout_in_place_with_and_without_split_folders() {
    for split_folders in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        published(folder.path(), split_folders);
        let dataset = Dataset::open(folder.path()).unwrap();
        assert_eq!(dataset.triplets.len(), 18);
        let test = dataset.split(Split::Test).unwrap();
        assert_eq!((test.len(), test[8].id.as_str(), test[8].angle_deg), (9, "2", Some(12.0)));
        assert_eq!(dataset.kernel_index(test[3]).unwrap(), 3);
        assert_eq!(dataset.code(test[3]).unwrap().to_vec(), [4.0; 5]);
        assert!((dataset.read_degraded(test[3]).unwrap().max() - 4.0).abs() < 1e-6);
        assert!((dataset.read_ground_truth(test[3]).unwrap().max() - 1.0).abs() < 1e-6);
        assert!(dataset.bank.is_none() && dataset.formation.clip_ground_truth);
        assert_eq!(dataset.real_captures.len(), 1);
    }
}

#[test]
fn says_what_the_published_layout_lacks() {
    let folder = tempfile::tempdir().unwrap();
    published(folder.path(), true);
    let root = folder.path();
    fs::remove_file(root.join(format!("synthetic_data/input/{NAME}_4/test/2.npy"))).unwrap();
    let missing = message(Dataset::open(root));
    assert!(
        missing.contains("1 of its images are missing") && missing.contains("_4/test/2.npy"),
        "{missing}"
    );
    fs::remove_dir_all(root.join("synthetic_data/GT/test")).unwrap();
    let untested = Dataset::open(root).unwrap();
    let message_of_split = untested.split(Split::Test).unwrap_err().to_string();
    assert!(message_of_split.contains("no test split (only train)"), "{message_of_split}");
    fs::remove_file(root.join(format!("PSF/kernel_code/{NAME}_code_7.npy"))).unwrap();
    assert!(message(Dataset::open(root)).contains("code_7.npy"));
    fs::remove_dir_all(root.join("PSF")).unwrap();
    assert!(message(Dataset::open(root)).contains("copy the kernel codes"));
}

/// Our own layout: one scene of one source, seen through one kernel without code.
fn own(root: &Path) -> DatasetConfig {
    let bank = KernelBank::single(Psf::from_energy(Array3::ones((3, 2, 2))).unwrap());
    io::write_bank(&root.join(BANK_FILE), &bank, true).unwrap();
    write_image(&root.join("gt/a.npy"), 2.0);
    write_image(&root.join("degraded/r+00/a.npy"), 1.0);
    let config = DatasetConfig {
        format: FORMAT.to_owned(),
        version: VERSION,
        program: "udc".to_owned(),
        bank: BANK_FILE.to_owned(),
        bank_sha256: io::bank_sha256(&root.join(BANK_FILE)).unwrap(),
        field_sha256: None,
        scene_domain: None,
        scene_primaries: None,
        seed: 0,
        division: "all train".to_owned(),
        image_format: "npy".to_owned(),
        archive_bytes: None,
        half: false,
        formation: FormationConfig::default(),
    };
    fs::write(root.join(CONFIG_FILE), config.to_toml()).unwrap();
    fs::write(root.join("triplets.jsonl"), line("a", "train")).unwrap();
    config
}

fn line(id: &str, split: &str) -> String {
    format!(
        "{{\"id\":\"{id}\",\"split\":\"{split}\",\"gt\":\"gt/a.npy\",\"degraded\":\"degraded/r+00/a.npy\",\
         \"kernel\":\"r+00\",\"angle_deg\":0.0,\"source\":\"s\",\"sha256\":null}}\n"
    )
}

#[test]
fn reads_its_own_layout_from_every_list() {
    let folder = tempfile::tempdir().unwrap();
    let config = own(folder.path());
    fs::write(folder.path().join("triplets-00002-of-00002.jsonl"), line("b", "train")).unwrap();
    let dataset = Dataset::open(folder.path()).unwrap();
    let ids: Vec<_> = dataset.triplets.iter().map(|triplet| triplet.id.as_str()).collect();
    assert_eq!(ids, ["a", "b"]);
    assert_eq!(dataset.config.as_ref(), Some(&config));
    assert!((dataset.read_ground_truth(&dataset.triplets[0]).unwrap().max() - 2.0).abs() < 1e-6);
    let message = dataset.code(&dataset.triplets[0]).unwrap_err().to_string();
    assert!(message.contains("have no codes"), "{message}");
}

#[test]
fn refuses_lists_that_contradict_themselves() {
    let folder = tempfile::tempdir().unwrap();
    own(folder.path());
    let with = |text: String| {
        fs::write(folder.path().join("triplets.jsonl"), text).unwrap();
        message(Dataset::open(folder.path()))
    };
    let twice = with(line("a", "train") + &line("a", "train"));
    assert!(twice.contains("twice"), "{twice}");
    let divided = with(line("a", "train") + &line("b", "test"));
    assert!(divided.contains("source s in the splits"), "{divided}");
    let torn = with(line("a", "train") + "{\"id\":\"b");
    assert!(torn.contains("line 2") && torn.contains("--resume"), "{torn}");
    let empty = with(String::new());
    assert!(empty.contains("no triplets"), "{empty}");
}

#[test]
fn refuses_another_bank_and_another_version() {
    let folder = tempfile::tempdir().unwrap();
    let config = own(folder.path());
    let other = KernelBank::single(Psf::from_energy(Array3::ones((3, 3, 3))).unwrap());
    io::write_bank(&folder.path().join(BANK_FILE), &other, true).unwrap();
    let bank = message(Dataset::open(folder.path()));
    assert!(bank.contains("not the kernel bank of this dataset"), "{bank}");
    let newer = DatasetConfig { version: VERSION + 1, ..config };
    fs::write(folder.path().join(CONFIG_FILE), newer.to_toml()).unwrap();
    let version = message(Dataset::open(folder.path()));
    assert!(version.contains("version 2; this program reads version 1"), "{version}");
    fs::write(folder.path().join(CONFIG_FILE), "format = \"other\"").unwrap();
    assert!(message(Dataset::open(folder.path())).contains("udc-dataset"));
}

#[test]
fn a_bank_may_be_recorded_by_the_hash_of_its_whole_file() {
    let folder = tempfile::tempdir().unwrap();
    let config = own(folder.path());
    let file = fs::read(folder.path().join(BANK_FILE)).unwrap();
    let recorded = DatasetConfig { bank_sha256: hex(&Sha256::digest(file)), ..config.clone() };
    assert_ne!(recorded, config);
    fs::write(folder.path().join(CONFIG_FILE), recorded.to_toml()).unwrap();
    assert_eq!(Dataset::open(folder.path()).unwrap().config, Some(config));
}

#[test]
fn says_that_a_folder_is_no_dataset() {
    let folder = tempfile::tempdir().unwrap();
    assert!(message(Dataset::open(folder.path())).contains("is no dataset"));
    assert!(message(Dataset::open(&folder.path().join("missing"))).contains("no such dataset folder"));
}

#[test]
fn a_division_that_is_whole_makes_up_for_what_others_left() {
    let scratch = tempfile::tempdir().unwrap();
    let root = scratch.path();
    let lacks = || TripletFiles::find(root).unwrap().unfinished();
    let make = |name: &str| fs::write(root.join(name), "").unwrap();
    let begun = |name: &str| fs::write(TripletFiles::mark_of(&root.join(name)), "").unwrap();
    make("triplets-00001-of-00002.jsonl");
    assert_eq!(lacks(), ["triplets-00002-of-00002.jsonl is not there"]);
    make("triplets-00002-of-00002.jsonl");
    assert!(lacks().is_empty());
    begun("triplets-00002-of-00002.jsonl");
    assert_eq!(lacks(), ["the run that writes triplets-00002-of-00002.jsonl has not ended"]);
    make("triplets.jsonl");
    assert!(lacks().is_empty(), "one process went on with it");
    make("triplets-val-00003-of-00003.jsonl");
    let expected = [1, 2].map(|part| format!("triplets-val-{part:05}-of-00003.jsonl is not there"));
    assert_eq!(lacks(), expected);
}
