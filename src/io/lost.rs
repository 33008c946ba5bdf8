//! Says what is known of an image and lost in a file that other commands would take it from.

use std::path::Path;

use super::Format;
use crate::core::capture::CaptureInfo;
use crate::core::tone::ToneCurve;

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

/// What the file of an image that was tone-mapped by this curve cannot say of it, with the flags that say it where the file is read.
/// Files of integers are asked for their domain, and those of floats would be taken for linear.
pub fn what_is_lost_of_mapping(path: &Path, curve: ToneCurve) -> Option<String> {
    let format = Format::of_extension(path).ok().filter(|format| *format != Format::Exr)?;
    let usual = ToneCurve::default();
    let numbers = [("--alpha", curve.alpha, usual.alpha), ("--x-max", curve.x_max, usual.x_max)];
    let differ = numbers.iter().filter(|(_, own, usual)| own.total_cmp(usual).is_ne());
    let mut flags: Vec<String> = differ.map(|(flag, own, _)| format!("{flag} {own}")).collect();
    if flags.is_empty() && format != Format::Npy {
        return None;
    }
    flags.insert(0, "--domain tone-mapped".to_owned());
    Some(format!(
        "files such as {} cannot say how they are tone-mapped: write .exr, or give {} where they are read",
        path.display(),
        flags.join(" ")
    ))
}

/// What a file of integers cannot say of linear light: it looks dark where it is taken for a picture.
pub(super) fn what_is_lost_of_light(path: &Path) -> Option<String> {
    Format::of_extension(path).ok().filter(|format| !format.holds_light())?;
    Some(format!(
        "{} holds linear light and cannot say so: give --domain linear where it is read; `udc finish` makes a picture to look at",
        path.display()
    ))
}

/// What the file of a picture for viewing cannot say of it: a `.npy` would be taken for linear light.
pub(super) fn what_is_lost_of_display(path: &Path) -> Option<String> {
    Format::of_extension(path).ok().filter(|format| *format == Format::Npy)?;
    Some(format!(
        "{} holds values of a display and cannot say so: it is read as linear light; write .exr, .png or .tif",
        path.display()
    ))
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

    #[test]
    fn only_exr_carries_the_tone_curve() {
        let (usual, other) = (ToneCurve::default(), ToneCurve { alpha: 0.1, x_max: 16.0 });
        let lost = |name: &str, curve| what_is_lost_of_mapping(Path::new(name), curve);
        assert_eq!(lost("a.exr", other), None);
        // It is asked for, and the rest is what is taken.
        assert_eq!(lost("a.png", usual), None);
        let said = lost("a.png", other).unwrap();
        assert!(said.contains("--domain tone-mapped --alpha 0.1 --x-max 16"), "{said}");
        assert!(lost("a.npy", usual).unwrap().contains("--domain tone-mapped where"));
    }
}
