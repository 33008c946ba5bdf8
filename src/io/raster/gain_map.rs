//! Puts a gain map behind a JPEG picture, by which displays with headroom show its highlights brighter than white.
//!
//! The file is that of Ultra HDR (Android, version 1.0) and of Adobe's gain map specification (version 1.0): the picture as
//! any program shows it, then a second, grey JPEG of the gains, which a directory of multi-picture format (CIPA DC-007)
//! and XMP announce.

use std::fmt::Write as _;

use ndarray::{ArrayView2, Axis};

use super::encode;
use crate::io::PixelOptions;
use crate::io::format::Format;

/// What is added to light before it is multiplied, as Android writes it: 1/64.
pub const GAIN_OFFSET: f32 = 1.0 / 64.0;

/// Gains below this are none: not visible, and beyond the steps of eight bits.
const LEAST_GAIN: f32 = 0.01;

/// The second byte of markers, after 0xff (ITU-T T.81, table B.1).
const FIRST_APPLICATION: u8 = 0xe0;
const XMP: u8 = 0xe1;
const MULTI_PICTURE: u8 = 0xe2;

const XMP_NAME: &[u8] = b"http://ns.adobe.com/xap/1.0/\0";
const EXIF_NAME: &[u8] = b"Exif\0";
const MULTI_PICTURE_NAME: &[u8] = b"MPF\0";

/// Attributes of the first picture: a baseline primary image.
const PRIMARY: u32 = 0x0003_0000;

/// The picture with its gains behind; without gains that anybody sees, the picture alone.
///
/// # Equation
/// Of linear light l of the picture, 1 being white, and the gain g in stops: `l_HDR = (l + 1/64)·2^g − 1/64`. Gains are
/// stored in steps of 1/255 of the largest.
pub(in crate::io) fn attach(picture: Vec<u8>, gains: ArrayView2<'_, f32>) -> Result<Vec<u8>, String> {
    let most = gains.iter().copied().fold(0.0, f32::max);
    if most < LEAST_GAIN {
        return Ok(picture);
    }
    let shares = gains.mapv(|gain| (gain / most).clamp(0.0, 1.0)).insert_axis(Axis(0));
    let map =
        encode(&shares.view(), Format::Jpeg, PixelOptions { clip: true, ..PixelOptions::default() }, None)?;
    let map = with_segments(&map, &[segment(XMP, &[XMP_NAME, xmp_of_map(most).as_bytes()])?]);
    let xmp = segment(XMP, &[XMP_NAME, xmp_of_picture(map.len()).as_bytes()])?;
    // The directory says where it stands itself: it is laid out twice, of the same length.
    let draft = segment(MULTI_PICTURE, &[MULTI_PICTURE_NAME, &directory([0; 2], 0)?])?;
    let length = picture.len() + xmp.len() + draft.len();
    let place = place_of_segments(&picture) + xmp.len() + 4 + MULTI_PICTURE_NAME.len();
    let listed = directory([length, map.len()], length - place)?;
    let multi = segment(MULTI_PICTURE, &[MULTI_PICTURE_NAME, &listed])?;
    Ok([with_segments(&picture, &[xmp, multi]), map].concat())
}

/// Where further segments belong: behind those of JFIF and EXIF, which have to be first.
fn place_of_segments(picture: &[u8]) -> usize {
    let mut place = 2;
    while let Some(&[0xff, marker, high, low]) = picture.get(place..).and_then(|rest| rest.first_chunk()) {
        let is_exif = marker == XMP && picture[place + 4..].starts_with(EXIF_NAME);
        if marker != FIRST_APPLICATION && !is_exif {
            break;
        }
        place += 2 + usize::from(u16::from_be_bytes([high, low]));
    }
    place.min(picture.len())
}

fn with_segments(picture: &[u8], segments: &[Vec<u8>]) -> Vec<u8> {
    let (before, after) = picture.split_at(place_of_segments(picture));
    [before, &segments.concat(), after].concat()
}

fn segment(marker: u8, parts: &[&[u8]]) -> Result<Vec<u8>, String> {
    let data = parts.concat();
    let length = u16::try_from(data.len() + 2).map_err(|_| "holds a segment that JPEG cannot".to_owned())?;
    Ok([&[0xff, marker][..], &length.to_be_bytes(), &data].concat())
}

/// The directory of two pictures of these lengths, the second of which starts `distance` bytes behind this.
fn directory(lengths: [usize; 2], distance: usize) -> Result<Vec<u8>, String> {
    const ENTRIES: u32 = 3;
    const UNDEFINED: u16 = 7;
    const LONG: u16 = 4;
    let number = |value: usize| u32::try_from(value).map_err(|_| "is larger than four gigabytes".to_owned());
    let field = |tag: u16, kind: u16, count: u32, value: [u8; 4]| {
        [&tag.to_be_bytes()[..], &kind.to_be_bytes(), &count.to_be_bytes(), &value].concat()
    };
    // Behind the header of 8 bytes: the number of fields, these, and the place of a next directory, which is none.
    let list = 8 + 2 + 12 * ENTRIES + 4;
    let mut bytes = [&b"MM\0*"[..], &8_u32.to_be_bytes(), &3_u16.to_be_bytes()].concat();
    bytes.extend(field(0xb000, UNDEFINED, 4, *b"0100"));
    bytes.extend(field(0xb001, LONG, 1, 2_u32.to_be_bytes()));
    bytes.extend(field(0xb002, UNDEFINED, 32, list.to_be_bytes()));
    bytes.extend(0_u32.to_be_bytes());
    for (attributes, length, place) in [(PRIMARY, lengths[0], 0), (0, lengths[1], distance)] {
        bytes.extend([attributes, number(length)?, number(place)?, 0].map(u32::to_be_bytes).concat());
    }
    Ok(bytes)
}

/// Says that a picture of this many bytes with gains follows.
fn xmp_of_picture(length: usize) -> String {
    packet(
        "xmlns:Container=\"http://ns.google.com/photos/1.0/container/\" \
         xmlns:Item=\"http://ns.google.com/photos/1.0/container/item/\" hdrgm:Version=\"1.0\"",
        &format!(
            "<Container:Directory><rdf:Seq><rdf:li rdf:parseType=\"Resource\"><Container:Item \
             Item:Semantic=\"Primary\" Item:Mime=\"image/jpeg\"/></rdf:li><rdf:li \
             rdf:parseType=\"Resource\"><Container:Item Item:Semantic=\"GainMap\" Item:Mime=\"image/jpeg\" \
             Item:Length=\"{length}\"/></rdf:li></rdf:Seq></Container:Directory>"
        ),
    )
}

/// Says what the values of the gains are: stops of `most`.
fn xmp_of_map(most: f32) -> String {
    let mut said = "hdrgm:Version=\"1.0\"".to_owned();
    for (name, value) in [
        ("GainMapMin", 0.0),
        ("GainMapMax", most),
        ("Gamma", 1.0),
        ("OffsetSDR", GAIN_OFFSET),
        ("OffsetHDR", GAIN_OFFSET),
        ("HDRCapacityMin", 0.0),
        ("HDRCapacityMax", most),
    ] {
        // Writing to a text cannot fail.
        let _ = write!(said, " hdrgm:{name}=\"{value}\"");
    }
    packet(&(said + " hdrgm:BaseRenditionIsHDR=\"False\""), "")
}

fn packet(attributes: &str, inner: &str) -> String {
    format!(
        "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\"><rdf:RDF \
         xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\"><rdf:Description rdf:about=\"\" \
         xmlns:hdrgm=\"http://ns.adobe.com/hdr-gain-map/1.0/\" {attributes}>{inner}</rdf:Description></rdf:RDF></x:xmpmeta>"
    )
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use ndarray::{Array2, Array3};

    use super::*;
    use crate::core::color::srgb_decode;
    use crate::core::exif::Exif;
    use crate::core::primaries::ColorSpace;
    use crate::io::read::decode_image;

    fn decode(bytes: &[u8]) -> Array3<f32> {
        decode_image(Path::new("a.jpg"), bytes, Format::Jpeg, None).unwrap().0.planes
    }

    /// A gradient with a lamp, as display values, and stops that the lamp is to have more.
    fn scene() -> (Array3<f32>, Array2<f32>) {
        let lamp =
            |y: usize, x: usize| (-((y as f32 - 40.0).powi(2) + (x as f32 - 60.0).powi(2)) / 200.0).exp();
        let picture = Array3::from_shape_fn((3, 96, 120), |(c, y, x)| {
            (0.1 + x as f32 / 400.0 + lamp(y, x) * [0.9, 0.7, 0.4][c]).min(1.0)
        });
        (picture, Array2::from_shape_fn((96, 120), |(y, x)| 2.7 * lamp(y, x)))
    }

    fn number_after(text: &str, name: &str) -> f64 {
        let rest = &text[text.find(name).unwrap() + name.len()..];
        rest[2..].split('"').next().unwrap().parse().unwrap()
    }

    /// Both pictures decoded as any program does, the formula of the specification: half a step of eight bits of 2.7 stops is
    /// 0.005, and JPEG of quality 95 errs by a few codes; a code more or less in the dark is 0.1 stops.
    #[test]
    fn light_returns_from_the_picture_and_its_gains() {
        let (planes, gains) = scene();
        let options =
            PixelOptions { eight_bit: true, color_space: Some(ColorSpace::Srgb), ..PixelOptions::default() };
        let exif = Exif { make: Some("Maker".to_owned()), ..Exif::default() };
        let base = encode(&planes.view(), Format::Jpeg, options, Some(&exif)).unwrap();
        let file = attach(base.clone(), gains.view()).unwrap();
        assert_eq!(decode(&file), decode(&base), "the picture is as it was");

        let text = String::from_utf8_lossy(&file);
        let list = file.windows(4).position(|name| name == MULTI_PICTURE_NAME).unwrap() + 4;
        let number = |place: usize| u32::from_be_bytes(*file[list + place..].first_chunk().unwrap()) as usize;
        let (first, second, distance) = (number(50 + 4), number(50 + 20), number(50 + 24));
        assert_eq!((first + second, list + distance), (file.len(), first), "the directory tells both places");
        assert_eq!(number_after(&text, "Item:Length"), second as f64);
        assert!(text.find("Exif").unwrap() < text.find("ns.adobe.com").unwrap(), "EXIF stands first");
        let map = &file[first..];
        let most = number_after(&String::from_utf8_lossy(map), "hdrgm:GainMapMax");
        assert!((most - 2.7).abs() < 0.01);

        let (shown, shares) = (decode(&file), decode(map));
        let light = |value: f32, gain: f64| {
            (srgb_decode(f64::from(value)) + f64::from(GAIN_OFFSET)) * gain.exp2() - f64::from(GAIN_OFFSET)
        };
        let mut errors: Vec<f64> = Vec::new();
        for ((c, y, x), value) in planes.indexed_iter() {
            let expected = light(*value, f64::from(gains[[y, x]]));
            let found = light(shown[[c, y, x]], most * f64::from(shares[[0, y, x]]));
            errors.push(((found + 1.0 / 64.0) / (expected + 1.0 / 64.0)).log2().abs());
        }
        errors.sort_by(f64::total_cmp);
        let [median, most] = [errors[errors.len() / 2], errors[errors.len() - 1]];
        assert!(median < 0.03 && most < 0.25, "off by {median} stops, at most by {most}");
    }

    #[test]
    fn a_picture_without_highlights_is_written_alone() {
        let (planes, _) = scene();
        let options = PixelOptions { eight_bit: true, ..PixelOptions::default() };
        let base = encode(&planes.view(), Format::Jpeg, options, None).unwrap();
        assert_eq!(attach(base.clone(), Array2::zeros((96, 120)).view()).unwrap(), base);
    }
}
