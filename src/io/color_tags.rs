//! Reads what image files say of their colours: PNG's gAMA, sRGB, cICP and iCCP chunks, ICC profiles of JPEG and TIFF.
//!
//! These never change a value. They are shown, and compared with what the user says of a file. A transfer curve counts as
//! sRGB's if it stays within [`CURVE_TOLERANCE`] of it, as a plain gamma of 2.2 does; a profile of tables (no matrix and
//! curves) is named only.

use std::fmt;

use serde::Serialize;

use super::{DomainTag, icc};
use crate::core::color::srgb_decode;

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
}

impl fmt::Display for ColorTag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.says)
    }
}

impl ColorTag {
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
            format!("its {place} says {says}, whose red, green and blue are not those of sRGB and are taken for them")
        })
    }
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
        }),
        b"gAMA" => {
            let gamma = f64::from(u32::from_be_bytes(*data.first_chunk()?)) / 1e5;
            let (transfer, means) = match transfer_of(|v| v.powf(1.0 / gamma.max(1e-5))) {
                Transfer::Linear => (Transfer::Linear, "linear light"),
                Transfer::Srgb => (Transfer::Srgb, "about as sRGB"),
                Transfer::Other => (Transfer::Other, "another curve than sRGB"),
            };
            let says = format!("a gamma of {gamma:.3} ({means})");
            Some(ColorTag { place: "gAMA chunk", says, transfer: Some(transfer), srgb_primaries: None })
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
            let (is_srgb, colours) = match primaries {
                1 => (true, "primaries of sRGB".to_owned()),
                9 => (false, "primaries of BT.2020".to_owned()),
                12 => (false, "primaries of Display P3".to_owned()),
                code => (false, format!("primaries {code}")),
            };
            let says = format!("{curve}, {colours}");
            let srgb_primaries = Some(is_srgb);
            Some(ColorTag { place: "cICP chunk", says, transfer: Some(transfer), srgb_primaries })
        }
        _ => None,
    }
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
    ColorTag { place, says: format!("{name}{curve}"), transfer, srgb_primaries }
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
    }
}
