//! Says how good a PSF is, measured or simulated, and what is doubtful of it.

use super::background::Background;
use super::measure::MeasuredPsf;
use super::propagate::SimulatedPsf;
use super::quality::assess_psf;

const CHANNELS: [&str; 3] = ["red", "green", "blue"];

/// Such a share of noise would lift or lower the haze and dim the peak visibly.
const MUCH_NOISE: f64 = 0.05;

/// A slope of as much light is worth a warning, for a tenth of it that is no plane would be seen: less is only told.
const MUCH_SLOPE: f64 = 0.2;

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
        let steepest = self.sloping.into_iter().fold(0.0, f64::max);
        if steepest > MUCH_SLOPE {
            warnings.push(format!(
                "the background slopes over the frame, by {:.0} % of the PSF's light: a plane of it is taken away, and what is no plane is \
                 left; keep stray light out, or take dark frames (--dark) with the source alone covered",
                100.0 * steepest
            ));
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
        lines.extend(self.slopes());
        lines
    }

    /// How the background slopes, where it does.
    fn slopes(&self) -> Option<String> {
        let slope = |(name, background): (&&str, &Background)| {
            let [down, right] = background.slope?;
            Some(format!("{name} {down:+.1e} down, {right:+.1e} right"))
        };
        let found: Vec<String> = CHANNELS.iter().zip(&self.background).filter_map(slope).collect();
        let slopes = "the background slopes from the frame's centre to its edges, which was taken away";
        (!found.is_empty()).then(|| format!("{slopes}: {}", found.join("; ")))
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

impl SimulatedPsf {
    /// Where its light went and how it is spread, in lines of text.
    pub fn summary(&self) -> Vec<String> {
        let header = "channel  passes panel  outside window  in peak pixel  50 / 90 / 99 % within px";
        let quality = assess_psf(&self.psf);
        let mut lines = vec![header.to_owned()];
        for ((name, light), quality) in CHANNELS.iter().zip(&self.light).zip(&quality.channels) {
            let [half, most, all] = quality.encircled_px;
            lines.push(format!(
                "{name:7}  {:10.1} %  {:12.2} %  {:11.2} %  {half:8.1} / {most:.1} / {all:.1}",
                100.0 * light.transmitted,
                100.0 * light.outside,
                100.0 * quality.peak_share
            ));
        }
        lines
    }

    /// The grid over the pupil, the place of the sensor and the memory that they took, in a sentence.
    pub fn geometry_in_words(&self) -> String {
        format!(
            "grid of {0} × {0} points, {1:.3} µm apart; sensor {2:.4} mm behind the lens; arrays of {3} MiB",
            self.grid.size,
            self.grid.pitch_m * 1e6,
            self.optics.sensor_distance_m * 1e3,
            self.memory_bytes >> 20
        )
    }
}
