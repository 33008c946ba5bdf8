//! `udc eval`.

use std::path::Path;

use ndarray::{Array3, ArrayD};
use serde_json::Value;
use udc::core::image::ToneMappedImage;
use udc::core::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};

fn write(path: &Path, size: usize, value: f32) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let image = ToneMappedImage::from_planes(Array3::from_elem((3, size, size), value)).unwrap();
    io::write_image(path, &image, &WriteOptions::default()).unwrap();
}

fn results(folder: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(folder.join("results/metrics.json")).unwrap()).unwrap()
}

#[test]
fn measures_two_folders_as_the_published_evaluation_does() {
    let scratch = tempfile::tempdir().unwrap();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/metrics");
    for (from, to) in [("1_a", "restored/1"), ("1_b", "gt/1"), ("3_a", "restored/3"), ("3_b", "gt/3")] {
        let to = scratch.path().join(format!("{to}.npy"));
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::copy(fixtures.join(format!("{from}.npy")), to).unwrap();
    }
    let arguments =
        ["eval", "--restored", "restored", "--gt", "gt", "--domain", "tone-mapped", "-o", "results"];
    let said = succeed(scratch.path(), &arguments);
    let json = results(scratch.path());
    let cases: Value = serde_json::from_str(include_str!("../fixtures/metrics/cases.json")).unwrap();
    for (image, case) in json["images"].as_array().unwrap().iter().zip(cases.as_array().unwrap()) {
        assert_eq!(image["id"], case["case"].to_string());
        let close = |a: &Value, b: &Value, tolerance: f64| {
            (a.as_f64().unwrap() - b.as_f64().unwrap()).abs() < tolerance
        };
        assert!(
            close(&image["psnr"], &case["psnr_8bit"], 1e-3)
                && close(&image["ssim"], &case["ssim_8bit"], 1e-5)
        );
    }
    assert_eq!(json["definition"]["quantise"], true);
    assert!(said.contains("| restored | 2 | 35.46 | 0.8688 |"), "{said}");
    let csv = std::fs::read_to_string(scratch.path().join("results/metrics.csv")).unwrap();
    assert_eq!(csv.lines().count(), 3);
    assert!(fail(scratch.path(), &arguments, 1).contains("--overwrite"));
    let said = fail(scratch.path(), &["eval", "--restored", "restored", "--gt", "gt", "-o", "undeclared"], 1);
    assert!(said.contains("--domain"), "{said}");
}

#[test]
fn never_averages_over_fewer_images_without_saying_so() {
    let scratch = tempfile::tempdir().unwrap();
    for name in ["restored/a.png", "gt/a.png", "gt/b.png", "restored/c.png"] {
        write(&scratch.path().join(name), 16, 0.5);
    }
    write(&scratch.path().join("gt/c.png"), 20, 0.5);
    let arguments = ["eval", "--restored", "restored", "--gt", "gt", "-o", "results"];
    let said = fail(scratch.path(), &arguments, 1);
    assert!(said.contains("b has no restored image") && said.contains("--allow-missing"), "{said}");
    assert!(!scratch.path().join("results/metrics.json").exists());

    let output = udc(scratch.path(), &[&arguments[..], &["--allow-missing"]].concat());
    assert!(output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("2 images are in no mean"));
    let json = results(scratch.path());
    assert_eq!(json["images"].as_array().unwrap().len(), 1);
    let excluded: Vec<_> =
        json["excluded"].as_array().unwrap().iter().map(|e| e["id"].as_str().unwrap()).collect();
    assert_eq!(excluded, ["c", "b"]);
}

#[test]
fn names_an_image_that_holds_a_nan() {
    let scratch = tempfile::tempdir().unwrap();
    write(&scratch.path().join("gt/a.png"), 16, 0.5);
    std::fs::create_dir(scratch.path().join("restored")).unwrap();
    let mut array = ArrayD::from_elem(vec![16, 16, 3], 0.5f32);
    array[[3, 4, 1]] = f32::NAN;
    io::write_array(&scratch.path().join("restored/a.npy"), &array, false).unwrap();
    let arguments =
        ["eval", "--restored", "restored", "--gt", "gt", "--domain", "tone-mapped", "-o", "results"];
    let said = fail(scratch.path(), &arguments, 1);
    assert!(said.contains("a.npy") && said.contains("NaN"), "{said}");
}

#[test]
fn says_what_to_measure_when_nothing_is_named() {
    let scratch = tempfile::tempdir().unwrap();
    assert!(fail(scratch.path(), &["eval", "-o", "results"], 2).contains("--restored"));
    let said = fail(scratch.path(), &["eval", "missing", "-o", "results"], 1);
    assert!(said.contains("missing"), "{said}");
    assert!(!scratch.path().join("results").exists());
}
