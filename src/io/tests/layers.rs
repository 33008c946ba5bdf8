//! Layers and parts of OpenEXR files, chosen by name.

use std::path::PathBuf;

use ::exr::meta::attribute::Chromaticities;
use ::exr::prelude::{
    AnyChannel, AnyChannels, Encoding as ExrEncoding, FlatSamples, Image as ExrImage, ImageAttributes,
    IntegerBounds, Layer, LayerAttributes, Layers, Text, Vec2, WritableImage,
};

use super::*;
use crate::core::primaries::Primaries;

const SIDE: usize = 4;

/// Channels of these names, of which each is even and has its place among all as its value.
fn part(name: &str, channels: &[(&str, f32)]) -> Layer<AnyChannels<FlatSamples>> {
    let channel =
        |(name, value): &(&str, f32)| AnyChannel::new(*name, FlatSamples::F32(vec![*value; SIDE * SIDE]));
    let channels = AnyChannels::sort(channels.iter().map(channel).collect());
    let named = if name.is_empty() { LayerAttributes::default() } else { LayerAttributes::named(name) };
    Layer::new((SIDE, SIDE), named, ExrEncoding::FAST_LOSSLESS, channels)
}

fn write(name: &str, parts: Vec<Layer<AnyChannels<FlatSamples>>>, folder: &Path) -> PathBuf {
    write_of(name, parts, folder, None)
}

fn write_of(
    name: &str,
    parts: Vec<Layer<AnyChannels<FlatSamples>>>,
    folder: &Path,
    chromaticities: Option<Chromaticities>,
) -> PathBuf {
    let mut attributes = ImageAttributes::new(IntegerBounds::from_dimensions((SIDE, SIDE)));
    attributes.chromaticities = chromaticities;
    let image: ExrImage<Layers<_>> = ExrImage { attributes, layer_data: parts.into_iter().collect() };
    let path = folder.join(name);
    image.write().to_file(&path).unwrap();
    path
}

/// The value of each channel of what a name reads, or why it reads nothing.
fn read(path: &Path, name: &str) -> Result<Vec<f32>, String> {
    let named = with_layer(path, name);
    let planes = read_pixels(&named).map_err(|error| error.to_string())?.planes;
    Ok(planes.axis_iter(Axis(0)).map(|plane| plane[[0, 0]]).collect())
}

fn beauty(folder: &Path) -> PathBuf {
    let channels = [
        ("R", 1.0),
        ("G", 2.0),
        ("B", 3.0),
        ("A", 1.0),
        ("diffuse.R", 4.0),
        ("diffuse.G", 5.0),
        ("diffuse.B", 6.0),
        ("light.key.r", 7.0),
        ("light.key.g", 8.0),
        ("light.key.b", 9.0),
        ("depth.Z", 10.0),
        ("N.X", 11.0),
        ("N.Y", 12.0),
        ("N.Z", 13.0),
    ];
    write("beauty.exr", vec![part("", &channels)], folder)
}

#[test]
fn prefixed_layers_and_single_channels_are_read_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = beauty(folder.path());
    for (name, values) in [
        ("RGB", vec![1.0, 2.0, 3.0]),
        ("rgba", vec![1.0, 2.0, 3.0]),
        ("diffuse", vec![4.0, 5.0, 6.0]),
        ("diffuse.RGB", vec![4.0, 5.0, 6.0]),
        ("Diffuse", vec![4.0, 5.0, 6.0]),
        ("light.key", vec![7.0, 8.0, 9.0]),
        ("light.key.rgb", vec![7.0, 8.0, 9.0]),
        ("depth", vec![10.0]),
        ("depth.Z", vec![10.0]),
        ("N.X", vec![11.0]),
        ("diffuse.G", vec![5.0]),
        ("A", vec![1.0]),
    ] {
        assert_eq!(read(&path, name), Ok(values), "{name}");
    }
    assert_eq!(read_pixels(&path).unwrap().planes[[0, 0, 0]], 1.0, "the unprefixed layer is the image");
    let listed = read_layers(&path).unwrap();
    let names: Vec<(&str, bool)> =
        listed.iter().map(|layer| (layer.name.as_str(), layer.is_default)).collect();
    assert_eq!(
        names,
        [
            ("RGB", true),
            ("N.X", false),
            ("N.Y", false),
            ("N.Z", false),
            ("depth.Z", false),
            ("diffuse", false),
            ("light.key", false)
        ],
    );
}

#[test]
fn a_wrong_name_lists_those_that_exist_with_the_nearest() {
    let folder = tempfile::tempdir().unwrap();
    let path = beauty(folder.path());
    let said = read(&path, "difuse").unwrap_err();
    assert!(said.contains("beauty.exr:difuse: has no layer `difuse`"), "{said}");
    assert!(said.contains("light.key") && said.ends_with("did you mean `diffuse`?"), "{said}");
    let said = read(&path, "N").unwrap_err();
    assert!(said.contains("N.X, N.Y, N.Z"), "{said}");
    assert!(read(&path, "").unwrap_err().contains("has no layer ``"));
}

#[test]
fn parts_are_read_by_their_names_and_one_must_be_named() {
    let folder = tempfile::tempdir().unwrap();
    let rgb = |first: f32| [("R", first), ("G", first + 1.0), ("B", first + 2.0)];
    let with_layers = [&rgb(7.0)[..], &[("spec.R", 17.0), ("spec.G", 18.0), ("spec.B", 19.0)]].concat();
    let path = write(
        "stereo.exr",
        vec![part("left", &rgb(1.0)), part("right", &with_layers), part("depth", &[("Z", 5.0)])],
        folder.path(),
    );
    for (name, values) in [
        ("left", vec![1.0, 2.0, 3.0]),
        ("right", vec![7.0, 8.0, 9.0]),
        ("right.RGB", vec![7.0, 8.0, 9.0]),
        ("right.spec", vec![17.0, 18.0, 19.0]),
        ("right/spec", vec![17.0, 18.0, 19.0]),
        ("spec", vec![17.0, 18.0, 19.0]),
        ("depth", vec![5.0]),
        ("depth.Z", vec![5.0]),
        ("Z", vec![5.0]),
    ] {
        assert_eq!(read(&path, name), Ok(values), "{name}");
    }
    let said = read_pixels(&path).unwrap_err().to_string();
    assert!(said.contains("left, right") && said.contains("file.exr:left"), "{said}");
    let said = read(&path, "RGB").unwrap_err();
    assert!(said.contains("several layers `RGB`") && said.contains("left, right, right.spec"), "{said}");
    assert!(read_layers(&path).unwrap().iter().all(|layer| !layer.is_default));
    let size = read_image_size::<Linear>(&with_layer(&path, "left"), None).unwrap();
    assert_eq!(size, [SIDE, SIDE], "the header tells the size of a layer");
}

#[test]
fn files_that_need_no_layer_refuse_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npy");
    write_image(&path, &scene(3, 4), &WriteOptions::default()).unwrap();
    let said = read_pixels(&with_layer(&path, "left")).unwrap_err().to_string();
    assert!(said.contains("NumPy file, which has no layers: leave out `:left`"), "{said}");
    assert!(read_layers(&path).unwrap().is_empty());
}

/// A folder and a pattern stand for the layers of their files; a file whose name is spelled with the colon for itself.
#[test]
fn layers_are_named_of_folders_and_patterns() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.exr", "b.exr"] {
        std::fs::rename(beauty(folder.path()), folder.path().join(name)).unwrap();
    }
    let expand = |name: &str| {
        let files = expand_inputs(&[folder.path().join(name)]).unwrap();
        files.iter().map(|file| file.file_name().unwrap().to_string_lossy().into_owned()).collect::<Vec<_>>()
    };
    assert_eq!(expand("*.exr:diffuse"), ["a.exr:diffuse", "b.exr:diffuse"]);
    assert_eq!(expand("b.exr:diffuse"), ["b.exr:diffuse"]);
    let of_folder = expand_inputs(&[with_layer(folder.path(), "diffuse")]).unwrap();
    assert_eq!(of_folder.len(), 2);
    assert!(of_folder.iter().all(|file| read_pixels(file).unwrap().planes[[0, 0, 0]] == 4.0));
    assert_eq!(read_pixels(&folder.path().join("a.exr:diffuse")).unwrap().planes[[0, 0, 0]], 4.0);
    std::fs::copy(folder.path().join("b.exr"), folder.path().join("a.exr:diffuse")).unwrap();
    assert_eq!(read_pixels(&folder.path().join("a.exr:diffuse")).unwrap().planes[[0, 0, 0]], 1.0);
}

/// Of a file of several views the first has no prefix, as the format's conventions say.
#[test]
fn views_are_read_by_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let mut both =
        part("", &[("R", 1.0), ("G", 2.0), ("B", 3.0), ("right.R", 4.0), ("right.G", 5.0), ("right.B", 6.0)]);
    both.attributes.multi_view_names = Some(vec![Text::from("left"), Text::from("right")]);
    let path = write("views.exr", vec![both], folder.path());
    assert_eq!(read(&path, "left"), Ok(vec![1.0, 2.0, 3.0]));
    assert_eq!(read(&path, "right"), Ok(vec![4.0, 5.0, 6.0]));
}

#[test]
fn declared_primaries_are_kept_unless_they_are_those_of_srgb() {
    let folder = tempfile::tempdir().unwrap();
    let rgb = [("R", 1.0), ("G", 2.0), ("B", 3.0)];
    let aces = Chromaticities {
        red: Vec2(0.713, 0.293),
        green: Vec2(0.165, 0.83),
        blue: Vec2(0.128, 0.044),
        white: Vec2(0.32168, 0.33767),
    };
    let path = write_of("aces.exr", vec![part("", &rgb)], folder.path(), Some(aces));
    let primaries = read_pixels(&path).unwrap().capture.unwrap().primaries.unwrap();
    assert_eq!(primaries.name(), Some("ACES AP1"));
    let info = read_capture_info(&path).unwrap();
    assert_eq!(info.as_ref().and_then(|info| info.primaries), Some(primaries));
    // What is made of it declares them as well, in the way of the format.
    let copy = folder.path().join("copy.exr");
    let options = WriteOptions { capture: info, ..WriteOptions::default() };
    write_image(&copy, &read_image::<Linear>(&path).unwrap(), &options).unwrap();
    let meta = ::exr::meta::MetaData::read_from_file(&copy, false).unwrap();
    assert_eq!(meta.headers[0].shared_attributes.chromaticities, Some(aces));
    let srgb = Chromaticities {
        red: Vec2(0.64, 0.33),
        green: Vec2(0.3, 0.6),
        blue: Vec2(0.15, 0.06),
        white: Vec2(0.3127, 0.329),
    };
    let broken = Chromaticities { white: Vec2(0.0, 0.0), ..aces };
    for (name, chromaticities) in [("srgb.exr", srgb), ("broken.exr", broken)] {
        let path = write_of(name, vec![part("", &rgb)], folder.path(), Some(chromaticities));
        assert_eq!(read_pixels(&path).unwrap().capture, None, "{name}");
    }
    assert!(Primaries::SRGB.matrix_to(&primaries).is_some());
}
