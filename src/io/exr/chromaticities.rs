//! The primaries that an OpenEXR file declares: those of Rec. 709 unless it says others.

use ::exr::math::Vec2;
use ::exr::meta::attribute::Chromaticities;
use ::exr::meta::header::Header;

use ndarray::{Array3, Axis, azip};

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

/// Turns planes of RY, Y and BY into red, green and blue.
///
/// # Equation
/// `RY = (R − Y)/Y`, `BY = (B − Y)/Y` and `Y = w·(R, G, B)` with the luminances w of the file's primaries, else of those of Rec. 709
/// (OpenEXR, `ImfRgbaYca.h`).
///
/// # Shapes
/// `[3, height, width]`.
pub(super) fn rgb_of_chroma(planes: &mut Array3<f32>, header: &Header) {
    let declared = header.shared_attributes.chromaticities.map(|found| primaries_of(&found));
    let to_xyz = declared.and_then(|primaries| primaries.to_xyz()).or_else(|| Primaries::SRGB.to_xyz());
    let [_, luminances, _] = to_xyz.expect("the primaries of sRGB span its colours");
    #[expect(clippy::cast_possible_truncation, reason = "images are f32")]
    let [red, green, blue] = luminances.map(|luminance| luminance as f32);
    let (mut first, rest) = planes.view_mut().split_at(Axis(0), 1);
    let (mut second, mut third) = rest.split_at(Axis(0), 1);
    azip!((r in &mut first, g in &mut second, b in &mut third) {
        let luminance = *g;
        (*r, *b) = ((*r + 1.0) * luminance, (*b + 1.0) * luminance);
        *g = (luminance - red * *r - blue * *b) / green;
    });
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
