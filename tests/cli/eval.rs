//! `udc eval`.

use std::path::Path;

use ndarray::{Array3, ArrayD};
use serde_json::{Value, json};
use udc::codes::make_rotated_bank;
use udc::core::capture::CaptureInfo;
use udc::core::image::{LinearImage, ToneMappedImage};
use udc::core::orientation::Orientation;
use udc::core::primaries::Primaries;
use udc::core::psf::Psf;
use udc::dataset::{DatasetConfig, FORMAT, FormationConfig, VERSION};
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};
use super::perceptual_weights;

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
    for described in ["results", "results/metrics.json"] {
        let info = succeed(scratch.path(), &["info", described]);
        assert!(
            info.contains("results of an evaluation") && info.contains("| restored | 2 | 35.46 | 0.8688 |"),
            "{info}"
        );
    }
    let info: Value = serde_json::from_str(&succeed(scratch.path(), &["info", "results", "--json"])).unwrap();
    assert_eq!((&info["kind"], &info["methods"][0]["images"]), (&json!("evaluation"), &json!(2)), "{info}");
    assert!(fail(scratch.path(), &arguments, 1).contains("--overwrite"));
    let said = fail(scratch.path(), &["eval", "--restored", "restored", "--gt", "gt", "-o", "undeclared"], 1);
    assert!(said.contains("--domain"), "{said}");
    assert!(!scratch.path().join("undeclared").exists(), "it would hold nothing");
    let itself = fail(scratch.path(), &["eval", "--restored", "gt", "--gt", "./gt", "-o", "itself"], 1);
    assert!(itself.contains("./gt is the folder of the restored images itself"), "{itself}");
}

#[test]
fn never_averages_over_fewer_images_without_saying_so() {
    let scratch = tempfile::tempdir().unwrap();
    for name in ["restored/a.png", "gt/a.png", "gt/b.png", "restored/c.png"] {
        write(&scratch.path().join(name), 16, 0.5);
    }
    write(&scratch.path().join("gt/c.png"), 20, 0.5);
    let arguments =
        ["eval", "--restored", "restored", "--gt", "gt", "--domain", "tone-mapped", "-o", "results"];
    let said = fail(scratch.path(), &arguments, 1);
    assert!(said.contains("b has no restored image") && said.contains("--allow-missing"), "{said}");
    assert!(!scratch.path().join("results/metrics.json").exists());

    let output = udc(scratch.path(), &[&arguments[..], &["--allow-missing"]].concat());
    assert!(output.status.success());
    assert!(String::from_utf8_lossy(&output.stderr).contains("2 images are excluded from all means"));
    let json = results(scratch.path());
    assert_eq!(json["images"].as_array().unwrap().len(), 1);
    let excluded: Vec<_> =
        json["excluded"].as_array().unwrap().iter().map(|e| e["id"].as_str().unwrap()).collect();
    assert_eq!(excluded, ["c", "b"]);
}

/// Writes grey light with what is known of its capture.
fn write_capture(path: &Path, capture: CaptureInfo) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let image = LinearImage::from_planes(Array3::from_elem((3, 16, 16), 0.5)).unwrap();
    let options = WriteOptions { capture: Some(capture), ..WriteOptions::default() };
    io::write_image(path, &image, &options).unwrap();
}

#[test]
fn images_of_other_primaries_and_images_that_lie_otherwise_are_not_compared() {
    let scratch = tempfile::tempdir().unwrap();
    let turned = CaptureInfo { orientation: Orientation::from_exif(6), ..CaptureInfo::default() };
    let wide = CaptureInfo::of_primaries(Primaries::BT2020);
    write_capture(&scratch.path().join("wide/a.exr"), wide.clone());
    write_capture(&scratch.path().join("same/a.exr"), wide);
    write_capture(&scratch.path().join("turned/a.exr"), turned);
    write_capture(&scratch.path().join("gt/a.exr"), CaptureInfo::default());
    let eval = |restored, gt, output| ["eval", "--restored", restored, "--gt", gt, "-o", output];
    let said = fail(scratch.path(), &eval("wide", "gt", "one"), 1);
    assert!(said.contains("wide/a.exr is of BT.2020 primaries, and gt/a.exr of sRGB"), "{said}");
    let said = fail(scratch.path(), &eval("gt", "turned", "two"), 1);
    assert!(
        said.contains("turned/a.exr is to be turned right") && said.contains("gt/a.exr is upright"),
        "{said}"
    );
    succeed(scratch.path(), &eval("wide", "same", "three"));
    write(&scratch.path().join("silent/a.npy"), 16, 0.5);
    let output =
        udc(scratch.path(), &[&eval("silent", "wide", "four")[..], &["--domain", "tone-mapped"]].concat());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.success() && said.contains("silent/a.npy does not say its red, green and blue"),
        "{said}"
    );
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

/// The value is PyTorch's, of the same weights.
#[test]
fn measures_lpips_with_the_weights_of_the_files() {
    let scratch = tempfile::tempdir().unwrap();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/perceptual");
    for (from, to) in [("x.npy", "restored"), ("y.npy", "gt")] {
        std::fs::create_dir(scratch.path().join(to)).unwrap();
        std::fs::copy(fixtures.join(from), scratch.path().join(to).join("a.npy")).unwrap();
    }
    let eval = ["eval", "--restored", "restored", "--gt", "gt", "--domain", "tone-mapped", "-o", "results"];
    let eval = [&eval[..], &["--metrics", "lpips,psnr", "--definition", "float"]].concat();
    let said = fail(scratch.path(), &eval, 1);
    assert!(said.contains("--lpips-alexnet") && said.contains("alex.pth"), "{said}");
    perceptual_weights::write_alexnet(&scratch.path().join("alexnet.safetensors"));
    perceptual_weights::write_linear(&scratch.path().join("linear.safetensors"));
    let weights = ["--lpips-alexnet", "alexnet.safetensors", "--lpips-linear", "linear.safetensors"];
    let said = succeed(scratch.path(), &[&eval[..], &weights].concat());
    assert!(said.contains("| PSNR (dB) | LPIPS |"), "{said}");
    let case = std::fs::read_to_string(fixtures.join("case.json")).unwrap();
    let expected = serde_json::from_str::<Value>(&case).unwrap()["lpips_alex"].as_f64().unwrap();
    let found = results(scratch.path())["mean"]["lpips"].as_f64().unwrap();
    assert!((found / expected - 1.0).abs() < 1e-4, "{found} for {expected}");
}

fn write_linear(path: &Path, size: usize, light: impl Fn(usize, usize) -> f32) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let image = LinearImage::from_planes(Array3::from_shape_fn((3, size, size), |(_, y, x)| light(y, x)));
    io::write_image(path, &image.unwrap(), &WriteOptions::default()).unwrap();
}

/// A dataset of one scene of 24 × 24 pixels in each split, seen through two kernels.
fn write_dataset(root: &Path) {
    std::fs::create_dir(root).unwrap();
    let energy = Array3::from_shape_fn((3, 9, 9), |(c, y, x)| 1.0 / (1.0 + (c + y * x) as f32));
    let bank = make_rotated_bank(&Psf::from_energy(energy).unwrap(), &[-3.0, 0.0, 3.0, 7.0, 11.0, 20.0], 5);
    let bank_file = root.join("kernels.safetensors");
    io::write_bank(&bank_file, &bank.unwrap(), false).unwrap();
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
        formation: FormationConfig::default(),
    };
    std::fs::write(root.join("dataset.toml"), toml::to_string(&config).unwrap()).unwrap();
    let mut lines = String::new();
    for (id, split) in [("street", "test"), ("room", "train")] {
        write_linear(&root.join(format!("gt/{id}.exr")), 24, |y, x| ((y * 5 + x * 3) % 7) as f32);
        for (kernel, angle) in [("r-03", -3.0), ("r+00", 0.0)] {
            let degraded = format!("degraded/{kernel}/{id}.exr");
            write_linear(&root.join(&degraded), 24, |y, x| ((y * 5 + x * 3) % 7) as f32 * 0.9 + 0.1);
            let line = json!({
                "id": id, "split": split, "gt": format!("gt/{id}.exr"), "degraded": degraded, "kernel": kernel,
                "angle_deg": angle, "source": id, "sha256": null,
            });
            lines += &format!("{line}\n");
        }
    }
    std::fs::write(root.join("triplets.jsonl"), lines).unwrap();
}

#[test]
fn measures_models_and_the_degraded_images_of_a_dataset() {
    let scratch = tempfile::tempdir().unwrap();
    write_dataset(&scratch.path().join("dataset"));
    let networks = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/discnet");
    for name in ["1.pth", "2.pth"] {
        std::fs::copy(networks.join(name), scratch.path().join(name)).unwrap();
    }
    let said = succeed(
        scratch.path(),
        &["eval", "dataset", "--model", "1.pth", "--model", "2.pth", "-o", "results"],
    );
    let json = results(scratch.path());
    let names: Vec<_> =
        json["methods"].as_array().unwrap().iter().map(|m| m["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["degraded", "1.pth", "2.pth"]);
    assert_eq!(json["method"], "1.pth");
    assert_eq!(json["images"].as_array().unwrap().len(), 2, "only the test split is measured");
    assert_eq!(json["images"][0]["kernel"], "r-03");
    assert_eq!(json["methods"][0]["kernels"]["r-03"], json["methods"][0]["kernels"]["r+00"]);
    assert!(
        said.contains("PSNR (dB) by kernel") && said.contains("| method | r-03 | r+00 | mean |"),
        "{said}"
    );

    let treated = ["--model", "1.pth", "--highlights", "restored,keep,blend", "-o", "highlights"];
    succeed(scratch.path(), &[&["eval", "dataset"][..], &treated].concat());
    let table = std::fs::read_to_string(scratch.path().join("highlights/table.md")).unwrap();
    assert!(
        table.contains("1.pth, highlights kept") && table.contains("1.pth, highlights blended"),
        "{table}"
    );

    succeed(scratch.path(), &["eval", "dataset", "--split", "train", "--limit", "1", "-o", "baseline"]);
    let csv = std::fs::read_to_string(scratch.path().join("baseline/metrics.csv")).unwrap();
    assert_eq!(csv.lines().count(), 2);
    assert!(csv.lines().nth(1).unwrap().starts_with("degraded,room,r-03,"), "{csv}");
}

/// Runs are called alike in different folders.
#[test]
fn models_of_one_name_are_told_apart() {
    let scratch = tempfile::tempdir().unwrap();
    write_dataset(&scratch.path().join("dataset"));
    let networks = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/discnet");
    for (number, folder) in [("1", "a/run"), ("2", "b/run")] {
        let folder = scratch.path().join(folder);
        std::fs::create_dir_all(&folder).unwrap();
        let checkpoint = networks.join(format!("{number}.pth"));
        succeed(&folder, &["convert", checkpoint.to_str().unwrap(), "model.safetensors"]);
    }
    let models = ["--model", "a/run/model.safetensors", "b/run/model.safetensors"];
    let said = succeed(scratch.path(), &[&["eval", "dataset", "-o", "results"][..], &models].concat());
    assert!(
        said.contains("| a/run/model.safetensors |") && said.contains("| b/run/model.safetensors |"),
        "{said}"
    );
    let message = fail(scratch.path(), &["eval", "dataset", "-o", "other", "--model", "a/run"], 1);
    assert!(message.contains("is a folder") && message.contains("a/run/model.safetensors"), "{message}");
}

#[test]
fn refuses_a_dataset_without_the_split_and_a_model_that_is_none() {
    let scratch = tempfile::tempdir().unwrap();
    write_dataset(&scratch.path().join("dataset"));
    let said = fail(scratch.path(), &["eval", "dataset", "--split", "val", "-o", "results"], 1);
    assert!(said.contains("no val split"), "{said}");
    std::fs::copy(
        scratch.path().join("dataset/kernels.safetensors"),
        scratch.path().join("bank.safetensors"),
    )
    .unwrap();
    let said = fail(scratch.path(), &["eval", "dataset", "--model", "bank.safetensors", "-o", "results"], 1);
    assert!(said.contains("bank.safetensors"), "{said}");
    assert!(!scratch.path().join("results").exists());
}

#[test]
fn replaces_the_pictures_and_plots_of_an_earlier_evaluation_when_told() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_dataset(&folder.join("dataset"));
    // A name that is a number, as its place among the pictures is.
    let network = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/discnet/1.pth");
    std::fs::copy(network, folder.join("0.pth")).unwrap();
    let eval = ["eval", "dataset", "-o", "results", "--pictures", "2"];
    succeed(folder, &[&eval[..], &["--model", "0.pth", "--mismatch", "--ldr", "--regions"]].concat());
    let pictures = || io::list_folder(&folder.join("results/pictures")).unwrap();
    // Three pictures of each of two scenes, and the light of the first.
    assert_eq!(pictures().len(), 6 + 3);
    succeed(folder, &["report", "results", "-o", "report.html"]);
    let page = std::fs::read_to_string(folder.join("report.html")).unwrap();
    let captions = ["street_r-03: degraded<", "street_r-03: 0-pth<", "street_r-03: ground truth<"];
    let places = captions.map(|caption| page.find(caption).expect(caption));
    assert!(places.is_sorted(), "{places:?}");

    std::fs::write(folder.join("results/pictures/mine.png"), b"kept").unwrap();
    std::fs::write(folder.join("results/notes.txt"), b"kept").unwrap();
    for name in io::list_folder(&folder.join("results")).unwrap() {
        if name.starts_with("metrics") || name == "table.md" {
            std::fs::remove_file(folder.join("results").join(name)).unwrap();
        }
    }
    assert!(fail(folder, &eval, 1).contains("--overwrite"));
    succeed(folder, &["eval", "dataset", "-o", "results", "--pictures", "1", "--overwrite"]);
    let [degraded, clean] = ["street_r-03.1-degraded", "street_r-03.2-ground truth"];
    let kept = [degraded, clean].map(|name| [format!("{name}.exr"), format!("{name}.png")]);
    assert_eq!(pictures(), [&["mine.png".to_owned()][..], &kept.concat()].concat());
    let left = io::list_folder(&folder.join("results")).unwrap();
    assert!(left.contains(&"notes.txt".to_owned()), "{left:?}");
    let is_stale =
        |name: &String| name.contains("mismatch") || name.contains("ldr") || name.contains("regions");
    assert!(!left.iter().any(is_stale), "{left:?}");
}

#[test]
fn folders_take_no_flag_of_a_dataset() {
    let scratch = tempfile::tempdir().unwrap();
    for name in ["restored/a.png", "gt/a.png"] {
        write(&scratch.path().join(name), 16, 0.5);
    }
    let folders =
        ["eval", "--restored", "restored", "--gt", "gt", "--domain", "tone-mapped", "-o", "results"];
    for flag in [
        &["--model", "1.pth"][..],
        &["--method", "wiener"],
        &["--mismatch"],
        &["--ldr"],
        &["--limit", "1"],
        &["--split", "train"],
        &["--pictures", "1"],
        &["--regions"],
        &["--highlights", "keep"],
        &["--precision", "bf16"],
    ] {
        let said = fail(scratch.path(), &[&folders[..], flag].concat(), 2);
        assert!(said.contains("cannot be used with"), "{flag:?}: {said}");
    }
    succeed(scratch.path(), &folders);
    write_dataset(&scratch.path().join("dataset"));
    for flag in [["--domain", "linear"], ["--gt", "gt"], ["--alpha", "0.5"]] {
        let said = fail(scratch.path(), &[&["eval", "dataset", "-o", "other"][..], &flag].concat(), 2);
        assert!(said.contains("cannot be used with"), "{flag:?}: {said}");
    }
}
