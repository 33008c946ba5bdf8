//! Reads what image files say of their colours: PNG's gAMA, sRGB, cICP and iCCP chunks, ICC profiles of JPEG and TIFF; and shows lines of
//! Radiance headers.
//!
//! These never change a value, but for factors of those lines and the narrow range of video (cICP), which reading undoes. They are
//! shown, and compared with what the user says of a file; other primaries than those of sRGB are kept for finishing, which converts
//! the colours. A transfer curve counts as sRGB's if it stays within [`CURVE_TOLERANCE`] of it, as a plain gamma of 2.2 does; a
//! profile of tables (no matrix and curves) is named only.

use std::fmt;

use ndarray::Array3;
use serde::Serialize;

use super::{DomainTag, icc};
use crate::core::color::srgb_decode;
use crate::core::primaries::Primaries;

/// How far a curve may lie from that of sRGB, in linear light: gamma 2.2 is off by 0.008, gamma 1.8 by 0.08.
const CURVE_TOLERANCE: f64 = 0.02;

/// How far the coordinates of primaries may lie from those of sRGB: profiles differ in the last digits, Display P3 by 0.08.
const PRIMARIES_TOLERANCE: f64 = 0.01;

/// Red, green and blue of sRGB as X, Y, Z under D50, as ICC profiles have them.
const SRGB_COLORANTS: [[f64; 3]; 3] =
    [[0.4361, 0.2225, 0.0139], [0.3851, 0.7169, 0.0971], [0.1431, 0.0606, 0.7141]];

/// How values grow with light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Transfer {
    Linear,
    Srgb,
    Other,
}

/// One place of a file that speaks of its colours.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ColorTag {
    /// The place: `gAMA chunk`, `ICC profile`.
    pub place: &'static str,
    /// What it says.
    pub says: String,
    #[serde(skip)]
    transfer: Option<Transfer>,
    /// Whether red, green and blue are those of sRGB.
    #[serde(skip)]
    srgb_primaries: Option<bool>,
    /// Which they are, where they are known.
    #[serde(skip)]
    primaries: Option<Primaries>,
}

impl fmt::Display for ColorTag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.says)
    }
}

impl ColorTag {
    /// A line of a header that is shown, and speaks of no transfer curve.
    pub(super) fn of_line(place: &'static str, says: &str) -> Self {
        Self { place, says: says.to_owned(), transfer: None, srgb_primaries: None, primaries: None }
    }

    /// Whether it says which red, green and blue are meant.
    pub fn says_primaries(&self) -> bool {
        self.srgb_primaries.is_some()
    }

    /// Whether pictures that it speaks of can be converted: they have the curve of sRGB, and known primaries, as far as it says it.
    pub fn is_converted(&self) -> bool {
        let has_curve = matches!(self.transfer, None | Some(Transfer::Srgb));
        has_curve && (self.srgb_primaries != Some(false) || self.primaries.is_some())
    }

    /// Why values cannot be of `domain` if the tag is right; none where both may be.
    pub(super) fn contradiction(&self, domain: DomainTag) -> Option<String> {
        let Self { place, says, .. } = self;
        let is_srgb = domain == DomainTag::Srgb;
        match (self.transfer, domain) {
            (Some(Transfer::Srgb), DomainTag::Srgb)
            | (Some(Transfer::Linear), DomainTag::Linear)
            | (None, _) => {}
            _ => return Some(format!("its {place} says {says}")),
        }
        (is_srgb && self.srgb_primaries == Some(false)).then(|| {
            let done = match self.primaries {
                Some(_) => "finishing converts them",
                None => "they are taken for those of sRGB",
            };
            format!("its {place} says {says}, whose red, green and blue are not those of sRGB; {done}")
        })
    }
}

/// Places that speak of primaries, the one that counts first (PNG, third edition, section 4.3).
const PRECEDENCE: [&str; 5] = ["cICP chunk", "iCCP chunk", "ICC profile", "sRGB chunk", "cHRM chunk"];

/// The primaries that tags say, where they are known and others than those of sRGB.
pub(super) fn other_primaries(tags: &[ColorTag]) -> Option<Primaries> {
    let says = |place: &&str| tags.iter().find(|tag| tag.place == *place && tag.srgb_primaries.is_some());
    PRECEDENCE.iter().find_map(says).filter(|tag| tag.srgb_primaries == Some(false))?.primaries
}

/// The tags of a PNG file that stand in its chunks; its profile is for [`of_profile`].
pub(super) fn of_png(bytes: &[u8]) -> Vec<ColorTag> {
    chunks_before_pixels(bytes).filter_map(|(name, data)| of_chunk(name, data)).collect()
}

/// The names and data of a PNG file's chunks: length, name, data, checksum (PNG, third edition, section 5.3).
fn chunks_before_pixels(bytes: &[u8]) -> impl Iterator<Item = ([u8; 4], &[u8])> {
    const SIGNATURE_BYTES: usize = 8;
    const CHECKSUM_BYTES: usize = 4;
    let mut rest = bytes.get(SIGNATURE_BYTES..).unwrap_or_default();
    std::iter::from_fn(move || {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let (name, after) = after.split_first_chunk::<4>()?;
        let length = usize::try_from(u32::from_be_bytes(*length)).ok()?;
        let data = after.get(..length)?;
        rest = after.get(length + CHECKSUM_BYTES..).unwrap_or_default();
        (name != b"IDAT").then_some((*name, data))
    })
}

fn of_chunk(name: [u8; 4], data: &[u8]) -> Option<ColorTag> {
    match &name {
        b"sRGB" => Some(ColorTag {
            place: "sRGB chunk",
            says: "sRGB".to_owned(),
            transfer: Some(Transfer::Srgb),
            srgb_primaries: Some(true),
            primaries: None,
        }),
        b"cHRM" => chromaticities(data),
        b"gAMA" => {
            let gamma = f64::from(u32::from_be_bytes(*data.first_chunk()?)) / 1e5;
            let (transfer, means) = match transfer_of(|v| v.powf(1.0 / gamma.max(1e-5))) {
                Transfer::Linear => (Transfer::Linear, "linear light"),
                Transfer::Srgb => (Transfer::Srgb, "about as sRGB"),
                Transfer::Other => (Transfer::Other, "another curve than sRGB"),
            };
            let says = format!("a gamma of {gamma:.3} ({means})");
            Some(ColorTag {
                place: "gAMA chunk",
                says,
                transfer: Some(transfer),
                srgb_primaries: None,
                primaries: None,
            })
        }
        b"cICP" => {
            // Code points of ITU-T H.273.
            let &[primaries, transfer, ..] = data else { return None };
            let (transfer, curve) = match transfer {
                8 => (Transfer::Linear, "linear light".to_owned()),
                13 => (Transfer::Srgb, "the curve of sRGB".to_owned()),
                16 => (Transfer::Other, "PQ".to_owned()),
                18 => (Transfer::Other, "HLG".to_owned()),
                code => (Transfer::Other, format!("transfer curve {code}")),
            };
            let (known, colours) = match primaries {
                1 => (Some(Primaries::SRGB), "primaries of sRGB".to_owned()),
                9 => (Some(Primaries::BT2020), "primaries of BT.2020".to_owned()),
                12 => (Some(Primaries::DISPLAY_P3), "primaries of Display P3".to_owned()),
                code => (None, format!("primaries {code}")),
            };
            let range = if is_narrow(data) { ", narrow range (as video has it)" } else { "" };
            let says = format!("{curve}, {colours}{range}");
            let srgb_primaries = Some(known == Some(Primaries::SRGB));
            let transfer = Some(transfer);
            Some(ColorTag { place: "cICP chunk", says, transfer, srgb_primaries, primaries: known })
        }
        _ => None,
    }
}

/// Whether the data of a cICP chunk say that black and white lie at 16 and 235 of 255, and not at the ends.
fn is_narrow(data: &[u8]) -> bool {
    data.get(3) == Some(&0)
}

/// Brings values of a PNG file that says narrow range to those of full range; what lies beyond black and white is clipped.
///
/// # Equation
/// Of b bits, black is `16·2^(b−8)` and white `235·2^(b−8)` (ITU-T H.273, 8.3), both divided here by `2^b − 1`.
pub(super) fn widen_range(bytes: &[u8], planes: &mut Array3<f32>, bits: u32) {
    if !chunks_before_pixels(bytes).any(|(name, data)| name == *b"cICP" && is_narrow(data)) {
        return;
    }
    let unit = f64::from(1_u32 << (bits - 8)) / f64::from((1_u32 << bits) - 1);
    #[expect(clippy::cast_possible_truncation, reason = "images are f32")]
    let [black, range] = [16.0 * unit, 219.0 * unit].map(|level| level as f32);
    planes.par_mapv_inplace(|value| ((value - black) / range).clamp(0.0, 1.0));
}

/// White, red, green and blue, each x and y in hundred-thousandths.
fn chromaticities(data: &[u8]) -> Option<ColorTag> {
    let (numbers, _) = data.get(..32)?.as_chunks::<4>();
    let number = |index: usize| f64::from(u32::from_be_bytes(numbers[index])) / 1e5;
    let [white, red, green, blue] = [0, 2, 4, 6].map(|index| [number(index), number(index + 1)]);
    let primaries = Primaries { red, green, blue, white };
    primaries.matrix_to(&Primaries::SRGB)?;
    let name = primaries.name().unwrap_or("others than those of sRGB");
    Some(ColorTag {
        place: "cHRM chunk",
        says: format!("primaries of {name}"),
        transfer: None,
        srgb_primaries: Some(primaries.is_near(&Primaries::SRGB)),
        primaries: Some(primaries),
    })
}

/// The tag of an embedded ICC profile, found at `place`.
pub(super) fn of_profile(place: &'static str, profile: &[u8]) -> ColorTag {
    let found = icc::Profile::parse(profile);
    let named = found.as_ref().and_then(|profile| profile.name.clone());
    let transfer = found.as_ref().and_then(|profile| {
        let curve = profile.curve.as_ref()?;
        Some(transfer_of(|v| curve.at(v)))
    });
    let srgb_primaries = found.as_ref().and_then(|profile| profile.colorants).map(|colorants| {
        let pairs = colorants.iter().flatten().zip(SRGB_COLORANTS.iter().flatten());
        pairs.into_iter().all(|(found, srgb)| (found - srgb).abs() <= PRIMARIES_TOLERANCE)
    });
    let name = named.map_or_else(|| "a profile without a name".to_owned(), |name| format!("`{name}`"));
    let curve = match transfer {
        Some(Transfer::Linear) => " (linear light)",
        Some(Transfer::Srgb) => " (the curve of sRGB)",
        Some(Transfer::Other) => " (another curve than sRGB)",
        None => "",
    };
    let primaries = found.as_ref().and_then(|profile| Primaries::of_profile(profile.colorants?));
    ColorTag { place, says: format!("{name}{curve}"), transfer, srgb_primaries, primaries }
}

/// What a curve from values to linear light is.
fn transfer_of(curve: impl Fn(f64) -> f64) -> Transfer {
    let is_near = |known: fn(f64) -> f64, tolerance: f64| {
        (0..=32).map(|step| f64::from(step) / 32.0).all(|v| (curve(v) - known(v)).abs() <= tolerance)
    };
    if is_near(|v| v, CURVE_TOLERANCE) {
        Transfer::Linear
    } else if is_near(srgb_decode, CURVE_TOLERANCE) {
        Transfer::Srgb
    } else {
        Transfer::Other
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plain_gamma_of_two_point_two_counts_as_srgb_and_one_point_eight_does_not() {
        assert_eq!(transfer_of(|v| v.powf(2.2)), Transfer::Srgb);
        assert_eq!(transfer_of(|v| v.powf(1.8)), Transfer::Other);
        assert_eq!(transfer_of(|v| v), Transfer::Linear);
    }

    #[test]
    fn chunks_say_what_contradicts_them() {
        let gamma =
            |hundred_thousandths: u32| of_chunk(*b"gAMA", &hundred_thousandths.to_be_bytes()).unwrap();
        let linear = gamma(100_000);
        assert!(linear.contradiction(DomainTag::Srgb).unwrap().contains("gAMA chunk says a gamma of 1.000"));
        assert_eq!(linear.contradiction(DomainTag::Linear), None);
        assert_eq!(gamma(45_455).contradiction(DomainTag::Srgb), None);
        assert!(gamma(45_455).contradiction(DomainTag::Linear).is_some());
        let p3 = of_chunk(*b"cICP", &[12, 13, 0, 1]).unwrap();
        assert!(p3.contradiction(DomainTag::Srgb).unwrap().contains("Display P3"));
        assert!(of_chunk(*b"gAMA", &[1, 2]).is_none(), "a short chunk says nothing");
        assert!(of_chunk(*b"cHRM", &[1, 2]).is_none());
    }

    #[test]
    fn primaries_are_those_of_the_tag_that_counts() {
        let chunk = |name: &[u8; 4], data: &[u8]| of_chunk(*name, data).unwrap();
        let of_p3 = [31_270, 32_900, 68_000, 32_000, 26_500, 69_000, 15_000, 6000_u32].map(u32::to_be_bytes);
        let p3 = chunk(b"cHRM", of_p3.as_flattened());
        assert_eq!((p3.says.as_str(), p3.transfer), ("primaries of Display P3", None));
        let srgb = chunk(b"sRGB", &[0]);
        let wide = chunk(b"cICP", &[9, 13, 0, 1]);
        assert!(other_primaries(std::slice::from_ref(&p3)).unwrap().is_near(&Primaries::DISPLAY_P3));
        assert_eq!(other_primaries(&[p3.clone(), srgb.clone()]), None, "sRGB counts before cHRM");
        assert_eq!(other_primaries(&[p3, srgb, wide]), Some(Primaries::BT2020));
        assert_eq!(other_primaries(&[chunk(b"cICP", &[22, 13, 0, 1])]), None, "unknown ones");
    }
}
