//! The command line: convert, tonemap, completions, man, and what is said of files that cannot be used.

use std::path::{Path, PathBuf};

use udc::io;

use super::common::{fail, succeed, udc};
use super::tiff::{Field, Tiff};

pub(super) fn fixture(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/files").join(name);
    path.to_str().expect("the checkout's path is text").to_owned()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = folder.read_dir().expect("the folder can be listed");
    let mut names: Vec<String> = entries
        .map(|entry| entry.expect("the folder can be listed").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// One line that names the file, and nothing written.
fn refused(folder: &Path, args: &[&str]) -> String {
    let before = names(folder);
    let message = fail(folder, args, 1);
    assert_eq!(message.trim_end().lines().count(), 1, "more than a line: {message}");
    assert_eq!(names(folder), before, "{args:?} left something behind");
    message
}

#[test]
fn a_pytorch_checkpoint_becomes_a_model() {
    let folder = tempfile::tempdir().unwrap();
    let checkpoint = fixture("../discnet/0.pth");
    let parameters = |file: &str| -> serde_json::Value {
        let text = succeed(folder.path(), &["info", "--json", file]);
        serde_json::from_str::<serde_json::Value>(&text).unwrap()["parameters"].clone()
    };
    succeed(folder.path(), &["convert", &checkpoint, "model.safetensors"]);
    assert!(parameters(&checkpoint).as_u64().is_some());
    assert_eq!(parameters("model.safetensors"), parameters(&checkpoint));
    let message = refused(folder.path(), &["convert", &fixture("rgb8.png"), "other.safetensors"]);
    assert!(message.contains("rgb8.png"), "{message}");
    let message = refused(folder.path(), &["convert", &checkpoint, "model.exr"]);
    assert!(message.contains("not an image"), "{message}");
}

#[test]
fn convert_keeps_float_values_and_says_where_they_came_from() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &["convert", &fixture("hwc_f4.npy"), "a.exr", "--domain", "linear"]);
    succeed(folder.path(), &["convert", "a.exr", "b.npy"]);
    assert_eq!(
        std::fs::read(folder.path().join("b.npy")).unwrap(),
        std::fs::read(fixture("hwc_f4.npy")).unwrap(),
        "NumPy's own file and ours are the same bytes"
    );
    let text = succeed(folder.path(), &["info", "a.exr"]);
    assert!(text.contains("linear") && text.contains("udc") && text.contains("hwc_f4.npy"), "{text}");
}

#[test]
fn convert_refuses_to_clip_unless_told() {
    let folder = tempfile::tempdir().unwrap();
    let message = refused(folder.path(), &["convert", &fixture("hwc_f4.npy"), "a.png"]);
    assert!(message.contains("tonemap") && message.contains("31.75"), "{message}");
    succeed(folder.path(), &["convert", &fixture("hwc_f4.npy"), "a.png", "--clip"]);
}

#[test]
fn every_exr_that_convert_writes_says_its_domain() {
    let folder = tempfile::tempdir().unwrap();
    let output = udc(folder.path(), &["convert", &fixture("hwc_f4.npy"), "float.exr"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && stderr.contains("says linear"), "{stderr}");
    assert_eq!(stderr.trim_end().lines().count(), 1, "{stderr}");
    assert!(!succeed(folder.path(), &["info", "float.exr"]).contains("not declared"));
    for name in ["rgb8.png", "rgb16.tif", "flat.jpg"] {
        let message = refused(folder.path(), &["convert", &fixture(name), "integer.exr"]);
        assert!(message.contains("--domain linear, --domain tone-mapped or --domain srgb"), "{message}");
    }
    succeed(folder.path(), &["convert", &fixture("rgb8.png"), "integer.exr", "--domain", "tone-mapped"]);
    assert!(succeed(folder.path(), &["info", "integer.exr"]).contains("tone-mapped"));
    succeed(folder.path(), &["convert", &fixture("rgb8.png"), "integer.tif"]);
}

#[test]
fn a_jpeg_that_was_cut_off_is_refused_and_one_with_more_behind_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let whole = std::fs::read(fixture("flat.jpg")).unwrap();
    std::fs::write(folder.path().join("cut.jpg"), &whole[..whole.len() - 4]).unwrap();
    let message = refused(folder.path(), &["convert", "cut.jpg", "a.npy"]);
    assert!(message.contains("truncated"), "{message}");
    std::fs::write(folder.path().join("more.jpg"), [&whole[..], b"maker's notes"].concat()).unwrap();
    succeed(folder.path(), &["convert", "more.jpg", "a.npy", "--domain", "srgb"]);
}

#[test]
fn tiff_files_of_wide_integers_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = Tiff::new();
    let mut fields = file.image(2, &[7; 4 * 5 * 6], [4, 5]);
    // Three samples of 32 bits where six of 16 were written.
    fields.retain(|(tag, _)| ![258, 277].contains(tag));
    fields.push((258, Field::Shorts(vec![32; 3])));
    fields.push((277, Field::Shorts(vec![3])));
    let first = file.directory(fields);
    std::fs::write(folder.path().join("wide.tif"), file.finish(first)).unwrap();
    let message = refused(folder.path(), &["convert", "wide.tif", "a.npy"]);
    assert!(message.contains("32-bit integers"), "{message}");
}

/// Of three directories: a page, its preview and a second page.
#[test]
fn a_tiff_of_several_pages_is_refused_and_one_with_a_preview_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, kinds: &[u32]| {
        let mut file = Tiff::new();
        let mut places = Vec::new();
        for kind in kinds {
            let value = 7 + 10 * u16::try_from(*kind).unwrap();
            let mut fields = file.image(2, &[value; 4 * 5 * 3], [4, 5]);
            fields.push((254, Field::Longs(vec![*kind])));
            // The position of the next stands behind the fields.
            places.push((file.directory(fields) as usize, 2 + 12 * 10));
        }
        let mut bytes = file.finish(u32::try_from(places[0].0).unwrap());
        for pair in places.windows(2) {
            let (start, length) = pair[0];
            let next = u32::try_from(pair[1].0).unwrap().to_le_bytes();
            bytes[start + length..start + length + 4].copy_from_slice(&next);
        }
        std::fs::write(folder.path().join(name), bytes).unwrap();
    };
    write("preview.tif", &[0, 1]);
    succeed(folder.path(), &["convert", "preview.tif", "a.npy", "--domain", "linear"]);
    // The preview comes first in files of some scanners and editors.
    write("first.tif", &[1, 0]);
    succeed(folder.path(), &["convert", "first.tif", "c.npy", "--domain", "linear"]);
    for name in ["a.npy", "c.npy"] {
        let planes = io::read_pixels(&folder.path().join(name)).unwrap().planes;
        assert!(planes.iter().all(|value| (value * 65535.0 - 7.0).abs() < 1e-2), "{name}: {planes}");
    }
    write("pages.tif", &[0, 1, 2]);
    let message = refused(folder.path(), &["convert", "pages.tif", "b.npy", "--domain", "linear"]);
    assert!(message.contains("2 pages"), "{message}");
}

#[test]
fn doubles_beyond_floats_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (1, 2, 3), }\n";
    let write = |value: f64| {
        let length = u16::try_from(header.len()).unwrap().to_le_bytes();
        let data = [[0.5_f64; 5].as_slice(), &[value]].concat();
        let data: Vec<u8> = data.iter().flat_map(|value| value.to_le_bytes()).collect();
        let bytes = [b"\x93NUMPY\x01\0", &length[..], header.as_bytes(), &data].concat();
        std::fs::write(folder.path().join("a.npy"), bytes).unwrap();
    };
    write(1e38);
    succeed(folder.path(), &["convert", "a.npy", "a.exr"]);
    write(1e39);
    let message = refused(folder.path(), &["convert", "a.npy", "b.exr"]);
    assert!(message.contains("1e39"), "{message}");
}

#[test]
fn convert_refuses_to_rename_a_domain() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &["convert", &fixture("hwc_f4.npy"), "a.exr", "--domain", "linear"]);
    let message = refused(folder.path(), &["convert", "a.exr", "b.exr", "--domain", "tone-mapped"]);
    assert!(message.contains("udc tonemap"), "{message}");
}

#[test]
fn convert_refuses_half_floats_that_would_overflow() {
    let folder = tempfile::tempdir().unwrap();
    let header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n";
    // Mantissa 200 and exponent 155: 200 · 2^(155 − 136), above the largest half.
    std::fs::write(folder.path().join("sun.hdr"), [&header[..], &[200, 200, 200, 155]].concat()).unwrap();
    let message = refused(folder.path(), &["convert", "sun.hdr", "a.exr", "--half"]);
    assert!(message.contains("65504"), "{message}");
}

#[test]
fn existing_files_stay_unless_overwrite_is_given() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.exr"), "mine").unwrap();
    let message = refused(folder.path(), &["convert", &fixture("hwc_f4.npy"), "a.exr"]);
    assert!(message.contains("--overwrite"), "{message}");
    assert_eq!(std::fs::read(folder.path().join("a.exr")).unwrap(), b"mine");
    succeed(folder.path(), &["convert", &fixture("hwc_f4.npy"), "a.exr", "--overwrite"]);
}

#[test]
fn tonemap_goes_there_and_back() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &["tonemap", &fixture("hwc_f4.npy"), "-o", "mapped.exr"]);
    succeed(folder.path(), &["tonemap", "--inverse", "mapped.exr", "-o", "back.exr"]);
    let max = |file: &str| -> f64 {
        let text = succeed(folder.path(), &["info", "--json", file]);
        let object: serde_json::Value = serde_json::from_str(&text).unwrap();
        object["channels"][2]["max"].as_f64().unwrap()
    };
    assert!((max("mapped.exr") - 31.75 / 32.0).abs() < 1e-6);
    assert!((max("back.exr") - 31.75).abs() < 1e-3);
}

#[test]
fn tonemap_refuses_an_image_that_is_mapped_already() {
    let folder = tempfile::tempdir().unwrap();
    succeed(folder.path(), &["tonemap", &fixture("hwc_f4.npy"), "-o", "mapped.exr"]);
    let message = refused(folder.path(), &["tonemap", "mapped.exr", "-o", "twice.exr"]);
    assert!(
        message.contains("holds tone-mapped values") && message.contains("`udc tonemap --inverse`"),
        "{message}"
    );
}

#[test]
fn tonemap_writes_several_images_to_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let inputs = [fixture("hwc_f4.npy"), fixture("float_zip.exr")];
    succeed(folder.path(), &["tonemap", &inputs[0], &inputs[1], "-o", "out", "--format", "png"]);
    assert_eq!(names(&folder.path().join("out")), ["float_zip.png", "hwc_f4.png"]);
    let clash = [fixture("rgb16.png"), fixture("rgb16.tif")];
    let message = fail(folder.path(), &["tonemap", &clash[0], &clash[1], "-o", "clash"], 1);
    assert!(message.contains("both be written"), "{message}");
    assert!(!folder.path().join("clash").exists());
}

#[test]
fn tonemap_maps_the_rest_of_a_folder_whose_one_file_is_damaged() {
    let folder = tempfile::tempdir().unwrap();
    let captures = folder.path().join("in");
    std::fs::create_dir(&captures).unwrap();
    std::fs::copy(fixture("hwc_f4.npy"), captures.join("b.npy")).unwrap();
    succeed(folder.path(), &["tonemap", "in", "-o", "one"]);
    assert_eq!(names(&folder.path().join("one")), ["b.exr"]);
    std::fs::write(captures.join("a.exr"), "no image").unwrap();
    let message = fail(folder.path(), &["tonemap", "in", "-o", "two"], 1);
    assert!(message.contains("1 of 2 images") && message.contains("a.exr"), "{message}");
    assert_eq!(names(&folder.path().join("two")), ["b.exr"]);
}

#[test]
fn tonemap_refuses_an_impossible_curve() {
    let folder = tempfile::tempdir().unwrap();
    let message = refused(folder.path(), &["tonemap", &fixture("hwc_f4.npy"), "-o", "a.exr", "--alpha", "0"]);
    assert!(message.contains("alpha"), "{message}");
}

#[test]
fn files_that_cannot_be_used_are_refused_in_a_line() {
    let folder = tempfile::tempdir().unwrap();
    let exr = std::fs::read(fixture("float_zip.exr")).unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    write("truncated.exr", &exr[..exr.len() / 2]);
    write("text.exr", b"these are only words");
    write("nothing.png", b"");
    for (file, expected) in [
        ("truncated.exr", "truncated"),
        ("text.exr", "not an image"),
        ("nothing.png", "empty"),
        ("missing.exr", "o such file"),
        (&fixture("empty.npy"), "empty"),
        (&fixture("two_parts.exr"), "left, right"),
    ] {
        for args in [&["convert", file, "out.exr"][..], &["tonemap", file, "-o", "out.exr"]] {
            let message = refused(folder.path(), args);
            assert!(message.contains(expected), "{message}");
        }
    }
}

#[test]
fn an_output_without_a_folder_or_a_format_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let message = refused(folder.path(), &["convert", &fixture("rgb8.png"), "no/a.exr"]);
    assert!(message.contains("create it"), "{message}");
    let message = refused(folder.path(), &["convert", &fixture("rgb8.png"), "a.xyz"]);
    assert!(message.contains(".exr"), "{message}");
    fail(folder.path(), &["convert", &fixture("rgb8.png")], 2);
}

/// Damaged headers ask for up to terabytes; this much address space is what a small image needs with ease.
#[cfg(target_os = "linux")]
#[test]
fn damaged_files_take_little_memory() {
    const LIMIT_KIB: usize = 1_500_000;
    let folder = tempfile::tempdir().unwrap();
    let mut files: Vec<PathBuf> = Vec::new();
    for name in [
        "half_tiled.exr",
        "float_zip.exr",
        "dwaa.exr",
        "multi_part.exr",
        "rgb16.png",
        "rgb16.tif",
        "hwc_f4.npy",
        "flat.hdr",
        "flat.jpg",
    ] {
        let bytes = std::fs::read(fixture(name)).unwrap();
        // High bits make sizes huge: every position of the small files is hit.
        for position in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[position] ^= 0x70;
            let file = folder.path().join(format!("{position}-{name}"));
            std::fs::write(&file, damaged).unwrap();
            files.push(file);
        }
    }
    let output = std::process::Command::new("sh")
        .args(["-c", &format!("ulimit -v {LIMIT_KIB}; exec \"$0\" --threads 2 info \"$@\"")])
        .arg(env!("CARGO_BIN_EXE_udc"))
        .args(&files)
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{}", stderr.lines().last().unwrap_or_default());
    assert!(stderr.contains(&format!("of {} files could not be described", files.len())), "{stderr}");
}

#[test]
fn completions_and_manual_pages_are_printed() {
    let folder = tempfile::tempdir().unwrap();
    assert!(succeed(folder.path(), &["completions", "bash"]).contains("_udc"));
    fail(folder.path(), &["completions", "cmd.com"], 2);
    assert!(succeed(folder.path(), &["man"]).contains(".TH"));
    assert!(succeed(folder.path(), &["man", "convert"]).contains("half"));
    assert!(fail(folder.path(), &["man", "nothing"], 1).contains("udc --help"));
    succeed(folder.path(), &["man", "-o", "man"]);
    assert!(names(&folder.path().join("man")).contains(&"udc-tonemap.1".to_owned()));
}

#[test]
fn half_floats_are_clipped_where_that_is_asked_for() {
    let scratch = tempfile::tempdir().unwrap();
    let bright = ndarray::ArrayD::from_elem(vec![2, 2, 3], 1e6_f32);
    io::write_array(&scratch.path().join("bright.npy"), &bright, false).unwrap();
    let convert = ["convert", "bright.npy", "half.exr", "--half", "--domain", "linear"];
    assert!(fail(scratch.path(), &convert, 1).contains("65504"));
    succeed(scratch.path(), &[&convert[..], &["--clip"]].concat());
    let found = io::read_pixels(&scratch.path().join("half.exr")).unwrap().planes;
    assert!(found.iter().all(|value| (value - 65504.0).abs() < 1.0));
    // A format without half floats clips as it does without them.
    succeed(
        scratch.path(),
        &["convert", "bright.npy", "bright.png", "--half", "--clip", "--domain", "linear"],
    );
}

/// What is copied from the help must be what a shell runs.
#[test]
fn examples_in_the_help_fit_into_terminals() {
    let scratch = tempfile::tempdir().unwrap();
    for command in
        ["fuse", "codes", "crop", "scenes", "synth", "train", "sweep", "restore", "eval", "finish", "report"]
    {
        let help = succeed(scratch.path(), &[command, "--help"]);
        let examples = help.split_once("Example").unwrap().1;
        let mut goes_on = false;
        for line in examples.lines().skip(1).filter(|line| !line.trim().is_empty()) {
            let is_call = line.trim_start().starts_with("udc ") || goes_on;
            assert!(!is_call || line.len() <= 80, "{command}: {line}");
            goes_on = is_call && line.ends_with('\\');
        }
        assert!(!goes_on, "{command}: {examples}");
    }
}

#[test]
fn a_pattern_of_all_folders_below_finds_their_images() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["gl/a.png", "gl/in/b.png", "gl/in/deep/c.png", "gl/.hidden/d.png"] {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::copy(fixture("rgb8.png"), path).unwrap();
    }
    std::fs::write(folder.path().join("gl/in/notes.txt"), "no image").unwrap();
    for pattern in ["gl/**", "gl/**/", "gl/**/*.png"] {
        let text = succeed(folder.path(), &["info", "--json", pattern]);
        assert_eq!(text.lines().count(), 3, "{pattern}: {text}");
        assert!(text.contains("gl/in/deep/c.png") && !text.contains("hidden"), "{text}");
    }
}

#[test]
fn an_empty_configuration_is_not_taken_for_one_of_defaults() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("empty.toml"), "# size-px = 9\n\n").unwrap();
    for args in [
        &["psf", "--display", "empty.toml", "-o", "psf.exr"][..],
        &["train", "empty.toml", "--data", "dataset", "-o", "run"],
        &["info", "empty.toml"],
    ] {
        let message = refused(folder, args);
        assert!(message.contains("empty.toml: is empty"), "{message}");
    }
    let said =
        fail(folder, &["synth", "a.exr", "--noise", "sensor:empty.toml", "--psf", "b.exr", "-o", "d"], 2);
    assert!(said.contains("empty.toml: is empty"), "{said}");
    let found = udc(folder, &["doctor", "empty.toml"]);
    assert!(String::from_utf8_lossy(&found.stdout).contains("is empty"), "{found:?}");
}

#[test]
fn a_folder_or_another_file_than_is_needed_is_said_to_be_one() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::create_dir(folder.join("results")).unwrap();
    std::fs::write(folder.join("results/metrics.json"), "{}").unwrap();
    for (args, expected) in [
        (&["psf", "--display", "results", "-o", "psf.exr"][..], "it is a folder, and a file is needed"),
        (&["plan", "results"], "it is a folder, and a file is needed"),
        (&["report", "results/metrics.json", "-o", "page.html"], "name the folder, results"),
        (&["eval", "results/metrics.json", "-o", "measured"], "is a file; name the folder"),
    ] {
        let message = fail(folder, args, 1);
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn light_and_models_that_nothing_can_be_computed_with_are_refused_with_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let write = |name: &str, brightest: f32| {
        let planes =
            ndarray::Array3::from_shape_fn(
                (3, 16, 16),
                |(_, y, x)| {
                    if (y, x) == (8, 8) { brightest } else { 0.3 }
                },
            );
        let image = udc::core::image::LinearImage::from_planes(planes).unwrap();
        io::write_image(&folder.join(name), &image, &io::WriteOptions::default()).unwrap();
    };
    write("psf.exr", 90.0);
    write("bright.exr", 1e38);
    let message = fail(folder, &["restore", "bright.exr", "--psf", "psf.exr", "-o", "out.exr"], 1);
    assert!(message.contains("bright.exr: holds light of 1e38"), "{message}");
    std::fs::create_dir(folder.join("models")).unwrap();
    let restore = ["restore", "psf.exr", "--psf", "psf.exr", "--model", "models", "-o", "out.exr"];
    let message = fail(folder, &restore, 1);
    assert!(message.contains("is a folder; name a file of weights, as a .safetensors or .pth"), "{message}");
}

/// By a user without rights, whoever runs the tests. The PSF that is named is none: nothing is read before.
#[cfg(unix)]
#[test]
fn a_folder_that_may_not_be_written_to_is_told_before_the_work() {
    use std::fs::{Permissions, copy, create_dir, metadata, set_permissions};
    use std::os::unix::fs::{MetadataExt, PermissionsExt};
    use std::os::unix::process::CommandExt;

    const NOBODY: u32 = 65534;
    let folder = tempfile::tempdir().unwrap();
    let allow = |name: &str, mode| {
        set_permissions(folder.path().join(name), Permissions::from_mode(mode)).unwrap();
    };
    let program = folder.path().join("udc");
    copy(env!("CARGO_BIN_EXE_udc"), &program).unwrap();
    copy(fixture("hwc_f4.npy"), folder.path().join("capture.npy")).unwrap();
    create_dir(folder.path().join("closed")).unwrap();
    for (name, mode) in [("", 0o755), ("udc", 0o755), ("capture.npy", 0o644), ("closed", 0o555)] {
        allow(name, mode);
    }
    let mut run = std::process::Command::new(&program);
    if metadata(folder.path()).unwrap().uid() == 0 {
        run.uid(NOBODY);
    }
    let args = ["restore", "capture.npy", "--psf", "capture.npy", "-o", "closed/photo.jpg"];
    let output = run.args(args).current_dir(folder.path()).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("the folder closed may not be written to; name another"), "{message}");
    allow("closed", 0o755);
}
