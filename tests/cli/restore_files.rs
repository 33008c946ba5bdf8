//! `udc restore` of many files: where results go, what is there already, what fails.

use std::path::Path;

use ndarray::ArrayD;
use udc::core::image::Linear;
use udc::io::{self, WriteOptions};
use udc::network::{Initialisation, Parameters, weights};

#[cfg(unix)]
use super::common::interrupt_after;
use super::common::{fail, succeed, udc};
use super::restore::{code, model, psf, scratch, write_scene};
use super::restore_brackets::{RAW, write_raw_bracket};

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

/// Not even with --overwrite, which is for what an earlier run made.
#[test]
fn what_it_reads_is_not_written_over() {
    let scratch = scratch();
    let read = |name: &str| std::fs::read(scratch.path().join(name)).unwrap();
    let before = ["scene.exr", "psf.exr"].map(read);
    for output in ["psf.exr", "scene.exr", "./psf.exr"] {
        let flags =
            ["restore", "scene.exr", "--method", "wiener", "--psf", "psf.exr", "-o", output, "--overwrite"];
        let message = fail(scratch.path(), &flags, 1);
        assert!(message.contains("would be read and written over"), "{message}");
    }
    assert_eq!(["scene.exr", "psf.exr"].map(read), before);
}

/// As folders of links to captures and PSFs that lie elsewhere.
#[cfg(unix)]
#[test]
fn what_it_reads_through_links_is_not_written_over() {
    let scratch = scratch();
    let at = |name: &str| scratch.path().join(name);
    for (file, link) in [("scene.exr", "capture.exr"), ("psf.exr", "panel.exr")] {
        std::os::unix::fs::symlink(at(file), at(link)).unwrap();
    }
    let before = ["scene.exr", "psf.exr"].map(|name| std::fs::read(at(name)).unwrap());
    for output in ["scene.exr", "psf.exr", "capture.exr"] {
        let flags = ["--method", "wiener", "--psf", "panel.exr", "-o", output, "--overwrite"];
        let message = fail(scratch.path(), &[&["restore", "capture.exr"][..], &flags].concat(), 1);
        assert!(message.contains("would be read and written over"), "{message}");
    }
    assert_eq!(["scene.exr", "psf.exr"].map(|name| std::fs::read(at(name)).unwrap()), before);
}

/// It would be restored by itself.
#[test]
fn a_psf_in_the_folder_of_captures_is_left_out_of_them() {
    let scratch = scratch();
    let folder = scratch.path().join("captures");
    std::fs::create_dir(&folder).unwrap();
    write_scene(&folder.join("a.exr"), 20, 24);
    std::fs::copy(scratch.path().join("psf.exr"), folder.join("psf.exr")).unwrap();
    let flags = ["--method", "wiener", "--psf", "captures/psf.exr", "-o", "restored/"];
    let said = udc(scratch.path(), &[&["restore", "captures"][..], &flags].concat());
    let said = String::from_utf8(said.stderr).unwrap();
    assert!(said.contains("captures/psf.exr is the PSF, and is left out"), "{said}");
    let restored = scratch.path().join("restored");
    assert!(restored.join("a.exr").exists() && !restored.join("psf.exr").exists());
}

#[test]
fn says_of_a_restored_image_that_it_is_no_capture() {
    let scratch = scratch();
    let restore = |from: &str, to: &str| {
        let output =
            udc(scratch.path(), &["restore", from, "--method", "wiener", "--psf", "psf.exr", "-o", to]);
        assert!(output.status.success());
        String::from_utf8(output.stderr).unwrap().contains(&format!("{from}: it was restored before"))
    };
    assert!(!restore("scene.exr", "once.exr") && restore("once.exr", "twice.exr"));
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

/// A folder `captures` with scenes of these names, of 20 × 24 pixels.
pub(super) fn write_captures(folder: &Path, names: &[&str]) {
    std::fs::create_dir(folder.join("captures")).unwrap();
    for name in names {
        write_scene(&folder.join("captures").join(name), 20, 24);
    }
}

pub(super) const WIENER: [&str; 4] = ["--method", "wiener", "--psf", "psf.exr"];

pub(super) fn restore_by_wiener<'a>(inputs: &[&'a str], more: &[&'a str]) -> Vec<&'a str> {
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
fn an_image_of_another_program_is_not_taken_for_a_finished_one() {
    let scratch = scratch();
    let foreign = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/files/float_zip.exr");
    for folder in ["captures", "out"] {
        std::fs::create_dir(scratch.path().join(folder)).unwrap();
        std::fs::copy(&foreign, scratch.path().join(folder).join("a.exr")).unwrap();
    }
    let said = fail(scratch.path(), &restore_by_wiener(&["captures"], &["-o", "out", "--resume"]), 1);
    assert!(said.contains("a.exr is not of this program"), "{said}");
}
