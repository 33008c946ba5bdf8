//! PSFs of the user's own: what is wrong with their files is said, with the flag that mends it.

use std::fs;
use std::path::Path;

use ndarray::{Array3, s};
use udc::core::image::{Linear, LinearImage};
use udc::io::{self, PixelOptions, Pixels, WriteOptions};

use super::common::{fail, succeed, udc};

/// A spot of unit sum whose peak is `down` and `right` of the centre, index N // 2, of 16 × 16 pixels.
fn spot(down: isize, right: isize) -> Array3<f32> {
    let value = |y: usize, x: usize| {
        let (dy, dx) = (y as f64 - 8.0 - down as f64, x as f64 - 8.0 - right as f64);
        (-(dy * dy + dx * dx) / 2.0).exp()
    };
    let sum: f64 = (0..16).flat_map(|y| (0..16).map(move |x| value(y, x))).sum();
    Array3::from_shape_fn((3, 16, 16), |(_, y, x)| (value(y, x) / sum) as f32)
}

fn write(path: &Path, planes: Array3<f32>) {
    let options = PixelOptions { overwrite: true, ..PixelOptions::default() };
    io::write_pixels(path, &Pixels::of_planes(planes), options).unwrap();
}

fn write_scene(folder: &Path) {
    fs::create_dir_all(folder.join("views")).unwrap();
    let planes = Array3::from_shape_fn((3, 20, 24), |(c, y, x)| {
        if (y, x) == (9, 11) { 50.0 } else { 0.1 + 0.01 * ((c + y + 3 * x) % 7) as f32 }
    });
    let scene = LinearImage::from_planes(planes).unwrap();
    io::write_image(&folder.join("views/park_01.exr"), &scene, &WriteOptions::default()).unwrap();
}

/// The exit code and what was said on stderr.
fn said(folder: &Path, args: &[&str]) -> String {
    let output = udc(folder, args);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "udc {args:?} failed: {stderr}");
    stderr
}

/// Every command that reads a PSF's file, by how it is called.
const READERS: [&[&str]; 9] = [
    &["codes", "psf.npy", "--angles=-3,0,3", "--dim", "2", "-o", "out.safetensors"],
    &["codes", "psf.npy", "wide.npy", "--dim", "1", "-o", "out.safetensors"],
    &["codes", "--project", "bank.safetensors", "psf.npy"],
    &["synth", "views", "--psf", "psf.npy", "-o", "out"],
    &["synth", "views", "--field", "field.toml", "-o", "out"],
    &["restore", "views/park_01.exr", "--method", "wiener", "--psf", "psf.npy", "-o", "out.exr"],
    &["report", "psf.npy", "-o", "out.html"],
    &["info", "--psf", "psf.npy"],
    &["info", "--psf", "--json", "psf.npy"],
];

#[test]
fn a_psf_off_its_centre_is_warned_of_by_every_command_and_mended_by_recenter() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_scene(folder);
    write(&folder.join("psf.npy"), spot(0, 0));
    let bank = ["codes", "psf.npy", "--angles=-3,0,3", "--dim", "2", "-o", "bank.safetensors"];
    assert_eq!(said(folder, &bank), "", "a PSF in its place is no reason to warn");
    fs::write(folder.join("field.toml"), "rows = 1\ncolumns = 2\npsfs = [\"psf.npy\", \"psf.npy\"]\n")
        .unwrap();

    write(&folder.join("wide.npy"), 0.5 * spot(0, 0) + 0.25 * (spot(0, 1) + spot(0, -1)));
    write(&folder.join("psf.npy"), spot(1, -2));
    for reader in READERS {
        let clear = || {
            for name in ["out", "out.exr", "out.html", "out.safetensors"] {
                io::remove(&folder.join(name)).unwrap();
            }
        };
        clear();
        let output = udc(folder, reader);
        // `udc info` says it among the rest.
        let everything = [output.stdout, output.stderr].concat();
        let everything = String::from_utf8(everything).unwrap();
        assert!(everything.contains("1 px down and 2 px left"), "{reader:?}: {everything}");
        assert!(everything.contains("--recenter"), "{reader:?}: {everything}");
        clear();
        let mended = [reader, &["--recenter"]].concat();
        let output = udc(folder, &mended);
        let stderr = String::from_utf8(output.stderr).unwrap();
        let is_of_psf = |line: &str| line.starts_with("warning") && line.contains("psf.npy");
        assert!(output.status.success() && !stderr.lines().any(is_of_psf), "{mended:?}: {stderr}");
    }
}

/// One point of light, through a PSF that is one pixel off: the degraded point lies one pixel off its clean one.
#[test]
fn one_pixel_of_shift_no_longer_moves_training_pairs() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write_scene(folder);
    let brightest = |output: &str| {
        let path = folder.join(output).join("degraded/r+00/park_01.exr");
        let image = io::read_image::<Linear>(&path).unwrap();
        let plane = image.channel(1).to_owned();
        plane.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0
    };
    write(&folder.join("psf.npy"), spot(0, 1));
    let synth = ["synth", "views", "--psf", "psf.npy", "-o"];
    succeed(folder, &[&synth[..], &["shifted"]].concat());
    assert_eq!(brightest("shifted"), (9, 12));
    let noted = said(folder, &[&synth[..], &["mended", "--recenter"]].concat());
    assert!(noted.contains("moved to the centre, 1 px left"), "{noted}");
    assert_eq!(brightest("mended"), (9, 11));
}

#[test]
fn sums_negative_lobes_and_nans_of_a_psf_are_named() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let info = ["info", "--psf", "psf.npy"];
    write(&folder.join("psf.npy"), spot(0, 0).mapv(|v| 0.87 * v));
    let text = succeed(folder, &info);
    assert!(text.contains("every colour sums to 0.8700 instead of 1"), "{text}");

    let mut lobes = spot(0, 0);
    lobes.slice_mut(s![.., 2, 2]).fill(-0.01);
    write(&folder.join("psf.npy"), lobes);
    let text = succeed(folder, &info);
    assert!(text.contains("1.00 % of negative energy"), "{text}");

    let mut broken = spot(0, 0);
    broken[[2, 3, 4]] = f32::NAN;
    write(&folder.join("psf.npy"), broken);
    let message = fail(folder, &["codes", "psf.npy", "-o", "bank.safetensors"], 1);
    assert!(message.contains("psf.npy") && message.contains("NaN at row 3, column 4 in blue"), "{message}");
    assert!(!folder.join("bank.safetensors").exists());
}

#[test]
fn psfs_that_udc_wrote_are_read_without_a_warning() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let panel = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/display/pentile.toml");
    let simulate = ["psf", "--display", panel.to_str().unwrap(), "--size", "64", "-o", "simulated.exr"];
    succeed(folder, &simulate);
    // Beside it a point source whose core saturates in every exposure, measured.
    let source = Array3::from_shape_fn((3, 64, 60), |(_, y, x)| {
        let spot = |cy: f32, cx: f32| (-((y as f32 - cy).powi(2) + (x as f32 - cx).powi(2)) / 4.0).exp();
        (700.0 * spot(33.0, 30.0) + 2.0 * spot(33.0, 42.0) + 0.01).min(1.0)
    });
    write(&folder.join("source.npy"), source);
    succeed(folder, &["fuse", "source.npy", "--point-source", "--size", "40", "-o", "measured.exr"]);
    succeed(folder, &["convert", "simulated.exr", "half.exr", "--half"]);
    for name in ["simulated.exr", "measured.exr", "half.exr"] {
        let bank = format!("{name}.safetensors");
        let made = ["codes", name, "--angles=-3,0,3", "--dim", "2", "-o", &bank];
        assert_eq!(said(folder, &made), "", "{name}");
    }
}

#[test]
fn flags_of_psf_files_without_a_psf_file_are_refused() {
    let scratch = tempfile::tempdir().unwrap();
    write_scene(scratch.path());
    let synth = ["synth", "views", "--bank", "bank.safetensors", "-o", "out", "--recenter"];
    assert!(fail(scratch.path(), &synth, 2).contains("--psf"));
}

/// As `numpy.fft.ifftshift` writes it, the centre comes first: zeros behind the move would leave a quarter of the light.
#[test]
fn a_psf_in_fft_layout_is_rolled_by_recenter_and_one_that_would_lose_its_light_is_refused() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let whole = spot(0, 0);
    let corner = Array3::from_shape_fn((3, 16, 16), |(c, y, x)| whole[[c, (y + 8) % 16, (x + 8) % 16]]);
    write(&folder.join("whole.npy"), whole);
    write(&folder.join("corner.npy"), corner);
    let codes = |psf: &str, bank: &str| {
        ["codes", psf, "--angles=-3,0,3", "--dim", "2", "-o", bank].map(str::to_owned)
    };
    let run = |args: &[String], more: &[&str]| {
        let args: Vec<&str> = args.iter().map(String::as_str).chain(more.iter().copied()).collect();
        said(folder, &args)
    };
    run(&codes("whole.npy", "whole.safetensors"), &[]);
    let warned = run(&codes("corner.npy", "corner.safetensors"), &[]);
    assert!(warned.contains("--recenter to roll it to the middle, which loses nothing"), "{warned}");
    let noted = run(&codes("corner.npy", "rolled.safetensors"), &["--recenter"]);
    assert!(noted.contains("was rolled to the middle") && noted.contains("nothing was lost"), "{noted}");
    let psf = |bank: &str| io::read_bank(&folder.join(bank)).unwrap().psfs;
    assert_eq!(psf("rolled.safetensors"), psf("whole.safetensors"));

    let mut haze = spot(-7, 0);
    haze.slice_mut(s![.., 10.., ..]).fill(1e-3);
    write(&folder.join("edge.npy"), haze);
    let info = ["info", "--psf", "edge.npy"];
    assert!(succeed(folder, &info).contains("--recenter is no help"));
    let refused = fail(folder, &[&info[..], &["--recenter"]].concat(), 1);
    assert!(refused.contains("edge.npy") && refused.contains("crop the PSF around its peak"), "{refused}");
}
