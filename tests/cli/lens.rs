//! What lenses do to captures beside the panel: colours that they draw apart, and shading that is taken out.

use std::path::Path;

use ndarray::Array3;
use udc::core::image::{CHANNELS, LinearImage};
use udc::io::{self, WriteOptions};

use super::common::{succeed, udc};

const SIDE: usize = 192;

/// Makes a panel's PSF, and a capture of a scene of this kind behind it, whose light is `exposure` times as much as it was.
fn capture_of(folder: &Path, kind: &str, exposure: f32) -> Array3<f32> {
    let panel = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/display/pentile.toml");
    succeed(folder, &["psf", "--display", panel.to_str().unwrap(), "--size", "65", "-o", "psf.exr"]);
    let side = SIDE.to_string();
    succeed(
        folder,
        &["scenes", "-o", "scenes", "--count", "1", "--kinds", kind, "--size", &side, "--margin", "40"],
    );
    succeed(
        folder,
        &["synth", "scenes", "--psf", "psf.exr", "--noise", "sensor", "--split", "test", "-o", "data"],
    );
    let files = std::fs::read_dir(folder.join("data/degraded/r+00")).unwrap();
    let file =
        files.map(|file| file.unwrap().path()).find(|path| path.extension().is_some_and(|e| e == "exr"));
    let image: LinearImage = io::read_image(&file.unwrap()).unwrap();
    image.into_planes() * exposure
}

fn write(folder: &Path, planes: Array3<f32>) {
    let image = LinearImage::from_planes(planes).unwrap();
    io::write_image(
        &folder.join("capture.exr"),
        &image,
        &WriteOptions { overwrite: true, ..WriteOptions::default() },
    )
    .unwrap();
}

/// What a restoration says, and its events.
fn restored(folder: &Path, more: &[&str]) -> (String, String) {
    let flags = [&["restore", "capture.exr", "--psf", "psf.exr", "-o", "out.exr", "--overwrite", "-v"], more]
        .concat();
    let output = udc(folder, &flags);
    assert!(output.status.success());
    let events = udc(folder, &[&flags[..], &["--json"]].concat()).stdout;
    (String::from_utf8(output.stderr).unwrap(), String::from_utf8(events).unwrap())
}

#[test]
fn colours_that_a_lens_draws_apart_are_told() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let planes = capture_of(folder, "foliage", 1.0);
    write(folder, planes.clone());
    let (said, events) = restored(folder, &[]);
    assert!(!said.contains("the lens draws") && events.contains("\"lateral-colour\":null"), "{said}{events}");

    // Red larger by 1.2 %: 1.6 pixels at the corner.
    let at = |out: usize| (SIDE as f32 - 1.0) / 2.0 + (out as f32 - (SIDE as f32 - 1.0) / 2.0) / 1.012;
    let larger = Array3::from_shape_fn(planes.dim(), |(channel, y, x)| {
        if channel > 0 {
            return planes[[channel, y, x]];
        }
        let (y, x) = (at(y), at(x));
        let value = |down: usize, along: usize| planes[[0, y as usize + down, x as usize + along]];
        let (down, along) = (y.fract(), x.fract());
        (1.0 - down) * ((1.0 - along) * value(0, 0) + along * value(0, 1))
            + down * ((1.0 - along) * value(1, 0) + along * value(1, 1))
    });
    write(folder, larger);
    let (said, events) = restored(folder, &[]);
    let px = events.split("\"red-px\":").nth(1).and_then(|rest| rest.split([',', '}']).next());
    let px: f64 = px.expect("red lies apart").parse().unwrap();
    assert!((1.2..2.3).contains(&px), "{px}");
    assert!(said.contains("the lens draws red up to "), "{said}");
}

#[test]
fn a_white_whose_shading_was_taken_out_is_found_and_a_level_that_is_told_of_it_not_warned_of() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let planes = capture_of(folder, "night", 1.0);
    // What lies around is the lamps' flare, which is not dimmed as they are: of no interest here.
    let middle = (SIDE as f32 - 1.0) / 2.0;
    let lamps = [(20.0, 30.0), (90.0, 100.0), (170.0, 160.0), (40.0, 150.0), (150.0, 40.0)];
    let shaded = Array3::from_shape_fn(planes.dim(), |(channel, y, x)| {
        let square = ((y as f32 - middle).powi(2) + (x as f32 - middle).powi(2)) / (2.0 * middle * middle);
        let gain = (1.0 + 0.2 * square).powi(2);
        let lamp: f32 = lamps
            .iter()
            .map(|lamp: &(f32, f32)| 50.0 * (-(y as f32 - lamp.0).hypot(x as f32 - lamp.1) / 2.0).exp())
            .sum();
        ((planes[[channel, y, x]] * 0.01 + lamp) / gain).min(1.0) * gain
    });
    assert_eq!(shaded.dim().0, CHANNELS);
    write(folder, shaded);
    let (said, _) = restored(folder, &[]);
    assert!(said.contains("saturates at 1.0"), "{said}");
    let (said, _) = restored(folder, &["--x-max", "1"]);
    assert!(!said.contains("above --x-max"), "{said}");
}
