//! What the headers of OpenEXR files say: windows, colours, the shape of pixels, the names of channels.

use std::path::Path;

use exr::meta::attribute::Chromaticities;
use exr::prelude::{
    AnyChannel, AnyChannels, FlatSamples, Image, IntegerBounds, Layer, LayerAttributes, Vec2, WritableImage,
};
use udc::io::read_pixels;

use super::common::{fail, succeed, udc};

const SIDE: usize = 64;

type File = Image<Layer<AnyChannels<FlatSamples>>>;

/// A picture of a level of 0.01 with a point source of light 0.8 in the middle, a square of `data` pixels.
fn point_source(data: usize) -> File {
    let half = data as f32 / 2.0;
    let light = |y: usize, x: usize| {
        0.01 + 0.8 * (-((y as f32 - half).powi(2) + (x as f32 - half).powi(2)) / 4.0).exp()
    };
    let samples: Vec<f32> = (0..data * data).map(|i| light(i / data, i % data)).collect();
    of_channels(data, &["B", "G", "R"].map(|name| (name, samples.clone())))
}

fn of_channels(side: usize, channels: &[(&str, Vec<f32>)]) -> File {
    let channel =
        |(name, samples): &(&str, Vec<f32>)| AnyChannel::new(*name, FlatSamples::F32(samples.clone()));
    let channels = AnyChannels::sort(channels.iter().map(channel).collect());
    Image::from_layer(Layer::new(
        (side, side),
        LayerAttributes::default(),
        exr::prelude::Encoding::FAST_LOSSLESS,
        channels,
    ))
}

/// What a command says on stderr that succeeds.
fn warnings(folder: &Path, args: &[&str]) -> String {
    let output = udc(folder, args);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "udc {args:?} failed: {said}");
    said
}

/// The commands that read an image of light.
const READERS: [&[&str]; 4] = [
    &["fuse", "a.exr", "--exposures", "1", "--point-source", "--size", "21", "-o", "fused.exr"],
    &["finish", "a.exr", "-o", "finished.png"],
    &["tonemap", "a.exr", "-o", "mapped.exr"],
    &["convert", "a.exr", "converted.npy"],
];

/// Each command warns once, and `udc info` says it as well.
fn assert_doubted(folder: &Path, what: &str) {
    for args in READERS {
        let said = warnings(folder, &[args, &["--overwrite"]].concat());
        assert_eq!(said.matches(what).count(), 1, "udc {args:?} said: {said}");
    }
    assert!(succeed(folder, &["info", "a.exr"]).contains(what));
}

#[test]
fn pixels_without_data_are_warned_of_wherever_light_is_read() {
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("a.exr");
    let mut image = point_source(48);
    image.layer_data.attributes.layer_position = Vec2(8, 8);
    image.attributes.display_window = IntegerBounds::from_dimensions((SIDE, SIDE));
    image.write().to_file(path).unwrap();
    let what = "1792 of 4096 pixels hold no data";
    let fuse: &[&str] = &["fuse", "a.exr", "--exposures", "1", "-o", "fused.exr"];
    for args in [&[fuse], &READERS[1..]].concat() {
        let said = warnings(scratch.path(), args);
        assert_eq!(said.matches(what).count(), 1, "udc {args:?} said: {said}");
    }
    assert!(succeed(scratch.path(), &["info", "a.exr"]).contains(what));
    let said = fail(scratch.path(), &[READERS[0], &["--overwrite"]].concat(), 1);
    assert!(said.contains("a.exr") && said.contains("crop the file to its data window"), "{said}");
}

#[test]
fn an_alpha_that_is_not_opaque_is_warned_of() {
    let scratch = tempfile::tempdir().unwrap();
    let write = |alpha: &dyn Fn(usize) -> f32| {
        let light: Vec<f32> =
            (0..SIDE * SIDE).map(|i| if i == SIDE * SIDE / 2 + 32 { 0.8 } else { 0.01 }).collect();
        let alpha = (0..SIDE * SIDE).map(alpha).collect();
        let channels = [("R", light.clone()), ("G", light.clone()), ("B", light), ("A", alpha)];
        of_channels(SIDE, &channels).write().to_file(scratch.path().join("a.exr")).unwrap();
    };
    write(&|i| if i % SIDE < 10 { 0.5 } else { 1.0 });
    let what = "its alpha is not 1 at 640 of 4096 pixels";
    assert_doubted(scratch.path(), what);
    let found = String::from_utf8(udc(scratch.path(), &["doctor", "a.exr"]).stdout).unwrap();
    assert!(found.contains(what), "{found}");
    write(&|_| 1.0);
    assert!(
        !warnings(scratch.path(), &["tonemap", "a.exr", "-o", "mapped.exr", "--overwrite"]).contains("alpha")
    );
}

#[test]
fn pixels_that_are_not_square_are_warned_of() {
    let scratch = tempfile::tempdir().unwrap();
    let mut image = point_source(SIDE);
    image.attributes.pixel_aspect = 2.0;
    image.write().to_file(scratch.path().join("a.exr")).unwrap();
    assert_doubted(scratch.path(), "2.000 times as wide as high (pixelAspectRatio)");
}

fn write_with_chromaticities(folder: &Path, [red, green, blue, white]: [[f32; 2]; 4]) {
    let place = |[x, y]: [f32; 2]| Vec2(x, y);
    let even = |light: f32| vec![light; SIDE * SIDE];
    let mut image = of_channels(SIDE, &[("R", even(0.25)), ("G", even(0.33)), ("B", even(0.12))]);
    image.attributes.chromaticities =
        Some(Chromaticities { red: place(red), green: place(green), blue: place(blue), white: place(white) });
    image.write().to_file(folder.join("a.exr")).unwrap();
}

/// What it becomes, by an independent computation.
const EXPECTED: [f32; 3] = [0.4603, 0.6662, 0.3194];

/// XYZ of 0.25, 0.33, 0.12 under equal energy, adapted to D65 by Bradford, in sRGB.
#[test]
fn an_image_of_xyz_is_finished_in_its_colours() {
    let scratch = tempfile::tempdir().unwrap();
    let third = 1.0 / 3.0;
    write_with_chromaticities(scratch.path(), [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [third, third]]);
    let args =
        ["finish", "a.exr", "-o", "a.png", "--curve", "srgb", "--max", "1", "--no-clahe", "--bits", "16"];
    assert!(!warnings(scratch.path(), &args).contains("chromaticities"));
    let planes = read_pixels(&scratch.path().join("a.png")).unwrap().planes;
    for (channel, expected) in EXPECTED.into_iter().enumerate() {
        let found = planes[[channel, 5, 5]];
        assert!((found - expected).abs() < 2e-3, "{found} of channel {channel}, not {expected}");
    }
}

#[test]
fn chromaticities_that_are_no_colours_are_warned_of() {
    let scratch = tempfile::tempdir().unwrap();
    write_with_chromaticities(scratch.path(), [[0.0, 0.0]; 4]);
    for args in &READERS[1..] {
        let said = warnings(scratch.path(), args);
        assert!(said.contains("its chromaticities span no colours"), "udc {args:?} said: {said}");
    }
}

#[test]
fn channels_in_capital_letters_are_the_image_and_others_are_named_as_they_are() {
    let scratch = tempfile::tempdir().unwrap();
    let lights = [("R", 0.1), ("G", 0.2), ("B", 0.3), ("r", 0.4), ("g", 0.5), ("b", 0.6)];
    let image = of_channels(SIDE, &lights.map(|(name, light)| (name, vec![light; SIDE * SIDE])));
    image.write().to_file(scratch.path().join("a.exr")).unwrap();
    for (input, expected) in [("a.exr", vec![0.1, 0.2, 0.3]), ("a.exr:g", vec![0.5]), ("a.exr:G", vec![0.2])]
    {
        let planes = read_pixels(&scratch.path().join(input)).unwrap().planes;
        let found: Vec<f32> = planes.outer_iter().map(|plane| plane[[3, 3]]).collect();
        assert_eq!(found, expected, "{input}");
    }
}
