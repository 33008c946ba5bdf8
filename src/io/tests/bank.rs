//! Kernel banks: to the bit and back, and what is said of files that are none.

use std::borrow::Cow;
use std::collections::BTreeMap;

use ndarray::{Array1, Array2};

use super::*;
use crate::core::kernel_code::{CodeBasis, KernelBank};
use crate::core::psf::Psf;

fn bank() -> KernelBank {
    let psfs: Vec<Psf> = (1..4)
        .map(|k| {
            let energy = Array3::from_shape_fn((3, 4, 5), |(c, y, x)| ((c + y * k + x) % 5 + 1) as f32);
            Psf::from_energy(energy).unwrap()
        })
        .collect();
    let basis = CodeBasis {
        mean: Array1::from_shape_fn(60, |i| i as f32 * 0.1),
        components: Array2::from_shape_fn((2, 60), |(b, i)| (b * 60 + i) as f32),
        explained_variance: Array1::from_vec(vec![2.0, 1.0]),
    };
    let codes = Array2::from_shape_fn((3, 2), |(k, b)| (k * 2 + b) as f32 - 2.5);
    KernelBank::new(psfs, codes, basis, Some(vec![-3.0, 0.0, 3.5])).unwrap()
}

#[test]
fn returns_to_the_bit_and_is_written_the_same_every_time() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("a.safetensors"), folder.path().join("b.safetensors"));
    write_bank(&first, &bank(), false).unwrap();
    assert_eq!(read_bank(&first).unwrap(), bank());
    write_bank(&second, &bank(), false).unwrap();
    assert_eq!(bank_sha256(&first).unwrap(), bank_sha256(&second).unwrap());
    assert_eq!(read_bank_codes(&first).unwrap(), bank().to_codes());
}

#[test]
fn banks_of_other_psfs_or_codes_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let sha256 = |name: &str, bank: &KernelBank| {
        let path = folder.path().join(name);
        write_bank(&path, bank, false).unwrap();
        assert_eq!(bank_sha256_of(&encode_bank(bank)), bank_sha256(&path).unwrap());
        bank_sha256(&path).unwrap()
    };
    let mut other_codes = bank();
    other_codes.codes[[1, 0]] += 1.0;
    let mut other_psfs = bank();
    other_psfs.psfs.swap(0, 1);
    let first = sha256("a", &bank());
    assert!(sha256("b", &other_codes) != first && sha256("c", &other_psfs) != first);
}

#[test]
fn codes_of_a_cut_or_foreign_file_are_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    let bytes = encode_bank(&bank());
    // Half of the file holds the codes, which come first, and still it is no whole bank.
    for (length, expected) in [
        (4, "no kernel bank"),
        (100, "no safetensors"),
        (bytes.len() / 2, "bytes, and"),
        (bytes.len() - 1, "bytes, and"),
    ] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        for message in [read_bank_codes(&path).map(|_| ()), bank_sha256(&path).map(|_| ())] {
            let message = message.unwrap_err().to_string();
            assert!(message.contains(expected), "{length} bytes: {message}");
        }
    }
    std::fs::write(&path, [&bytes[..], b"more"].concat()).unwrap();
    assert!(read_bank_codes(&path).unwrap_err().to_string().contains("damaged"));
    std::fs::write(&path, [255; 64]).unwrap();
    assert!(read_bank_codes(&path).unwrap_err().to_string().contains("too long"));
}

#[test]
fn an_image_is_told_from_a_bank_and_what_makes_one_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("psf.exr");
    write_psf(&path, &bank().psfs[0], &WriteOptions::default()).unwrap();
    for message in [read_bank(&path).map(|_| ()), bank_sha256(&path).map(|_| ())] {
        let message = message.unwrap_err().to_string();
        assert!(message.contains("psf.exr: is no kernel bank; `udc codes` makes one"), "{message}");
    }
}

#[test]
fn a_set_without_angles_has_none_when_it_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    let set = KernelBank { angles_deg: None, ..bank() };
    write_bank(&path, &set, false).unwrap();
    assert_eq!(read_bank(&path).unwrap(), set);
}

#[test]
fn a_change_of_one_sample_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    write_bank(&path, &bank(), false).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let last = bytes.len() - 1;
    // `psfs` is the last tensor in the order of names.
    bytes[last - 2] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    assert!(read_bank(&path).unwrap_err().to_string().contains("hash"));
}

#[test]
fn a_model_is_not_taken_for_a_bank() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    let tensors = BTreeMap::from([("w".to_owned(), (vec![2], Cow::Owned(vec![1.0, 2.0])))]);
    for (format, expected) in [(Some("udc-model"), "udc-model, not a kernel bank"), (None, "does not say")] {
        let metadata = format.map(|format| ("format".to_owned(), format.to_owned())).into_iter().collect();
        write_safetensors(&path, &tensors, &metadata, FloatWidth::Single, true).unwrap();
        let message = read_bank(&path).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    std::fs::write(&path, "no tensors at all").unwrap();
    assert!(read_bank(&path).is_err());
}

#[test]
fn the_published_layout_has_a_file_for_each_kernel_and_code() {
    let folder = tempfile::tempdir().unwrap();
    write_published_bank(folder.path(), "ZTE_new", &bank(), false).unwrap();
    let psf = read_psf(&folder.path().join("ZTE_new_psf_2.npy")).unwrap();
    assert_eq!(psf, bank().psfs[1]);
    let code = read_array(&folder.path().join("ZTE_new_code_3.npy")).unwrap();
    assert_eq!(code.as_slice().unwrap(), [1.5, 2.5]);
    assert!(!folder.path().join("ZTE_new_code_4.npy").exists());
    assert!(write_published_bank(folder.path(), "ZTE_new", &bank(), false).is_err());
}

#[test]
fn damaged_banks_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    write_bank(&path, &bank(), false).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for length in (0..bytes.len()).step_by(97) {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(read_bank(&path).is_err(), "of {length} bytes");
    }
    for position in 0..bytes.len().min(600) {
        let mut damaged = bytes.clone();
        damaged[position] ^= 0x04;
        std::fs::write(&path, damaged).unwrap();
        // A changed angle is still an angle: only the absence of panics is asserted here.
        let _ = read_bank(&path);
    }
}
