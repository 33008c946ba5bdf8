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

#[cfg(unix)]
use super::common::interrupt_after;
use super::common::{fail, succeed, udc};

fn fixture(name: &str) -> String {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name).to_str().unwrap().to_owned()
}

/// The network of the fixture, which reads image and code; 4 features, single scale.
fn model() -> String {
    fixture("discnet/1.pth")
}

fn code() -> String {
    fixture("discnet/1_code.npy")
}

fn write_scene(path: &Path, height: usize, width: usize) {
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

fn psf() -> Psf {
    let energy = |(c, y, x): (usize, usize, usize)| {
        let (dy, dx) = (y as f32 - 10.0, x as f32 - 10.0);
        (-(dy * dy + dx * dx) / (1.0 + c as f32)).exp() + 0.002 * (1.0 + dx / 20.0)
    };
    Psf::from_energy(Array3::from_shape_fn((3, 21, 21), energy)).unwrap()
}

/// A scratch folder with a scene of 48 × 56, a PSF and a bank with codes of 5 numbers.
fn scratch() -> tempfile::TempDir {
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
        succeed(scratch.path(), &[&common, more, &["-o", output][..]].concat());
        io::read_image::<Linear>(&scratch.path().join(output)).unwrap()
    };
    let of_angle = restore("angle.exr", &["--angle", "0"]);
    let of_psf = restore("psf-code.exr", &["--psf", "psf.exr"]);
    let between = restore("between.exr", &["--angle", "-5.5"]);
    let distance = |a: &LinearImage, b: &LinearImage| {
        a.as_slice()
            .iter()
            .zip(b.as_slice())
            .map(|(a, b)| (a - b).abs() / (b.abs() + 0.1))
            .fold(0.0, f32::max)
    };
    // The PSF is the bank's own, so that its projection differs from its code by rounding only.
    let (rounding, turned) = (distance(&of_angle, &of_psf), distance(&of_angle, &between));
    assert!(rounding < 0.1 * turned, "{rounding} against {turned}");
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
    for (method, gain) in
        [("wiener", 2.9), ("wiener-orieux", 6.3), ("richardson-lucy", 5.5), ("constrained", 8.0)]
    {
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
        (&["--iterations", "3"], &["wiener", "wiener-orieux"], "richardson-lucy and constrained"),
        (&["--seed", "1"], &["wiener", "richardson-lucy", "constrained"], "wiener-orieux"),
        (&["--balance", "3"], &["wiener-orieux", "richardson-lucy", "constrained"], "wiener"),
        (&["--mask-saturated"], &["richardson-lucy", "constrained"], "wiener and wiener-orieux"),
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
    assert!(restore(&network, &["--border", "zero"], 2).contains("--border"));
}

#[test]
fn gives_the_same_bytes_with_one_and_two_threads() {
    let scratch = scratch();
    for method in ["wiener-orieux", "constrained"] {
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
fn does_the_others_when_one_file_of_a_folder_is_corrupt() {
    let scratch = scratch();
    let folder = scratch.path().join("captures");
    std::fs::create_dir(&folder).unwrap();
    for name in ["a.exr", "c.exr"] {
        write_scene(&folder.join(name), 20, 24);
    }
    let bytes = std::fs::read(folder.join("a.exr")).unwrap();
    std::fs::write(folder.join("b.exr"), &bytes[..bytes.len() / 2]).unwrap();
    let mut broken = ArrayD::from_elem(vec![8, 8, 3], 0.5f32);
    broken[[3, 4, 1]] = f32::NAN;
    io::write_array(&folder.join("d.npy"), &broken, false).unwrap();

    let output = udc(
        scratch.path(),
        &["restore", "captures", "--method", "wiener", "--psf", "psf.exr", "-o", "restored"],
    );
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr);
    let last = said.lines().last().unwrap();
    assert!(last.contains("2 of 4 images") && last.contains("b.exr") && last.contains("d.npy"), "{said}");
    assert!(last.contains("NaN"), "{said}");
    let mut done: Vec<_> = std::fs::read_dir(scratch.path().join("restored"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    done.sort();
    assert_eq!(done, ["a.exr", "c.exr"]);
}

#[test]
fn restores_a_bracket_as_its_fused_image() {
    let scratch = scratch();
    let scene = io::read_image::<Linear>(&scratch.path().join("scene.exr")).unwrap();
    for (name, time) in [("long.exr", 1.0), ("middle.exr", 0.25), ("short.exr", 0.0625)] {
        let picture: LinearImage = scene.map_values(|v| (v * time).min(1.0));
        io::write_image(&scratch.path().join(name), &picture, &WriteOptions::default()).unwrap();
    }
    let how = ["--method", "wiener", "--psf", "psf.exr"];
    let bracket = ["restore", "--exposures", "1,1/4,1/16", "long.exr", "middle.exr", "short.exr"];
    succeed(scratch.path(), &[&bracket, &how[..], &["-o", "bracket.exr"]].concat());
    succeed(scratch.path(), &[&["restore", "scene.exr"][..], &how, &["-o", "single.exr"]].concat());
    let [a, b] = ["bracket.exr", "single.exr"]
        .map(|name| io::read_image::<Linear>(&scratch.path().join(name)).unwrap());
    let worst = a.as_slice().iter().zip(b.as_slice()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 1e-3, "{worst}");
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
    assert!(said.contains("leave out the flag that says linear (--domain)"), "{said}");
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
    for limit in ["37MiB", "38MiB", "39MiB", "41MiB", "60MiB"] {
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
    let common = ["restore", "scene.exr", "-o", "o.exr", "--max-memory", "100kB"];
    for how in [["--method", "constrained", "--psf", "psf.exr"], ["--model", &model(), "--code", &code()]] {
        let said = fail(scratch.path(), &[&common[..], &how].concat(), 1);
        assert!(said.contains("allow at least"), "{said}");
    }
    assert!(fail(scratch.path(), &["restore", "x", "--max-memory", "lots"], 2).contains("2GiB"));
}

/// A mosaic of a scene in three exposures, 10 bits above a black level, as a camera would store it.
fn write_raw_bracket(folder: &Path, exposures: &[(&str, f32)], shift: usize) {
    write_filtered_bracket(folder, exposures, shift, [1.0; 4]);
}

/// The same, the four photosites of each cell behind filters.
fn write_filtered_bracket(folder: &Path, exposures: &[(&str, f32)], shift: usize, filters: [f32; 4]) {
    std::fs::create_dir_all(folder).unwrap();
    for (index, (name, time)) in exposures.iter().enumerate() {
        let mosaic = ArrayD::from_shape_fn(vec![96, 112], |place| {
            let (y, x) = (place[0], place[1] + shift * index);
            let lamp = |cy: f32, cx: f32| (-((y as f32 - cy).powi(2) + (x as f32 - cx).powi(2)) / 30.0).exp();
            let light = 0.2 + 12.0 * lamp(40.0, 50.0) + 6.0 * lamp(70.0, 20.0) + 9.0 * lamp(20.0, 90.0);
            let filter = filters[place[0] % 2 * 2 + place[1] % 2];
            (64.0 + (light * filter * time).min(1.0) * 959.0).round()
        });
        io::write_array(&folder.join(name), &mosaic, true).unwrap();
    }
}

const RAW: [&str; 8] = ["--white", "1023", "--black", "64", "--bayer", "rggb", "--exposures", "1,1/4,1/16"];

#[test]
fn restores_brackets_of_mosaics_folder_by_folder() {
    let scratch = scratch();
    let exposures = [("1.npy", 1.0), ("2.npy", 0.25), ("3.npy", 0.0625)];
    for scene in ["scenes/a", "scenes/b"] {
        write_raw_bracket(&scratch.path().join(scene), &exposures, 0);
    }
    let how = ["--method", "wiener", "--psf", "psf.exr"];
    let restore = |more: &[&'static str]| [&["restore", "scenes"][..], &RAW, &how, more].concat();
    succeed(scratch.path(), &restore(&["-o", "out"]));
    let balanced = ["-o", "balanced", "--white-balance", "2,1,1.5"];
    succeed(scratch.path(), &restore(&balanced));
    let read = |name: &str| io::read_image::<Linear>(&scratch.path().join(name)).unwrap();
    let (plain, balanced) = (read("out/a.exr"), read("balanced/a.exr"));
    assert_eq!(plain, read("out/b.exr"));
    for (channel, gain) in [2.0, 1.0, 1.5].into_iter().enumerate() {
        let ratio = balanced.channel(channel)[[48, 100]] / plain.channel(channel)[[48, 100]];
        assert!((ratio / gain - 1.0).abs() < 0.05, "channel {channel}: {ratio}");
    }
    std::fs::remove_file(scratch.path().join("scenes/b/2.npy")).unwrap();
    let output = udc(scratch.path(), &restore(&["-o", "missing"]));
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("1 of 2 images") && said.contains("expected 3 pictures"), "{said}");
    assert!(scratch.path().join("missing/a.exr").exists());
}

#[test]
fn says_what_is_wrong_with_a_bracket() {
    let scratch = scratch();
    let exposures = [("1.npy", 1.0), ("2.npy", 0.25), ("3.npy", 0.0625)];
    write_filtered_bracket(&scratch.path().join("raw"), &exposures, 0, [0.5, 1.0, 1.0, 0.3]);
    let all = ["raw/1.npy", "raw/2.npy", "raw/3.npy"];
    let flags = |black: &'static str, bayer: &'static str| {
        ["--white", "1023", "--black", black, "--bayer", bayer, "--exposures", "1,1/4,1/16", "--overwrite"]
    };
    let run = |pictures: &[&'static str], black, bayer| {
        let how = ["--method", "wiener", "--psf", "psf.exr", "-o", "out.exr"];
        let arguments = [&["restore"][..], pictures, &flags(black, bayer), &how].concat();
        let output = udc(scratch.path(), &arguments);
        (output.status.code(), String::from_utf8(output.stderr).unwrap())
    };
    let refuses = |pictures: &[&'static str], black, reason: &str| {
        let (code, said) = run(pictures, black, "rggb");
        assert!(code == Some(1) && said.contains(reason) && said.lines().count() == 1, "{code:?} {said}");
    };
    refuses(&["raw/3.npy", "raw/2.npy", "raw/1.npy"], "64", "is brighter than picture 1");
    refuses(&["raw/1.npy", "raw/3.npy", "raw/2.npy"], "64", "is brighter than picture 2");
    refuses(&all[..2], "64", "expected 3 pictures, one for each exposure time, found 2");
    refuses(&all, "200", "black: lies above");
    refuses(&all, "2000", "white: must lie above black 2000, found 1023");
    let (code, said) = run(&all, "64", "rggb");
    assert!(code == Some(0) && !said.contains("warning"), "{said}");
    for wrong in ["grbg", "gbrg"] {
        let (code, said) = run(&all, "64", wrong);
        assert!(code == Some(0) && said.contains("check --bayer"), "{said}");
    }
    let mosaic = ArrayD::from_elem(vec![94, 112], 70.0f32);
    io::write_array(&scratch.path().join("raw/2.npy"), &mosaic, true).unwrap();
    refuses(&all, "64", "picture 2 of the bracket: expected 1 channels of 96 × 112");
}

#[test]
fn refuses_a_bracket_that_moved_unless_told() {
    let scratch = scratch();
    let exposures = [("1.npy", 1.0), ("2.npy", 0.25), ("3.npy", 0.0625)];
    write_raw_bracket(&scratch.path().join("moved"), &exposures, 4);
    let how = ["--method", "wiener", "--psf", "psf.exr", "-o", "out.exr"];
    let restore = [&["restore", "moved"][..], &RAW, &how].concat();
    let said = fail(scratch.path(), &restore, 1);
    assert!(said.contains("picture 2") && said.contains("--allow-motion"), "{said}");
    succeed(scratch.path(), &[&restore[..], &["--allow-motion"]].concat());
}

#[test]
fn reads_exposure_times_from_the_files_and_says_when_there_are_none() {
    let scratch = scratch();
    let scene = io::read_image::<Linear>(&scratch.path().join("scene.exr")).unwrap();
    let write = |name: &str, time: f32, exposure_s| {
        let planes = scene.planes().mapv(|v| (v * time).min(1.0));
        let pixels = io::Pixels { exposure_s, ..io::Pixels::of_planes(planes) };
        let options = io::PixelOptions { overwrite: true, ..io::PixelOptions::default() };
        io::write_pixels(&scratch.path().join(name), &pixels, options).unwrap();
    };
    for (name, time) in [("1.exr", 1.0), ("2.exr", 0.25), ("3.exr", 0.0625)] {
        write(name, time, Some(f64::from(time)));
    }
    let how = ["--method", "wiener", "--psf", "psf.exr"];
    let restore = [&["restore", "--bracket", "1.exr", "2.exr", "3.exr"][..], &how].concat();
    succeed(scratch.path(), &[&restore[..], &["-o", "bracket.exr"]].concat());
    succeed(scratch.path(), &[&["restore", "scene.exr", "-o", "single.exr"][..], &how].concat());
    let [a, b] = ["bracket.exr", "single.exr"]
        .map(|name| io::read_image::<Linear>(&scratch.path().join(name)).unwrap());
    assert!(a.as_slice().iter().zip(b.as_slice()).all(|(a, b)| (a - b).abs() < 1e-3));
    write("2.exr", 0.25, None);
    let said = fail(scratch.path(), &[&restore[..], &["-o", "o.exr"]].concat(), 1);
    assert!(said.contains("add --exposures"), "{said}");
}

#[test]
fn goes_on_where_it_ended() {
    let scratch = scratch();
    let folder = scratch.path().join("captures");
    std::fs::create_dir(&folder).unwrap();
    for name in ["a.exr", "b.exr", "c.exr"] {
        std::fs::copy(scratch.path().join("scene.exr"), folder.join(name)).unwrap();
    }
    let restore = |more: &[&'static str]| {
        [&["restore", "captures", "--method", "wiener", "--psf", "psf.exr", "-o", "out"][..], more].concat()
    };
    succeed(scratch.path(), &restore(&[]));
    let written = |name: &str| scratch.path().join("out").join(name).metadata().unwrap().modified().unwrap();
    let before = written("a.exr");
    std::fs::remove_file(scratch.path().join("out/b.exr")).unwrap();
    let said = succeed(scratch.path(), &restore(&["--resume"]));
    assert!(said.contains("2 of 3 images are there") && said.contains("b.exr"), "{said}");
    assert_eq!(written("a.exr"), before);
    assert!(fail(scratch.path(), &restore(&[]), 1).contains("--overwrite"));
    let said = fail(scratch.path(), &restore(&["--resume", "--balance", "0.5"]), 1);
    assert!(said.contains("other settings"), "{said}");
}

/// After Ctrl-C there are finished files and nothing else, and the run can be taken up again.
#[cfg(unix)]
#[test]
fn an_interrupt_leaves_finished_files_only() {
    let scratch = scratch();
    let folder = scratch.path().join("captures");
    std::fs::create_dir(&folder).unwrap();
    write_scene(&scratch.path().join("large.exr"), 160, 200);
    let count = 30;
    for index in 0..count {
        std::fs::copy(scratch.path().join("large.exr"), folder.join(format!("{index:02}.exr"))).unwrap();
    }
    let restore = ["restore", "captures", "--method", "constrained", "--psf", "psf.exr", "-o", "out"];
    let (code, said) = interrupt_after(scratch.path(), &restore, "out/00.exr");
    assert!(code == Some(1) && said.contains("interrupted"), "{said}");
    let names = io::list_folder(&scratch.path().join("out")).unwrap();
    assert!((1..count).contains(&names.len()), "{names:?}");
    for name in &names {
        io::read_image::<Linear>(&scratch.path().join("out").join(name)).unwrap();
    }
    let said = succeed(scratch.path(), &[&restore[..], &["--resume"]].concat());
    assert!(said.contains(&format!("{} of {count} images are there", names.len())), "{said}");
    assert_eq!(io::list_folder(&scratch.path().join("out")).unwrap().len(), count);
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

/// A folder `captures` with scenes of these names, of 20 × 24 pixels.
fn write_captures(folder: &Path, names: &[&str]) {
    std::fs::create_dir(folder.join("captures")).unwrap();
    for name in names {
        write_scene(&folder.join("captures").join(name), 20, 24);
    }
}

const WIENER: [&str; 4] = ["--method", "wiener", "--psf", "psf.exr"];

fn restore_by_wiener<'a>(inputs: &[&'a str], more: &[&'a str]) -> Vec<&'a str> {
    [&["restore"][..], inputs, &WIENER, more].concat()
}

#[cfg(unix)]
#[test]
fn restores_and_finishes_files_whose_names_are_no_text() {
    use std::os::unix::ffi::OsStrExt as _;
    let scratch = scratch();
    write_captures(scratch.path(), &["a.exr"]);
    let captures = scratch.path().join("captures");
    let odd = std::ffi::OsStr::from_bytes(b"\xff.exr");
    // Some file systems take names that are text only.
    if std::fs::rename(captures.join("a.exr"), captures.join(odd)).is_err() {
        return;
    }
    succeed(scratch.path(), &restore_by_wiener(&["captures"], &["-o", "out"]));
    succeed(scratch.path(), &["finish", "captures", "-o", "finished", "--format", "exr"]);
    for folder in ["out", "finished"] {
        assert_eq!(io::list_folder(&scratch.path().join(folder)).unwrap(), ["\u{fffd}.exr"]);
    }
}

/// Runs `udc` with another stdout than a file or a reader; returns exit code and stderr.
#[cfg(target_os = "linux")]
fn run_with_stdout(folder: &Path, args: &[&str], stdout: std::process::Stdio) -> (Option<i32>, String) {
    let mut run = std::process::Command::new(env!("CARGO_BIN_EXE_udc"))
        .args(args)
        .current_dir(folder)
        .stdout(stdout)
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(run.stdout.take());
    let output = run.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[cfg(target_os = "linux")]
#[test]
fn a_stdout_that_takes_nothing_does_not_stop_the_work() {
    let scratch = scratch();
    let names = ["a.exr", "b.exr", "c.exr", "d.exr"];
    write_captures(scratch.path(), &names);
    let restore = restore_by_wiener(&["captures"], &["-o", "out", "--overwrite"]);
    let (code, said) = run_with_stdout(scratch.path(), &restore, std::process::Stdio::piped());
    assert_eq!(code, Some(0), "{said}");
    assert_eq!(io::list_folder(&scratch.path().join("out")).unwrap(), names);

    std::fs::remove_dir_all(scratch.path().join("out")).unwrap();
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let (code, said) = run_with_stdout(scratch.path(), &restore, full.into());
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("writing to stdout: No space left") && !said.contains("not done"), "{said}");
    assert_eq!(io::list_folder(&scratch.path().join("out")).unwrap(), names);
}

#[test]
fn resumes_with_what_decides_the_result_and_nothing_else() {
    let scratch = scratch();
    write_captures(scratch.path(), &["a.exr", "b.exr"]);
    succeed(scratch.path(), &["convert", &model(), "net.safetensors"]);
    let code = code();
    let common = ["restore", "captures", "--model", "net.safetensors", "--code", &code, "-o", "out"];
    succeed(scratch.path(), &common);
    let resume = |more: &[&'static str]| [&common[..], &["--resume"], more].concat();
    let said = succeed(scratch.path(), &resume(&["--max-memory", "1GiB"]));
    assert!(said.contains("2 of 2 images are there"), "{said}");
    for other in [&["--half"][..], &["--output-domain", "tone-mapped"], &["--domain", "linear"]] {
        let said = fail(scratch.path(), &resume(other), 1);
        assert!(said.contains("other settings"), "{other:?}: {said}");
    }
    let file = scratch.path().join("net.safetensors");
    let mut weights = weights::read(&file).unwrap();
    weights.parameters = Parameters::random(&weights.architecture, Initialisation::Released, 3);
    weights::write(&file, &weights, true).unwrap();
    let said = fail(scratch.path(), &resume(&[]), 1);
    assert!(said.contains("other settings"), "{said}");
}

#[test]
fn a_deconvolution_resumes_with_the_same_psf_only() {
    let scratch = scratch();
    write_captures(scratch.path(), &["a.exr"]);
    succeed(scratch.path(), &restore_by_wiener(&["captures"], &["-o", "out"]));
    let turned = udc::codes::rotate(&psf(), 20.0).unwrap();
    let options = WriteOptions { overwrite: true, ..WriteOptions::default() };
    io::write_psf(&scratch.path().join("psf.exr"), &turned, &options).unwrap();
    let said = fail(scratch.path(), &restore_by_wiener(&["captures"], &["-o", "out", "--resume"]), 1);
    assert!(said.contains("other settings"), "{said}");
}

#[test]
fn a_name_with_a_slash_is_a_folder_that_is_made() {
    let scratch = scratch();
    let exposures = [("1.npy", 1.0), ("2.npy", 0.25), ("3.npy", 0.0625)];
    write_raw_bracket(&scratch.path().join("brackets/one"), &exposures, 0);
    let restore = |input: &'static str, output: &'static str| {
        let raw = if input == "scene.exr" { &[][..] } else { &RAW };
        restore_by_wiener(&[input], &[raw, &["-o", output]].concat())
    };
    for (input, output, made) in [
        ("brackets/", "of-brackets/", "of-brackets/one.exr"),
        ("brackets/", "unslashed", "unslashed/one.exr"),
        ("brackets/one", "of-one/", "of-one/one.exr"),
        ("brackets/one", "one.exr", "one.exr"),
        ("scene.exr", "of-a-file/", "of-a-file/scene.exr"),
    ] {
        succeed(scratch.path(), &restore(input, output));
        assert!(scratch.path().join(made).is_file(), "{made}");
    }
    succeed(scratch.path(), &["finish", "scene.exr", "-o", "finished/"]);
    assert!(scratch.path().join("finished/scene.png").is_file());
}

#[test]
fn several_inputs_are_not_written_to_a_folder_named_like_a_file() {
    let scratch = scratch();
    write_captures(scratch.path(), &["a.exr", "b.exr"]);
    let inputs = ["captures/a.exr", "captures/b.exr"];
    let said = fail(scratch.path(), &restore_by_wiener(&inputs, &["-o", "two.exr"]), 1);
    assert!(said.contains("several inputs") && said.contains("-o two/"), "{said}");
    let said = fail(scratch.path(), &["finish", "captures", "-o", "two.png"], 1);
    assert!(said.contains("several inputs") && said.contains("-o two/"), "{said}");
    assert!(!scratch.path().join("two.exr").exists() && !scratch.path().join("two.png").exists());
}

#[test]
fn leaves_no_folder_without_a_result() {
    let scratch = scratch();
    write_captures(scratch.path(), &["a.exr"]);
    std::fs::create_dir(scratch.path().join("other")).unwrap();
    write_scene(&scratch.path().join("other/a.exr"), 20, 24);
    std::fs::write(scratch.path().join("captures/b.exr"), b"no image").unwrap();
    let clash = restore_by_wiener(&["captures/a.exr", "other/a.exr"], &["-o", "out/deep"]);
    assert!(fail(scratch.path(), &clash, 1).contains("would both be written to"));
    let missing = ["restore", "captures", "--model", "missing.pth", "-o", "out/deep"];
    assert!(fail(scratch.path(), &missing, 1).contains("missing.pth"));
    let broken = restore_by_wiener(&["captures/b.exr"], &["-o", "out/deep/"]);
    assert!(fail(scratch.path(), &broken, 1).contains("b.exr"));
    assert!(fail(scratch.path(), &["finish", "captures/b.exr", "-o", "out/deep/"], 1).contains("b.exr"));
    assert!(!scratch.path().join("out").exists());
}

#[test]
fn a_file_that_is_named_twice_is_done_once() {
    let scratch = scratch();
    write_captures(scratch.path(), &["a.exr", "b.exr"]);
    let inputs = ["captures/*.exr", "captures/a.exr", "captures", "./captures/b.exr"];
    succeed(scratch.path(), &restore_by_wiener(&inputs, &["-o", "out"]));
    succeed(scratch.path(), &[&["finish"][..], &inputs, &["-o", "finished", "--format", "exr"]].concat());
    for folder in ["out", "finished"] {
        assert_eq!(io::list_folder(&scratch.path().join(folder)).unwrap(), ["a.exr", "b.exr"]);
    }
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
fn hidden_files_of_a_folder_are_no_images() {
    let scratch = scratch();
    write_captures(scratch.path(), &["a.exr"]);
    std::fs::write(scratch.path().join("captures/._a.exr"), b"what macOS keeps beside a file").unwrap();
    succeed(scratch.path(), &restore_by_wiener(&["captures"], &["-o", "out"]));
    assert_eq!(io::list_folder(&scratch.path().join("out")).unwrap(), ["a.exr"]);
    let said = fail(scratch.path(), &restore_by_wiener(&["captures/._a.exr"], &["-o", "b.exr"]), 1);
    assert!(said.contains("._a.exr"), "{said}");
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

#[test]
fn an_image_of_another_program_is_not_taken_for_a_finished_one() {
    let scratch = scratch();
    let foreign = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/files/float_zip.exr");
    std::fs::create_dir(scratch.path().join("captures")).unwrap();
    std::fs::copy(foreign, scratch.path().join("captures/a.exr")).unwrap();
    let said = fail(scratch.path(), &restore_by_wiener(&["captures"], &["-o", "captures", "--resume"]), 1);
    assert!(said.contains("a.exr is not of this program"), "{said}");
}

#[test]
fn flags_of_brackets_need_a_bracket() {
    let scratch = scratch();
    for flag in [&["--estimate-exposures"][..], &["--merge", "weighted"], &["--allow-motion"]] {
        let said = fail(
            scratch.path(),
            &restore_by_wiener(&["capture.exr"], &[&["-o", "out.exr"], flag].concat()),
            1,
        );
        assert!(said.contains(flag[0]) && said.contains("--bracket"), "{said}");
    }
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
