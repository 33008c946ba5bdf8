//! Datasets whose images are kept in tar archives.

use std::fs;
use std::path::Path;

use udc::core::image::Linear;
use udc::dataset::Dataset;
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed};
use super::synth::{scratch, synth};

/// A ground truth and three images of 20 × 24 are 24 KB: two archives of two scenes, one of one.
const TWO_SCENES: [&str; 4] = ["--format", "npy", "--tar", "30KiB"];

fn archives(dataset: &Path) -> Vec<String> {
    let names = fs::read_dir(dataset).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names.filter(|name| name.ends_with(".tar")).collect();
    names.sort();
    names
}

/// Every image of a dataset by scene and kernel, as it is stored.
fn images(dataset: &Path) -> Vec<(String, String, Vec<u8>, Vec<u8>)> {
    let dataset = Dataset::open(dataset).unwrap();
    let read = |path: &str| io::read_bytes(&dataset.root.join(path)).unwrap();
    let triplets = dataset.triplets.iter();
    triplets.map(|t| (t.id.clone(), t.kernel.clone(), read(&t.gt), read(&t.degraded))).collect()
}

#[test]
fn an_archive_holds_the_bytes_that_files_would() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "files", &["--format", "npy"]);
    synth(folder, "packed", &TWO_SCENES);
    assert_eq!(archives(&folder.join("packed")), [0, 1, 2].map(|n| format!("images-00000{n}.tar")));
    assert!(!folder.join("packed/gt").exists());
    assert_eq!(images(&folder.join("packed")), images(&folder.join("files")));
    let measure = |dataset| {
        succeed(folder, &["eval", dataset, "--method", "wiener", "-o", &format!("of_{dataset}")]);
        fs::read_to_string(folder.join(format!("of_{dataset}/metrics.csv"))).unwrap()
    };
    assert_eq!(measure("packed"), measure("files"));
    succeed(folder, &["doctor", "packed"]);
    succeed(folder, &["info", "packed"]);
    let member = "packed/images-000000.tar/hall_01.r+00.npy";
    succeed(folder, &["restore", member, "--psf", "psf.npy", "--method", "wiener", "-o", "restored.exr"]);
    fail(folder, &["bench", "--read", "packed", "--device", "cpu"], 2);
    let said = succeed(folder, &["bench", "--read", "packed"]);
    assert!(said.contains("as stored: 20 images") && said.contains("decoded: 20 images"), "{said}");
}

/// As WebDataset reads it: what stands before the first dot is the key of a sample, whose files lie together.
#[test]
fn other_software_finds_samples() {
    let scratch = scratch();
    synth(scratch.path(), "packed", &TWO_SCENES);
    let file = fs::File::open(scratch.path().join("packed/images-000000.tar")).unwrap();
    let mut archive = tar::Archive::new(file);
    let names = archive.entries().unwrap().map(|entry| entry.unwrap().path().unwrap().into_owned());
    let names: Vec<String> = names.map(|name| name.to_str().unwrap().to_owned()).collect();
    let of =
        |id: &str| ["gt.npy", "r-03.npy", "r+00.npy", "r+03.npy", "json"].map(|end| format!("{id}.{end}"));
    assert_eq!(names, [of("hall_01"), of("hall_02")].concat());
    let told = io::read_bytes(&scratch.path().join("packed/images-000000.tar/hall_02.json")).unwrap();
    let told: serde_json::Value = serde_json::from_slice(&told).unwrap();
    assert_eq!(told["id"], "hall_02");
    assert_eq!(told["kernels"][2]["angle_deg"], 3.0);
    assert_eq!(told["kernels"][1]["code"].as_array().unwrap().len(), 2);
}

/// A damaged archive, one that a killed run did not come to list, and a new beginning.
#[test]
fn what_is_lost_is_made_again() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "packed", &TWO_SCENES);
    let dataset = folder.join("packed");
    let before = images(&dataset);
    let refused =
        fail(folder, &["synth", "views", "--bank", "bank.safetensors", "-o", "packed", "--resume"], 1);
    assert!(refused.contains("archive-bytes"), "{refused}");
    let bytes = fs::read(dataset.join("images-000001.tar")).unwrap();
    fs::write(dataset.join("images-000001.tar"), &bytes[..bytes.len() / 2]).unwrap();
    fs::copy(dataset.join("images-000000.tar"), dataset.join("images-000007.tar")).unwrap();
    let refused = fail(folder, &["eval", "packed", "--method", "wiener", "-o", "results"], 1);
    assert!(refused.contains("are missing"), "{refused}");
    let said = synth(folder, "packed", &[&TWO_SCENES[..], &["--resume"]].concat());
    assert!(said.contains("6 images made, 9 were there"), "{said}");
    assert_eq!(images(&dataset), before);
    assert_eq!(archives(&dataset), ["images-000000.tar", "images-000002.tar", "images-000003.tar"]);
    synth(folder, "packed", &[&TWO_SCENES[..], &["--overwrite"]].concat());
    assert_eq!(images(&dataset), before);
    assert_eq!(archives(&dataset).len(), 3);
}

#[test]
fn resume_notices_a_scene_that_changed_where_its_ground_truth_is_clipped() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "packed", &TWO_SCENES);
    let scene = folder.join("views/park_01.npy");
    let brighter = io::read_image::<Linear>(&scene).unwrap();
    let brighter = brighter.map_values::<Linear>(|light| if light > 1000.0 { 2.0 * light } else { light });
    io::write_image(&scene, &brighter, &WriteOptions { overwrite: true, ..WriteOptions::default() }).unwrap();
    let resume = ["synth", "views", "--bank", "bank.safetensors", "-o", "packed", "--resume"];
    let said = fail(folder, &[&resume[..], &TWO_SCENES].concat(), 1);
    assert!(said.contains("images of another views/park_01.npy"), "{said}");
}

#[test]
fn shards_write_archives_of_their_own() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "whole", &TWO_SCENES);
    for shard in ["2/2", "1/2"] {
        synth(folder, "parts", &[&TWO_SCENES[..], &["--shard", shard]].concat());
    }
    assert_eq!(images(&folder.join("parts")), images(&folder.join("whole")));
    let of = |part: &str| archives(&folder.join("parts")).iter().filter(|name| name.contains(part)).count();
    assert!(of("00001-of-00002") >= 1 && of("00002-of-00002") >= 1);
}
