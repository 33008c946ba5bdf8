//! Writes ICC profiles, and reads of one its name, its primaries and the curve of its first channel (ICC.1:2022).
//!
//! A profile: a header of 128 bytes, the number of tags, for each its signature, position and length. Numbers are
//! big-endian. Nothing is believed that lies beyond the end of the profile.

mod write;

pub(super) use write::profile_of;

const HEADER_BYTES: usize = 128;
/// The most tags that are looked at; profiles have about a dozen.
const MAX_TAGS: usize = 256;

/// What a profile says.
pub(super) struct Profile {
    pub(super) name: Option<String>,
    /// Red, green and blue as X, Y, Z.
    pub(super) colorants: Option<[[f64; 3]; 3]>,
    pub(super) curve: Option<Curve>,
}

/// A curve from values to linear light, both in `[0, 1]`.
pub(super) enum Curve {
    /// Values at even distances.
    Table(Vec<f64>),
    /// `(a·v + b)^g + e` from d on, `c·v + f` below.
    Formula { g: f64, a: f64, b: f64, c: f64, d: f64, e: f64, f: f64 },
}

impl Profile {
    /// What is understood of a profile; none of what is none.
    pub(super) fn parse(bytes: &[u8]) -> Option<Self> {
        if bytes.get(36..40)? != b"acsp" {
            return None;
        }
        let tag = |signature: &[u8; 4]| tag_of(bytes, signature);
        let [red, green, blue] = [b"rXYZ", b"gXYZ", b"bXYZ"].map(|name| tag(name).and_then(xyz));
        let colorants = red.zip(green).zip(blue).map(|((red, green), blue)| [red, green, blue]);
        let curve = tag(b"rTRC").or_else(|| tag(b"kTRC")).and_then(Curve::parse);
        Some(Self { name: tag(b"desc").and_then(text), colorants, curve })
    }
}

/// The data of a tag.
fn tag_of<'a>(bytes: &'a [u8], signature: &[u8; 4]) -> Option<&'a [u8]> {
    let count = usize::try_from(u32_at(bytes, HEADER_BYTES)?).ok()?.min(MAX_TAGS);
    let place = |index: usize| HEADER_BYTES + 4 + 12 * index;
    let found = (0..count).map(place).find(|&at| bytes.get(at..at + 4) == Some(&signature[..]))?;
    let start = usize::try_from(u32_at(bytes, found + 4)?).ok()?;
    let length = usize::try_from(u32_at(bytes, found + 8)?).ok()?;
    bytes.get(start..start.checked_add(length)?)
}

fn u32_at(bytes: &[u8], place: usize) -> Option<u32> {
    bytes.get(place..)?.first_chunk().map(|four| u32::from_be_bytes(*four))
}

fn u16_at(bytes: &[u8], place: usize) -> Option<u16> {
    bytes.get(place..)?.first_chunk().map(|two| u16::from_be_bytes(*two))
}

/// A signed number of 16 bits before and 16 behind the point.
fn fixed_at(bytes: &[u8], place: usize) -> Option<f64> {
    Some(f64::from(u32_at(bytes, place)?.cast_signed()) / 65536.0)
}

fn xyz(data: &[u8]) -> Option<[f64; 3]> {
    data.starts_with(b"XYZ ").then_some(())?;
    Some([fixed_at(data, 8)?, fixed_at(data, 12)?, fixed_at(data, 16)?])
}

/// A name: of version 2 in ASCII, of version 4 the first of several languages in UTF-16.
fn text(data: &[u8]) -> Option<String> {
    let text = if data.starts_with(b"desc") {
        let length = usize::try_from(u32_at(data, 8)?).ok()?;
        String::from_utf8_lossy(data.get(12..12usize.checked_add(length)?)?).into_owned()
    } else if data.starts_with(b"mluc") {
        let length = usize::try_from(u32_at(data, 20)?).ok()?;
        let start = usize::try_from(u32_at(data, 24)?).ok()?;
        let (units, _) = data.get(start..start.checked_add(length)?)?.as_chunks::<2>();
        String::from_utf16_lossy(&units.iter().map(|unit| u16::from_be_bytes(*unit)).collect::<Vec<_>>())
    } else {
        return None;
    };
    // Names are shown: one line of what is printable.
    let text: String = text.chars().filter(|c| !c.is_control()).take(80).collect();
    (!text.trim().is_empty()).then(|| text.trim().to_owned())
}

impl Curve {
    fn parse(data: &[u8]) -> Option<Self> {
        if data.starts_with(b"curv") {
            return match usize::try_from(u32_at(data, 8)?).ok()? {
                0 => Some(Self::gamma(1.0)),
                1 => Some(Self::gamma(f64::from(u16_at(data, 12)?) / 256.0)),
                count => {
                    let (entries, _) = data.get(12..12usize.checked_add(2 * count)?)?.as_chunks::<2>();
                    let entry = |two: &[u8; 2]| f64::from(u16::from_be_bytes(*two)) / f64::from(u16::MAX);
                    Some(Self::Table(entries.iter().map(entry).collect()))
                }
            };
        }
        data.starts_with(b"para").then_some(())?;
        let n = |index: usize| fixed_at(data, 12 + 4 * index);
        let Self::Formula { g, .. } = Self::gamma(n(0)?) else { return None };
        let (e, f) = (0.0, 0.0);
        Some(match u16_at(data, 8)? {
            0 => Self::gamma(g),
            1 => {
                let (a, b) = (n(1)?, n(2)?);
                Self::Formula { g, a, b, c: 0.0, d: -b / a, e, f }
            }
            2 => {
                let (a, b, c) = (n(1)?, n(2)?, n(3)?);
                Self::Formula { g, a, b, c: 0.0, d: -b / a, e: c, f: c }
            }
            3 => Self::Formula { g, a: n(1)?, b: n(2)?, c: n(3)?, d: n(4)?, e, f },
            4 => Self::Formula { g, a: n(1)?, b: n(2)?, c: n(3)?, d: n(4)?, e: n(5)?, f: n(6)? },
            _ => return None,
        })
    }

    fn gamma(g: f64) -> Self {
        Self::Formula { g, a: 1.0, b: 0.0, c: 0.0, d: 0.0, e: 0.0, f: 0.0 }
    }

    /// The linear light of a value.
    pub(super) fn at(&self, v: f64) -> f64 {
        match self {
            Self::Formula { g, a, b, c, d, e, f } => {
                if v >= *d {
                    (a * v + b).max(0.0).powf(*g) + e
                } else {
                    c * v + f
                }
            }
            Self::Table(entries) => {
                let place = v * (entries.len() - 1) as f64;
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "within the table"
                )]
                let below = (place.floor() as usize).min(entries.len() - 2);
                let part = place - below as f64;
                entries[below] * (1.0 - part) + entries[below + 1] * part
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::color::srgb_decode;

    /// The parameters of sRGB in a profile of version 4.
    #[test]
    fn a_parametric_curve_of_srgb_is_the_curve_of_srgb() {
        let numbers = [2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.040_45];
        let fixed = numbers.map(|n| ((n * 65536.0_f64).round() as i32).to_be_bytes());
        let data = [b"para\0\0\0\0\0\x03\0\0", fixed.as_flattened()].concat();
        let curve = Curve::parse(&data).unwrap();
        for step in 0..=100 {
            let v = f64::from(step) / 100.0;
            assert!((curve.at(v) - srgb_decode(v)).abs() < 1e-4, "{v}: {}", curve.at(v));
        }
        assert!(Curve::parse(&data[..20]).is_none(), "a cut one says nothing");
    }

    #[test]
    fn tables_and_gammas_are_read() {
        let table = Curve::parse(b"curv\0\0\0\0\0\0\0\x03\0\0\x40\0\xff\xff").unwrap();
        assert!((table.at(0.25) - 0.125).abs() < 1e-4 && (table.at(1.0) - 1.0).abs() < 1e-12);
        let gamma = Curve::parse(b"curv\0\0\0\0\0\0\0\x01\x02\0").unwrap();
        assert!((gamma.at(0.5) - 0.25).abs() < 1e-12);
        let linear = Curve::parse(b"curv\0\0\0\0\0\0\0\0").unwrap();
        assert!((linear.at(0.3) - 0.3).abs() < 1e-12);
    }
}
