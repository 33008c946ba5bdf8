//! Reads what cameras say of their pictures, EXIF in JPEG, PNG and TIFF files and in digital negatives, and writes it anew.
//!
//! Kept is what is understood: previews, notes of makers and the like belong to the file that was read, and not to what
//! becomes of it.

mod write;

use super::directory::Directory;
use crate::core::exif::{Exif, Position};
use crate::core::orientation::Orientation;

pub(super) use write::{Field, Picture, encode, fields_of_tiff};

/// Tags of the first directory.
const MAKE: u16 = 271;
const MODEL: u16 = 272;
const ORIENTATION: u16 = 274;
const ARTIST: u16 = 315;
const COPYRIGHT: u16 = 33432;
const UNIQUE_MODEL: u16 = 50708;
/// Those of the directories for EXIF and for the position.
const EXIF: u16 = 34665;
const POSITION: u16 = 34853;
/// Tags of the directory for EXIF.
const EXPOSURE_TIME: u16 = 33434;
const F_NUMBER: u16 = 33437;
const ISO: u16 = 34855;
const TAKEN: u16 = 36867;
const TAKEN_OFFSET: u16 = 36881;
const EXPOSURE_BIAS: u16 = 37380;
const FOCAL_LENGTH: u16 = 37386;
const TAKEN_SUBSECOND: u16 = 37521;
const FOCAL_LENGTH_35MM: u16 = 41989;
const LENS: u16 = 42036;
/// Tags of the directory for the position.
const LATITUDE: [u16; 2] = [1, 2];
const LONGITUDE: [u16; 2] = [3, 4];
const ALTITUDE: [u16; 2] = [5, 6];
const TIME: u16 = 7;
const DATE: u16 = 29;

/// The most characters of a text that are kept.
const LONGEST_TEXT: usize = 500;

/// What a file says of its picture, and how that lies.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Said {
    pub(super) exif: Option<Exif>,
    pub(super) orientation: Option<Orientation>,
}

impl Said {
    /// Reads a block of EXIF, which is a TIFF file without picture; what is damaged says nothing.
    pub(super) fn of_block(bytes: &[u8]) -> Self {
        let bytes = bytes.strip_prefix(b"Exif\0\0").unwrap_or(bytes);
        let is_tiff = [&b"II*\0"[..], b"MM\0*"].iter().any(|start| bytes.starts_with(start));
        Directory::first(bytes).filter(|_| is_tiff).map_or_else(Self::default, |root| Self::of(&root))
    }

    /// Reads the first directory of a file.
    pub(super) fn of(root: &Directory<'_>) -> Self {
        let exif = read(root);
        let orientation = root.number(ORIENTATION).and_then(Orientation::from_exif);
        Self { exif: (!exif.is_empty()).then_some(exif), orientation }
    }

    /// What is said here, or else by another directory of the file.
    pub(super) fn or(self, other: Self) -> Self {
        Self { exif: self.exif.or(other.exif), orientation: self.orientation.or(other.orientation) }
    }
}

fn read(root: &Directory<'_>) -> Exif {
    let inner = root.inner(EXIF).next();
    let text = |tag| {
        let found = root.text(tag).or_else(|| inner.as_ref()?.text(tag))?;
        Some(found.chars().take(LONGEST_TEXT).collect())
    };
    let real = |tag| {
        let values = root.reals(tag).or_else(|| inner.as_ref()?.reals(tag))?;
        values.first().copied().filter(|value| value.is_finite())
    };
    let positive = |tag| real(tag).filter(|value| *value > 0.0);
    Exif {
        make: text(MAKE),
        model: text(MODEL).or_else(|| text(UNIQUE_MODEL)),
        lens: text(LENS),
        artist: text(ARTIST),
        copyright: text(COPYRIGHT),
        taken: text(TAKEN).filter(|taken| is_time(taken)),
        taken_subsecond: text(TAKEN_SUBSECOND).filter(|digits| digits.chars().all(|c| c.is_ascii_digit())),
        taken_offset: text(TAKEN_OFFSET).filter(|offset| offset.len() == 6),
        exposure_s: positive(EXPOSURE_TIME),
        f_number: positive(F_NUMBER),
        iso: positive(ISO),
        exposure_bias_ev: real(EXPOSURE_BIAS),
        focal_length_mm: positive(FOCAL_LENGTH),
        focal_length_35mm: positive(FOCAL_LENGTH_35MM),
        position: root.inner(POSITION).next().and_then(|position| read_position(&position)),
    }
}

/// Whether a text is a point in time as EXIF writes it; cameras whose clock is not set write spaces or zeros.
fn is_time(text: &str) -> bool {
    text.len() == 19
        && text.is_ascii()
        && text.starts_with(|c: char| c.is_ascii_digit())
        && !text.starts_with("0000")
}

fn read_position(directory: &Directory<'_>) -> Option<Position> {
    let three = |tag| {
        let values: [f64; 3] = directory.reals(tag)?.try_into().ok()?;
        values.iter().all(|value| value.is_finite()).then_some(values)
    };
    let degrees = |[reference, tag]: [u16; 2], negative: &str, most: f64| {
        let [degrees, minutes, seconds] = three(tag)?;
        let size = degrees + minutes / 60.0 + seconds / 3600.0;
        let sign = if directory.text(reference)?.eq_ignore_ascii_case(negative) { -1.0 } else { 1.0 };
        (size <= most).then_some(sign * size)
    };
    let altitude = directory.reals(ALTITUDE[1]).and_then(|values| values.first().copied());
    let is_below = directory.number(ALTITUDE[0]) == Some(1);
    Some(Position {
        latitude_deg: degrees(LATITUDE, "S", 90.0)?,
        longitude_deg: degrees(LONGITUDE, "W", 180.0)?,
        altitude_m: altitude
            .filter(|altitude| altitude.is_finite())
            .map(|altitude| if is_below { -altitude } else { altitude }),
        date: directory.text(DATE).filter(|date| date.len() == 10),
        time_utc: three(TIME),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn full() -> Exif {
        Exif {
            make: Some("Müller & Söhne".to_owned()),
            model: Some("UDC 1".to_owned()),
            lens: Some("4.2 mm f/1.8".to_owned()),
            artist: Some("A".to_owned()),
            copyright: Some("2026".to_owned()),
            taken: Some("2026:11:23 12:30:05".to_owned()),
            taken_subsecond: Some("042".to_owned()),
            taken_offset: Some("+01:00".to_owned()),
            exposure_s: Some(1.0 / 125.0),
            f_number: Some(1.8),
            iso: Some(100_000.0),
            exposure_bias_ev: Some(-0.7),
            focal_length_mm: Some(4.2),
            focal_length_35mm: Some(26.0),
            position: Some(Position {
                latitude_deg: -33.856_784,
                longitude_deg: 151.215_297,
                altitude_m: Some(-3.25),
                date: Some("2026:11:23".to_owned()),
                time_utc: Some([11.0, 30.0, 5.0]),
            }),
        }
    }

    /// Seconds of arc are written to a ten-thousandth, which is 3 mm on the ground.
    #[test]
    fn what_is_written_is_read_again() {
        let picture = Picture { width: 40, height: 30, is_srgb: true };
        let found = Said::of_block(&encode(&full(), picture));
        assert_eq!(found.orientation, Orientation::from_exif(1), "pictures are written upright");
        let mut exif = found.exif.unwrap();
        let (place, expected) = (exif.position.take().unwrap(), full().position.unwrap());
        assert!((place.latitude_deg - expected.latitude_deg).abs() < 1e-7, "{place:?}");
        assert!((place.longitude_deg - expected.longitude_deg).abs() < 1e-7, "{place:?}");
        assert_eq!((place.altitude_m, place.time_utc), (expected.altitude_m, expected.time_utc));
        assert_eq!(exif, Exif { position: None, ..full() });
    }

    #[test]
    fn damaged_blocks_say_nothing_and_never_fail() {
        let block = encode(&full(), Picture { width: 1, height: 1, is_srgb: false });
        for length in 0..block.len() {
            Said::of_block(&block[..length]);
        }
        for place in 0..block.len() {
            let mut broken = block.clone();
            broken[place] ^= 0xff;
            Said::of_block(&broken);
        }
        assert_eq!(Said::of_block(b"Exif\0\0II"), Said::default());
        assert_eq!(Said::of_block(b""), Said::default());
    }
}
