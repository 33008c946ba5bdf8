//! The command line: synth.

#![expect(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use std::fs;
use std::path::{Path, PathBuf};

use ndarray::Array3;
use udc::core::capture::CaptureInfo;
use udc::core::image::{Linear, LinearImage};
use udc::core::primaries::Primaries;
use udc::core::psf::Psf;
use udc::dataset::{Dataset, NoiseConfig, Split};
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};

/// A scratch folder with five scenes of two panoramas in `views/`, a PSF and a bank of three kernels.
pub(super) fn scratch() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("views")).unwrap();
    for (index, name) in ["park_01", "park_02", "park_03", "hall_01", "hall_02"].iter().enumerate() {
        let planes = Array3::from_shape_fn((3, 20, 24), |(c, y, x)| {
            let lamp = if (y, x) == (5 + index, 7) { 2000.0 } else { 0.0 };
            lamp + 0.1 * (c + 1) as f32 + 0.01 * ((y * 24 + x * (index + 3)) % 17) as f32
        });
        let image = LinearImage::from_planes(planes).unwrap();
        let path = folder.path().join(format!("views/{name}.npy"));
        io::write_image(&path, &image, &WriteOptions::default()).unwrap();
    }
    let energy = Array3::from_shape_fn((3, 16, 16), |(c, y, x)| {
        let (dy, dx) = (y as f32 - 8.0, x as f32 - 8.0);
        (-(dy * dy + (2.0 + c as f32) * dx * dx) / 6.0).exp() + 1e-3
    });
    let psf = Psf::from_energy(energy).unwrap();
    io::write_psf(&folder.path().join("psf.npy"), &psf, &WriteOptions::default()).unwrap();
    succeed(folder.path(), &["codes", "psf.npy", "--angles=-3,0,3", "--dim", "2", "-o", "bank.safetensors"]);
    folder
}

pub(super) fn synth(folder: &Path, output: &str, more: &[&str]) -> String {
    let mut args = vec!["synth", "views", "--bank", "bank.safetensors", "-o", output];
    args.extend(more);
    succeed(folder, &args)
}

#[test]
fn images_are_of_the_primaries_of_their_scenes_which_are_the_same_in_all() {
    let folder = scratch();
    let views = folder.path().join("views");
    let write = |name: &str, primaries: Option<Primaries>| {
        let image = io::read_image::<Linear>(&views.join(name).with_extension("npy")).unwrap();
        fs::remove_file(views.join(name).with_extension("npy")).unwrap();
        let capture = primaries.map(CaptureInfo::of_primaries);
        let options = WriteOptions { capture, ..WriteOptions::default() };
        io::write_image(&views.join(name), &image, &options).unwrap();
    };
    for name in ["park_01.exr", "park_02.exr", "park_03.exr", "hall_01.exr"] {
        write(name, Some(Primaries::BT2020));
    }
    let args = ["synth", "views", "--bank", "bank.safetensors", "-o", "wide"];
    let message = fail(folder.path(), &args, 1);
    assert!(
        message.contains("hall_01.exr is of BT.2020") && message.contains("hall_02.npy of sRGB"),
        "{message}"
    );
    write("hall_02.exr", Some(Primaries::BT2020));
    synth(folder.path(), "wide", &[]);
    let images = files_below(&folder.path().join("wide"));
    let images: Vec<_> = images.iter().filter(|path| path.extension().is_some_and(|e| e == "exr")).collect();
    assert_eq!(images.len(), 20);
    for path in images {
        let found = io::read_primaries(path).unwrap().unwrap();
        assert!(found.is_near(&Primaries::BT2020), "{}", path.display());
    }
    let dataset = Dataset::open(&folder.path().join("wide")).unwrap();
    assert!(dataset.scene_primaries().unwrap().is_near(&Primaries::BT2020));
    synth(folder.path(), "wide", &["--resume"]);
    let said = udc(folder.path(), &["synth", "views", "--psf", "psf.npy", "--format", "npy", "-o", "npy"]);
    let said = String::from_utf8_lossy(&said.stderr).into_owned();
    assert!(said.contains("hall_01.npy cannot carry what is known of the capture"), "{said}");
}

fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { files.extend(files_below(&path)) } else { files.push(path) }
    }
    files.sort();
    files
}

/// Names below `folder` and contents of all files.
pub(super) fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let read = |path: PathBuf| (path.strip_prefix(folder).unwrap().to_owned(), fs::read(&path).unwrap());
    files_below(folder).into_iter().map(read).collect()
}

#[test]
fn writes_a_dataset_that_opens_and_keeps_panoramas_together() {
    let folder = scratch();
    let said = synth(folder.path(), "dataset", &[]);
    assert!(said.contains("5 scenes of 20 × 24 through 3 kernels: 15 images"), "{said}");
    let dataset = Dataset::open(&folder.path().join("dataset")).unwrap();
    assert_eq!(dataset.triplets.len(), 15);
    assert_eq!(dataset.kernel_names(), ["r-03", "r+00", "r+03"]);
    let test = dataset.split(Split::Test).unwrap();
    let train = dataset.split(Split::Train).unwrap();
    assert!(
        test.iter().all(|t| t.source == test[0].source) && train.iter().all(|t| t.source == train[0].source)
    );
    assert_ne!(test[0].source, train[0].source);
    let triplet = test[0];
    assert_eq!(dataset.code(triplet).unwrap().len(), 2);
    let (truth, degraded) =
        (dataset.read_ground_truth(triplet).unwrap(), dataset.read_degraded(triplet).unwrap());
    assert!(
        (truth.max() - 500.0).abs() < 1e-3 && degraded.max() < 500.0,
        "{} {}",
        truth.max(),
        degraded.max()
    );
}

#[test]
fn images_that_a_new_beginning_leaves_behind_are_told_of() {
    let folder = scratch();
    synth(folder.path(), "dataset", &[]);
    fs::remove_file(folder.path().join("views/hall_02.npy")).unwrap();
    let again = ["synth", "views", "--bank", "bank.safetensors", "-o", "dataset", "--overwrite"];
    let told =
        |more: &[&str]| String::from_utf8(udc(folder.path(), &[&again[..], more].concat()).stderr).unwrap();
    let said = told(&[]);
    assert!(said.contains("keeps 4 images that its list named") && said.contains("/hall_02.exr"), "{said}");
    assert!(!told(&[]).contains("keeps"), "no list names them any more");
    assert!(folder.path().join("dataset/gt/hall_02.exr").is_file());
    assert!(told(&["--tar", "1MB"]).contains("keeps 16 images"));
}

#[test]
fn one_and_two_threads_write_the_same_bytes() {
    let folder = scratch();
    let flags = ["--noise", "sensor", "--border", "reflect", "--seed", "7"];
    synth(folder.path(), "one", &[&flags[..], &["--threads", "1"]].concat());
    synth(folder.path(), "two", &[&flags[..], &["--threads", "2"]].concat());
    let (one, two) = (contents(&folder.path().join("one")), contents(&folder.path().join("two")));
    assert!(one.len() > 15, "{} files", one.len());
    assert!(one == two, "different bytes");
}

/// Moves the scenes of the hall to a folder of their own.
fn divide_views(folder: &Path) {
    fs::create_dir(folder.join("halls")).unwrap();
    for name in ["hall_01.npy", "hall_02.npy"] {
        fs::rename(folder.join("views").join(name), folder.join("halls").join(name)).unwrap();
    }
}

const HALLS: [&str; 7] = ["synth", "halls", "--bank", "bank.safetensors", "-o", "dataset", "--split"];

#[test]
fn a_dataset_gets_the_split_that_it_lacks() {
    let folder = scratch();
    divide_views(folder.path());
    synth(folder.path(), "dataset", &["--split", "train"]);
    let root = folder.path().join("dataset");
    let images = || contents(&root.join("degraded"));
    let list = || fs::read(root.join("triplets.jsonl")).unwrap();
    let (trained, listed) = (images(), list());
    let halls = [&HALLS[..], &["test"]].concat();
    assert!(succeed(folder.path(), &halls).contains("6 images made"));
    let dataset = Dataset::open(&root).unwrap();
    let count = |split| dataset.split(split).unwrap().len();
    assert_eq!((count(Split::Train), count(Split::Test)), (9, 6));
    assert_eq!(dataset.config.as_ref().unwrap().division, "all train, test");
    assert!(trained.iter().all(|file| images().contains(file)) && listed == list());
    assert!(fail(folder.path(), &halls, 1).contains("--resume"));
    // Either run can be taken up again, and neither touches what the other has made.
    let path = root.join("triplets-test.jsonl");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, text.lines().take(4).collect::<Vec<_>>().join("\n")).unwrap();
    assert!(
        succeed(folder.path(), &[&halls[..], &["--resume"]].concat()).contains("2 images made, 4 were there")
    );
    assert!(synth(folder.path(), "dataset", &["--split", "train", "--resume"]).contains("9 were there"));
    assert_eq!(Dataset::open(&root).unwrap().triplets, dataset.triplets);
    fs::rename(folder.path().join("halls/hall_01.npy"), folder.path().join("halls/lobby_01.npy")).unwrap();
    fs::remove_file(folder.path().join("halls/hall_02.npy")).unwrap();
    for shard in ["1/2", "2/2"] {
        let val = [&HALLS[..], &["val", "--shard", shard]].concat();
        if shard == "1/2" {
            succeed(folder.path(), &val);
        } else {
            assert!(fail(folder.path(), &val, 1).contains("fewer shards"));
        }
    }
    assert_eq!(Dataset::open(&root).unwrap().split(Split::Val).unwrap().len(), 3);
}

#[test]
fn an_added_split_shares_neither_flags_nor_scenes_with_the_others() {
    let folder = scratch();
    divide_views(folder.path());
    synth(folder.path(), "dataset", &["--split", "train"]);
    let before = contents(&folder.path().join("dataset"));
    let refused = |more: &[&str]| fail(folder.path(), &[&HALLS[..], more].concat(), 1);
    assert!(refused(&["test", "--x-max", "400"]).contains("another formation.x-max"));
    assert!(refused(&["test", "--half"]).contains("another half"));
    assert!(refused(&["train"]).contains("--resume"));
    let (views, halls) = (folder.path().join("views"), folder.path().join("halls"));
    fs::copy(views.join("park_01.npy"), halls.join("park_01.npy")).unwrap();
    let said = refused(&["test"]);
    assert!(said.contains("scene park_01 in its train split"), "{said}");
    fs::rename(halls.join("park_01.npy"), halls.join("park_09.npy")).unwrap();
    let said = refused(&["test"]);
    assert!(said.contains("scenes of park in its train split") && said.contains("park_09"), "{said}");
    assert!(before == contents(&folder.path().join("dataset")), "the dataset was touched");
}

/// A field file with the given PSFs side by side.
pub(super) fn write_field(folder: &Path, name: &str, psfs: &[&str]) {
    let text = format!("rows = 1\ncolumns = {}\npsfs = {psfs:?}\n", psfs.len());
    fs::write(folder.join(name), text).unwrap();
}

/// The stored image is C of the scene convolved with the field, whatever the memory; equal PSFs are one kernel.
#[test]
fn the_psf_may_change_over_the_frame() {
    let folder = scratch();
    let psf = io::read_psf(&folder.path().join("psf.npy")).unwrap();
    let turned = udc::codes::rotate(&psf, 40.0).unwrap();
    io::write_psf(&folder.path().join("turned.npy"), &turned, &WriteOptions::default()).unwrap();
    write_field(folder.path(), "field.toml", &["psf.npy", "turned.npy"]);
    write_field(folder.path(), "same.toml", &["psf.npy", "psf.npy"]);
    let said = synth(folder.path(), "dataset", &["--field", "field.toml", "--border", "replicate"]);
    assert!(said.contains("through 1 kernels: 5 images"), "{said}");
    let root = folder.path().join("dataset");
    let dataset = Dataset::open(&root).unwrap();
    let field = io::read_psf_field(&root.join("field.toml")).unwrap();
    assert_eq!(field.psfs(), [psf.clone(), turned]);
    let triplet = &dataset.triplets[0];
    assert_eq!(dataset.code(triplet).unwrap().len(), 2);
    let scene = io::read_image::<Linear>(&folder.path().join(format!("views/{}.npy", triplet.id))).unwrap();
    let light = udc::synth::convolve_field(&scene, &field, udc::core::fft::Boundary::Replicate).unwrap();
    let formation = udc::synth::Formation::new(dataset.formation.clone(), 0).unwrap();
    let near = |a: &LinearImage, b: &LinearImage| {
        a.as_slice().iter().zip(b.as_slice()).all(|(a, b)| (a - b).abs() <= 1e-5 * b.abs().max(1.0))
    };
    assert!(near(&dataset.read_degraded(triplet).unwrap(), &formation.record(light, "").unwrap()));

    synth(
        folder.path(),
        "poor",
        &["--field", "field.toml", "--border", "replicate", "--max-memory", "200kB"],
    );
    assert!(contents(&folder.path().join("poor")) == contents(&root), "different bytes");
    let views = ["synth", "views", "-o"];
    succeed(folder.path(), &[&views[..], &["same", "--field", "same.toml"]].concat());
    succeed(folder.path(), &[&views[..], &["single", "--psf", "psf.npy"]].concat());
    let [same, single] = ["same", "single"].map(|name| Dataset::open(&folder.path().join(name)).unwrap());
    for (a, b) in same.triplets.iter().zip(&single.triplets) {
        assert!(near(&same.read_degraded(a).unwrap(), &single.read_degraded(b).unwrap()), "{}", a.id);
    }
}

#[test]
fn a_dataset_of_a_field_is_not_taken_for_one_of_a_kernel() {
    let folder = scratch();
    write_field(folder.path(), "field.toml", &["psf.npy"]);
    write_field(folder.path(), "short.toml", &["psf.npy"; 0]);
    let text = "rows = 4294967296\ncolumns = 4294967296\npsfs = []\n";
    fs::write(folder.path().join("vast.toml"), text).unwrap();
    synth(folder.path(), "dataset", &["--field", "field.toml"]);
    let base = ["synth", "views", "--bank", "bank.safetensors", "-o", "dataset", "--resume"];
    assert!(fail(folder.path(), &base, 1).contains("another bank-sha256, field-sha256"));
    synth(folder.path(), "dataset", &["--field", "field.toml", "--resume"]);
    let said = fail(
        folder.path(),
        &["eval", "dataset", "--method", "wiener", "--metrics", "psnr", "-o", "results", "--ldr"],
        1,
    );
    assert!(said.contains("changes over the frame"), "{said}");
    succeed(folder.path(), &["eval", "dataset", "--method", "wiener", "--metrics", "psnr", "-o", "results"]);
    let refused = |file: &str| fail(folder.path(), &["synth", "views", "--field", file, "-o", "other"], 1);
    assert!(refused("short.toml").contains("at least 1 × 1 places"));
    assert!(refused("vast.toml").contains("as many places as it names PSFs"));
    assert!(refused("missing.toml").contains("missing.toml"));
    assert!(!folder.path().join("other").exists());
}

#[test]
fn a_single_psf_makes_a_dataset_without_codes() {
    let folder = scratch();
    succeed(
        folder.path(),
        &[
            "synth", "views", "--psf", "psf.npy", "-o", "dataset", "--split", "test", "--preset", "released",
            "--format", "npy", "--half",
        ],
    );
    let dataset = Dataset::open(&folder.path().join("dataset")).unwrap();
    assert_eq!((dataset.kernel_names().len(), dataset.code_dim()), (1, 0));
    let test = dataset.split(Split::Test).unwrap();
    assert_eq!(test.len(), 5);
    assert!(dataset.formation.clip_ground_truth);
    let message = dataset.code(test[0]).unwrap_err().to_string();
    assert!(message.contains("have no codes"), "{message}");
    let message = dataset.split(Split::Train).unwrap_err().to_string();
    assert!(message.contains("no train split (only test)"), "{message}");
}

/// The stored image is C(x∗k): recomputed here for the first scene and the unrotated kernel.
#[test]
fn stores_what_the_formation_model_says() {
    let folder = scratch();
    synth(folder.path(), "dataset", &[]);
    let scene = io::read_image::<Linear>(&folder.path().join("views/park_01.npy")).unwrap();
    let psf = io::read_psf(&folder.path().join("psf.npy")).unwrap();
    let dataset = Dataset::open(&folder.path().join("dataset")).unwrap();
    let formation = udc::synth::Formation::new(dataset.formation.clone(), 0).unwrap();
    let expected = formation.degrade(&scene, &psf, "").unwrap();
    let found = io::read_image::<Linear>(&folder.path().join("dataset/degraded/r+00/park_01.exr")).unwrap();
    for (found, expected) in found.as_slice().iter().zip(expected.as_slice()) {
        assert!((found - expected).abs() <= 1e-6 * expected.abs().max(1.0), "{found} {expected}");
    }
}

#[test]
fn says_what_is_wrong_with_its_flags() {
    let folder = scratch();
    let base = ["synth", "views", "-o", "out"];
    let with = |more: &[&str]| fail(folder.path(), &[&base[..], more].concat(), 2);
    assert!(with(&[]).contains("--bank"));
    let bank = ["--bank", "bank.safetensors"];
    let with = |more: &[&str], code| fail(folder.path(), &[&base[..], &bank, more].concat(), code);
    assert!(with(&["--noise", "gausian:1"], 2).contains("gaussian:SIGMA"));
    assert!(with(&["--noise", "gaussian:-1"], 2).contains("0 or more"));
    assert!(with(&["--noise", "sensor:missing.toml"], 2).contains("missing.toml"));
    assert!(with(&["--noise", "sensor:"], 2).contains("sensor:FILE.toml, or sensor"));
    fs::write(folder.path().join("sensor.toml"), "full-wel-e = 3.0\n").unwrap();
    assert!(with(&["--noise", "sensor:sensor.toml"], 2).contains("full-wel-e"));
    assert!(with(&["--shard", "3/2"], 2).contains("I/N"));
    assert!(with(&["--border", "wrap"], 2).contains("replicate"));
    assert!(with(&["--seed", "9223372036854775808"], 2).contains("9223372036854775807"));
    assert!(with(&["--x-max", "-5"], 2).contains("-5") || with(&["--x-max=-5"], 1).contains("x-max"));
    assert!(with(&["--test-fraction", "1.5"], 1).contains("test-fraction"));
    assert!(with(&["--max-memory", "100kB"], 1).contains("MiB at least"));
    let psf = fail(folder.path(), &["synth", "views", "--bank", "psf.npy", "-o", "out"], 1);
    assert!(psf.contains("psf.npy"), "{psf}");
    assert!(!folder.path().join("out").exists(), "partial output");
}

#[test]
fn the_largest_seed_makes_a_dataset_that_opens() {
    let folder = scratch();
    synth(folder.path(), "dataset", &["--seed", "9223372036854775807"]);
    Dataset::open(&folder.path().join("dataset")).unwrap();
}

#[test]
fn refuses_a_folder_that_holds_something_else() {
    let folder = scratch();
    let message = fail(folder.path(), &["synth", "views", "--bank", "bank.safetensors", "-o", "views"], 1);
    assert!(message.contains("holds no dataset"), "{message}");
    assert_eq!(files_below(&folder.path().join("views")).len(), 5);
}

/// The small scene comes first, and fits.
#[test]
fn memory_and_disk_are_those_of_the_largest_scene() {
    let folder = scratch();
    let image = LinearImage::from_planes(Array3::ones((3, 300, 200))).unwrap();
    io::write_image(&folder.path().join("views/park_04.npy"), &image, &WriteOptions::default()).unwrap();
    let args = ["synth", "views", "--bank", "bank.safetensors", "-o", "dataset", "--max-memory", "1MiB"];
    let said = fail(folder.path(), &args, 1);
    assert!(said.contains("scenes of 300 × 200 need"), "{said}");
    assert!(!folder.path().join("dataset").exists(), "partial output");
    let said = synth(folder.path(), "dataset", &[]);
    assert!(said.contains("6 scenes of up to 300 × 200 through 3 kernels: 18 images"), "{said}");
}

#[test]
fn less_memory_gives_the_same_images() {
    let folder = scratch();
    synth(folder.path(), "rich", &[]);
    synth(folder.path(), "poor", &["--max-memory", "150kB"]);
    let images = |name: &str| contents(&folder.path().join(name).join("degraded"));
    assert!(images("rich") == images("poor"), "different bytes");
}

#[test]
fn the_shipped_sensor_file_is_read() {
    let folder = scratch();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/sensor/phone-10bit.toml");
    synth(folder.path(), "dataset", &["--noise", &format!("sensor:{}", file.display())]);
    let dataset = Dataset::open(&folder.path().join("dataset")).unwrap();
    assert!(matches!(dataset.formation.noise, NoiseConfig::Sensor(_)));
}

#[test]
fn a_dataset_does_not_name_a_bank_outside_of_its_folder() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "dataset", &[]);
    fs::copy(folder.join("dataset/kernels.safetensors"), folder.join("elsewhere.safetensors")).unwrap();
    let config = folder.join("dataset/dataset.toml");
    let text = fs::read_to_string(&config).unwrap();
    let absolute = folder.join("elsewhere.safetensors").to_string_lossy().replace('\\', "/");
    for bank in ["../elsewhere.safetensors", absolute.as_str()] {
        fs::write(&config, text.replace("\"kernels.safetensors\"", &format!("\"{bank}\""))).unwrap();
        let said = fail(folder, &["info", "dataset"], 1);
        assert!(
            said.contains(&format!("`{bank}` as bank")) && said.contains("stay in the dataset"),
            "{said}"
        );
    }
    fs::write(&config, text).unwrap();
    succeed(folder, &["info", "dataset"]);
}

#[test]
fn an_evaluation_records_the_curve_the_margin_and_the_kernels_of_each_dataset() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "day", &["--split", "test", "--x-max", "16", "--margin", "2"]);
    synth(folder, "night", &["--split", "test"]);
    let definition = |output: &str, args: &[&str]| {
        succeed(folder, &[&["eval"][..], args, &["-o", output]].concat());
        let text = fs::read_to_string(folder.join(output).join("metrics.json")).unwrap();
        serde_json::from_str::<serde_json::Value>(&text).unwrap()["definition"]["datasets"].clone()
    };
    let both = definition("both", &["day", "night", "--kernels", "r+00,r+03", "--limit", "2"]);
    let expected = |dataset: &str, x_max: f64, margin: usize| {
        serde_json::json!({
            "dataset": dataset, "alpha": 0.25, "x-max": x_max, "margin": margin, "split": "test",
            "kernels": ["r+00", "r+03"], "limit": 2,
        })
    };
    assert_eq!(both, serde_json::json!([expected("day", 16.0, 2), expected("night", 500.0, 0)]));
    let table = fs::read_to_string(folder.join("both/table.md")).unwrap();
    let words = "x / (x + 0.25) of x up to 16 for day; x / (x + 0.25) of x up to 500 for night";
    assert!(table.contains(words), "{table}");
    let warned = |args: &[&str]| {
        let output = udc(folder, args);
        assert!(output.status.success(), "{args:?}");
        String::from_utf8_lossy(&output.stderr).contains("cannot be compared")
    };
    assert!(warned(&["eval", "day", "night", "--limit", "1", "-o", "again"]));
    let one = definition("one", &["night", "--limit", "1"]);
    let table = fs::read_to_string(folder.join("one/table.md")).unwrap();
    assert!(table.contains("mapped by x / (x + 0.25) of x up to 500."), "{table}");
    succeed(folder, &["eval", "night", "--limit", "1", "--definition", "float", "-o", "float"]);
    assert!(!warned(&["eval", "night", "--limit", "1", "-o", "two"]));
    assert!(!warned(&["report", "one", "two", "-o", "alike.html"]));
    assert!(warned(&["report", "one", "float", "-o", "bits.html"]));
    assert!(warned(&["report", "one", "both", "-o", "curves.html"]));
    assert_eq!((&one[0]["kernels"], &one[0]["dataset"]), (&"all".into(), &serde_json::Value::Null));
}
