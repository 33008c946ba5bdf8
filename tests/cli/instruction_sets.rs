//! `UDC_SIMD`, and what is told of the instruction sets that results come from.

use std::path::Path;
use std::process::{Command, Output};

use udc::kernels::Isa;

use super::common::succeed;
use super::train::prepare;

/// Runs `udc` with an instruction set asked for.
fn udc_with(set: &str, folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_udc"));
    command.args(args).current_dir(folder).env("UDC_SIMD", set).output().expect("udc starts")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_misspelt_instruction_set_is_an_error_in_every_command() {
    let folder = tempfile::tempdir().unwrap();
    for args in [
        &["info", "absent.exr"][..],
        &["tonemap", "absent.exr", "-o", "out.exr"],
        &["train", "absent.toml", "--data", "absent", "-o", "run"],
        &["restore", "absent.exr", "--model", "absent.safetensors", "-o", "out.exr"],
        &["bench"],
        &["completions", "bash"],
        &["--quiet", "man"],
    ] {
        for set in ["avx-512", "AVX2", "sse2"] {
            let output = udc_with(set, folder.path(), args);
            let said = stderr(&output);
            assert_eq!(output.status.code(), Some(2), "{args:?} {said}");
            assert!(said.contains("UDC_SIMD must be one of avx512, avx2, portable"), "{args:?} {said}");
            assert!(said.contains(set) && output.stdout.is_empty(), "{args:?} {said}");
        }
    }
    assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "nothing is written");
    assert!(udc_with("", folder.path(), &["completions", "bash"]).status.success(), "empty is not set");
}

#[test]
fn a_training_that_goes_on_with_other_instructions_warns_that_its_bits_differ() {
    let best = Isa::available()[0].name();
    if best == "portable" {
        // There is no other set to go on with; the unit tests of `instruction_sets` cover the rest.
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    prepare(folder);
    let train = |set: &str, more: &[&str]| {
        let common = ["train", "config.toml", "--data", "dataset", "-o", "run"];
        let output = udc_with(set, folder, &[&common[..], more].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        stderr(&output)
    };
    assert!(!train("portable", &["--set", "iterations=4"]).contains("instructions"));
    let described = succeed(folder, &["info", "run/model.safetensors"]);
    assert!(described.contains("portable instructions"), "{described}");

    // A run that has ended computes nothing more.
    let model = || std::fs::read(folder.join("run/model.safetensors")).unwrap();
    let ended = model();
    let idle = train(best, &["--resume", "--set", "iterations=4"]);
    assert!(!idle.contains("instructions"), "{idle}");
    assert!(model() == ended, "a run that has ended has another model");

    let same = train("portable", &["--resume", "--set", "iterations=6"]);
    assert!(!same.contains("bits will differ"), "{same}");
    let other = train(best, &["--resume", "--set", "iterations=8"]);
    let sentence = format!("computed with portable and goes on with {best}");
    assert!(other.contains(&sentence) && other.contains("bits will differ"), "{other}");
    assert!(other.contains("UDC_SIMD=portable"), "{other}");
    let described = succeed(folder, &["info", "run/model.safetensors"]);
    assert!(described.contains(&format!("portable → {best} instructions")), "{described}");
}
