//! The primaries that an OpenEXR file declares: those of Rec. 709 unless it says others.

use ::exr::math::Vec2;
use ::exr::meta::attribute::Chromaticities;
use ::exr::meta::header::Header;

use crate::core::capture::CaptureInfo;
use crate::core::primaries::Primaries;

/// What is known of a capture, with the primaries of the file's header where they are others than sRGB's and nothing else
/// says what the colours are.
pub(super) fn with_primaries(info: Option<CaptureInfo>, header: &Header) -> Option<CaptureInfo> {
    let declared = header.shared_attributes.chromaticities.map(|found| primaries_of(&found));
    let is_other = |primaries: &Primaries| {
        !primaries.is_near(&Primaries::SRGB) && primaries.matrix_to(&Primaries::SRGB).is_some()
    };
    let Some(primaries) = declared.filter(is_other) else { return info };
    let mut info = info.unwrap_or_default();
    if info.color.is_none() {
        info.primaries.get_or_insert(primaries);
    }
    Some(info)
}

/// What to tell of primaries that the file declares and that are none, so that they are not heeded.
pub(super) fn doubt(header: &Header) -> Option<String> {
    let declared = header.shared_attributes.chromaticities.map(|found| primaries_of(&found))?;
    declared.matrix_to(&Primaries::SRGB).is_none().then(|| {
        "its chromaticities span no colours; its red, green and blue are taken for those of Rec. 709"
            .to_owned()
    })
}

fn primaries_of(found: &Chromaticities) -> Primaries {
    let place = |Vec2(x, y): Vec2<f32>| [f64::from(x), f64::from(y)];
    Primaries {
        red: place(found.red),
        green: place(found.green),
        blue: place(found.blue),
        white: place(found.white),
    }
}

/// The attribute of an image of these primaries.
pub(super) fn attribute_of(primaries: &Primaries) -> Chromaticities {
    #[expect(clippy::cast_possible_truncation, reason = "the attribute is of 32-bit floats")]
    let place = |[x, y]: [f64; 2]| Vec2(x as f32, y as f32);
    Chromaticities {
        red: place(primaries.red),
        green: place(primaries.green),
        blue: place(primaries.blue),
        white: place(primaries.white),
    }
}
