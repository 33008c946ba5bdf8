//! Says what is known of a capture and lost in a file that `udc finish` would take it from.

use std::path::Path;

use super::Format;
use crate::core::capture::CaptureInfo;

/// What a file cannot carry that `udc finish` would take from it, with the flags that say it instead.
pub fn what_is_lost(path: &Path, info: &CaptureInfo) -> Option<String> {
    if Format::of_extension(path).is_ok_and(|format| format == Format::Exr) {
        return None;
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
    (!flags.is_empty()).then(|| {
        format!(
            "{} cannot carry what is known of the capture: write .exr, or give `udc finish` {}",
            path.display(),
            flags.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::orientation::Orientation;

    #[test]
    fn only_exr_carries_what_is_known_of_a_capture() {
        let info = CaptureInfo {
            saturation: Some([1.9, 1.0, 1.6]),
            orientation: Orientation::from_exif(6),
            baseline_exposure_ev: Some(0.0),
            ..CaptureInfo::default()
        };
        assert_eq!(what_is_lost(Path::new("a.exr"), &info), None);
        assert_eq!(what_is_lost(Path::new("a.png"), &CaptureInfo::default()), None);
        let said = what_is_lost(Path::new("a.png"), &info).unwrap();
        assert!(said.ends_with("`udc finish` --saturation 1.9000,1.0000,1.6000, --orientation 6"), "{said}");
    }
}
