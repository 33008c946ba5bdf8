//! `udc view`, and what the pages of `udc report` promise: no file beside them, no network, a size.

use std::fs;
use std::path::Path;

use data_encoding::BASE64;
use half::f16;
use ndarray::Array3;
use serde_json::Value;
use udc::core::capture::CaptureInfo;
use udc::core::image::{LinearImage, ToneMappedImage};
use udc::core::primaries::Primaries;
use udc::io::{self, Pixels, WriteOptions};

use super::common::{fail, succeed, udc};

/// Writes linear light whose value is told by channel, row and column.
fn write_light(path: &Path, [height, width]: [usize; 2], scale: f32) {
    let value =
        |(c, y, x): (usize, usize, usize)| scale * (1.0 + c as f32 + 4.0 * y as f32 + 0.25 * x as f32);
    let image = LinearImage::from_planes(Array3::from_shape_fn((3, height, width), value)).unwrap();
    io::write_image(path, &image, &WriteOptions::default()).unwrap();
}

/// The data of a page's only viewer.
pub(crate) fn data_of(page: &str) -> Value {
    let (_, rest) =
        page.split_once("<div class=\"viewer\"><script type=\"application/json\">").expect("a viewer");
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

/// The half floats that stand in a page under an id.
pub(crate) fn light_of(page: &str, id: &Value) -> Vec<f32> {
    let start = format!("id=\"{}\">", id.as_str().unwrap());
    let (_, rest) = page.split_once(&start).expect("the light stands in the page");
    let bytes = BASE64.decode(rest.split_once("</script>").unwrap().0.as_bytes()).unwrap();
    bytes.chunks(2).map(|pair| f16::from_le_bytes([pair[0], pair[1]]).to_f32()).collect()
}

/// Addresses that a page names; a page of udc names none.
fn addresses(page: &str) -> Vec<&str> {
    let namespace = "http://www.w3.org/2000/svg";
    let found =
        page.match_indices("://").map(|(at, _)| &page[at.saturating_sub(5)..(at + 22).min(page.len())]);
    found.filter(|found| !namespace.contains(found.trim_start_matches('"'))).collect()
}

/// A green of BT.2020 lies outside of sRGB: less than no red.
#[test]
fn light_of_other_primaries_is_shown_as_that_of_srgb() {
    let scratch = tempfile::tempdir().unwrap();
    let planes = Array3::from_shape_fn((3, 2, 2), |(c, _, _)| if c == 1 { 1.0 } else { 0.0 });
    let image = LinearImage::from_planes(planes).unwrap();
    let capture = Some(CaptureInfo::of_primaries(Primaries::BT2020));
    let options = WriteOptions { capture, ..WriteOptions::default() };
    io::write_image(&scratch.path().join("wide.exr"), &image, &options).unwrap();
    succeed(scratch.path(), &["view", "wide.exr", "-o", "page.html"]);
    let page = fs::read_to_string(scratch.path().join("page.html")).unwrap();
    let picture = &data_of(&page)["scenes"][0]["pictures"][0];
    let light = light_of(&page, &picture["half"]);
    // ITU-R BT.2087, the inverse of its matrix.
    for (found, expected) in light.iter().zip([-0.5876, 1.1329, -0.1006]) {
        assert!((found - expected).abs() < 1e-3, "{light:?}");
    }
    let note = picture["note"].as_str().unwrap();
    assert!(note.contains("converted from BT.2020 primaries"), "{note}");
}

#[test]
fn a_page_holds_every_value_of_its_images() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_light(&folder.join("a.exr"), [3, 5], 0.01);
    write_light(&folder.join("b.npy"), [3, 5], 20.0);
    let said = succeed(folder, &["view", "a.exr", "b.npy", "-o", "page.html", "--reference", "a.exr"]);
    assert_eq!(said.trim(), "wrote page.html");
    let page = fs::read_to_string(folder.join("page.html")).unwrap();
    let data = data_of(&page);
    let scene = &data["scenes"][0];
    assert_eq!((&scene["width"], &scene["height"], &scene["reference"]), (&5.into(), &3.into(), &0.into()));
    for (picture, scale) in [(0, 0.01), (1, 20.0)] {
        let light = light_of(&page, &scene["pictures"][picture]["half"]);
        assert_eq!(light.len(), 3 * 3 * 5);
        for (at, found) in light.iter().enumerate() {
            let (c, y, x) = (at % 3, at / 15, at / 3 % 5);
            let expected = scale * (1.0 + c as f32 + 4.0 * y as f32 + 0.25 * x as f32);
            // A half float has 11 bits.
            assert!((found - expected).abs() <= expected / 2048.0, "{picture}: {at}: {found} and {expected}");
        }
    }
    assert_eq!(addresses(&page), [""; 0]);
    assert!(page.contains("default-src 'none'"), "the page may load nothing");
    assert!(fail(folder, &["view", "a.exr", "-o", "page.html"], 1).contains("--overwrite"));
    succeed(folder, &["view", "a.exr", "-o", "page.html", "--overwrite"]);
}

#[test]
fn every_format_and_domain_is_shown_as_what_it_is() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let flat = |value: f32| Array3::from_elem((3, 4, 4), value);
    let mapped = ToneMappedImage::from_planes(flat(0.5)).unwrap();
    io::write_image(&folder.join("mapped.exr"), &mapped, &WriteOptions::default()).unwrap();
    io::write_pixels(&folder.join("photo.png"), &Pixels::of_planes(flat(0.5)), Default::default()).unwrap();
    io::write_pixels(&folder.join("photo.jpg"), &Pixels::of_planes(flat(0.5)), Default::default()).unwrap();
    io::write_pixels(
        &folder.join("grey.npy"),
        &Pixels::of_planes(Array3::from_elem((1, 4, 4), 0.25)),
        Default::default(),
    )
    .unwrap();
    let files = ["grey.npy", "mapped.exr", "photo.jpg", "photo.png"];
    succeed(folder, &[&["view"][..], &files, &["-o", "page.html"]].concat());
    let page = fs::read_to_string(folder.join("page.html")).unwrap();
    let data = data_of(&page);
    let value = |at: usize| light_of(&page, &data["scenes"][0]["pictures"][at]["half"])[0];
    // φ of one quarter is one half; sRGB encodes 0.2140 as one half.
    for (at, expected) in [(0, 0.25), (1, 0.25), (2, 0.214), (3, 0.214)] {
        assert!((value(at) - expected).abs() < 4e-3, "{}: {}", files[at], value(at));
    }
    assert!(page.contains("taken for sRGB"), "the guess is said");
    succeed(folder, &["view", "photo.png", "--domain", "tone-mapped", "-o", "told.html"]);
    let told = fs::read_to_string(folder.join("told.html")).unwrap();
    let told = light_of(&told, &data_of(&told)["scenes"][0]["pictures"][0]["half"])[0];
    assert!((told - 0.25).abs() < 1e-3, "{told}");
}

#[test]
fn odd_sizes_and_names_and_values_are_shown_with_a_word() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let hostile =
        if cfg!(windows) { "a&'b .exr" } else { "</script><img src=x onerror=\"alert(1)\"> & 'ü' №1.exr" };
    // A slash would be a folder's.
    let hostile = hostile.replace('/', "∕");
    write_light(&folder.join(&hostile), [1, 1], 1.0);
    write_light(&folder.join("wide.exr"), [2, 700], 1.0);
    let mut planes = Array3::from_elem((3, 1, 1), 2.0);
    planes[[1, 0, 0]] = f32::NAN;
    planes[[2, 0, 0]] = 1e9;
    io::write_pixels(&folder.join("nan.npy"), &Pixels::of_planes(planes), Default::default()).unwrap();
    succeed(folder, &["view", &hostile, "wide.exr", "nan.npy", "-o", "page.html", "--title", "<b>ä</b>"]);
    let page = fs::read_to_string(folder.join("page.html")).unwrap();
    assert!(!page.contains("<img src=x") && !page.contains("<b>"), "names are text");
    assert!(page.contains("&lt;b&gt;ä&lt;/b&gt;") && page.contains("№1") != cfg!(windows));
    let data = data_of(&page);
    assert_eq!(data["scenes"].as_array().unwrap().len(), 2, "two sizes");
    assert!(page.contains("The images differ in size"));
    let pictures = &data["scenes"][0]["pictures"];
    assert_eq!(pictures[0]["name"].as_str().unwrap(), hostile);
    let light = light_of(&page, &pictures[1]["half"]);
    assert!(light[0] == 2.0 && light[1].is_nan() && light[2] == 65504.0, "{light:?}");
    let note = pictures[1]["note"].as_str().unwrap();
    assert!(note.contains("1 values are NaN") && note.contains("beyond ±65504"), "{note}");
}

#[test]
fn a_psf_is_shown_with_how_it_spreads_its_light() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let mut point = Array3::from_elem((3, 9, 9), 0.01);
    point.slice_mut(ndarray::s![.., 4, 4]).fill(1.0);
    let point = LinearImage::from_planes(point).unwrap();
    io::write_image(&folder.join("point.exr"), &point, &WriteOptions::default()).unwrap();
    succeed(folder, &["view", "point.exr", "--as-psf", "-o", "psf.html"]);
    let page = fs::read_to_string(folder.join("psf.html")).unwrap();
    for part in ["Radial profile", "Encircled energy", "Modulation transfer function", "peak / sidelobe"] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("class=\"viewer\""));
    // What the program made as a PSF is known as one.
    succeed(folder, &["psf", "--from", "point.exr", "--turn", "1", "-o", "made.exr"]);
    succeed(folder, &["view", "made.exr", "-o", "made.html"]);
    let page = fs::read_to_string(folder.join("made.html")).unwrap();
    assert!(page.contains("Encircled energy") && page.contains("How made.exr was made"));
}

#[test]
fn refuses_what_is_no_image_and_a_reference_that_is_not_shown() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    fs::write(folder.join("notes.txt"), "no image").unwrap();
    write_light(&folder.join("a.exr"), [2, 2], 1.0);
    let said = fail(folder, &["view", "a.exr", "notes.txt", "-o", "page.html"], 1);
    assert!(said.contains("opening notes.txt"), "{said}");
    assert!(fail(folder, &["view", "missing.exr", "-o", "page.html"], 1).contains("missing.exr"));
    let said = fail(folder, &["view", "a.exr", "--reference", "b.exr", "-o", "page.html"], 1);
    assert!(said.contains("b.exr") && said.contains("none of the images"), "{said}");
    fail(folder, &["view"], 2);
    assert!(!folder.join("page.html").exists(), "no page of a failure");
}

/// A program of the name that opens pages, which keeps what it was told.
#[cfg(target_os = "linux")]
#[test]
fn opens_the_page_and_never_fails_for_it() {
    use std::os::unix::fs::PermissionsExt as _;
    use std::process::Command;
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_light(&folder.join("a.exr"), [2, 2], 1.0);
    let programs = folder.join("programs");
    fs::create_dir(&programs).unwrap();
    let run = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_udc"));
        command.args(args).current_dir(folder).env("PATH", &programs).env("TMPDIR", folder).output().unwrap()
    };
    let nothing = run(&["view", "a.exr", "-o", "page.html", "--open"]);
    let said = String::from_utf8_lossy(&nothing.stderr).into_owned();
    assert!(nothing.status.success() && said.contains("page.html in a browser"), "{said}");

    let opener = programs.join("xdg-open");
    fs::write(&opener, format!("#!/bin/sh\nprintf %s \"$1\" > '{}'\n", folder.join("opened").display()))
        .unwrap();
    fs::set_permissions(&opener, fs::Permissions::from_mode(0o755)).unwrap();
    let output = run(&["view", "a.exr"]);
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    let opened = fs::read_to_string(folder.join("opened")).unwrap();
    assert!(opened.contains("udc-view-") && Path::new(&opened).is_file(), "{opened}");

    fs::write(&opener, "#!/bin/sh\nexit 3\n").unwrap();
    let output = run(&["view", "a.exr", "-o", "other.html", "--open"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && said.contains("other.html in a browser"), "{said}");
}

/// Noise, which compresses worst: sixteen scenes of three pictures would take twice as much as a page may.
#[test]
fn a_page_of_results_stays_small_and_says_what_was_left_out() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let side = 600;
    let results = folder.join("results");
    fs::create_dir_all(results.join("pictures")).unwrap();
    let metrics = serde_json::json!({
        "format": "udc-evaluation", "version": 1, "method": "net", "mean": {"psnr": 30.5}, "images": [], "methods": [],
        "kernels": [], "sizes": [], "excluded": [],
        "definition": {"quantise": true, "border": 0, "ssim-window": 11, "ssim-sigma": 1.5, "peak": 1.0, "domain": "",
                       "ssim-channels": "mean", "metrics": ["psnr"]}});
    fs::write(results.join("metrics.json"), metrics.to_string()).unwrap();
    let mut state = 1u32;
    let noise = Array3::from_shape_simple_fn((3, side, side), || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    });
    let picture = ToneMappedImage::from_planes(noise).unwrap();
    let first = results.join("pictures/s00.1-degraded.png");
    io::write_image(&first, &picture, &WriteOptions::default()).unwrap();
    for scene in 0..16 {
        for what in ["1-degraded", "2-net", "3-ground truth"] {
            let path = results.join(format!("pictures/s{scene:02}.{what}.png"));
            if !path.exists() {
                fs::hard_link(&first, path).unwrap();
            }
        }
    }
    succeed(folder, &["report", "results", "-o", "report.html"]);
    let page = fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(page.len() < 25_000_000, "{} bytes", page.len());
    assert!(page.len() > 15_000_000, "the room is used: {} bytes", page.len());
    let data = data_of(&page);
    let scene = &data["scenes"][0];
    assert!(scene["pictures"][0]["half"].is_string(), "light of one scene");
    let [shown, note] = [data["scenes"].as_array().unwrap().len().to_string(), scene["note"].to_string()];
    assert!(shown == "16" || note.contains("find no room"), "{shown}: {note}");
    assert_eq!(addresses(&page), [""; 0]);
    assert!(
        udc(folder, &["report", "results", "-o", "report.html"]).status.code() == Some(1),
        "never over a page"
    );
}

#[test]
fn a_page_is_not_written_under_the_name_of_an_image() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    succeed(folder, &["psf", "--random", "3", "--size", "9", "-o", "psf.exr"]);
    for command in ["view", "report"] {
        let said = fail(folder, &[command, "psf.exr", "-o", "psf.exr", "--overwrite"], 1);
        assert!(said.contains("name it *.html"), "{said}");
    }
    succeed(folder, &["info", "psf.exr"]);
}
