//! One scale of light: where a sensor saturates, images are clipped, and everything that learns from them knows it.

use std::fs;
use std::path::Path;

use ndarray::Array3;
use udc::core::image::{Linear, LinearImage};
use udc::core::psf::Psf;
use udc::core::tone::ToneCurve;
use udc::dataset::Dataset;
use udc::io::{self, WriteOptions};
use udc::network::Model;

use super::common::{fail, succeed, udc};

/// Scenes of two sources with lamps far above every saturation, and a bank of one kernel.
fn scratch() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("views")).unwrap();
    for (index, name) in ["park_01", "hall_01"].iter().enumerate() {
        let planes = Array3::from_shape_fn((3, 32, 32), |(c, y, x)| {
            let lamp = if (y, x) == (9 + index, 13) { 4000.0 } else { 0.0 };
            lamp + 0.1 * (c + 1) as f32 + 0.02 * ((y + x * (index + 3)) % 17) as f32
        });
        let image = LinearImage::from_planes(planes).unwrap();
        io::write_image(&folder.path().join(format!("views/{name}.npy")), &image, &WriteOptions::default())
            .unwrap();
    }
    let energy = Array3::from_shape_fn((3, 9, 9), |(_, y, x)| {
        (-((y as f32 - 4.0).powi(2) + (x as f32 - 4.0).powi(2)) / 3.0).exp() + 1e-3
    });
    let psf = Psf::from_energy(energy).unwrap();
    io::write_psf(&folder.path().join("psf.npy"), &psf, &WriteOptions::default()).unwrap();
    folder
}

/// The shipped sensor, as `--noise` takes it.
fn sensor() -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/sensor/phone-10bit.toml");
    format!("sensor:{}", file.display())
}

/// `udc synth` by one PSF; returns what it warned of.
fn synth(folder: &Path, output: &str, more: &[&str]) -> String {
    let args =
        [&["synth", "views", "--psf", "psf.npy", "-o", output, "--test-fraction", "0.5"], more].concat();
    let run = udc(folder, &args);
    let said = String::from_utf8_lossy(&run.stderr).into_owned();
    assert!(run.status.success(), "{said}");
    said
}

#[test]
fn synthetic_images_saturate_where_their_sensor_does() {
    let scratch = scratch();
    let folder = scratch.path();
    assert_eq!(synth(folder, "dataset", &["--noise", &sensor()]), "");
    let dataset = Dataset::open(&folder.join("dataset")).unwrap();
    assert_eq!(dataset.formation.x_max, 16.0);
    for triplet in &dataset.triplets {
        assert_eq!(dataset.read_ground_truth(triplet).unwrap().max(), 16.0);
        assert_eq!(dataset.read_degraded(triplet).unwrap().max(), 16.0);
    }
    // Without a sensor, the scale is the published one.
    assert_eq!(synth(folder, "published", &[]), "");
    assert_eq!(Dataset::open(&folder.join("published")).unwrap().formation.x_max, 500.0);

    let said = synth(folder, "clipped-late", &["--noise", &sensor(), "--x-max", "500"]);
    assert!(said.contains("warning: x-max is 500") && said.contains("nothing above"), "{said}");
    assert_eq!(Dataset::open(&folder.join("clipped-late")).unwrap().formation.x_max, 500.0);
    let said = synth(folder, "clipped-early", &["--noise", &sensor(), "--x-max", "2"]);
    assert!(said.contains("is clipped"), "{said}");
}

/// A file from before, whose shortest exposure saturates at 500.
#[test]
fn a_sensor_may_say_its_electrons_or_its_white_but_not_two_things() {
    let scratch = scratch();
    let folder = scratch.path();
    let write = |text: &str| fs::write(folder.join("sensor.toml"), text).unwrap();
    write("full-well-e = 6000.0\nelectrons-per-unit = 192.0\n");
    assert_eq!(synth(folder, "before", &["--noise", "sensor:sensor.toml"]), "");
    let before = Dataset::open(&folder.join("before")).unwrap().formation;
    write("full-well-e = 6000.0\nwhite-irradiance = 31.25\n");
    synth(folder, "now", &["--noise", "sensor:sensor.toml"]);
    assert_eq!(Dataset::open(&folder.join("now")).unwrap().formation, before);
    assert_eq!(before.x_max, 500.0);
    let said = succeed(folder, &["info", "sensor.toml"]);
    assert!(
        said.contains("irradiance of 31.2500 in the longest") && said.contains("500.0000 (x-max)"),
        "{said}"
    );
    write("electrons-per-unit = 192.0\nwhite-irradiance = 1.0\n");
    let args = ["synth", "views", "--psf", "psf.npy", "-o", "none", "--noise", "sensor:sensor.toml"];
    let said = fail(folder, &args, 2);
    assert!(said.contains("electrons-per-unit") && said.contains("leave one of the two out"), "{said}");
}

/// The model says what its inputs were clipped at, which is what `udc restore` takes when no flag says otherwise.
#[test]
fn training_takes_the_scale_of_the_dataset() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "dataset", &["--noise", &sensor()]);
    let config = "iterations = 2\n[architecture]\nfeatures = 2\nfilter-size = 3\ncondition = \"image\"\n\
                  [data]\ncrop = 16\nbatch = 1\naccumulate = 1\n[validation]\ncrop = 16\n";
    fs::write(folder.join("config.toml"), config).unwrap();
    let expected = Some(ToneCurve { x_max: 16.0, ..ToneCurve::default() });
    let curve =
        |run: &str| Model::load(&folder.join(run).join("model.safetensors")).unwrap().origin().tone_curve();
    let train = ["train", "config.toml", "--data"];
    let live = ["--set", "data.degradation=on-the-fly"];
    succeed(folder, &[&train[..], &["dataset", "-o", "stored"]].concat());
    assert_eq!(curve("stored"), expected);
    succeed(folder, &[&train[..], &["dataset", "-o", "live"], &live].concat());
    assert_eq!(curve("live"), expected);

    // A folder of scenes says nothing; the configuration does.
    succeed(folder, &["codes", "psf.npy", "--angles=-3,0,3", "--dim", "1", "-o", "bank.safetensors"]);
    let views = [&train[..], &["views", "--bank", "bank.safetensors"], &live].concat();
    let scale = ["--set", "data.formation.x-max=16", "--set", "data.formation.noise.kind=sensor"];
    let run = udc(folder, &[&views[..], &["-o", "views"], &scale].concat());
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success() && !said.contains("x-max"), "{said}");
    assert_eq!(curve("views"), expected);
    // The sensor says it too.
    let run = udc(folder, &[&views[..], &["-o", "sensor"], &scale[2..]].concat());
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success() && !said.contains("x-max"), "{said}");
    let found = curve("sensor").unwrap();
    assert!((found.x_max - 16.0).abs() < 1e-4, "{found:?}");
    let said = fail(folder, &[&train[..], &["dataset", "-o", "both"], &live, &scale].concat(), 1);
    assert!(said.contains("data.formation goes with a folder of clean images"), "{said}");
}

/// What `udc synth` writes of a grey wall at half of white.
#[test]
fn noise_is_that_of_a_capture_not_thirty_one_times_poorer() {
    let scratch = scratch();
    let folder = scratch.path();
    let flat = LinearImage::from_planes(Array3::from_elem((3, 64, 64), 0.5)).unwrap();
    fs::create_dir(folder.join("flat")).unwrap();
    io::write_image(&folder.join("flat/grey_01.npy"), &flat, &WriteOptions::default()).unwrap();
    let noise = sensor();
    let flags = ["--split", "test", "--border", "replicate", "--noise", &noise];
    succeed(folder, &[&["synth", "flat", "--psf", "psf.npy", "-o", "dataset"][..], &flags].concat());
    let dataset = Dataset::open(&folder.join("dataset")).unwrap();
    let path = folder.join("dataset").join(&dataset.triplets[0].degraded);
    let green: Vec<f64> =
        io::read_image::<Linear>(&path).unwrap().channel(1).iter().map(|&v| f64::from(v)).collect();
    let mean = green.iter().sum::<f64>() / green.len() as f64;
    let variance = green.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (green.len() - 1) as f64;
    // Half of a full well of 6000 electrons, read noise 2.5 and steps of 6000/959: (3000 + 9.5) / 6000². The variance of
    // 4096 readings scatters by 2.2 %; five of these are allowed. It was 31 times this.
    let expected = 3009.5 / 6000f64.powi(2);
    assert!((variance / expected - 1.0).abs() < 0.11, "{variance}, expected {expected}");
}

/// The shipped sensor saturates at 16, and a deconvolution that takes its lamps for light of 16 does harm.
#[test]
fn restoring_a_synthetic_image_knows_where_its_sensor_saturates() {
    let scratch = scratch();
    let folder = scratch.path();
    synth(folder, "dataset", &["--noise", &sensor()]);
    let dataset = Dataset::open(&folder.join("dataset")).unwrap();
    let degraded = format!("dataset/{}", dataset.triplets[0].degraded);
    let restore = |output: &str, more: &[&str]| {
        let args = ["restore", &degraded, "--method", "constrained", "--psf", "psf.npy", "-o", output];
        succeed(folder, &[&args[..], more].concat());
        io::read_image::<Linear>(&folder.join(output)).unwrap()
    };
    let told = restore("told.exr", &["--x-max", "16"]);
    assert_eq!(restore("by_itself.exr", &[]), told);
    io::write_image(
        &folder.join("silent.exr"),
        &io::read_image::<Linear>(&folder.join(&degraded)).unwrap(),
        &WriteOptions::default(),
    )
    .unwrap();
    let args = ["restore", "silent.exr", "--method", "constrained", "--psf", "psf.npy", "-o", "wrong.exr"];
    succeed(folder, &args);
    assert_ne!(io::read_image::<Linear>(&folder.join("wrong.exr")).unwrap(), told);
}
