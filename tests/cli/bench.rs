//! `udc bench`.

use super::common::{fail, succeed};

#[test]
fn times_operations_the_network_and_a_training_step() {
    let folder = tempfile::tempdir().unwrap();
    let only = ["--only", "to weights 8→32", "--patience", "0"];
    let printed = succeed(folder.path(), &[&["bench", "--size", "8", "--train", "1x8"], &only[..]].concat());
    // Only some CPUs have products of the other precision.
    let lines: Vec<&str> = printed.lines().filter(|line| !line.contains("--precision")).collect();
    assert_eq!(lines.len(), 4, "{printed}");
    let isa = lines[0].split(',').next().unwrap();
    assert!(["avx512", "avx2", "portable"].contains(&isa), "{printed}");
    for (line, name) in
        lines[1..].iter().zip(["3×3 to weights 8→32 4×128²", "network @8²", "training step 1×8²"])
    {
        assert!(line.starts_with(name), "{printed}");
        let before_unit = line.split(" ms").next().unwrap().split_whitespace().next_back().unwrap();
        assert!(before_unit.parse::<f64>().unwrap() > 0.0, "{line}");
    }
}

#[test]
fn refuses_a_batch_without_crops_and_a_negative_patience() {
    let folder = tempfile::tempdir().unwrap();
    let stderr = fail(folder.path(), &["bench", "--train", "0x64"], 2);
    assert!(stderr.contains("number of crops and their side"), "{stderr}");
    let stderr = fail(folder.path(), &["bench", "--patience=-1"], 2);
    assert!(stderr.contains("--patience"), "{stderr}");
}

#[test]
fn refuses_what_no_machine_can_time() {
    let folder = tempfile::tempdir().unwrap();
    for (flag, value) in [
        ("--patience", "1e20"),
        ("--patience", "NaN"),
        ("--size", "4294967295"),
        ("--train", "1x99999"),
        ("--train", "99999999999x99999999999"),
    ] {
        let stderr = fail(folder.path(), &["bench", "--only", "nothing", flag, value], 2);
        assert!(stderr.contains(flag), "{stderr}");
    }
}

/// The system gives every page once: what a step frees the next step uses again.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
#[test]
fn training_on_large_images_keeps_its_memory() {
    use std::io::Read as _;
    use std::process::Stdio;

    const PAGE: u64 = 4096;
    let folder = tempfile::tempdir().unwrap();
    // Tensors of 33 MB, more than the allocator keeps by itself; a step to warm up and one that is timed.
    let args = ["bench", "--only", "nothing", "--size", "8", "--train", "1x512", "--patience", "0"];
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_udc"))
        .args(args)
        .current_dir(folder.path())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut printed = String::new();
    child.stdout.take().unwrap().read_to_string(&mut printed).unwrap();
    // It has ended, but nobody has asked how: its numbers are still there.
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap();
    assert!(child.wait().unwrap().success());
    let after_name = stat.rsplit_once(')').unwrap().1;
    let faults: u64 = after_name.split_whitespace().nth(7).unwrap().parse().unwrap();
    let mebibytes = printed.trim_end().strip_suffix(" MiB").unwrap().rsplit(' ').next().unwrap();
    let peak = mebibytes.parse::<u64>().unwrap() << 20;
    assert!(faults * PAGE < peak * 3 / 2, "{faults} pages for {printed}");
}
