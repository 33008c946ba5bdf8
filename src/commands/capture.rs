//! What is known of a capture, from the raw file to the file that `udc finish` reads.

use std::path::Path;

use udc::capture::Fused;
use udc::core::capture::CaptureInfo;
use udc::io::{Format, RawMetadata};

use super::Session;

/// What finishing needs to know of a capture that was read from raw files, or of a fused bracket.
pub(super) fn info_of(fused: &Fused, raw: Option<&RawMetadata>, white_balance: [f64; 3]) -> CaptureInfo {
    #[expect(clippy::cast_possible_truncation, reason = "an irradiance in f32")]
    let saturation = Some(fused.saturation.map(|white| white as f32));
    let info = CaptureInfo { saturation, white_balance: Some(white_balance), ..CaptureInfo::default() };
    match raw {
        None => info,
        Some(raw) => CaptureInfo {
            orientation: Some(raw.orientation),
            baseline_exposure_ev: raw.baseline_exposure_ev,
            color: raw.color.clone(),
            ..info
        },
    }
}

/// Names the corrections that a raw file asks for and that were not made.
pub(super) fn uncorrected(raw: &RawMetadata) -> Option<String> {
    let names = |optional: bool| {
        let names = raw.ignored.iter().filter(|opcode| opcode.optional == optional);
        names.map(|opcode| opcode.name.as_str()).collect::<Vec<_>>().join(", ")
    };
    // Opcodes that have no name yet may be skipped silently where the file allows it.
    let (needed, optional) = (names(false), names(true));
    let is_known = raw.ignored.iter().any(|opcode| opcode.optional && !opcode.name.starts_with("opcode"));
    match (needed.is_empty(), is_known) {
        (true, false) => None,
        (true, true) => {
            Some(format!("restored without the correction of {optional}, which the file makes optional"))
        }
        (false, _) => {
            let also = if is_known { format!(", and of {optional}") } else { String::new() };
            Some(format!(
                "restored without the correction of {needed}{also}; the file requires {needed}: positions or values may \
                 be off, so convert it with these corrections made, if they matter"
            ))
        }
    }
}

/// Says what a file cannot carry that `udc finish` would take from it.
pub(super) fn note_what_is_lost(path: &Path, info: &CaptureInfo, session: &Session) {
    if Format::of_extension(path).is_ok_and(|format| format == Format::Exr) {
        return;
    }
    let mut flags = Vec::new();
    if let Some([red, green, blue]) = info.saturation {
        flags.push(format!("--saturation {red:.4},{green:.4},{blue:.4}"));
    }
    if let Some(orientation) = info.orientation.filter(|orientation| !orientation.is_upright()) {
        flags.push(format!("--orientation {}", orientation.exif()));
    }
    if let Some(matrix) = info.color_matrix() {
        let numbers: Vec<String> = matrix.iter().flatten().map(|value| format!("{value:.4}")).collect();
        flags.push(format!("--ccm with a file of `ccm: {}`", numbers.join(" ")));
    }
    if let Some(stops) = info.baseline_exposure_ev.filter(|stops| *stops != 0.0) {
        flags.push(format!("--baseline-exposure {stops}"));
    }
    if !flags.is_empty() {
        session.note(format_args!(
            "{} cannot carry what is known of the capture: write .exr, or give `udc finish` {}",
            path.display(),
            flags.join(", ")
        ));
    }
}
