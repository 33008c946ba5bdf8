//! What the headers of OpenEXR files say: windows, colours, the shape of pixels, the names of channels.

use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, FlatSamples, Image, IntegerBounds, Layer, LayerAttributes, Vec2, WritableImage,
};
use udc::io::read_pixels;

use super::common::{succeed, udc};

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
    assert_doubted(scratch.path(), "1792 of 4096 pixels hold no data");
}
