//! Light from outside of the frame: scenes with a margin, from `udc crop` to training.

use std::fs;
use std::path::Path;

use ndarray::{Array3, s};
use udc::core::image::{Linear, LinearImage};
use udc::core::provenance::Provenance;
use udc::core::psf::Psf;
use udc::dataset::Dataset;
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};

const MARGIN: usize = 8;
const FRAME: [usize; 2] = [20, 26];

fn write_psf(path: &Path) -> Psf {
    let energy = Array3::from_shape_fn((3, 17, 17), |(c, y, x)| {
        let (dy, dx) = (y as f32 - 8.0, x as f32 - 8.0);
        (-(dy * dy + dx * dx) / 4.0).exp() + 0.01 / (1.0 + dy.abs() + (1.0 + c as f32) * dx.abs())
    });
    let psf = Psf::from_energy(energy).unwrap();
    io::write_psf(path, &psf, &WriteOptions::default()).unwrap();
    psf
}

/// Dark scenes with a lamp in the margin, 3 rows above the frame, over one of its columns.
fn lamp_in_the_margin(column: usize) -> LinearImage {
    let [height, width] = FRAME.map(|side| side + 2 * MARGIN);
    let mut planes = Array3::zeros((3, height, width));
    planes.slice_mut(s![.., MARGIN - 3, MARGIN + column]).fill(1000.0);
    LinearImage::from_planes(planes).unwrap()
}

/// A scratch folder with a PSF and two scenes in `scenes/`, which say their margin if `margin` is one.
fn scratch(margin: Option<usize>) -> (tempfile::TempDir, Psf) {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("scenes")).unwrap();
    let psf = write_psf(&folder.path().join("psf.exr"));
    for (column, name) in [(5, "park_01"), (20, "hall_01")] {
        write_scene(folder.path(), name, column, margin);
    }
    (folder, psf)
}

fn write_scene(folder: &Path, name: &str, column: usize, margin: Option<usize>) {
    let provenance = margin.map(|margin| Provenance::new("crop", &serde_json::json!({ "margin": margin })));
    let options = WriteOptions { provenance, overwrite: true, ..WriteOptions::default() };
    io::write_image(&folder.join(format!("scenes/{name}.exr")), &lamp_in_the_margin(column), &options)
        .unwrap();
}

const SYNTH: [&str; 5] = ["synth", "scenes", "--psf", "psf.exr", "-o"];

#[test]
fn a_lamp_outside_of_the_frame_throws_flare_into_the_picture() {
    let (scratch, psf) = scratch(None);
    let folder = scratch.path();
    let said = succeed(folder, &[&SYNTH[..], &["dataset", "--margin", "8"]].concat());
    assert!(said.contains("2 scenes of 20 × 26 with a margin of 8 through 1 kernels"), "{said}");
    let dataset = Dataset::open(&folder.join("dataset")).unwrap();
    assert_eq!(dataset.formation.margin, MARGIN);
    for triplet in &dataset.triplets {
        let column: usize = if triplet.id == "park_01" { 5 } else { 20 };
        let (truth, seen) =
            (dataset.read_ground_truth(triplet).unwrap(), dataset.read_degraded(triplet).unwrap());
        assert_eq!([truth.height(), truth.width()], FRAME);
        assert_eq!([seen.height(), seen.width()], FRAME);
        assert_eq!(truth.max(), 0.0);
        for ((c, y, x), &found) in seen.planes().indexed_iter() {
            let (row, column) = (Some(8 + 3 + y), (8 + x).checked_sub(column));
            let tail = row.zip(column).and_then(|(row, column)| psf.planes().get([c, row, column]).copied());
            // A transform in 64 bits, rounded to 32.
            let expected = 1000.0 * tail.unwrap_or(0.0);
            assert!(
                (found - expected).abs() <= 1e-6 * expected + 1e-6,
                "{c} {y} {x}: {found}, not {expected}"
            );
        }
    }
    // Without the margin these are scenes with a lamp in the picture.
    succeed(folder, &[&SYNTH[..], &["whole"]].concat());
    let whole = Dataset::open(&folder.join("whole")).unwrap();
    assert_eq!(whole.read_ground_truth(&whole.triplets[0]).unwrap().max(), 500.0);
}

#[test]
fn a_dataset_goes_on_with_the_margin_that_it_was_begun_with() {
    let (scratch, _) = scratch(None);
    let folder = scratch.path();
    let synth = |output: &str, more: &[&str]| succeed(folder, &[&SYNTH[..], &[output], more].concat());
    synth("dataset", &["--margin", "8"]);
    let lost = Dataset::open(&folder.join("dataset")).unwrap().triplets[0].degraded.clone();
    fs::remove_file(folder.join("dataset").join(lost)).unwrap();
    for other in [&[][..], &["--margin", "7"]] {
        let said = fail(folder, &[&SYNTH[..], &["dataset", "--resume"], other].concat(), 1);
        assert!(said.contains("another formation.margin"), "{said}");
    }
    assert!(synth("dataset", &["--margin", "8", "--resume"]).contains("1 images made, 1 were there"));
    for shard in ["2/2", "1/2"] {
        synth("parts", &["--margin", "8", "--shard", shard]);
    }
    let [whole, parts] = ["dataset", "parts"].map(|name| Dataset::open(&folder.join(name)).unwrap());
    assert_eq!(whole.triplets, parts.triplets);
    // Equal PSFs all over the frame are one PSF: the two ways differ by roundings of sums.
    fs::write(folder.join("field.toml"), "rows = 1\ncolumns = 2\npsfs = [\"psf.exr\", \"psf.exr\"]\n")
        .unwrap();
    let field = ["synth", "scenes", "--field", "field.toml", "--margin", "8", "-o", "field"];
    succeed(folder, &field);
    let field = Dataset::open(&folder.join("field")).unwrap();
    for (a, b) in whole.triplets.iter().zip(&field.triplets) {
        let (a, b) = (whole.read_degraded(a).unwrap(), field.read_degraded(b).unwrap());
        assert!(a.as_slice().iter().zip(b.as_slice()).all(|(a, b)| (a - b).abs() < 1e-4));
    }
    let said = fail(folder, &[&SYNTH[..], &["none", "--margin", "18"]].concat(), 1);
    assert!(said.contains("more than twice the margin of 18") && !folder.join("none").exists(), "{said}");
}

#[test]
fn views_say_their_margin_and_synth_takes_no_other() {
    let (scratch, _) = scratch(Some(MARGIN));
    let folder = scratch.path();
    let said = succeed(folder, &[&SYNTH[..], &["dataset"]].concat());
    assert!(said.contains("with a margin of 8"), "{said}");
    succeed(folder, &[&SYNTH[..], &["asked", "--margin", "8"]].concat());
    for other in ["0", "4"] {
        let said = fail(folder, &[&SYNTH[..], &["other", "--margin", other]].concat(), 1);
        assert!(said.contains("was cut with a margin of 8 pixels"), "{said}");
    }
    write_scene(folder, "hall_01", 20, Some(4));
    let said = fail(folder, &[&SYNTH[..], &["other"]].concat(), 1);
    assert!(said.contains("with a margin of") && said.contains("a dataset of each"), "{said}");
    write_scene(folder, "hall_01", 20, None);
    let said = fail(folder, &[&SYNTH[..], &["other"]].concat(), 1);
    assert!(said.contains("does not say"), "{said}");
    assert!(!folder.join("other").exists(), "partial output");
}

#[test]
fn a_view_with_a_margin_has_the_view_in_its_middle() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let planes = Array3::from_shape_fn((3, 64, 128), |(c, y, x)| 0.1 + ((c + y * 3 + x * 7) % 11) as f32);
    let panorama = LinearImage::from_planes(planes).unwrap();
    io::write_image(&folder.join("street.exr"), &panorama, &WriteOptions::default()).unwrap();
    let crop = ["crop", "street.exr", "--size", "24", "--fov", "50", "--yaw=10", "--pitch=-20", "-o"];
    succeed(folder, &[&crop[..], &["plain"]].concat());
    let said = succeed(folder, &[&crop[..], &["wide", "--margin", "9"]].concat());
    assert!(said.contains("24 × 24 pixels and a margin of 9 on each side"), "{said}");
    let read = |name: &str| io::read_image::<Linear>(&folder.join(name).join("street_01.exr")).unwrap();
    let wide = read("wide");
    assert_eq!((wide.height(), wide.width()), (42, 42));
    assert_eq!(wide.crop(9, 9, 24, 24), read("plain"));
    let provenance = io::read_provenance(&folder.join("wide/street_01.exr")).unwrap().unwrap();
    assert_eq!(provenance.margin(), Some(9));
    // The field of view is the frame's.
    assert_eq!(provenance.config["fov_deg"], 50.0);
    write_psf(&folder.join("psf.exr"));
    let said = succeed(folder, &["synth", "wide", "--psf", "psf.exr", "--split", "train", "-o", "dataset"]);
    assert!(said.contains("24 × 24 with a margin of 9"), "{said}");
    let dataset = Dataset::open(&folder.join("dataset")).unwrap();
    assert_eq!(dataset.read_ground_truth(&dataset.triplets[0]).unwrap(), read("plain"));
    let said = fail(folder, &[&crop[..], &["none", "--margin", "2000"]].concat(), 1);
    assert!(said.contains("field of view of 17") && !folder.join("none").exists(), "{said}");
}

/// A bright scene that goes on outside of the frame: who takes its surroundings for dark (the boundary beyond the margin)
/// makes the border brighter than it can be.
#[test]
fn deconvolution_does_not_take_a_margin_for_darkness() {
    let (scratch, _) = scratch(None);
    let folder = scratch.path();
    let [height, width] = FRAME.map(|side| 2 * side + 2 * MARGIN);
    let planes = Array3::from_shape_fn((3, height, width), |(c, y, x)| {
        1.0 + 0.3 * (y as f32 * 0.2 + c as f32).sin() * (x as f32 * 0.15).cos()
    });
    fs::create_dir(folder.join("bright")).unwrap();
    let image = LinearImage::from_planes(planes).unwrap();
    io::write_image(&folder.join("bright/wall_01.npy"), &image, &WriteOptions::default()).unwrap();
    let flags = ["--psf", "psf.exr", "--split", "test", "--margin", "8", "-o", "dataset"];
    succeed(folder, &[&["synth", "bright"][..], &flags].concat());
    let methods = ["--method", "richardson-lucy,constrained", "--metrics", "psnr", "-o", "results"];
    succeed(folder, &[&["eval", "dataset"][..], &methods].concat());
    let text = fs::read_to_string(folder.join("results/metrics.csv")).unwrap();
    let psnr = |method: &str| -> f64 {
        let line = text.lines().find(|line| line.starts_with(method)).unwrap_or_else(|| panic!("{text}"));
        line.split(',').filter_map(|cell| cell.parse().ok()).next_back().unwrap()
    };
    for method in ["richardson-lucy", "constrained"] {
        assert!(psnr(method) > psnr("degraded"), "{text}");
    }
}

#[test]
fn training_on_the_fly_learns_from_the_middle_of_views_with_a_margin() {
    let (scratch, _) = scratch(Some(MARGIN));
    let folder = scratch.path();
    succeed(folder, &["codes", "psf.exr", "--angles=-3,0,3", "--dim", "1", "-o", "bank.safetensors"]);
    let config = "iterations = 2\n[architecture]\nfeatures = 2\nfilter-size = 3\ncondition = \"image\"\n\
                  [data]\ndegradation = \"on-the-fly\"\ncrop = 20\nbatch = 1\naccumulate = 1\n[validation]\ncrop = 16\n";
    fs::write(folder.join("config.toml"), config).unwrap();
    let train = ["train", "config.toml", "--data"];
    let views = [&train[..], &["scenes", "--bank", "bank.safetensors", "-o", "run"]].concat();
    let said = fail(folder, &views, 1);
    assert!(said.contains("data.formation.margin") && said.contains("margin of 8"), "{said}");
    // Found before anything is written; the scene without what it says of its margin.
    fs::create_dir(folder.join("plain")).unwrap();
    write_scene(folder, "view", 30, None);
    fs::rename(folder.join("scenes/view.exr"), folder.join("plain/view.exr")).unwrap();
    let plain = [&train[..], &["plain", "--bank", "bank.safetensors", "-o", "none"]].concat();
    let said = fail(folder, &[&plain[..], &["--set", "data.formation.margin=30"]].concat(), 1);
    assert!(said.contains("more than twice the margin of 30 pixels"), "{said}");
    assert!(said.contains("view") && !folder.join("none").exists(), "{said}");
    let margin = ["--set", "data.formation.margin=8"];
    succeed(folder, &[&views[..], &margin].concat());
    // A crop that fits the scene and not the frame.
    let large = ["--set", "data.crop=24", "--overwrite"];
    assert!(fail(folder, &[&views[..], &margin, &large].concat(), 1).contains("20 × 26"));

    succeed(folder, &["synth", "scenes", "--bank", "bank.safetensors", "--split", "train", "-o", "dataset"]);
    let run = udc(folder, &[&train[..], &["dataset", "-o", "of-dataset"]].concat());
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success() && said.contains("lack the margin"), "{said}");
}

/// A file that says its margin is known by its hash: what lies in the margin is not in the ground truth.
#[test]
fn resume_notices_another_lamp_in_the_margin() {
    let (scratch, _) = scratch(Some(MARGIN));
    let folder = scratch.path();
    succeed(folder, &[&SYNTH[..], &["dataset"]].concat());
    let resume = [&SYNTH[..], &["dataset", "--resume"]].concat();
    assert!(succeed(folder, &resume).contains("0 images made, 2 were there"));
    write_scene(folder, "park_01", 9, Some(MARGIN));
    let said = fail(folder, &resume, 1);
    assert!(said.contains("images of another scenes/park_01.exr"), "{said}");
    write_scene(folder, "park_01", 5, Some(MARGIN));
    assert!(succeed(folder, &resume).contains("0 images made, 2 were there"));
}

#[test]
fn views_in_npy_with_a_margin_warn_that_the_files_do_not_say_it() {
    let scratch = tempfile::tempdir().unwrap();
    let image = LinearImage::from_planes(Array3::from_elem((3, 32, 64), 0.5)).unwrap();
    io::write_image(&scratch.path().join("street.exr"), &image, &WriteOptions::default()).unwrap();
    let crop = |output: &str, more: &[&str]| {
        let args = ["crop", "street.exr", "--size", "16", "--views", "1", "-o", output];
        let run = udc(scratch.path(), &[&args[..], more].concat());
        assert!(run.status.success());
        String::from_utf8_lossy(&run.stderr).into_owned()
    };
    let said = crop("npy", &["--margin", "8", "--format", "npy"]);
    assert!(said.contains("warning: .npy does not say") && said.contains("synth --margin 8"), "{said}");
    assert!(!crop("exr", &["--margin", "8"]).contains("warning"));
    assert!(!crop("plain", &["--format", "npy"]).contains("warning"));
}
