//! Outputs: whole or not at all, never over somebody's file, never in a name that says nothing.

use std::io::{Error as IoError, ErrorKind};

use super::*;

fn entries(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        folder.read_dir().unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_write_that_fails_leaves_the_old_file_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.txt");
    std::fs::write(&path, "old").unwrap();
    let error = write_atomically(&path, true, |file| {
        file.write_all(&vec![1; 3 << 20])?;
        Err(IoError::new(ErrorKind::StorageFull, "no space left"))
    })
    .unwrap_err();
    assert!(error.to_string().contains("a.txt"), "{error}");
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "old");
    assert_eq!(entries(folder.path()), ["a.txt"]);
}

#[test]
fn replaces_a_file_only_when_it_may() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.txt");
    write_atomically(&path, false, |file| file.write_all(b"1")).unwrap();
    let error = write_atomically(&path, false, |file| file.write_all(b"2")).unwrap_err();
    assert!(format!("{:#}", anyhow::Error::from(error)).contains("--overwrite"));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "1");
    write_atomically(&path, true, |file| file.write_all(b"3")).unwrap();
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "3");
}

#[test]
fn does_not_replace_a_file_that_appears_while_it_writes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.txt");
    let error = write_atomically(&path, false, |file| {
        std::fs::write(&path, "theirs")?;
        file.write_all(b"ours")
    });
    assert!(error.is_err());
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "theirs");
    assert_eq!(entries(folder.path()), ["a.txt"]);
}

#[test]
fn a_missing_folder_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let error = write_atomically(&folder.path().join("no/a.txt"), false, |_| Ok(())).unwrap_err();
    assert!(format!("{:#}", anyhow::Error::from(error)).contains("does not exist; create it"));
}

#[cfg(unix)]
#[test]
fn an_unwritable_folder_is_an_error_that_names_the_file() {
    use std::os::unix::fs::PermissionsExt;

    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), PermissionsExt::from_mode(0o555)).unwrap();
    if std::fs::write(folder.path().join("probe"), "").is_ok() {
        // The superuser may write anywhere: nothing to test.
        return;
    }
    let error = write_atomically(&folder.path().join("a.txt"), false, |_| Ok(())).unwrap_err();
    assert!(error.to_string().contains("a.txt"), "{error}");
}

#[cfg(unix)]
#[test]
fn outputs_are_as_readable_as_any_new_file() {
    use std::os::unix::fs::PermissionsExt;

    let folder = tempfile::tempdir().unwrap();
    let (ours, plain) = (folder.path().join("ours"), folder.path().join("plain"));
    write_atomically(&ours, false, |file| file.write_all(b"1")).unwrap();
    std::fs::write(&plain, "1").unwrap();
    let mode = |path: &Path| path.metadata().unwrap().permissions().mode();
    assert_eq!(mode(&ours), mode(&plain));
}

#[test]
fn integer_formats_refuse_bright_linear_images_and_clip_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let pixels = Pixels::of_planes(Array3::from_elem((3, 2, 2), 2.0));
    for name in ["a.png", "a.tif", "a.jpg"] {
        let path = folder.path().join(name);
        assert!(write_pixels(&path, &pixels, PixelOptions::default()).is_err(), "{name}");
        assert!(!path.exists());
        write_pixels(&path, &pixels, PixelOptions { clip: true, ..Default::default() }).unwrap();
        assert!(read_pixels(&path).unwrap().planes.iter().all(|&v| v > 0.99), "{name}");
    }
}

#[test]
fn formats_refuse_values_that_they_cannot_hold() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, value: f32, options: PixelOptions| {
        let path = folder.path().join(name);
        let mut planes = Array3::from_elem((3, 2, 2), 0.5);
        planes[[1, 1, 0]] = value;
        write_pixels(&path, &Pixels::of_planes(planes), PixelOptions { overwrite: true, ..options })
            .map(|()| read_pixels(&path).unwrap().planes[[1, 1, 0]])
            .map_err(|error| error.to_string())
    };
    let clip = PixelOptions { clip: true, ..PixelOptions::default() };
    for name in ["a.png", "a.tif", "a.jpg", "a.hdr"] {
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for options in [PixelOptions::default(), clip] {
                let message = write(name, value, options).unwrap_err();
                assert!(
                    message.contains("row 1, column 0") && !message.contains("--clip"),
                    "{name}: {message}"
                );
            }
        }
        let message = write(name, -0.25, PixelOptions::default()).unwrap_err();
        assert!(message.contains("-0.25") && message.contains("--clip"), "{name}: {message}");
        assert!(write(name, -0.25, clip).unwrap() < 0.2, "{name}");
    }
    assert!(write("a.hdr", 2e38, PixelOptions::default()).unwrap_err().contains("--clip"));
    for (value, options) in [(1.69e38, PixelOptions::default()), (f32::MAX, clip)] {
        let found = write("a.hdr", value, options).unwrap();
        assert!((found / 1.69e38 - 1.0).abs() < 0.01, "{value} became {found}");
    }
    for (name, value) in [("a.exr", f32::NEG_INFINITY), ("a.npy", -0.25)] {
        assert_eq!(write(name, value, PixelOptions::default()), Ok(value));
    }
}

/// The format's encoder cuts mantissas off, which alone loses a share of 2⁻⁸ of the light.
#[test]
fn radiance_files_hold_the_nearest_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.hdr");
    let planes = Array3::from_shape_fn((3, 64, 64), |(c, y, x)| {
        let scatter = ((c * 4096 + y * 64 + x) * 2_654_435_761 % 65_536) as f32 / 65_536.0;
        (scatter + 1e-3) * 2f32.powi((y % 9) as i32 - 4)
    });
    write_pixels(&path, &Pixels::of_planes(planes.clone()), PixelOptions::default()).unwrap();
    let found = read_pixels(&path).unwrap().planes;
    let bias = found.mean().unwrap() / planes.mean().unwrap() - 1.0;
    assert!(bias.abs() < 3e-4, "{bias}");
    for y in 0..64 {
        for x in 0..64 {
            let brightest = (0..3).map(|c| planes[[c, y, x]]).fold(0.0, f32::max);
            for c in 0..3 {
                let error = (found[[c, y, x]] - planes[[c, y, x]]).abs() / brightest;
                assert!(error < 0.5 / 127.0, "{error} at {c}, {y}, {x}");
            }
        }
    }
}

#[test]
fn grey_and_packed_bayer_keep_their_planes_where_a_format_can() {
    let folder = tempfile::tempdir().unwrap();
    let grey = Pixels::of_planes(Array3::from_shape_fn((1, 5, 7), |(_, y, x)| (y * 7 + x) as f32 / 64.0));
    for name in ["a.exr", "a.npy"] {
        let path = folder.path().join(name);
        write_pixels(&path, &grey, PixelOptions::default()).unwrap();
        assert_eq!(read_pixels(&path).unwrap().planes, grey.planes, "{name}");
        assert_eq!(read_image::<Linear>(&path).unwrap().channel(2), grey.planes.index_axis(Axis(0), 0));
    }
    let bayer = Pixels::of_planes(Array3::from_elem((4, 5, 7), 0.5));
    let path = folder.path().join("bayer.npy");
    write_pixels(&path, &bayer, PixelOptions::default()).unwrap();
    assert_eq!(read_pixels(&path).unwrap().planes, bayer.planes);
    assert!(read_image::<Linear>(&path).unwrap_err().to_string().contains("Bayer"));
    assert!(write_pixels(&folder.path().join("bayer.exr"), &bayer, PixelOptions::default()).is_err());
}

#[test]
fn folders_and_patterns_expand_in_order() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["b.exr", "a.PNG", "c.npy", "notes.txt", ".udc-x.partial"] {
        std::fs::write(folder.path().join(name), "").unwrap();
    }
    let names = |inputs: &[&str]| -> Result<Vec<String>> {
        let inputs: Vec<_> = inputs.iter().map(|input| folder.path().join(input)).collect();
        let files = expand_inputs(&inputs)?;
        Ok(files.iter().map(|file| file.file_name().unwrap().to_str().unwrap().to_owned()).collect())
    };
    assert_eq!(names(&[""]).unwrap(), ["a.PNG", "b.exr", "c.npy"]);
    assert_eq!(names(&["*.exr", "a.PNG"]).unwrap(), ["b.exr", "a.PNG"]);
    assert!(names(&["*.jpg"]).unwrap_err().to_string().contains("no file matches"));
    assert!(names(&["gone.exr"]).is_err());
}
