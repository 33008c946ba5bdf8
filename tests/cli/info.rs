//! `udc info`: what it says of files and folders.

use std::path::Path;

use udc::network::{Architecture, Initialisation, Model, Origin, Parameters, weights::Weights};

use super::common::{fail, succeed, udc};
use super::files::fixture;

#[test]
fn info_describes_an_image() {
    let folder = tempfile::tempdir().unwrap();
    let text = succeed(folder.path(), &["info", &fixture("half_tiled.exr")]);
    assert!(text.contains("OpenEXR image, 5 × 6 (width × height), 3 channels of half"), "{text}");
    assert!(text.contains("not declared"), "{text}");
}

#[test]
fn info_prints_json_that_a_script_can_use() {
    let folder = tempfile::tempdir().unwrap();
    let text = succeed(folder.path(), &["info", "--json", &fixture("half_piz.exr"), &fixture("code.npy")]);
    let objects: Vec<serde_json::Value> =
        text.lines().map(|line| serde_json::from_str(line).expect("each line is JSON")).collect();
    assert_eq!(objects[0]["kind"], "image");
    assert_eq!(objects[0]["exposure_s"], 0.125);
    assert_eq!(objects[0]["channels"][2]["max"], 31.75);
    assert_eq!(objects[1]["values"][1], -2.0);
}

#[test]
fn info_tells_what_a_configured_network_costs() {
    let folder = tempfile::tempdir().unwrap();
    let config = concat!(env!("CARGO_MANIFEST_DIR"), "/configs/sftmd.toml");
    let text = succeed(folder.path(), &["info", config]);
    for part in ["sftmd", "parameters    3844227", "2454.77 GMAC"] {
        assert!(text.contains(part), "{text}");
    }
    std::fs::write(folder.path().join("other.toml"), "iteratons = 5\n").unwrap();
    let message = fail(folder.path(), &["info", "other.toml"], 1);
    assert!(message.contains("as a training's configuration") && message.contains("iteratons"), "{message}");
}

#[test]
fn info_tells_configurations_apart() {
    let folder = tempfile::tempdir().unwrap();
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
    let config = |name: &str| configs.join(name).to_str().unwrap().to_owned();
    std::fs::write(
        folder.path().join("field.toml"),
        "rows = 1\ncolumns = 2\npsfs = [\"a.exr\", \"b.exr\"]\n",
    )
    .unwrap();
    for (file, expected) in [
        (config("display/pentile.toml").as_str(), "layout pentile, a PSF of 800 × 800 pixels"),
        (&config("display/none.toml"), "layout none"),
        (&config("sensor/phone-10bit.toml"), "sensor, for --noise sensor:"),
        ("field.toml", "PSFs of 1 × 2 places"),
    ] {
        let text = succeed(folder.path(), &["info", file]);
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn info_describes_what_is_there_and_names_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let output = udc(folder.path(), &["info", &fixture("rgb8.png"), "nope", &fixture("hwc_f4.npy")]);
    assert_eq!(output.status.code(), Some(1));
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(stdout.contains("PNG image") && stdout.contains("hwc_f4.npy"), "{stdout}");
    assert!(stderr.contains("nope") && stderr.contains("1 of 3 files"), "{stderr}");
}

#[test]
fn info_says_how_far_a_run_has_come() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    std::fs::create_dir(&run).unwrap();
    std::fs::write(run.join("config.toml"), "iterations = 40\n").unwrap();
    std::fs::write(
        run.join("metrics.jsonl"),
        "{\"iteration\":10,\"loss\":0.5}\n{\"iteration\":20,\"loss\":0.25}\n",
    )
    .unwrap();
    let text = succeed(folder.path(), &["info", "run"]);
    assert!(text.contains("training run, iteration 20 of 40") && text.contains("no model yet"), "{text}");
    // The log has not every iteration.
    let architecture = Architecture { features: 1, ..Architecture::default() };
    let parameters = Parameters::random(&architecture, Initialisation::Released, 1);
    let training = Some(serde_json::json!({"iteration": 24}));
    let origin = Origin { training, ..Origin::default() };
    let model = Model::new(Weights { architecture, parameters, origin });
    model.save(&run.join("model.safetensors"), false).unwrap();
    let text = succeed(folder.path(), &["info", "run"]);
    assert!(text.contains("training run, iteration 24 of 40") && text.contains("24 iterations"), "{text}");
    assert!(text.contains("0.25") && text.contains("parameters"), "{text}");
    let object: serde_json::Value =
        serde_json::from_str(&succeed(folder.path(), &["info", "--json", "run"])).unwrap();
    assert_eq!((&object["kind"], &object["iteration"]), (&"run".into(), &24.into()));
}

#[test]
fn info_goes_on_after_a_file_that_it_cannot_describe() {
    let folder = tempfile::tempdir().unwrap();
    let output = udc(folder.path(), &["info", &fixture("strings.npy"), &fixture("rgb8.png")]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stdout).contains("PNG image"));
    assert!(String::from_utf8_lossy(&output.stderr).contains("1 of 2 files"));
}

/// The published dataset's layout with two scenes of the same few pixels.
#[test]
fn info_counts_what_a_dataset_holds() {
    let folder = tempfile::tempdir().unwrap();
    let copy = |from: &str, to: String| {
        let to = folder.path().join("data").join(to);
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::copy(fixture(from), to).unwrap();
    };
    for (split, scene) in [("train", "0"), ("test", "1")] {
        copy("hwc_f4.npy", format!("synthetic_data/GT/{split}/{scene}.npy"));
        for i in 1..=9 {
            copy("hwc_f4.npy", format!("synthetic_data/input/panel_{i}/{split}/{scene}.npy"));
            copy("code.npy", format!("PSF/kernel_code/panel_code_{i}.npy"));
        }
    }
    let text = succeed(folder.path(), &["info", "data"]);
    assert!(text.contains("test      9 triplets (scenes 1, sources 1, kernels 9)"), "{text}");
    let object: serde_json::Value =
        serde_json::from_str(&succeed(folder.path(), &["info", "--json", "data"])).unwrap();
    assert_eq!(object["splits"]["train"]["kernels"]["panel_3"], 1);
    assert_eq!(object["code_dim"], 3);
    std::fs::remove_dir_all(folder.path().join("data/PSF")).unwrap();
    assert!(fail(folder.path(), &["info", "data"], 1).contains("kernel_code"));
}
