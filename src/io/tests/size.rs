//! Sizes from headers: those of the images that are read.

use super::*;

/// Every file of the tests, whole or damaged: the header says the size of the image, or nothing more is believed.
#[test]
fn a_header_says_the_size_of_the_image_that_is_read() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/files");
    let mut sizes = 0;
    for name in list_folder(&folder).unwrap() {
        let path = folder.join(name);
        for told in [None, Some(DomainTag::Linear), Some(DomainTag::Srgb)] {
            let image = read_image_told::<Linear>(&path, told);
            if let Ok((image, _)) = image {
                let size = read_image_size::<Linear>(&path, told).unwrap();
                assert_eq!(size, [image.height(), image.width()], "{}", path.display());
                sizes += 1;
            }
        }
    }
    assert!(sizes > 10, "only {sizes} files were images");
}

#[test]
fn a_file_of_another_domain_or_kind_has_no_size() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let image = Image::<ToneMapped>::from_planes(Array3::zeros((3, 2, 5))).unwrap();
    write_image(&path, &image, &WriteOptions::default()).unwrap();
    assert_eq!(read_image_size::<ToneMapped>(&path, None).unwrap(), [2, 5]);
    assert!(read_image_size::<Linear>(&path, None).unwrap_err().to_string().contains("tone-mapped"));
    std::fs::write(&path, b"\x93NUMPY").unwrap();
    assert!(read_image_size::<Linear>(&path, None).unwrap_err().to_string().contains("truncated"));
    assert!(read_image_size::<Linear>(&folder.path().join("absent"), None).is_err());
}

#[test]
fn light_in_either_domain_has_a_size() {
    let folder = tempfile::tempdir().unwrap();
    let [mapped, linear] = ["mapped.exr", "linear.exr"].map(|name| folder.path().join(name));
    let options = WriteOptions::default();
    write_image(&mapped, &Image::<ToneMapped>::from_planes(Array3::zeros((3, 2, 5))).unwrap(), &options)
        .unwrap();
    write_image(&linear, &Image::<Linear>::from_planes(Array3::zeros((3, 4, 3))).unwrap(), &options).unwrap();
    assert_eq!(read_any_image_size(&mapped, None).unwrap(), [2, 5]);
    assert_eq!(read_any_image_size(&mapped, Some(DomainTag::ToneMapped)).unwrap(), [2, 5]);
    assert_eq!(read_any_image_size(&linear, None).unwrap(), [4, 3]);
    assert!(read_any_image_size(&mapped, Some(DomainTag::Linear)).is_err());
}
