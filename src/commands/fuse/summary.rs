//! Says how a fusion went: what was taken from where, what is doubtful, how good the PSF is.

use std::path::Path;

use serde_json::{Value, json};

use udc::capture::Fused;
use udc::psf::MeasuredPsf;

use super::positions::Position;

/// What there is to tell about a fusion.
pub(super) struct Summary<'a> {
    pub(super) output: &'a Path,
    pub(super) fused: &'a Fused,
    pub(super) measured: Option<&'a MeasuredPsf>,
    /// Where the source was taken, if at several positions: `fused` is of the first, with the image of all.
    pub(super) positions: &'a [Position],
}

impl Summary<'_> {
    /// What the user should look at.
    pub(super) fn warnings(&self) -> Vec<String> {
        let mut warnings = doubts_of(self.fused);
        if self.positions.is_empty() {
            warnings.extend(self.fused.core_is_narrow());
        }
        if let Some(measured) = self.measured {
            warnings.extend(measured.warnings());
        }
        warnings
    }

    /// The summary for people.
    pub(super) fn text(&self) -> String {
        let image = self.measured.map_or(&self.fused.image, |measured| &measured.image);
        let mut lines = vec![format!("{}: {} × {}", self.output.display(), image.width(), image.height())];
        lines.extend(self.fused.summary());
        lines.extend(self.positions.iter().map(Position::describe));
        lines.extend(self.measured.map(MeasuredPsf::summary).unwrap_or_default());
        lines.join("\n")
    }

    /// The summary for programs.
    pub(super) fn json(&self) -> Value {
        let fused = self.fused;
        let psf = self.measured.map(|measured| {
            json!({
                "displacement-px": measured.displacement_px,
                "centroid-px": measured.centroid_px,
                "background": measured.background,
                "padded": measured.padded,
                "noise": measured.noise,
                "sloping": measured.sloping,
                "channels": measured.quality.channels,
            })
        });
        let positions = self.positions.iter().map(Position::json).collect::<Vec<_>>();
        json!({
            "output": self.output,
            "positions": positions,
            "exposures": fused.times,
            "shares": fused.shares(fused.times.len()),
            "saturated": fused.saturated,
            "averaged": fused.averaged,
            "discarded": fused.discarded,
            "hot-pixels": fused.hot_pixels,
            "looks-hot": fused.looks_hot,
            "brightness-ratio-found": fused.ratio_found,
            "motion-px": fused.motion.iter().map(|motion| motion.map(|m| m.shift_px)).collect::<Vec<_>>(),
            "psf": psf,
        })
    }
}

/// What the user should look at in one bracket.
pub(super) fn doubts_of(fused: &Fused) -> Vec<String> {
    let mut warnings = Vec::new();
    let saturated: usize = fused.saturated.iter().sum();
    if saturated > 0 {
        let values = if saturated == 1 { "value is" } else { "values are" };
        warnings.push(format!(
            "{saturated} {values} saturated in every exposure and brighter than written; add a shorter exposure"
        ));
    }
    warnings.extend(fused.warnings());
    warnings
}
