//! The tone curve of `udc eval` on folders is that of their files.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use serde_json::Value;
use udc::core::image::{LinearImage, ToneMappedImage};
use udc::core::provenance::Provenance;
use udc::core::tone::ToneCurve;
use udc::io::{self, WriteOptions};

use super::common::{fail, succeed, udc};

/// Light of about a third of what the sensor records, and a restoration that is a tenth too bright.
fn light(factor: f32) -> LinearImage {
    let value = |(c, y, x): (usize, usize, usize)| factor * (0.2 + (c + 2 * y + 3 * x) as f32 % 7.0);
    LinearImage::from_planes(Array3::from_shape_fn((3, 24, 24), value)).unwrap()
}

fn write(path: &Path, image: &LinearImage, command: &str, config: &Value) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let provenance = Some(Provenance::new(command, config));
    io::write_image(path, image, &WriteOptions { provenance, overwrite: true, ..WriteOptions::default() })
        .unwrap();
}

/// As `udc restore` and `udc synth` write their images.
fn write_folders(folder: &Path, restored: (f32, f32), truth: Option<(f32, f32)>) {
    let tone = |(alpha, x_max): (f32, f32)| serde_json::json!({"alpha": alpha, "x-max": x_max});
    write(
        &folder.join("restored/a.exr"),
        &light(1.1),
        "restore",
        &serde_json::json!({"tone": tone(restored)}),
    );
    let formation = truth.map_or(Value::Null, tone);
    write(&folder.join("gt/a.exr"), &light(1.0), "synth", &serde_json::json!({"formation": formation}));
}

/// The mean squared error of the two as their definition has it, before rounding to 8 bits.
fn psnr_under(curve: ToneCurve) -> f64 {
    let map = |factor: f32| -> ToneMappedImage { curve.tone_map(&light(factor)) };
    let (a, b) = (map(1.1), map(1.0));
    let round = |v: f32| f64::from((v.clamp(0.0, 1.0) * 255.0).round_ties_even()) / 255.0;
    let squares = a.as_slice().iter().zip(b.as_slice()).map(|(&a, &b)| (round(a) - round(b)).powi(2));
    let count = a.as_slice().len() as f64;
    -10.0 * (squares.sum::<f64>() / count).log10()
}

const EVAL: [&str; 5] = ["eval", "--restored", "restored", "--gt", "gt"];

fn results(folder: &Path, name: &str) -> Value {
    serde_json::from_str(&fs::read_to_string(folder.join(name).join("metrics.json")).unwrap()).unwrap()
}

/// α = 1 and x_max = 4 cut and bend otherwise than the default: the numbers differ by decibels.
#[test]
fn images_of_folders_are_compared_under_the_curve_that_their_files_say() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_folders(folder, (1.0, 4.0), Some((1.0, 4.0)));
    let said = succeed(folder, &[&EVAL[..], &["-o", "results"]].concat());
    let found = results(folder, "results");
    let expected = psnr_under(ToneCurve { alpha: 1.0, x_max: 4.0 });
    assert!((psnr_under(ToneCurve::default()) - expected).abs() > 1.0, "the curves are told apart");
    assert!((found["mean"]["psnr"].as_f64().unwrap() - expected).abs() < 1e-6, "{found}");
    let tone = &found["definition"]["tone"];
    assert_eq!(tone["alpha"], 1.0);
    assert_eq!(tone["x-max"], 4.0);
    assert_eq!(tone["said-by"], "the files");
    assert!(said.contains("x / (x + 1) of x up to 4, as the files said"), "{said}");
}

#[test]
fn folders_of_two_curves_are_refused_until_flags_decide() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_folders(folder, (0.25, 16.0), Some((0.25, 500.0)));
    let refused = fail(folder, &[&EVAL[..], &["-o", "results"]].concat(), 1);
    assert!(refused.contains("x-max 16") && refused.contains("x-max 500"), "{refused}");
    assert!(refused.contains("--alpha") && refused.contains("--x-max"), "{refused}");
    assert!(!folder.join("results").exists());
    // What is given is no longer in dispute, and α is still the files'.
    succeed(folder, &[&EVAL[..], &["-o", "results", "--x-max", "16"]].concat());
    assert_eq!(results(folder, "results")["definition"]["tone"]["said-by"], "the flags and the files");
    succeed(folder, &[&EVAL[..], &["-o", "other", "--x-max", "2", "--alpha", "0.5"]].concat());
    let found = results(folder, "other");
    let expected = psnr_under(ToneCurve { alpha: 0.5, x_max: 2.0 });
    assert!((found["mean"]["psnr"].as_f64().unwrap() - expected).abs() < 1e-6, "{found}");
    assert_eq!(found["definition"]["tone"]["said-by"], "the flags");
    let output = udc(folder, &[&EVAL[..], &["-o", "none", "--alpha", "0"]].concat());
    assert!(!output.status.success() && String::from_utf8_lossy(&output.stderr).contains("alpha"));
}

/// Files that carry nothing, as .npy: the dataset that the ground truth lies in says the curve, and without one nobody does.
#[test]
fn a_dataset_says_the_curve_of_its_ground_truth() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    fs::create_dir_all(folder.join("views")).unwrap();
    fs::create_dir_all(folder.join("restored")).unwrap();
    let options = WriteOptions::default();
    io::write_image(&folder.join("views/a.npy"), &light(1.0), &options).unwrap();
    io::write_image(&folder.join("restored/a.npy"), &light(1.1), &options).unwrap();
    let mut point = Array3::zeros((3, 5, 5));
    point.slice_mut(ndarray::s![.., 2, 2]).fill(1.0);
    io::write_image(&folder.join("psf.exr"), &LinearImage::from_planes(point).unwrap(), &options).unwrap();
    let synth =
        ["synth", "views", "--psf", "psf.exr", "-o", "dataset", "--format", "npy", "--alpha", "1", "--x-max"];
    succeed(folder, &[&synth[..], &["4"]].concat());
    let eval = |gt: &str, output: &str| {
        let eval = ["eval", "--restored", "restored", "--gt", gt, "--domain", "linear", "-o", output];
        succeed(folder, &eval);
        results(folder, output)
    };
    let found = eval("dataset/gt", "results");
    assert_eq!(found["definition"]["tone"]["x-max"], 4.0);
    let expected = psnr_under(ToneCurve { alpha: 1.0, x_max: 4.0 });
    assert!((found["mean"]["psnr"].as_f64().unwrap() - expected).abs() < 1e-6, "{found}");
    let found = eval("views", "default");
    assert_eq!(found["definition"]["tone"]["x-max"], 500.0);
    assert!(found["definition"]["tone"]["said-by"].as_str().unwrap().contains("nobody"), "{found}");
}

/// The files that are compared are of φ(0.5), as `udc tonemap --alpha 0.5` writes them: their own α says how to undo it.
#[test]
fn flags_decide_the_curve_of_tone_mapped_files_too() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let (own, asked) = (ToneCurve { alpha: 0.5, x_max: 16.0 }, ToneCurve { alpha: 0.25, x_max: 16.0 });
    fs::create_dir_all(folder.join("restored")).unwrap();
    let provenance = Provenance::new("tonemap", &serde_json::json!({"tone": {"alpha": 0.5, "x-max": 16.0}}));
    let options = WriteOptions { provenance: Some(provenance), ..WriteOptions::default() };
    io::write_image(&folder.join("restored/a.exr"), &own.tone_map(&light(1.1)), &options).unwrap();
    let synth = serde_json::json!({"formation": {"alpha": 0.25, "x-max": 16.0}});
    write(&folder.join("gt/a.exr"), &light(1.0), "synth", &synth);
    let eval = |output: &str, flags: &[&str]| {
        succeed(folder, &[&EVAL[..], &["-o", output], flags].concat());
        results(folder, output)
    };
    let found = eval("results", &["--alpha", "0.25"]);
    // The round trip through φ moves no value by half a step of 8 bits, but for ties.
    let close = |found: &Value, curve: ToneCurve| {
        let psnr = found["mean"]["psnr"].as_f64().unwrap();
        assert!((psnr - psnr_under(curve)).abs() < 0.05, "{psnr} for {}", psnr_under(curve));
    };
    close(&found, asked);
    let says = found["definition"]["tone"]["tone-mapped-files"].as_str().unwrap();
    assert!(says.contains("mapped back by the curve that they say"), "{says}");
    close(&eval("other", &["--alpha", "0.5", "--x-max", "16"]), own);
}

#[test]
fn a_finished_image_is_not_compared_with_light() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_folders(folder, (0.25, 16.0), Some((0.25, 16.0)));
    fs::rename(folder.join("restored"), folder.join("plain")).unwrap();
    fs::create_dir(folder.join("restored")).unwrap();
    succeed(folder, &["finish", "plain/a.exr", "-o", "restored/a.exr"]);
    let refused = fail(folder, &[&EVAL[..], &["-o", "results"]].concat(), 1);
    assert!(refused.contains("restored/a.exr") && refused.contains("before `udc finish`"), "{refused}");
    assert!(refused.contains("--domain"), "{refused}");
    succeed(folder, &[&EVAL[..], &["-o", "results", "--domain", "srgb"]].concat());
}

/// φ gives nothing above 1, and its inverse would make the brightest light of all of it.
#[test]
fn linear_light_is_not_taken_for_tone_mapped() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    for name in ["restored", "gt"] {
        fs::create_dir(folder.join(name)).unwrap();
        let light = Array3::<f32>::from_elem((16, 16, 3), 1.5).into_dyn();
        io::write_array(&folder.join(name).join("a.npy"), &light, false).unwrap();
    }
    let eval = [&EVAL[..], &["-o", "results", "--domain", "tone-mapped"]].concat();
    let inverse = ["tonemap", "--inverse", "gt/a.npy", "-o", "light.exr"];
    let convert = ["convert", "gt/a.npy", "mapped.exr", "--domain", "tone-mapped"];
    for command in [&eval[..], &inverse, &convert] {
        let said = fail(folder, command, 1);
        assert!(said.contains("holds 1.5, and tone-mapped values are below 1"), "{command:?}: {said}");
    }
}
