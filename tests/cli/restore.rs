//! `udc restore`.

use std::path::{Path, PathBuf};

use ndarray::{Array3, ArrayD};
use udc::codes::make_rotated_bank;
use udc::core::capture::CaptureInfo;
use udc::core::image::{Linear, LinearImage, ToneMapped, ToneMappedImage};
use udc::core::metrics::{MetricDefinition, psnr};
use udc::core::orientation::Orientation;
use udc::core::psf::Psf;
use udc::core::tone::ToneCurve;
use udc::io::{self, WriteOptions};
#[cfg(target_os = "linux")]
use udc::network::{Architecture, Model, Origin};
use udc::network::{Initialisation, Parameters, weights};

use super::common::{fail, succeed, udc};
use super::restore_files::{WIENER, write_captures};

fn fixture(name: &str) -> String {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name).to_str().unwrap().to_owned()
}

/// The network of the fixture, which reads image and code; 4 features, single scale.
pub(super) fn model() -> String {
    fixture("discnet/1.pth")
}

pub(super) fn code() -> String {
    fixture("discnet/1_code.npy")
}

pub(super) fn write_scene(path: &Path, height: usize, width: usize) {
    let value =
        |(c, y, x): (usize, usize, usize)| wave(c, y, x) + if (y / 20 + x / 30) % 5 == 0 { 6.0 } else { 0.0 };
    write_planes(path, Array3::from_shape_fn((3, height, width), value));
}

fn wave(c: usize, y: usize, x: usize) -> f32 {
    0.4 + 0.3 * ((y as f32) * 0.31 + c as f32).sin() * ((x as f32) * 0.17).cos()
}

fn write_planes(path: &Path, planes: Array3<f32>) {
    io::write_image(path, &LinearImage::from_planes(planes).unwrap(), &WriteOptions::default()).unwrap();
}

pub(super) fn psf() -> Psf {
    let energy = |(c, y, x): (usize, usize, usize)| {
        let (dy, dx) = (y as f32 - 10.0, x as f32 - 10.0);
        (-(dy * dy + dx * dx) / (1.0 + c as f32)).exp() + 0.002 * (1.0 + dx / 20.0)
    };
    Psf::from_energy(Array3::from_shape_fn((3, 21, 21), energy)).unwrap()
}

/// A scratch folder with a scene of 48 × 56, a PSF and a bank with codes of 5 numbers.
pub(super) fn scratch() -> tempfile::TempDir {
    let scratch = tempfile::tempdir().unwrap();
    write_scene(&scratch.path().join("scene.exr"), 48, 56);
    io::write_psf(&scratch.path().join("psf.exr"), &psf(), &WriteOptions::default()).unwrap();
    let angles = [-12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0];
    let bank = make_rotated_bank(&psf(), &angles, 5).unwrap();
    io::write_bank(&scratch.path().join("bank.safetensors"), &bank, false).unwrap();
    scratch
}

fn largest_difference(a: &ToneMappedImage, b: &ToneMappedImage) -> f32 {
    a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn restores_as_the_published_network_does() {
    let scratch = tempfile::tempdir().unwrap();
    let input = fixture("discnet/1_input.npy");
    let arguments = [
        "restore",
        &input,
        "--model",
        &model(),
        "--code",
        &code(),
        "--domain",
        "tone-mapped",
        "-o",
        "out.npy",
    ];
    assert!(succeed(scratch.path(), &arguments).contains("out.npy"));
    let restored = io::read_image::<ToneMapped>(&scratch.path().join("out.npy")).unwrap();
    let expected = io::read_image::<ToneMapped>(Path::new(&fixture("discnet/1_output.npy"))).unwrap();
    assert!(largest_difference(&restored, &expected) < 1e-5);
    assert!(fail(scratch.path(), &arguments, 1).contains("--overwrite"));
}

/// A few roundings of f32 in another order: 1e-5, as against other software.
#[test]
fn tiles_change_nothing() {
    let scratch = tempfile::tempdir().unwrap();
    write_scene(&scratch.path().join("scene.exr"), 205, 270);
    let (model, code) = (model(), code());
    let restore = |output: &str, more: &[&str]| {
        let common = ["restore", "scene.exr", "--model", &model, "--code", &code, "-o", output];
        succeed(scratch.path(), &[&common, &["--output-domain", "tone-mapped"][..], more].concat());
        io::read_image::<ToneMapped>(&scratch.path().join(output)).unwrap()
    };
    let whole = restore("whole.exr", &[]);
    let tiled = restore("tiled.exr", &["--tile", "64"]);
    assert!(largest_difference(&whole, &tiled) < 1e-5, "{}", largest_difference(&whole, &tiled));
}

#[test]
fn finds_the_code_by_angle_and_by_psf() {
    let scratch = scratch();
    let common = ["restore", "scene.exr", "--model", &model(), "--bank", "bank.safetensors"];
    let restore = |output: &str, more: &[&str]| {
        let output_domain = ["--output-domain", "tone-mapped"];
        succeed(scratch.path(), &[&common, more, &output_domain, &["-o", output][..]].concat());
        io::read_image::<ToneMapped>(&scratch.path().join(output)).unwrap()
    };
    let of_angle = restore("angle.exr", &["--angle", "0"]);
    let of_psf = restore("psf-code.exr", &["--psf", "psf.exr"]);
    let between = restore("between.exr", &["--angle", "-5.5"]);
    // The PSF is the bank's own, so that its projection differs from its code by rounding only.
    let (rounding, turned) =
        (largest_difference(&of_angle, &of_psf), largest_difference(&of_angle, &between));
    assert!(3.0 * rounding < turned, "{rounding} against {turned}");
}

#[test]
fn says_which_flags_a_code_needs() {
    let scratch = scratch();
    let model = model();
    let say = |more: &[&str], status: i32| {
        let common = ["restore", "scene.exr", "--model", &model, "-o", "out.exr"];
        fail(scratch.path(), &[&common, more].concat(), status)
    };
    let without = say(&[], 1);
    assert!(without.contains("--bank BANK with --angle A") && without.contains("--code"), "{without}");
    assert!(say(&["--bank", "bank.safetensors"], 1).contains("add --angle A"));
    assert!(say(&["--psf", "psf.exr"], 1).contains("add --bank BANK"));
    assert!(say(&["--angle", "3"], 2).contains("--bank"));
    assert!(say(&["--bank", "bank.safetensors", "--angle", "45"], 1).contains("45"));
    assert!(!scratch.path().join("out.exr").exists());
}

#[test]
fn refuses_a_model_of_another_kind() {
    let scratch = scratch();
    let said =
        fail(scratch.path(), &["restore", "scene.exr", "--model", "bank.safetensors", "-o", "o.exr"], 1);
    assert!(said.contains("bank.safetensors") && said.contains("kernel-bank"), "{said}");
    let said = fail(
        scratch.path(),
        &["restore", "scene.exr", "--model", &model(), "--bank", &model(), "--angle", "0", "-o", "o.exr"],
        1,
    );
    assert!(said.contains("1.pth"), "{said}");
}

/// A scene of small blocks seen through the PSF, summed as the image formation model says, and the scene itself: its
/// middle, so that what the PSF brings from outside of the frame is there.
fn seen_through_the_psf(height: usize, width: usize) -> [Array3<f32>; 2] {
    const MARGIN: usize = 20;
    let value = |c: usize, y: usize, x: usize| {
        wave(c, y, x) + if (y / 6 + x / 9).is_multiple_of(3) { 0.5 } else { 0.0 }
    };
    let psf = psf();
    let (cy, cx) = psf.centre();
    let seen = |(c, y, x): (usize, usize, usize)| {
        let taps = psf.channel(c);
        let beneath = |dy: usize, dx: usize| value(c, y + MARGIN + cy - dy, x + MARGIN + cx - dx);
        taps.indexed_iter().map(|((dy, dx), tap)| tap * beneath(dy, dx)).sum()
    };
    let clean = |(c, y, x): (usize, usize, usize)| value(c, y + MARGIN, x + MARGIN);
    let size = (3, height, width);
    [Array3::from_shape_fn(size, seen), Array3::from_shape_fn(size, clean)]
}

/// Away from the frame's edges, where no method knows what came from outside. Measured: 24.7 dB before and gains of 3.9, 7.3,
/// 6.5 and 9.0 dB; a decibel less must be left.
#[test]
fn deconvolves_by_every_method() {
    let scratch = scratch();
    let [seen, truth] = seen_through_the_psf(96, 104);
    write_planes(&scratch.path().join("seen.exr"), seen.clone());
    let middle = |planes: Array3<f32>| {
        let image = LinearImage::from_planes(planes).unwrap();
        ToneCurve::default().tone_map(&image).crop(16, 16, 64, 72)
    };
    let truth = middle(truth);
    let quality = |image: &ToneMappedImage| psnr(image, &truth, &MetricDefinition::float()).unwrap();
    let before = quality(&middle(seen));
    for (method, gain) in [
        ("wiener", 2.9),
        ("wiener-orieux", 6.3),
        ("richardson-lucy", 5.5),
        ("constrained", 8.0),
        ("joint", 8.0),
    ] {
        let output = format!("{method}.exr");
        succeed(
            scratch.path(),
            &["restore", "seen.exr", "--method", method, "--psf", "psf.exr", "-o", &output],
        );
        let restored = io::read_image::<Linear>(&scratch.path().join(&output)).unwrap();
        assert_eq!((restored.height(), restored.width()), (96, 104), "{method}");
        let after = quality(&middle(restored.into_planes()));
        assert!(after > before + gain, "{method}: {after:.2} dB of {before:.2} dB, a gain below {gain} dB");
    }
    let said = fail(scratch.path(), &["restore", "scene.exr", "--method", "constrained", "-o", "o.exr"], 2);
    assert!(said.contains("--psf"), "{said}");
}

#[test]
fn refuses_flags_that_the_method_would_ignore() {
    let scratch = scratch();
    let restore = |how: &[&str], flags: &[&str], code: i32| {
        let common = ["restore", "scene.exr", "-o", "o.exr", "--overwrite"];
        fail(scratch.path(), &[&common[..], how, flags].concat(), code)
    };
    let belongings: [(&[&str], &[&str], &str); 4] = [
        (&["--iterations", "3"], &["wiener", "wiener-orieux", "joint"], "richardson-lucy and constrained"),
        (&["--seed", "1"], &["wiener", "richardson-lucy", "constrained", "joint"], "wiener-orieux"),
        (&["--balance", "3"], &["wiener-orieux", "richardson-lucy", "constrained", "joint"], "wiener"),
        (&["--mask-saturated"], &["richardson-lucy", "constrained", "joint"], "wiener and wiener-orieux"),
    ];
    let (model, code) = (model(), code());
    let network = ["--model", &model, "--code", &code];
    for (flag, others, methods) in belongings {
        for other in others {
            let said = restore(&["--method", other, "--psf", "psf.exr"], flag, 2);
            let belongs = format!("{} belongs to --method {methods}", flag[0]);
            assert!(said.contains(&belongs) && said.contains(other), "{said}");
        }
        assert!(restore(&network, flag, 2).contains(flag[0]), "{flag:?}");
    }
    for flag in [["--angle", "3"], ["--field", "field.toml"]] {
        assert!(restore(&["--method", "wiener"], &flag, 2).contains("cannot be used with"), "{flag:?}");
    }
    assert!(restore(&network, &["--border", "zero"], 2).contains("--border"));
}

#[test]
fn gives_the_same_bytes_with_one_and_two_threads() {
    let scratch = scratch();
    for method in ["wiener-orieux", "constrained", "joint"] {
        let bytes = |threads: &str| {
            let output = format!("{method}-{threads}.npy");
            let common = ["restore", "scene.exr", "--method", method, "--psf", "psf.exr"];
            succeed(scratch.path(), &[&common[..], &["--threads", threads, "-o", &output]].concat());
            std::fs::read(scratch.path().join(output)).unwrap()
        };
        assert!(bytes("1") == bytes("2"), "{method}");
    }
}

#[test]
fn asks_for_the_domain_where_the_file_is_silent() {
    let scratch = scratch();
    succeed(scratch.path(), &["tonemap", "scene.exr", "-o", "scene.png"]);
    let restore = ["restore", "scene.png", "--method", "wiener", "--psf", "psf.exr", "-o", "out.png"];
    let said = fail(scratch.path(), &restore, 1);
    assert!(said.contains("--domain tone-mapped"), "{said}");
    succeed(scratch.path(), &[&restore[..], &["--domain", "tone-mapped"]].concat());
    let said = fail(
        scratch.path(),
        &["restore", "scene.exr", "--method", "wiener", "--psf", "psf.exr", "-o", "linear.png"],
        1,
    );
    assert!(said.contains("--output-domain tone-mapped"), "{said}");
    succeed(scratch.path(), &["tonemap", "scene.exr", "-o", "mapped.exr"]);
    let said = fail(
        scratch.path(),
        &[
            "restore",
            "mapped.exr",
            "--domain",
            "linear",
            "--method",
            "wiener",
            "--psf",
            "psf.exr",
            "-o",
            "o.exr",
        ],
        1,
    );
    assert!(said.contains("leave out the flag that says linear (as --domain or --psf-domain)"), "{said}");
}

/// In MiB: what is said that a restoration will take, and what the process took in the end.
#[cfg(target_os = "linux")]
fn memory_of(folder: &Path, how: &[&str]) -> (u64, u64) {
    let output =
        udc(folder, &[&["-v", "restore", "scene.exr", "-o", "o.exr", "--overwrite"][..], how].concat());
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{said}");
    let mib = |line: &str| line.strip_suffix(" MiB")?.rsplit(' ').next()?.parse().ok();
    let estimated = said.lines().find(|line| line.contains(" × ")).and_then(mib);
    let taken = said.lines().find(|line| line.contains("peak memory")).and_then(mib);
    (estimated.expect(&said), taken.expect(&said))
}

/// The full network, with random weights.
fn write_full_model(path: &Path) {
    let architecture = Architecture::default();
    let parameters = Parameters::random(&architecture, Initialisation::Released, 1);
    let weights = weights::Weights { architecture, parameters, origin: Origin::default() };
    Model::new(weights).save(path, false).unwrap();
}

#[cfg(target_os = "linux")]
#[test]
fn takes_no_more_memory_than_it_said() {
    let scratch = scratch();
    write_full_model(&scratch.path().join("model.safetensors"));
    let code = code();
    let network = ["--model", "model.safetensors", "--code", &code];
    let (tiled, wiener) =
        ([&network[..], &["--tile", "128"]].concat(), ["--method", "wiener", "--psf", "psf.exr"]);
    let deconvolution =
        |method, border| ["--method", method, "--psf", "psf.exr", "--border", border, "--x-max", "6"];
    let (lucy, constrained) =
        (deconvolution("richardson-lucy", "smooth"), deconvolution("constrained", "smooth"));
    let dark = deconvolution("constrained", "zero");
    for (side, how) in [
        (64, &network[..]),
        (384, &network),
        (384, &tiled),
        (768, &wiener),
        (768, &lucy),
        (768, &constrained),
        (768, &dark),
    ] {
        write_scene(&scratch.path().join("large.exr"), side, side);
        std::fs::rename(scratch.path().join("large.exr"), scratch.path().join("scene.exr")).unwrap();
        let (estimated, taken) = memory_of(scratch.path(), how);
        assert!(taken <= estimated, "{side}² {how:?}: {taken} MiB, {estimated} expected");
        assert!(taken * 3 > estimated * 2, "{side}² {how:?}: only {taken} MiB, {estimated} expected");
    }
}

/// Tiles are chosen by the memory that there is, and neither they nor the result depend on the number of threads.
#[test]
fn as_many_threads_as_there_are_make_the_same_image_in_the_same_windows() {
    let scratch = scratch();
    write_scene(&scratch.path().join("large.exr"), 400, 520);
    let (model, code) = (model(), code());
    let mut tilings = Vec::new();
    for limit in ["41MiB", "42MiB", "43MiB", "45MiB", "64MiB"] {
        let runs = ["1", "2", "16"].map(|threads| {
            let output = format!("{limit}-{threads}.npy");
            let how = ["--model", &model, "--code", &code, "--max-memory", limit, "--threads", threads];
            let restore = [&["restore", "large.exr", "-v", "-o", &output], &how[..]].concat();
            let run = udc(scratch.path(), &restore);
            assert!(run.status.success(), "{run:?}");
            let said = String::from_utf8(run.stderr).unwrap();
            let windows = said.lines().find(|line| line.contains(" of up to ")).unwrap();
            let tiling = windows.rsplit_once(',').unwrap().0.to_owned();
            (tiling, std::fs::read(scratch.path().join(output)).unwrap())
        });
        assert!(runs.iter().all(|run| *run == runs[0]), "{limit}: {:?}", runs.map(|run| run.0));
        tilings.push(runs[0].0.clone());
    }
    tilings.dedup();
    assert!(tilings.len() > 1, "{tilings:?}");
}

#[test]
fn refuses_too_little_memory_naming_what_would_do() {
    let scratch = scratch();
    write_scene(&scratch.path().join("scene-400.exr"), 400, 400);
    let call = |limit: &str, how: &[&str]| -> Vec<String> {
        let common = ["restore", "scene-400.exr", "-o", "o.exr", "--overwrite", "--max-memory", limit];
        common.iter().chain(how).map(ToString::to_string).collect()
    };
    let (model, code) = (model(), code());
    for how in [
        ["--method", "constrained", "--psf", "psf.exr"],
        ["--model", &model, "--code", &code],
        ["--model", "guided", "--psf", "psf.exr"],
    ] {
        let refused = call("100kB", &how);
        let said = fail(scratch.path(), &refused.iter().map(String::as_str).collect::<Vec<_>>(), 1);
        let (_, least) = said.trim().rsplit_once("allow at least ").expect(&said);
        let enough = call(&least.replace(' ', ""), &how);
        succeed(scratch.path(), &enough.iter().map(String::as_str).collect::<Vec<_>>());
    }
    assert!(fail(scratch.path(), &["restore", "x", "--max-memory", "lots"], 2).contains("2GiB"));
}

/// A network restores images that are tone-mapped as those that it learned from.
#[test]
fn tone_maps_as_the_model_was_trained_unless_told_otherwise() {
    let scratch = scratch();
    let mut trained = weights::read(Path::new(&model())).unwrap();
    trained.origin.training = Some(serde_json::json!({"tone-curve": {"alpha": 2.0, "x-max": 5.0}}));
    Model::new(trained).save(&scratch.path().join("trained.safetensors"), false).unwrap();
    let code = code();
    let restore = |model: &str, more: &[&str], output: &str| {
        let common = ["restore", "scene.exr", "--model", model, "--code", &code, "-o", output];
        let run = udc(scratch.path(), &[&common[..], more].concat());
        assert!(run.status.success(), "{run:?}");
        let said = String::from_utf8(run.stderr).unwrap();
        (io::read_image::<Linear>(&scratch.path().join(output)).unwrap(), said)
    };
    let (of_model, said) = restore("trained.safetensors", &[], "of_model.exr");
    assert!(!said.contains("warning"), "{said}");
    let told = restore(&model(), &["--alpha", "2", "--x-max", "5"], "told.exr").0;
    assert_eq!(of_model, told);
    let (usual, said) = restore("trained.safetensors", &["--alpha", "0.25", "--x-max", "500"], "usual.exr");
    assert!(said.contains("--alpha 2 --x-max 5"), "{said}");
    assert_eq!(usual, restore(&model(), &[], "default.exr").0);
    assert!(usual != of_model);
}

/// Where the CPU has no such products nothing changes, and the user is told.
#[test]
fn multiplies_as_precisely_as_told_and_says_what_it_did() {
    let scratch = scratch();
    write_full_model(&scratch.path().join("model.safetensors"));
    let code = code();
    let common = ["restore", "scene.exr", "--model", "model.safetensors", "--code", &code];
    let run = |more: &[&str]| {
        let output = udc(scratch.path(), &[&common[..], more].concat());
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    run(&["--output-domain", "tone-mapped", "-o", "f32.exr"]);
    let said = run(&["--output-domain", "tone-mapped", "-o", "bf16.exr", "--precision", "bf16"]);
    let read = |name: &str| io::read_image::<ToneMapped>(&scratch.path().join(name)).unwrap();
    let (exact, rounded) = (read("f32.exr"), read("bf16.exr"));
    let pairs = exact.as_slice().iter().zip(rounded.as_slice());
    let largest = pairs.map(|(a, b)| (a - b).abs()).fold(0.0f32, f32::max);
    let recorded = succeed(scratch.path(), &["info", "bf16.exr"]);
    if said.contains("no products in bfloat16") {
        assert_eq!((largest, recorded.contains("\"precision\":\"f32\"")), (0.0, true), "{recorded}");
    } else {
        assert!(
            largest > 0.0 && largest < 1e-2 && recorded.contains("\"precision\":\"bf16\""),
            "{largest}: {recorded}"
        );
    }
    let method = [
        "restore",
        "scene.exr",
        "--method",
        "wiener",
        "--psf",
        "psf.exr",
        "--precision",
        "bf16",
        "-o",
        "o.exr",
    ];
    assert!(fail(scratch.path(), &method, 2).contains("--precision"));
}

#[test]
fn finds_the_angle_and_treats_highlights_as_told() {
    let scratch = scratch();
    let common = ["restore", "scene.exr", "--model", &model(), "--bank", "bank.safetensors", "--angle"];
    let run = |more: &[&str]| succeed(scratch.path(), &[&common[..], more].concat());
    let said = run(&["auto", "-o", "auto.exr"]);
    assert!(said.contains("the panel is turned by") && said.contains("nearest kernel r"), "{said}");
    let read = |name: &str| io::read_image::<Linear>(&scratch.path().join(name)).unwrap();
    let scene = read("scene.exr");
    // Everything at 6 and above counts as saturated, so that the patches of the scene are.
    run(&["0", "--x-max", "6", "-o", "network.exr"]);
    run(&["0", "--x-max", "6", "--highlights", "keep", "-o", "keep.exr"]);
    let (network, keep) = (read("network.exr"), read("keep.exr"));
    let mut kept = 0;
    for ((place, &captured), &value) in scene.planes().indexed_iter().zip(keep.planes()) {
        if captured >= 6.0 {
            kept += 1;
            assert!((value - 6.0).abs() < 1e-2, "{value} at {place:?}");
        } else if captured < 5.9 {
            assert_eq!(value, network.planes()[place]);
        }
    }
    assert!(kept > 100, "{kept}");
    assert!(fail(scratch.path(), &[&common[..], &["maybe", "-o", "o.exr"]].concat(), 2).contains("auto"));
}

/// A field with one PSF at every place is that PSF; one that varies changes the frame where it does.
#[test]
fn interpolates_codes_over_the_field() {
    let scratch = scratch();
    // A streak, whose codes change much with the angle.
    let streak = |(c, y, x): (usize, usize, usize)| {
        let (dy, dx) = (y as f32 - 10.0, x as f32 - 10.0);
        (-(dy * dy / (9.0 + c as f32) + dx * dx)).exp() + 5e-4
    };
    let straight = Psf::from_energy(Array3::from_shape_fn((3, 21, 21), streak)).unwrap();
    let turned = udc::codes::rotate(&straight, 40.0).unwrap();
    let bank = make_rotated_bank(&straight, &[-60.0, -40.0, -20.0, 0.0, 20.0, 40.0, 60.0], 5).unwrap();
    io::write_bank(&scratch.path().join("bank.safetensors"), &bank, true).unwrap();
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    io::write_psf(&scratch.path().join("psf.exr"), &straight, &options).unwrap();
    io::write_psf(&scratch.path().join("turned.exr"), &turned, &options).unwrap();
    let write = |name: &str, right: &str| {
        let text = format!("rows = 1\ncolumns = 2\npsfs = [\"psf.exr\", \"{right}\"]\n");
        std::fs::write(scratch.path().join(name), text).unwrap();
    };
    write("same.toml", "psf.exr");
    write("varying.toml", "turned.exr");
    let common = ["restore", "scene.exr", "--model", &model(), "--bank", "bank.safetensors"];
    let restore = |output: &str, flag: &str, file: &str| {
        succeed(scratch.path(), &[&common[..], &[flag, file, "-o", output]].concat());
        io::read_image::<Linear>(&scratch.path().join(output)).unwrap()
    };
    let one = restore("one.exr", "--psf", "psf.exr");
    let same = restore("same.exr", "--field", "same.toml");
    let varying = restore("varying.exr", "--field", "varying.toml");
    // Tone-mapped, since rounding grows with the light: the inverse of the tone mapping is steep where it is bright.
    let worst = |a: &LinearImage, x: usize| {
        let column = |image: &LinearImage| {
            image.planes().slice(ndarray::s![.., .., x]).mapv(|light| ToneCurve::default().compress(light))
        };
        (column(a) - column(&one)).iter().fold(0.0f32, |worst, d| worst.max(d.abs()))
    };
    let everywhere = (0..56).map(|x| worst(&same, x)).fold(0.0, f32::max);
    // A few roundings of 1 in 32 bits.
    assert!(everywhere < 1e-6, "{everywhere}");
    assert!(worst(&varying, 55) > 10.0 * everywhere, "{} {everywhere}", worst(&varying, 55));
    std::fs::write(scratch.path().join("short.toml"), "rows = 2\ncolumns = 2\npsfs = [\"psf.exr\"]\n")
        .unwrap();
    let refused = [&common[..], &["--field", "short.toml", "-o", "o.exr"]].concat();
    assert!(fail(scratch.path(), &refused, 1).contains("names 1 PSFs for 2 × 2 places"));
}

#[test]
fn says_beforehand_what_memory_it_takes() {
    let scratch = scratch();
    write_captures(scratch.path(), &["a.exr", "b.exr", "c.exr"]);
    write_scene(&scratch.path().join("captures/d.exr"), 30, 24);
    let lines = |how: &[&str], quiet: &[&str]| {
        let restore = [quiet, &["restore", "captures", "-o", "out", "--overwrite"], how].concat();
        let output = udc(scratch.path(), &restore);
        assert!(output.status.success());
        let said = String::from_utf8(output.stderr).unwrap();
        said.lines().filter(|line| line.contains("memory up to")).map(str::to_owned).collect::<Vec<_>>()
    };
    let said = lines(&WIENER, &[]);
    assert_eq!(said.len(), 2, "{said:?}");
    assert!(said[0].starts_with("20 × 24: ") && said[1].starts_with("30 × 24: "), "{said:?}");
    let said = lines(&["--model", &model(), "--code", &code()], &[]);
    assert!(said[0].contains("1 window of up to 20 × 24"), "{said:?}");
    assert!(lines(&WIENER, &["-q"]).is_empty());
}

#[test]
fn a_code_may_be_a_row_or_a_column() {
    let scratch = scratch();
    let (model, code) = (model(), code());
    let values = io::read_code(Path::new(&code)).unwrap().to_vec();
    for (name, shape) in [("row.npy", vec![1, values.len()]), ("column.npy", vec![values.len(), 1])] {
        let array = ArrayD::from_shape_vec(shape, values.clone()).unwrap();
        io::write_array(&scratch.path().join(name), &array, false).unwrap();
    }
    let restored = |code: &str, output: &str| {
        succeed(scratch.path(), &["restore", "scene.exr", "--model", &model, "--code", code, "-o", output]);
        io::read_image::<Linear>(&scratch.path().join(output)).unwrap()
    };
    let expected = restored(&code, "vector.exr");
    assert_eq!(restored("row.npy", "row.exr"), expected);
    assert_eq!(restored("column.npy", "column.exr"), expected);
}

/// A JPEG is finished as `udc finish` does it without a word, with what is known of the capture.
#[test]
fn a_jpeg_is_what_finishing_makes_of_the_restored_light() {
    let scratch = scratch();
    let (model, code) = (model(), code());
    let info = CaptureInfo {
        saturation: Some([5.0, 4.0, 4.5]),
        orientation: Orientation::from_exif(6),
        baseline_exposure_ev: Some(0.5),
        ..CaptureInfo::default()
    };
    let scene = io::read_image::<Linear>(&scratch.path().join("scene.exr")).unwrap();
    let known = WriteOptions { capture: Some(info), ..WriteOptions::default() };
    io::write_image(&scratch.path().join("known.exr"), &scene, &known).unwrap();
    let method = ["--method", "wiener", "--psf", "psf.exr"];
    for (name, how) in [("a", &["--model", &model, "--code", &code][..]), ("b", &method)] {
        for input in ["scene.exr", "known.exr"] {
            let [light, finished, photo] =
                ["exr", "finished.jpg", "jpg"].map(|end| format!("{name}-{input}.{end}"));
            succeed(scratch.path(), &[&["restore", input, "-o", &light], how].concat());
            succeed(scratch.path(), &["finish", &light, "-o", &finished]);
            succeed(scratch.path(), &[&["restore", input, "-o", &photo], how].concat());
            let [finished, photo] =
                [finished, photo].map(|file| std::fs::read(scratch.path().join(file)).unwrap());
            assert!(finished == photo, "{name} of {input}");
        }
    }
    let folder =
        [&["restore", "scene.exr", "known.exr", "-o", "photos", "--format", "jpg"], &method[..]].concat();
    succeed(scratch.path(), &folder);
    assert_eq!(io::list_folder(&scratch.path().join("photos")).unwrap(), ["known.jpg", "scene.jpg"]);
    let said = succeed(scratch.path(), &[&folder[..], &["--resume"]].concat());
    assert!(said.contains("2 of 2 images are there"), "{said}");
    for domain in ["linear", "tone-mapped"] {
        let asked = ["restore", "scene.exr", "-o", "c.jpg", "--output-domain", domain];
        let said = fail(scratch.path(), &[&asked, &method[..]].concat(), 2);
        assert!(said.contains("--output-domain") && said.contains("write .exr"), "{said}");
    }
}
