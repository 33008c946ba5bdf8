//! Going on with what was begun: nobody else does the same part, and a capture is known by its contents.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use udc::core::image::LinearImage;
use udc::core::psf::Psf;
use udc::dataset::Dataset;
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed};

fn write_image(path: &Path, side: usize, phase: f32) {
    let planes = Array3::from_shape_fn((3, side, side), |(c, y, x)| {
        0.5 + 0.3 * (phase + y as f32 * 0.31 + c as f32).sin() * (x as f32 * 0.17).cos()
    });
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    io::write_image(path, &LinearImage::from_planes(planes).unwrap(), &options).unwrap();
}

/// A folder with a PSF, and `count` images of `side` pixels in `images/`.
fn scratch(count: usize, side: usize) -> tempfile::TempDir {
    let scratch = tempfile::tempdir().unwrap();
    fs::create_dir(scratch.path().join("images")).unwrap();
    for index in 0..count {
        write_image(&scratch.path().join(format!("images/view{index}_01.exr")), side, index as f32);
    }
    let energy = Array3::from_shape_fn((3, 15, 15), |(_, y, x)| {
        (-((y as f32 - 7.0).powi(2) + (x as f32 - 7.0).powi(2)) / 3.0).exp() + 0.002
    });
    io::write_psf(
        &scratch.path().join("psf.exr"),
        &Psf::from_energy(energy).unwrap(),
        &WriteOptions::default(),
    )
    .unwrap();
    scratch
}

const SYNTH: [&str; 9] =
    ["synth", "images", "--psf", "psf.exr", "--split", "train", "-o", "dataset", "--resume"];

/// A process holds the list of the first part, as a run does; the test's own lets it go.
#[test]
#[cfg(unix)]
fn a_part_of_a_dataset_is_made_by_one_process() {
    let scratch = scratch(4, 24);
    let folder = scratch.path();
    let part = |shard: &'static str, more: &[&'static str]| [&SYNTH[..], &["--shard", shard], more].concat();
    succeed(folder, &part("1/2", &[]));
    let list = folder.join("dataset/triplets-00001-of-00002.jsonl");
    let before = fs::read_to_string(&list).unwrap();
    let held = io::LineLog::open(&list).unwrap();
    held.try_lock().unwrap();
    let said = fail(folder, &part("1/2", &[]), 1);
    assert!(said.contains("another run at work") && said.contains("triplets-00001-of-00002.jsonl"), "{said}");
    // Nor is it taken away by one that begins anew, or that makes another dataset of another part.
    fail(folder, &[&part("1/2", &["--overwrite"])[..]].concat(), 1);
    let others =
        ["synth", "images", "--psf", "psf.exr", "--split", "train", "-o", "dataset", "--shard", "2/2"];
    let said = fail(folder, &[&others[..], &["--x-max", "400", "--overwrite"]].concat(), 1);
    assert!(said.contains("another run at work"), "{said}");
    assert_eq!(fs::read_to_string(&list).unwrap(), before);
    // Other parts do not mind.
    assert!(succeed(folder, &part("2/2", &[])).contains("2 images made"));
    drop(held);
    assert!(succeed(folder, &part("1/2", &[])).contains("2 were there"));
    assert_eq!(Dataset::open(&folder.join("dataset")).unwrap().triplets.len(), 4);
}

/// The first process is stopped in the middle of its work, with a list that was begun anew.
#[test]
#[cfg(unix)]
fn two_runs_of_one_part_do_not_lose_lines() {
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};

    let scratch = scratch(12, 320);
    let folder = scratch.path();
    let run = Command::new(env!("CARGO_BIN_EXE_udc"))
        .args([&SYNTH[..], &["--threads", "1"]].concat())
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let signal = |name: &str| {
        let sent = Command::new("kill").args([name, &run.id().to_string()]).status().unwrap();
        assert!(sent.success(), "{name}");
    };
    let list = folder.join("dataset/triplets.jsonl");
    let deadline = Instant::now() + Duration::from_secs(60);
    while fs::read_to_string(&list).unwrap_or_default().lines().count() < 2 {
        assert!(Instant::now() < deadline, "the run lists nothing");
        std::thread::sleep(Duration::from_millis(2));
    }
    signal("-STOP");
    let listed = fs::read_to_string(&list).unwrap().lines().count();
    assert!(listed < 12, "the run was over before it was stopped");
    let said = fail(folder, &SYNTH, 1);
    assert!(said.contains("another run at work"), "{said}");
    signal("-CONT");
    let ended = run.wait_with_output().unwrap();
    assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    assert_eq!(Dataset::open(&folder.join("dataset")).unwrap().triplets.len(), 12);
    assert!(succeed(folder, &SYNTH).contains("0 images made, 12 were there"));
}

const RESTORE: [&str; 5] = ["--method", "wiener", "--psf", "psf.exr", "-o"];

fn restore(folder: &Path, inputs: &str, more: &[&str]) -> String {
    succeed(folder, &[&["restore", inputs][..], &RESTORE, &["out/"], more].concat())
}

#[test]
fn a_capture_that_was_replaced_is_not_taken_for_restored() {
    let scratch = scratch(2, 32);
    let folder = scratch.path();
    restore(folder, "images", &[]);
    assert!(restore(folder, "images", &["--resume"]).contains("2 of 2 images are there"));
    // Another picture under the same name, of the same size and age.
    let path = folder.join("images/view1_01.exr");
    let age = path.metadata().unwrap().modified().unwrap();
    write_image(&path, 32, 0.5);
    fs::File::options().write(true).open(&path).unwrap().set_modified(age).unwrap();
    let resume = [&["restore", "images"][..], &RESTORE, &["out/", "--resume"]].concat();
    let said = fail(folder, &resume, 1);
    assert!(said.contains("view1_01.exr was made with other settings or of other files"), "{said}");
    fs::remove_file(folder.join("out/view1_01.exr")).unwrap();
    assert!(restore(folder, "images", &["--resume"]).contains("1 of 2 images are there"));
    assert!(restore(folder, "images", &["--resume"]).contains("2 of 2 images are there"));
}

#[test]
fn a_capture_is_known_by_whatever_path_it_is_named() {
    let scratch = scratch(2, 32);
    let folder = scratch.path();
    restore(folder, "images", &[]);
    let absolute = folder.join("images");
    let said = restore(folder, absolute.to_str().unwrap(), &["--resume"]);
    assert!(said.contains("2 of 2 images are there"), "{said}");
    assert!(restore(folder, "./images/../images", &["--resume"]).contains("2 of 2 images are there"));
    // A folder that was moved.
    fs::rename(&absolute, folder.join("moved")).unwrap();
    assert!(restore(folder, "moved", &["--resume"]).contains("2 of 2 images are there"));
    let provenance = io::read_provenance(&folder.join("out/view0_01.exr")).unwrap().unwrap();
    assert!(
        provenance.config["inputs"][0].as_str().unwrap().contains("images"),
        "where it lay is still told"
    );
    assert_eq!(provenance.config["inputs-sha256"][0].as_str().unwrap().len(), 64);
}

#[test]
fn a_psf_and_a_model_are_known_by_whatever_path_they_are_named() {
    use udc::network::weights::Weights;
    use udc::network::{Architecture, Condition, Initialisation, Model, Origin, Parameters};

    let scratch = scratch(1, 32);
    let folder = scratch.path();
    let architecture = Architecture { features: 1, condition: Condition::Image, ..Architecture::default() };
    let parameters = Parameters::random(&architecture, Initialisation::Released, 1);
    let model = Model::new(Weights { architecture, parameters, origin: Origin::default() });
    model.save(&folder.join("model.safetensors"), false).unwrap();
    let wiener =
        |psf: &'static str| vec!["restore", "images", "--method", "wiener", "--psf", psf, "-o", "wiener/"];
    let network = |model: &'static str| vec!["restore", "images", "--model", model, "-o", "network/"];
    for (first, again, key) in [
        (wiener("psf.exr"), wiener("./images/../psf.exr"), "psf"),
        (network("model.safetensors"), network("./model.safetensors"), "model"),
    ] {
        succeed(folder, &first);
        let said = succeed(folder, &[&again[..], &["--resume"]].concat());
        assert!(said.contains("1 of 1 images are there"), "{said}");
        let output = folder.join(first.last().unwrap()).join("view0_01.exr");
        let how = io::read_provenance(&output).unwrap().unwrap().config["how"].clone();
        assert_eq!(how[key], *first[first.len() - 3], "where it lay is still told");
    }
    // Another PSF of the same name is another.
    let energy =
        Array3::from_shape_fn((3, 15, 15), |(_, y, x)| (-((y + x) as f32 - 14.0).powi(2)).exp() + 0.002);
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    io::write_psf(&folder.join("psf.exr"), &Psf::from_energy(energy).unwrap(), &options).unwrap();
    assert!(fail(folder, &[&wiener("psf.exr")[..], &["--resume"]].concat(), 1).contains("other settings"));
}

/// Replaces a file by another image under the same name, of the same size and age.
fn replace(path: &Path, phase: f32) {
    let age = path.metadata().unwrap().modified().unwrap();
    write_image(path, 32, phase);
    fs::File::options().write(true).open(path).unwrap().set_modified(age).unwrap();
}

#[test]
fn a_picture_that_was_replaced_is_not_taken_for_finished() {
    let scratch = scratch(2, 32);
    let folder = scratch.path();
    fs::write(folder.join("ccm.txt"), "ccm: 1 0 0 0 1 0 0 0 1").unwrap();
    write_image(&folder.join("phone.exr"), 32, 0.7);
    let finish = |inputs: &'static str, more: &[&'static str]| {
        let flags = ["--ccm", "ccm.txt", "--reference", "phone.exr", "--format", "exr", "-o", "out/"];
        [&["finish", inputs][..], &flags, more].concat()
    };
    succeed(folder, &finish("images", &[]));
    assert!(succeed(folder, &finish("images", &["--resume"])).contains("2 of 2 images are there"));
    // Known by whatever path it is named.
    let said = succeed(folder, &finish("./images/../images", &["--resume"]));
    assert!(said.contains("2 of 2 images are there"), "{said}");
    fs::rename(folder.join("images"), folder.join("moved")).unwrap();
    assert!(succeed(folder, &finish("moved", &["--resume"])).contains("2 of 2 images are there"));
    let provenance = io::read_provenance(&folder.join("out/view0_01.exr")).unwrap().unwrap();
    assert!(provenance.config["input"].as_str().unwrap().contains("images"), "where it lay is still told");
    let refused = || {
        let said = fail(folder, &finish("moved", &["--resume"]), 1);
        assert!(said.contains("was made with other settings or of other files"), "{said}");
        succeed(folder, &finish("moved", &["--overwrite"]));
    };
    replace(&folder.join("moved/view1_01.exr"), 0.5);
    refused();
    replace(&folder.join("phone.exr"), 0.9);
    refused();
    fs::write(folder.join("ccm.txt"), "ccm: 1 0 0 0 1 0 0 0 2").unwrap();
    refused();
    assert!(succeed(folder, &finish("moved", &["--resume"])).contains("2 of 2 images are there"));
}

#[test]
fn a_dark_frame_that_was_replaced_is_not_taken_for_the_same() {
    let scratch = scratch(1, 32);
    let folder = scratch.path();
    let write_dark = |level: f32| {
        let planes = Array3::from_shape_fn((3, 32, 32), |(_, y, _)| level + y as f32 * 1e-5);
        let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
        io::write_image(&folder.join("dark.exr"), &LinearImage::from_planes(planes).unwrap(), &options)
            .unwrap();
    };
    write_dark(0.01);
    restore(folder, "images", &["--dark", "dark.exr"]);
    assert!(
        restore(folder, "images", &["--dark", "dark.exr", "--resume"]).contains("1 of 1 images are there")
    );
    // The same frame by another path is the same.
    let said = restore(folder, "images", &["--dark", "./images/../dark.exr", "--resume"]);
    assert!(said.contains("1 of 1 images are there"), "{said}");
    let provenance = io::read_provenance(&folder.join("out/view0_01.exr")).unwrap().unwrap();
    assert_eq!(provenance.config["dark-files"][0], "dark.exr");
    assert_eq!(provenance.config["dark-sha256"][0].as_str().unwrap().len(), 64);
    write_dark(0.02);
    let resume = [&["restore", "images"][..], &RESTORE, &["out/", "--resume", "--dark", "dark.exr"]].concat();
    let said = fail(folder, &resume, 1);
    assert!(said.contains("was made with other settings or of other files"), "{said}");
    let said = fail(folder, &resume[..resume.len() - 2], 1);
    assert!(said.contains("was made with other settings"), "without dark frames it is another image: {said}");
}

/// Light of which nothing says where it clips: by joint that is looked for, unless it is told.
#[test]
fn an_image_whose_levels_were_looked_for_is_not_taken_for_one_whose_levels_are_told() {
    let scratch = scratch(1, 32);
    let folder = scratch.path();
    let joint = |more: &[&'static str]| {
        [&["restore", "images", "--method", "joint", "--psf", "psf.exr", "-o", "out/"], more].concat()
    };
    succeed(folder, &joint(&[]));
    assert!(succeed(folder, &joint(&["--resume"])).contains("1 of 1 images are there"));
    assert!(fail(folder, &joint(&["--resume", "--x-max", "500"]), 1).contains("other settings"));
    assert!(fail(folder, &joint(&["--resume", "--alpha", "0.25"]), 1).contains("other settings"));
}

#[test]
fn a_picture_with_a_colour_matrix_is_not_taken_for_one_without() {
    let scratch = scratch(1, 32);
    let finish =
        |more: &[&'static str]| [&["finish", "images", "--format", "exr", "-o", "out/"], more].concat();
    succeed(scratch.path(), &finish(&[]));
    assert!(fail(scratch.path(), &finish(&["--resume", "--no-ccm"]), 1).contains("other settings"));
    assert!(succeed(scratch.path(), &finish(&["--resume"])).contains("1 of 1 images are there"));
}
