//! What is known of a capture and lost in the file that `udc finish` would take it from.

use std::path::Path;

use udc::core::capture::CaptureInfo;
use udc::io::Format;

use super::Session;

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
