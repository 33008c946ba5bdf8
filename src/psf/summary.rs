//! Says how good a measured PSF is, and what is doubtful of it.

use super::measure::MeasuredPsf;

const CHANNELS: [&str; 3] = ["red", "green", "blue"];

/// Such a share of noise would lift or lower the haze and dim the peak visibly.
const MUCH_NOISE: f64 = 0.05;

impl MeasuredPsf {
    /// What the user should look at.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.padded > 0.0 {
            warnings.push(format!(
                "{:.1} % of the PSF lies outside of the frame and is zero; centre the source or reduce --size",
                100.0 * self.padded
            ));
        }
        for (name, noise) in CHANNELS.iter().zip(self.noise) {
            if noise > MUCH_NOISE {
                let percent = 100.0 * noise;
                warnings.push(format!(
                    "noise leaves {percent:.0} % of the {name} PSF's light uncertain; average more captures: give several \
                     files of each exposure time"
                ));
            }
        }
        warnings
    }

    /// Where it was found and how it spreads its light, in lines of text.
    pub fn summary(&self) -> Vec<String> {
        let [down, right] = self.displacement_px;
        let mut lines = vec![
            format!("main peak: {down:+} down, {right:+} right of the frame's centre"),
            "channel  background        peak / sidelobe  50 / 90 / 99 % within px  centroid".to_owned(),
        ];
        lines.extend((0..3).map(|channel| self.line(channel)));
        lines
    }

    fn line(&self, channel: usize) -> String {
        let background = self.background[channel];
        let quality = &self.quality.channels[channel];
        let ratio = quality.peak_to_sidelobe.map_or("none".to_owned(), |ratio| format!("{ratio:.1}"));
        let [half, most, all] = quality.encircled_px;
        let [y, x] = self.centroid_px[channel];
        format!(
            "{:7}  {:.2e} ± {:.0e}  {ratio:>15}  {half:8.1} / {most:.1} / {all:.1}  {y:+.2} {x:+.2}",
            CHANNELS[channel], background.level, background.spread
        )
    }
}
