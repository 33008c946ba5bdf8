//! Layers of OpenEXR files, and pictures of formats that are not read.

use std::fs;
use std::path::Path;

use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, ImageAttributes, IntegerBounds, Layer,
    LayerAttributes, Layers, WritableImage,
};
use udc::io::read_pixels;

use super::common::{fail, succeed, udc};

const SIDE: usize = 24;

/// A part with R, G, B of even light, and the same under a prefix with twice the light.
fn part(name: &str, light: f32, prefix: Option<&str>) -> Layer<AnyChannels<FlatSamples>> {
    let mut channels: Vec<(String, f32)> = ["R", "G", "B"].map(|c| (c.to_owned(), light)).into();
    channels.extend(
        prefix.iter().flat_map(|prefix| ["R", "G", "B"].map(|c| (format!("{prefix}.{c}"), 2.0 * light))),
    );
    let channel = |(name, light): (String, f32)| {
        AnyChannel::new(name.as_str(), FlatSamples::F32(vec![light; SIDE * SIDE]))
    };
    let channels = AnyChannels::sort(channels.into_iter().map(channel).collect());
    Layer::new((SIDE, SIDE), LayerAttributes::named(name), Encoding::FAST_LOSSLESS, channels)
}

fn write(path: &Path, parts: Vec<Layer<AnyChannels<FlatSamples>>>) {
    let attributes = ImageAttributes::new(IntegerBounds::from_dimensions((SIDE, SIDE)));
    let image: Image<Layers<_>> = Image { attributes, layer_data: parts.into_iter().collect() };
    image.write().to_file(path).unwrap();
}

fn value(path: &Path) -> f32 {
    read_pixels(path).unwrap().planes[[1, 3, 3]]
}

#[test]
fn a_part_of_several_is_chosen_by_the_path_or_by_a_flag() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write(&folder.join("stereo.exr"), vec![part("left", 0.1, None), part("right", 0.3, Some("fog"))]);
    let said = fail(folder, &["convert", "stereo.exr", "out.npy"], 1);
    assert!(
        said.contains("several layers (left, right, right.fog)") && said.contains("file.exr:left"),
        "{said}"
    );
    for (input, expected) in
        [("stereo.exr:left", 0.1), ("stereo.exr:right.RGB", 0.3), ("stereo.exr:right.fog", 0.6)]
    {
        succeed(folder, &["convert", input, "out.npy", "--overwrite"]);
        assert_eq!(value(&folder.join("out.npy")), expected, "{input}");
    }
    let said = fail(folder, &["convert", "stereo.exr:rihgt", "other.npy"], 1);
    assert!(said.contains("did you mean `right`?") && said.contains("left, right, right.fog"), "{said}");
    assert!(!folder.join("other.npy").exists());

    // What becomes of layers is named after them.
    let bare = ["--no-clip", "--no-clahe", "--curve", "none", "--format", "exr"];
    succeed(folder, &[&["finish", "stereo.exr:left", "stereo.exr:right", "-o", "out/"][..], &bare].concat());
    assert_eq!(value(&folder.join("out/stereo.left.exr")), 0.1);
    assert_eq!(value(&folder.join("out/stereo.right.exr")), 0.3);
    succeed(folder, &[&["finish", "*.exr", "--layer", "right.fog", "-o", "fog/"][..], &bare].concat());
    assert_eq!(value(&folder.join("fog/stereo.right.fog.exr")), 0.6);
    succeed(folder, &["tonemap", "stereo.exr", "--layer", "right", "-o", "mapped.exr"]);
    assert!((value(&folder.join("mapped.exr")) - 0.3 / 0.55).abs() < 1e-6);
}

/// A picture that was made of one layer is not taken for that of another.
#[test]
fn a_run_that_goes_on_tells_layers_apart() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write(&folder.join("a.exr"), vec![part("left", 0.1, None), part("right", 0.3, None)]);
    let finish = |layer: &str| {
        let named = format!("a.exr:{layer}");
        udc(folder, &["finish", &named, "-o", "out.exr", "--no-clahe", "--resume"])
    };
    assert!(finish("left").status.success() && finish("left").status.success());
    let other = finish("right");
    let said = String::from_utf8_lossy(&other.stderr);
    assert!(other.status.code() == Some(1) && said.contains("other settings or of other files"), "{said}");
}

#[test]
fn info_lists_layers_and_how_to_name_them() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write(&folder.join("stereo.exr"), vec![part("left", 0.1, None), part("right", 0.3, None)]);
    write(&folder.join("beauty.exr"), vec![part("beauty", 0.1, Some("diffuse"))]);
    let said = succeed(folder, &["info", "stereo.exr"]);
    assert!(said.contains(":left ") && said.contains(":right") && said.contains("24 × 24, R G B"), "{said}");
    let said = succeed(folder, &["info", "beauty.exr"]);
    assert!(said.contains(":RGB") && said.contains("read where none is named"), "{said}");
    assert!(said.contains(":diffuse") && said.contains("diffuse.R diffuse.G diffuse.B"), "{said}");
    let json: serde_json::Value =
        serde_json::from_str(&succeed(folder, &["info", "--json", "stereo.exr"])).unwrap();
    assert_eq!((json["kind"].as_str(), json["layers"][1]["name"].as_str()), (Some("layers"), Some("right")));
    let said = succeed(folder, &["info", "stereo.exr:right"]);
    assert!(said.contains("OpenEXR image, 24 × 24") && said.contains("0.30000"), "{said}");
    let said = succeed(folder, &["info", "--layer", "left", "stereo.exr"]);
    assert!(said.contains("0.10000"), "{said}");
}

#[test]
fn names_with_colons_of_their_own_are_files() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    write(&folder.join("12:30 street.exr"), vec![part("", 0.2, Some("fog"))]);
    succeed(folder, &["convert", "12:30 street.exr", "a.npy"]);
    assert_eq!(value(&folder.join("a.npy")), 0.2);
    succeed(folder, &["convert", "12:30 street.exr:fog", "b.npy"]);
    assert_eq!(value(&folder.join("b.npy")), 0.4);
    assert!(fail(folder, &["convert", "C:\\none.exr", "c.npy"], 1).contains("cannot read C:\\none.exr"));
}

#[test]
fn other_raw_formats_and_pictures_are_told_what_converts_them() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    for (name, start, converter) in [
        ("a.CR3", &b"\0\0\0\x18ftypcrx \0\0\0\x01crx isom"[..], "dnglab convert a.CR3 a.dng"),
        ("a.raf", b"FUJIFILMCCD-RAW 0201FF383501", "Adobe DNG Converter"),
        ("a.nef", b"MM\0*\0\0\0\x08\0\0\0\0\0\0", "dnglab convert a.nef a.dng"),
        ("a.arw", b"II*\0\x08\0\0\0\0\0\0\0\0\0", "Sony ARW"),
        ("a.heic", b"\0\0\0\x24ftypheic\0\0\0\0mif1", "heif-convert"),
        ("a.webp", b"RIFF\x24\0\0\0WEBPVP8 ", "dwebp"),
    ] {
        fs::write(folder.join(name), start).unwrap();
        let said = fail(folder, &["finish", name, "-o", "out.png"], 1);
        assert!(said.contains(converter), "{name}: {said}");
        assert!(!folder.join("out.png").exists());
    }
    fs::create_dir(folder.join("raws")).unwrap();
    fs::rename(folder.join("a.CR3"), folder.join("raws/a.CR3")).unwrap();
    let said = fail(folder, &["finish", "raws", "-o", "out/"], 1);
    assert!(said.contains("1 raw files of cameras") && said.contains("dnglab"), "{said}");
}
