//! Builds the ICC profile of a colour space for displays: three primaries, one curve (ICC.1:2022, version 4.4).

use super::HEADER_BYTES;
use crate::core::matrix3::product;
use crate::core::primaries::{ColorSpace, PROFILE_WHITE, adaptation};

/// The curve of sRGB (IEC 61966-2-1) as a parametric curve of type 3: g, a, b, c, d.
const CURVE: [f64; 5] = [2.4, 1.0 / 1.055, 0.055 / 1.055, 1.0 / 12.92, 0.040_45];

/// The profile of a colour space, both of whose curves are that of sRGB.
///
/// # Equation
/// The columns of the matrix to XYZ, adapted from D65 to the white of profiles by linear Bradford, are the colorants;
/// the adaptation stands beside them (tag `chad`).
///
/// # Panics
/// Never: the primaries of displays span their colours.
pub(in crate::io) fn profile_of(space: ColorSpace) -> Vec<u8> {
    let to_xyz = space.primaries().to_xyz().expect("primaries of displays span their colours");
    let white = to_xyz.map(|row| row.iter().sum());
    let adapted = adaptation(white, PROFILE_WHITE).expect("D65 is light");
    let colorants = product(&adapted, &to_xyz);
    let column = |index: usize| xyz(colorants.map(|row| row[index]));
    let curve = [&b"para\0\0\0\0\0\x03\0\0"[..], &fixed(&CURVE)].concat();
    let chad = [&b"sf32\0\0\0\0"[..], &fixed(adapted.as_flattened())].concat();
    let tags = [
        (b"desc", text(space.name())),
        (b"cprt", text("No copyright, use freely")),
        (b"wtpt", xyz(PROFILE_WHITE)),
        (b"chad", chad),
        (b"rXYZ", column(0)),
        (b"gXYZ", column(1)),
        (b"bXYZ", column(2)),
        (b"rTRC", curve),
    ];
    // Green and blue have the curve of red.
    let count = tags.len() + 2;
    let mut table = u32_of(count).to_vec();
    let mut data = Vec::new();
    let start = HEADER_BYTES + 4 + 12 * count;
    for (name, contents) in &tags {
        let entry = [u32_of(start + data.len()), u32_of(contents.len())].concat();
        let names: &[&[u8; 4]] = if *name == b"rTRC" { &[b"rTRC", b"gTRC", b"bTRC"] } else { &[*name] };
        names.iter().for_each(|name| table.extend([&name[..], &entry].concat()));
        data.extend(contents);
        data.resize(data.len().next_multiple_of(4), 0);
    }
    [header(start + data.len()), table, data].concat()
}

/// The header (section 7.2): a display's profile of RGB to XYZ; the date is that of version 4.4.
fn header(length: usize) -> Vec<u8> {
    let mut header = vec![0; HEADER_BYTES];
    let mut put = |place: usize, bytes: &[u8]| header[place..place + bytes.len()].copy_from_slice(bytes);
    put(0, &u32_of(length));
    put(8, &[4, 0x40]);
    put(12, b"mntrRGB XYZ ");
    put(24, &[2022_u16, 5, 1, 0, 0, 0].map(u16::to_be_bytes).concat());
    put(36, b"acsp");
    put(68, &fixed(&PROFILE_WHITE));
    header
}

/// A text in one language (section 10.15).
fn text(text: &str) -> Vec<u8> {
    let letters: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
    // One record of 12 bytes: its language, its length, and where it starts.
    let head = [&b"mluc\0\0\0\0"[..], &u32_of(1), &u32_of(12), b"enUS", &u32_of(letters.len()), &u32_of(28)];
    [head.concat(), letters].concat()
}

fn xyz(values: [f64; 3]) -> Vec<u8> {
    [&b"XYZ \0\0\0\0"[..], &fixed(&values)].concat()
}

/// Numbers of 16 bits before and 16 behind the point.
fn fixed(values: &[f64]) -> Vec<u8> {
    #[expect(clippy::cast_possible_truncation, reason = "numbers of a few units")]
    let bytes = |value: &f64| ((value * 65536.0).round() as i32).to_be_bytes();
    values.iter().flat_map(bytes).collect()
}

fn u32_of(number: usize) -> [u8; 4] {
    u32::try_from(number).expect("profiles are of a few hundred bytes").to_be_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::color::srgb_decode;
    use crate::core::primaries::Primaries;
    use crate::io::icc::Profile;

    /// The colorants that Apple's `Display P3` and the ICC's `sRGB2014` have, and white as their sum.
    #[test]
    fn profiles_have_the_colorants_of_published_ones() {
        let p3 = [[0.5151, 0.2412, -0.0011], [0.2920, 0.6922, 0.0419], [0.1571, 0.0666, 0.7841]];
        let srgb = [[0.4361, 0.2225, 0.0139], [0.3851, 0.7169, 0.0971], [0.1431, 0.0606, 0.7141]];
        for (space, expected) in [(ColorSpace::DisplayP3, p3), (ColorSpace::Srgb, srgb)] {
            let profile = Profile::parse(&profile_of(space)).unwrap();
            assert_eq!(profile.name.as_deref(), Some(space.name()));
            let colorants = profile.colorants.unwrap();
            for (found, expected) in colorants.iter().flatten().zip(expected.iter().flatten()) {
                assert!((found - expected).abs() < 3e-4, "{space:?}: {found} instead of {expected}");
            }
            for (axis, white) in PROFILE_WHITE.into_iter().enumerate() {
                let sum: f64 = colorants.iter().map(|colorant| colorant[axis]).sum();
                // Each number is rounded to half of 2⁻¹⁶.
                assert!((sum - white).abs() < 4.0 / 65536.0, "{sum} instead of {white}");
            }
            let curve = profile.curve.unwrap();
            for step in 0..=50 {
                let value = f64::from(step) / 50.0;
                assert!((curve.at(value) - srgb_decode(value)).abs() < 1e-4, "{value}");
            }
            assert!(Primaries::of_profile(colorants).unwrap().is_near(&space.primaries()), "{colorants:?}");
        }
    }

    #[test]
    fn the_length_is_that_of_the_file() {
        let profile = profile_of(ColorSpace::Srgb);
        assert_eq!(profile[..4], u32_of(profile.len()));
        assert!(profile.len().is_multiple_of(4) && profile.len() < 600, "{}", profile.len());
    }
}
