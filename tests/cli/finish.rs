//! `udc finish`.

use std::fs;
use std::path::{Path, PathBuf};

use udc::core::capture::CaptureInfo;
use udc::core::image::{Linear, LinearImage};
use udc::core::primaries::Primaries;
use udc::io::{self, PixelOptions, Pixels, WriteOptions, read_pixels, write_pixels};

#[cfg(unix)]
use super::common::interrupt_after;
use super::common::{fail, succeed, udc};

fn fixture(name: &str) -> String {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures/finish")
        .join(name)
        .to_str()
        .unwrap()
        .to_owned()
}

fn write_scene(path: &Path) {
    let planes =
        ndarray::Array3::from_shape_fn((3, 40, 52), |(c, y, x)| ((c + 1) * (y * 52 + x)) as f32 / 900.0);
    io::write_image(path, &LinearImage::from_planes(planes).unwrap(), &WriteOptions::default()).unwrap();
}

fn write_reference(path: &Path) {
    let planes = ndarray::Array3::from_shape_fn((3, 17, 23), |(c, y, _)| 0.3 + (c * y) as f32 / 100.0);
    write_pixels(path, &Pixels::of_planes(planes), PixelOptions::default()).unwrap();
}

const CCM: &str = "ccm: 1.5 -0.4 -0.1 -0.2 1.4 -0.2 0 -0.5 1.5\n";

#[test]
fn finishes_as_opencv_does() {
    let scratch = tempfile::tempdir().unwrap();
    let [input, ccm, reference] = ["restored_tonemapped.npy", "ccm.txt", "reference.png"].map(fixture);
    let common = ["finish", &input, "--domain", "tone-mapped", "--ccm", &ccm, "--reference", &reference];
    succeed(scratch.path(), &[&common[..], &["-o", "final.png"]].concat());
    let found = io::inspect_image(&scratch.path().join("final.png")).unwrap();
    assert_eq!(found.1.sample_type, "uint8");
    let expected = read_pixels(Path::new(&fixture("final.png"))).unwrap().planes;
    let near = |a: f32, b: f32| (255.0 * (a - b)).abs() < 1.5;
    let count = found.0.planes.iter().zip(&expected).filter(|(a, b)| near(**a, **b)).count();
    assert!(count as f64 >= 0.999 * expected.len() as f64, "{count} of {}", expected.len());
}

#[test]
fn writes_every_format_in_its_depth() {
    let scratch = tempfile::tempdir().unwrap();
    write_scene(&scratch.path().join("a.exr"));
    let depth = |output: &str, more: &[&str]| {
        succeed(scratch.path(), &[&["finish", "a.exr", "-o", output][..], more].concat());
        io::inspect_image(&scratch.path().join(output)).unwrap().1.sample_type
    };
    assert_eq!(depth("a8.png", &[]), "uint8");
    assert_eq!(depth("a16.png", &["--bits", "16"]), "uint16");
    assert_eq!(depth("a.tif", &[]), "uint16");
    assert_eq!(depth("a.jpg", &["--curve", "srgb"]), "uint8");
    assert_eq!(depth("bare.exr", &["--no-clip", "--no-clahe", "--curve", "none"]), "float");
    let [bare, scene] =
        ["bare.exr", "a.exr"].map(|name| read_pixels(&scratch.path().join(name)).unwrap().planes);
    assert!(bare.iter().zip(&scene).all(|(a, b)| *a == b.min(1.0)), "no step is left");
    assert!(fail(scratch.path(), &["finish", "a.exr", "-o", "a.jpg"], 1).contains("--overwrite"));
    assert!(fail(scratch.path(), &["finish", "a.exr", "-o", "b.png", "--bits", "12"], 2).contains("8, 16"));
    assert!(fail(scratch.path(), &["finish", "a.exr", "-o", "b.png", "--gamma", "0"], 1).contains("gamma"));
    assert!(!scratch.path().join("b.png").exists());
}

/// The folders of the published dataset, with names that have something appended.
fn write_published(root: &Path, captures: &[&str]) {
    let real = root.join("real_data");
    for folder in ["input", "CCM_txt", "jpg_ZTE"] {
        fs::create_dir_all(real.join(folder)).unwrap();
    }
    for name in captures {
        let scene = root.join("scene.exr");
        if !scene.exists() {
            write_scene(&scene);
        }
        let planes = io::read_image::<Linear>(&scene).unwrap().into_planes();
        let path = real.join("input").join(format!("{name}.npy"));
        write_pixels(&path, &Pixels::of_planes(planes), PixelOptions::default()).unwrap();
        fs::write(real.join("CCM_txt").join(format!("{name}.txt")), CCM).unwrap();
        write_reference(&real.join("jpg_ZTE").join(format!("{name}_ZTE.jpg")));
    }
}

#[test]
fn finishes_the_published_captures_in_one_go() {
    let scratch = tempfile::tempdir().unwrap();
    write_published(scratch.path(), &["1", "11"]);
    let said = succeed(scratch.path(), &["finish", ".", "-o", "out", "--no-clahe"]);
    assert!(said.contains("1.png") && said.contains("11.png"), "{said}");
    let finished = read_pixels(&scratch.path().join("out/1.png")).unwrap().planes;
    let reference = read_pixels(&scratch.path().join("real_data/jpg_ZTE/1_ZTE.jpg")).unwrap().planes;
    // Scaled to the means of the reference, but for what the scaling clipped and eight bits rounded.
    for (a, b) in udc::finish::channel_means(&finished).iter().zip(udc::finish::channel_means(&reference)) {
        assert!((a - b).abs() < 0.05, "{a} {b}");
    }
    let plain = ["finish", ".", "-o", "plain", "--no-ccm", "--no-reference"];
    succeed(scratch.path(), &plain);
}

#[test]
fn names_what_does_not_pair() {
    let scratch = tempfile::tempdir().unwrap();
    write_published(scratch.path(), &["a", "b"]);
    let real = scratch.path().join("real_data");
    fs::rename(real.join("CCM_txt/b.txt"), real.join("CCM_txt/c.txt")).unwrap();
    let said = fail(scratch.path(), &["finish", ".", "-o", "out"], 1);
    assert!(said.contains("b has no file in ./real_data/CCM_txt"), "{said}");
    assert!(!scratch.path().join("out").exists());
    fs::copy(real.join("CCM_txt/c.txt"), real.join("CCM_txt/b.txt")).unwrap();
    let output = udc(scratch.path(), &["finish", ".", "-o", "out"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("c.txt belongs to no image"), "{said}");
    fs::copy(real.join("jpg_ZTE/a_ZTE.jpg"), real.join("jpg_ZTE/a_again.jpg")).unwrap();
    let said = fail(scratch.path(), &["finish", ".", "-o", "again"], 1);
    assert!(said.contains("a has several files") && said.contains("a_again.jpg"), "{said}");
    fs::remove_dir_all(real.join("jpg_ZTE")).unwrap();
    assert!(fail(scratch.path(), &["finish", ".", "-o", "again"], 1).contains("--no-reference"));
}

#[test]
fn a_broken_image_does_not_stop_the_others() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path().join("restored");
    fs::create_dir(&folder).unwrap();
    for name in ["a.exr", "c.exr"] {
        write_scene(&folder.join(name));
    }
    fs::write(folder.join("b.exr"), b"\x76\x2f\x31\x01 and no more").unwrap();
    let output = udc(scratch.path(), &["finish", "restored", "-o", "out", "--format", "jpg"]);
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8_lossy(&output.stderr);
    let last = said.lines().last().unwrap();
    assert!(last.contains("1 of 3 images") && last.contains("b.exr"), "{said}");
    assert_eq!(io::list_folder(&scratch.path().join("out")).unwrap(), ["a.jpg", "c.jpg"]);
}

/// What is there stays, what is missing or was corrupt is made; a changed setting is told where the file carries it.
#[test]
fn goes_on_where_it_ended() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path().join("restored");
    fs::create_dir(&folder).unwrap();
    for name in ["a.exr", "b.exr", "c.exr"] {
        write_scene(&folder.join(name));
    }
    let whole = fs::read(folder.join("b.exr")).unwrap();
    fs::write(folder.join("b.exr"), &whole[..whole.len() / 2]).unwrap();
    let finish = ["finish", "restored", "-o", "out", "--format", "exr", "--no-clahe"];
    assert!(fail(scratch.path(), &finish, 1).contains("1 of 3 images were not done"));
    let written = |name: &str| scratch.path().join("out").join(name).metadata().unwrap().modified().unwrap();
    let before = [written("a.exr"), written("c.exr")];
    fs::write(folder.join("b.exr"), whole).unwrap();
    assert!(fail(scratch.path(), &finish, 1).contains("--overwrite"));
    let resume = [&finish[..], &["--resume"]].concat();
    let said = succeed(scratch.path(), &resume);
    assert!(said.contains("2 of 3 images are there") && said.contains("b.exr"), "{said}");
    assert_eq!([written("a.exr"), written("c.exr")], before);
    let said = fail(scratch.path(), &[&resume[..], &["--gamma", "2"]].concat(), 1);
    assert!(said.contains("other settings"), "{said}");
    assert!(succeed(scratch.path(), &resume).contains("3 of 3 images are there"));
}

/// After Ctrl-C there are finished pictures and nothing else, and the run can be taken up again.
#[cfg(unix)]
#[test]
fn an_interrupt_leaves_finished_pictures_only() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path().join("restored");
    fs::create_dir(&folder).unwrap();
    let planes =
        ndarray::Array3::from_shape_fn((3, 300, 400), |(c, y, x)| ((c + 1) * (y ^ x)) as f32 / 900.0);
    let scene = LinearImage::from_planes(planes).unwrap();
    io::write_image(&folder.join("00.exr"), &scene, &WriteOptions::default()).unwrap();
    let count = 40;
    for index in 1..count {
        fs::copy(folder.join("00.exr"), folder.join(format!("{index:02}.exr"))).unwrap();
    }
    let finish = ["finish", "restored", "-o", "out"];
    let (code, said) = interrupt_after(scratch.path(), &finish, "out/00.png");
    assert!(code == Some(1) && said.contains("interrupted"), "{said}");
    let names = io::list_folder(&scratch.path().join("out")).unwrap();
    assert!((1..count).contains(&names.len()), "{names:?}");
    for name in &names {
        read_pixels(&scratch.path().join("out").join(name)).unwrap();
    }
    let said = succeed(scratch.path(), &[&finish[..], &["--resume"]].concat());
    assert!(said.contains(&format!("{} of {count} images are there", names.len())), "{said}");
    assert_eq!(io::list_folder(&scratch.path().join("out")).unwrap().len(), count);
}

#[test]
fn warns_of_a_transposed_matrix_and_refuses_one_of_eight_numbers() {
    let scratch = tempfile::tempdir().unwrap();
    write_scene(&scratch.path().join("a.exr"));
    fs::write(scratch.path().join("t.txt"), "ccm: 1.5 -0.2 0 -0.4 1.4 -0.5 -0.1 -0.2 1.5").unwrap();
    let output = udc(scratch.path(), &["finish", "a.exr", "--ccm", "t.txt", "-o", "a.png"]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("transposed"));
    fs::write(scratch.path().join("e.txt"), "ccm: 1 2 3 4 5 6 7 8").unwrap();
    let said = fail(scratch.path(), &["finish", "a.exr", "--ccm", "e.txt", "-o", "b.png"], 1);
    assert!(said.contains("holds 8 numbers"), "{said}");
}

/// What is made for viewing is not taken for light unless the user says so.
#[test]
fn a_finished_exr_says_that_it_is_for_viewing() {
    let scratch = tempfile::tempdir().unwrap();
    write_scene(&scratch.path().join("a.exr"));
    succeed(scratch.path(), &["finish", "a.exr", "-o", "finished.exr"]);
    assert!(succeed(scratch.path(), &["info", "finished.exr"]).contains("domain    display"));
    let said = fail(scratch.path(), &["finish", "finished.exr", "-o", "again.png"], 1);
    assert!(said.contains("display values") && said.contains("--domain linear"), "{said}");
    succeed(scratch.path(), &["finish", "finished.exr", "-o", "again.png", "--domain", "linear"]);
    let said = fail(scratch.path(), &["tonemap", "finished.exr", "-o", "mapped.exr"], 1);
    assert!(said.contains("before `udc finish`"), "{said}");
    succeed(scratch.path(), &["convert", "finished.exr", "picture.png"]);
    for name in ["picture.npy", "picture.hdr"] {
        let said = fail(scratch.path(), &["finish", "a.exr", "-o", name], 1);
        assert!(said.contains("values of a display") && said.contains("write .png, .jpg, .tif or"), "{said}");
        assert!(!scratch.path().join(name).exists());
    }
    let output = udc(scratch.path(), &["convert", "finished.exr", "picture.npy"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.contains("it is read as linear light"), "{said}");
}

#[test]
fn refuses_a_setting_of_another_curve() {
    let scratch = tempfile::tempdir().unwrap();
    write_scene(&scratch.path().join("a.exr"));
    let finish = |more: &[&'static str]| [&["finish", "a.exr", "-o", "a.png", "--curve"][..], more].concat();
    let said = fail(scratch.path(), &finish(&["srgb", "--gamma", "2"]), 2);
    assert!(
        said.contains("--gamma belongs to --curve gamma") && said.contains("Usage: udc finish"),
        "{said}"
    );
    assert!(fail(scratch.path(), &finish(&["none", "--max", "2"]), 2).contains("--max"));
    succeed(scratch.path(), &finish(&["srgb", "--max", "2"]));
}

/// They say what its red, green and blue are, which no camera's matrix does.
#[test]
fn other_primaries_are_converted_without_a_colour_matrix_too() {
    let scratch = tempfile::tempdir().unwrap();
    let planes = ndarray::Array3::from_shape_fn((3, 16, 16), |(c, y, x)| ((c + 1) * (y + x)) as f32 / 99.0);
    let info = CaptureInfo { primaries: Some(Primaries::DISPLAY_P3), ..CaptureInfo::default() };
    let options = WriteOptions { capture: Some(info), ..WriteOptions::default() };
    io::write_image(&scratch.path().join("a.exr"), &LinearImage::from_planes(planes).unwrap(), &options)
        .unwrap();
    let shown = |output: &str, more: &[&str]| {
        let finish = ["finish", "a.exr", "--curve", "srgb", "--max", "1", "--no-clahe", "-o", output];
        succeed(scratch.path(), &[&finish[..], more].concat());
        read_pixels(&scratch.path().join(output)).unwrap().planes
    };
    assert_eq!(shown("a.png", &[]), shown("b.png", &["--no-ccm"]));
}
