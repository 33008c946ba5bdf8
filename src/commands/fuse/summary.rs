//! Says how a fusion went: what was taken from where, what is doubtful, how good the PSF is.

use std::path::Path;

use serde_json::{Value, json};

use udc::capture::{Fused, show_time};
use udc::psf::MeasuredPsf;

const CHANNELS: [&str; 3] = ["red", "green", "blue"];

/// What there is to tell about a fusion.
pub(super) struct Summary<'a> {
    pub(super) output: &'a Path,
    pub(super) fused: &'a Fused,
    pub(super) measured: Option<&'a MeasuredPsf>,
}

impl Summary<'_> {
    /// What the user should look at.
    pub(super) fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        let saturated: usize = self.fused.saturated.iter().sum();
        if saturated > 0 {
            let values = if saturated == 1 { "value is" } else { "values are" };
            warnings.push(format!(
                "{saturated} {values} saturated in every exposure and brighter than written; add a shorter exposure"
            ));
        }
        warnings.extend(self.fused.warnings());
        if let Some(measured) = self.measured {
            warnings.extend(psf_warnings(measured));
        }
        warnings
    }

    /// The summary for people.
    pub(super) fn text(&self) -> String {
        let image = self.measured.map_or(&self.fused.image, |measured| &measured.image);
        let mut lines = vec![format!("{}: {} × {}", self.output.display(), image.width(), image.height())];
        let shares = self.fused.shares(self.fused.times.len());
        let shares: Vec<String> = self
            .fused
            .times
            .iter()
            .zip(shares)
            .zip(&self.fused.averaged)
            .map(|((time, share), count)| {
                let mean = if *count > 1 { format!(" (mean of {count})") } else { String::new() };
                format!("{:.2} % from {}{mean}", 100.0 * share, show_time(*time))
            })
            .collect();
        lines.push(format!("values: {}", shares.join(", ")));
        for (motion, time) in self.fused.motion.iter().zip(&self.fused.times[1..]) {
            if let Some(motion) = motion {
                let [down, right] = motion.shift_px;
                lines.push(format!(
                    "motion of {} against the next longer exposure: {down:+.2} down, {right:+.2} right",
                    show_time(*time)
                ));
            }
        }
        if self.fused.discarded > 0 {
            lines.push(format!("discarded by the mask: {} pixels", self.fused.discarded));
        }
        if let Some(hot) = self.fused.hot_pixels {
            let filled = if hot > 0 { ", filled from their neighbours" } else { "" };
            lines.push(format!("hot pixels in the dark frames: {hot}{filled}"));
        }
        if let Some(measured) = self.measured {
            let [down, right] = measured.displacement_px;
            lines.push(format!("main peak: {down:+} down, {right:+} right of the frame's centre"));
            lines.push(
                "channel  background        peak / sidelobe  50 / 90 / 99 % within px  centroid".to_owned(),
            );
            lines.extend((0..3).map(|channel| psf_line(measured, channel)));
        }
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
                "channels": measured.quality.channels,
            })
        });
        json!({
            "output": self.output,
            "exposures": fused.times,
            "shares": fused.shares(fused.times.len()),
            "saturated": fused.saturated,
            "averaged": fused.averaged,
            "discarded": fused.discarded,
            "hot-pixels": fused.hot_pixels,
            "brightness-ratio-found": fused.ratio_found,
            "motion-px": fused.motion.iter().map(|motion| motion.map(|m| m.shift_px)).collect::<Vec<_>>(),
            "psf": psf,
        })
    }
}

fn psf_line(measured: &MeasuredPsf, channel: usize) -> String {
    let background = measured.background[channel];
    let quality = &measured.quality.channels[channel];
    let ratio = quality.peak_to_sidelobe.map_or("none".to_owned(), |ratio| format!("{ratio:.1}"));
    let [half, most, all] = quality.encircled_px;
    let [y, x] = measured.centroid_px[channel];
    format!(
        "{:7}  {:.2e} ± {:.0e}  {ratio:>15}  {half:8.1} / {most:.1} / {all:.1}  {y:+.2} {x:+.2}",
        CHANNELS[channel], background.level, background.spread
    )
}

fn psf_warnings(measured: &MeasuredPsf) -> Vec<String> {
    let mut warnings = Vec::new();
    if measured.padded > 0.0 {
        warnings.push(format!(
            "{:.1} % of the PSF lies outside of the frame and is zero; centre the source or reduce --size",
            100.0 * measured.padded
        ));
    }
    for (name, noise) in CHANNELS.iter().zip(measured.noise) {
        // Such a share would lift or lower the haze and dim the peak visibly.
        if noise > 0.05 {
            let percent = 100.0 * noise;
            warnings.push(format!(
                "noise leaves {percent:.0} % of the {name} PSF's light uncertain; average more captures: give several \
                 files of each exposure time"
            ));
        }
    }
    warnings
}
