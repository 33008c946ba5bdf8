//! `udc bench`.

use super::common::{fail, succeed};

#[test]
fn times_operations_the_network_and_a_training_step() {
    let folder = tempfile::tempdir().unwrap();
    let only = ["--only", "to weights 8→32", "--patience", "0"];
    let printed = succeed(folder.path(), &[&["bench", "--size", "8", "--train", "1x8"], &only[..]].concat());
    let lines: Vec<&str> = printed.lines().collect();
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
    let stderr = fail(folder.path(), &["bench", "--patience=-1"], 1);
    assert!(stderr.contains("--patience"), "{stderr}");
}
