//! Writes EXIF anew: as a block for JPEG and PNG, and as the fields that belong into a TIFF file.

use super::{
    ALTITUDE, ARTIST, COPYRIGHT, DATE, EXIF, EXPOSURE_BIAS, EXPOSURE_TIME, F_NUMBER, FOCAL_LENGTH,
    FOCAL_LENGTH_35MM, ISO, LATITUDE, LENS, LONGITUDE, MAKE, MODEL, ORIENTATION, POSITION, TAKEN,
    TAKEN_OFFSET, TAKEN_SUBSECOND, TIME,
};
use crate::core::exif::{Exif, Position};

const X_RESOLUTION: u16 = 282;
const Y_RESOLUTION: u16 = 283;
const RESOLUTION_UNIT: u16 = 296;
const SOFTWARE: u16 = 305;
const CHROMA_POSITION: u16 = 531;
const SENSITIVITY_KIND: u16 = 34864;
const VERSION: u16 = 36864;
const COLOR_SPACE: u16 = 40961;
const WIDTH: u16 = 40962;
const HEIGHT: u16 = 40963;
const POSITION_VERSION: u16 = 0;

/// The types of fields: bytes, text, 16 and 32 bits, fractions, data without a type.
const BYTE: u16 = 1;
const ASCII: u16 = 2;
const SHORT: u16 = 3;
const LONG: u16 = 4;
const RATIONAL: u16 = 5;
const UNDEFINED: u16 = 7;
const SRATIONAL: u16 = 10;

/// Parts of a second of arc that are kept, and of other fractions without a shorter one.
const PARTS: u32 = 10_000;

/// The largest denominator of fractions that are looked for.
const MOST_PARTS: f64 = 1e6;

/// What is said of the picture itself.
#[derive(Clone, Copy, Debug)]
pub(in crate::io) struct Picture {
    pub(in crate::io) width: u32,
    pub(in crate::io) height: u32,
    /// Whether its colours are those of sRGB, or said by a profile.
    pub(in crate::io) is_srgb: bool,
}

/// A field: its tag, its type, and its values as this machine orders bytes.
pub(in crate::io) struct Field {
    pub(in crate::io) tag: u16,
    pub(in crate::io) kind: u16,
    pub(in crate::io) bytes: Vec<u8>,
}

/// The fields of the three directories of a TIFF file: the picture's own, EXIF, and the position, where it is known.
pub(in crate::io) fn fields_of_tiff(exif: &Exif, picture: Picture) -> [Vec<Field>; 3] {
    let position = exif.position.as_ref().map_or_else(Vec::new, fields_of_position);
    [first_fields(exif), exif_fields(exif, picture), position]
}

/// A block for JPEG (behind its `Exif` mark) and PNG.
pub(in crate::io) fn encode(exif: &Exif, picture: Picture) -> Vec<u8> {
    let [mut first, inner, position] = fields_of_tiff(exif, picture);
    first.extend([
        rational(X_RESOLUTION, &[(72, 1)]),
        rational(Y_RESOLUTION, &[(72, 1)]),
        short(RESOLUTION_UNIT, 2),
        short(CHROMA_POSITION, 1),
    ]);
    let mut block = Block::new();
    for (tag, fields) in [(EXIF, inner), (POSITION, position)] {
        if !fields.is_empty() {
            let place = block.directory(fields);
            first.push(long(tag, place));
        }
    }
    let place = block.directory(first);
    block.0[4..8].copy_from_slice(&place.to_ne_bytes());
    block.0
}

fn first_fields(exif: &Exif) -> Vec<Field> {
    let texts =
        [(MAKE, &exif.make), (MODEL, &exif.model), (ARTIST, &exif.artist), (COPYRIGHT, &exif.copyright)];
    let mut fields = texts_of(&texts);
    fields.push(short(ORIENTATION, 1));
    fields.push(text(SOFTWARE, concat!("udc ", env!("CARGO_PKG_VERSION"))));
    fields
}

fn exif_fields(exif: &Exif, picture: Picture) -> Vec<Field> {
    let mut fields = texts_of(&[
        (TAKEN, &exif.taken),
        (TAKEN_OFFSET, &exif.taken_offset),
        (TAKEN_SUBSECOND, &exif.taken_subsecond),
        (LENS, &exif.lens),
    ]);
    let numbers =
        [(EXPOSURE_TIME, exif.exposure_s), (F_NUMBER, exif.f_number), (FOCAL_LENGTH, exif.focal_length_mm)];
    let found = numbers.into_iter().filter_map(|(tag, value)| Some(rational(tag, &[fraction(value?)])));
    fields.extend(found);
    if let Some(stops) = exif.exposure_bias_ev {
        let (numerator, denominator) = fraction(stops.abs());
        let sign = if stops < 0.0 { -1 } else { 1 };
        let parts = [sign * numerator.cast_signed(), denominator.cast_signed()];
        let bytes = parts.map(i32::to_ne_bytes).concat();
        fields.push(Field { tag: EXPOSURE_BIAS, kind: SRATIONAL, bytes });
    }
    for (tag, value) in [(ISO, exif.iso), (FOCAL_LENGTH_35MM, exif.focal_length_35mm)] {
        let Some(value) = value else { continue };
        // Larger ones than 16 bits hold are written with 32, as newer cameras do.
        fields.push(
            u16::try_from(whole(value)).map_or_else(|_| long(tag, whole(value)), |value| short(tag, value)),
        );
    }
    if exif.iso.is_some() {
        fields.push(short(SENSITIVITY_KIND, 3));
    }
    fields.push(Field { tag: VERSION, kind: UNDEFINED, bytes: b"0232".to_vec() });
    fields.push(short(COLOR_SPACE, if picture.is_srgb { 1 } else { u16::MAX }));
    fields.extend([long(WIDTH, picture.width), long(HEIGHT, picture.height)]);
    fields
}

fn fields_of_position(position: &Position) -> Vec<Field> {
    let mut fields = vec![Field { tag: POSITION_VERSION, kind: BYTE, bytes: vec![2, 3, 0, 0] }];
    for ([reference, tag], degrees, names) in
        [(LATITUDE, position.latitude_deg, ["N", "S"]), (LONGITUDE, position.longitude_deg, ["E", "W"])]
    {
        let minutes = (degrees.abs() * 60.0).floor();
        let seconds = whole((degrees.abs() * 60.0 - minutes) * 60.0 * f64::from(PARTS));
        let minutes = whole(minutes);
        fields.push(text(reference, names[usize::from(degrees < 0.0)]));
        fields.push(rational(tag, &[(minutes / 60, 1), (minutes % 60, 1), (seconds, PARTS)]));
    }
    if let Some(altitude) = position.altitude_m {
        fields.push(Field { tag: ALTITUDE[0], kind: BYTE, bytes: vec![u8::from(altitude < 0.0)] });
        fields.push(rational(ALTITUDE[1], &[fraction(altitude.abs())]));
    }
    if let Some(time) = position.time_utc {
        fields.push(rational(TIME, &time.map(fraction)));
    }
    fields.extend(texts_of(&[(DATE, &position.date)]));
    fields
}

fn texts_of(texts: &[(u16, &Option<String>)]) -> Vec<Field> {
    texts.iter().filter_map(|(tag, found)| Some(text(*tag, found.as_deref()?))).collect()
}

fn text(tag: u16, text: &str) -> Field {
    Field { tag, kind: ASCII, bytes: [text.as_bytes(), b"\0"].concat() }
}

fn short(tag: u16, value: u16) -> Field {
    Field { tag, kind: SHORT, bytes: value.to_ne_bytes().to_vec() }
}

fn long(tag: u16, value: u32) -> Field {
    Field { tag, kind: LONG, bytes: value.to_ne_bytes().to_vec() }
}

fn rational(tag: u16, parts: &[(u32, u32)]) -> Field {
    let bytes = parts.iter().flat_map(|(a, b)| [a.to_ne_bytes(), b.to_ne_bytes()].concat());
    Field { tag, kind: RATIONAL, bytes: bytes.collect() }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a cast that saturates")]
fn whole(value: f64) -> u32 {
    value.round() as u32
}

/// The shortest fraction of a number, by its continued fraction, to a millionth of it: 1/125 of 0.008.
fn fraction(value: f64) -> (u32, u32) {
    let limit = f64::from(i32::MAX);
    let value = value.clamp(0.0, limit);
    let (mut before, mut now) = ((0.0, 1.0), (1.0, 0.0));
    let mut rest = value;
    loop {
        let step = rest.floor();
        let next: (f64, f64) = (step * now.0 + before.0, step * now.1 + before.1);
        if next.1 > MOST_PARTS || next.0 > limit {
            break;
        }
        (before, now) = (now, next);
        let is_near = (now.0 / now.1 - value).abs() <= 1e-6 * value;
        rest = 1.0 / (rest - step);
        if is_near || !rest.is_finite() {
            break;
        }
    }
    // A number below one over the largest denominator has none.
    if now.1 > 0.0 { (whole(now.0), whole(now.1)) } else { (0, 1) }
}

impl Field {
    /// How many values there are.
    fn count(&self) -> usize {
        let size = match self.kind {
            SHORT => 2,
            LONG => 4,
            RATIONAL | SRATIONAL => 8,
            _ => 1,
        };
        self.bytes.len() / size
    }
}

/// A TIFF file without a picture that grows, in the byte order of this machine.
struct Block(Vec<u8>);

impl Block {
    fn new() -> Self {
        let mut bytes = if cfg!(target_endian = "big") { b"MM".to_vec() } else { b"II".to_vec() };
        bytes.extend(42_u16.to_ne_bytes());
        bytes.extend([0; 4]);
        Self(bytes)
    }

    fn place(&self) -> u32 {
        u32::try_from(self.0.len()).expect("a few thousand bytes")
    }

    /// Appends a directory, behind what is too long to stand in it, and returns its position.
    fn directory(&mut self, mut fields: Vec<Field>) -> u32 {
        fields.sort_by_key(|field| field.tag);
        let mut directory = u16::try_from(fields.len()).expect("a few fields").to_ne_bytes().to_vec();
        for field in &fields {
            let count = u32::try_from(field.count()).expect("a short text");
            directory.extend(field.tag.to_ne_bytes());
            directory.extend(field.kind.to_ne_bytes());
            directory.extend(count.to_ne_bytes());
            let mut value = field.bytes.clone();
            if value.len() > 4 {
                value = self.place().to_ne_bytes().to_vec();
                self.0.extend(&field.bytes);
                self.0.resize(self.0.len().next_multiple_of(2), 0);
            }
            value.resize(4, 0);
            directory.extend(value);
        }
        // No directory follows.
        directory.extend([0; 4]);
        let place = self.place();
        self.0.extend(directory);
        place
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_are_short_and_near() {
        for (value, expected) in [
            (0.008, (1, 125)),
            (1.0 / 3.0, (1, 3)),
            (1.8, (9, 5)),
            (30.0, (30, 1)),
            (0.0, (0, 1)),
            (2.5, (5, 2)),
            (1.0 / 32_000.0, (1, 32_000)),
        ] {
            assert_eq!(fraction(value), expected, "{value}");
        }
        for value in [1e-12, 1e30, 0.123_456_789, std::f64::consts::PI * 1e4] {
            let (a, b) = fraction(value);
            let found = f64::from(a) / f64::from(b);
            assert!(value > 1e9 || (found - value).abs() < 1e-6 * value.max(1.0), "{value}: {a}/{b}");
        }
    }
}
