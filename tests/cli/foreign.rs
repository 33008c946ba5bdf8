//! Files of somebody else: what they hold is neither run, nor followed out of their folder, nor taken up by chance.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use serde_json::json;
use udc::core::image::LinearImage;
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed};

const HOSTILE: &str = "<svg xmlns=\"http://www.w3.org/2000/svg\" onload=\"alert(1)\"><script>fetch('//evil')</script>\
                       <foreignObject><iframe src=\"https://evil.example\"/></foreignObject></svg>";

/// Results of which a drawing and every name is hostile, with numbers that are not.
fn write_results(folder: &Path) {
    fs::create_dir_all(folder).unwrap();
    let name = "<img src=x onerror=alert(2)>";
    let kernels = json!({"r-03": {"psnr": 30.0}, "r+00": {"psnr": 31.0}});
    let method = json!({"name": name, "baseline": false, "count": 1, "mean": {"psnr": 30.5}, "kernels": kernels,
                        "images": []});
    let definition = json!({"quantise": true, "border": 0, "ssim-window": 11, "ssim-sigma": 1.5, "peak": 1.0,
                            "domain": "<script>alert(3)</script>", "ssim-channels": "mean", "metrics": ["psnr"]});
    let angles = json!([{"name": "r-03", "angle-deg": -3.0}, {"name": "r+00", "angle-deg": 0.0}]);
    let metrics = json!({"format": "udc-evaluation", "version": 1, "method": name, "mean": {"psnr": 30.5}, "images": [],
                         "methods": [method], "kernels": angles, "sizes": [], "excluded": [],
                         "definition": definition});
    fs::write(folder.join("metrics.json"), metrics.to_string()).unwrap();
    let matrix = json!({"method": name, "metric": "psnr", "simulated": ["r-03", "<script>"], "assumed": ["r-03", "r+00"],
                        "mean": [[31.25, 22.5], [21.75, null]], "images": [1, 1], "excluded": []});
    let matrices = json!({"format": "udc-mismatch", "version": 1, "matrices": [matrix]});
    fs::write(folder.join("mismatch.json"), matrices.to_string()).unwrap();
    fs::write(folder.join("mismatch-1-psnr.svg"), HOSTILE).unwrap();
}

#[test]
fn a_page_draws_foreign_results_anew_and_embeds_no_foreign_drawing() {
    let scratch = tempfile::tempdir().unwrap();
    write_results(&scratch.path().join("results"));
    succeed(scratch.path(), &["report", "results", "-o", "report.html"]);
    let page = fs::read_to_string(scratch.path().join("report.html")).unwrap();
    for hostile in
        ["<script>alert", "<script>fetch", "onload=", "evil", "<foreignObject", "<iframe", "<img src=x"]
    {
        assert!(!page.contains(hostile), "the page holds {hostile}");
    }
    for number in [">31.25<", ">22.50<", ">21.75<", ">∞<"] {
        assert!(page.contains(number), "the matrix lost {number}");
    }
    assert!(page.contains("&lt;script&gt;"), "names are shown as text");
}

#[test]
fn damaged_and_outdated_results_are_named_with_what_to_do_and_no_page_is_written() {
    let scratch = tempfile::tempdir().unwrap();
    let results = scratch.path().join("results");
    let damage = |name: &str, from: &str, to: &str| {
        write_results(&results);
        let text = fs::read_to_string(results.join(name)).unwrap();
        assert!(text.contains(from), "{text}");
        fs::write(results.join(name), text.replace(from, to)).unwrap();
        let message = fail(scratch.path(), &["report", "results", "-o", "report.html"], 1);
        assert!(message.contains(&format!("{name}: ")), "{message}");
        assert!(!scratch.path().join("report.html").exists());
        message
    };
    let message = damage("mismatch.json", "\"simulated\"", "\"assumed\"");
    assert!(message.contains("is damaged") && message.contains("`udc eval --mismatch`"), "{message}");
    let message = damage("metrics.json", "\"methods\"", "\"method-s\"");
    assert!(message.contains("is damaged") && message.contains("make it anew with `udc eval`"), "{message}");
    let message = damage("metrics.json", ",\"version\":1", "");
    assert!(message.contains("says no version"), "{message}");
    let message = damage("metrics.json", "\"version\":1", "\"version\":7");
    assert!(message.contains("layout 7, and this program reads 1"), "{message}");
}

fn write_scene(path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let planes = Array3::from_shape_fn((3, 12, 12), |(c, y, x)| 0.1 + (c + y + x) as f32 % 5.0);
    io::write_image(path, &LinearImage::from_planes(planes).unwrap(), &WriteOptions::default()).unwrap();
}

/// macOS keeps `._name` beside each file on foreign disks, which are no images.
#[test]
fn a_quoted_pattern_matches_no_hidden_file_unless_it_spells_the_dot() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    for name in ["views/park_01.exr", "views/.hidden_01.exr"] {
        write_scene(&folder.join(name));
    }
    fs::write(folder.join("views/._park_01.exr"), b"\0\x05\x16\x07 no image").unwrap();
    let listed = |pattern: &str| succeed(folder, &["info", pattern]);
    let found = listed("views/*.exr");
    assert!(found.contains("park_01.exr") && !found.contains("hidden") && !found.contains("._"), "{found}");
    assert!(listed("views/.h*.exr").contains(".hidden_01.exr"));
    fs::create_dir(folder.join("views/.trash")).unwrap();
    write_scene(&folder.join("views/.trash/old_01.exr"));
    assert!(!listed("*/*.exr").contains("old_01") && !listed("**/*.exr").contains("old_01"));
}

#[test]
fn triplets_that_lead_out_of_their_dataset_are_refused_with_their_line() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_scene(&folder.join("views/park_01.exr"));
    write_scene(&folder.join("secret.exr"));
    let mut point = Array3::zeros((3, 5, 5));
    point.slice_mut(ndarray::s![.., 2, 2]).fill(1.0);
    let options = WriteOptions::default();
    io::write_image(&folder.join("psf.exr"), &LinearImage::from_planes(point).unwrap(), &options).unwrap();
    succeed(folder, &["synth", "views", "--psf", "psf.exr", "-o", "dataset", "--split", "test"]);
    let list = folder.join("dataset/triplets.jsonl");
    let good = fs::read_to_string(&list).unwrap();
    let absolute = folder.join("secret.exr").to_str().unwrap().to_owned();
    for path in [
        "../secret.exr",
        "gt/../../secret.exr",
        &absolute,
        "C:\\secret.exr",
        "C:secret.exr",
        "\\\\host\\a.exr",
        "..\\a",
        "",
    ] {
        let mut triplet: serde_json::Value = serde_json::from_str(good.trim()).unwrap();
        triplet["gt"] = json!(path);
        triplet["id"] = json!("other");
        fs::write(&list, format!("{good}{triplet}\n")).unwrap();
        let message = fail(folder, &["eval", "dataset", "-o", "results"], 1);
        assert!(message.contains("triplets.jsonl") && message.contains("line 2"), "{path}: {message}");
        assert!(message.contains("relative"), "{path}: {message}");
    }
    // Dots within a name lead nowhere.
    fs::copy(folder.join("dataset/gt/park_01.exr"), folder.join("dataset/gt/a..b.exr")).unwrap();
    let mut triplet: serde_json::Value = serde_json::from_str(good.trim()).unwrap();
    triplet["gt"] = json!("./gt/a..b.exr");
    fs::write(&list, format!("{triplet}\n")).unwrap();
    succeed(folder, &["eval", "dataset", "-o", "results"]);
}
