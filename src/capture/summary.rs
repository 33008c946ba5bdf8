//! Says how a fusion went: what was taken from where, what moved, what was filled.

use super::bracket::show_time;
use super::fuse::Fused;

impl Fused {
    /// What the image was made of, in lines of text.
    pub fn summary(&self) -> Vec<String> {
        let shares = self.shares(self.times.len());
        let shares: Vec<String> = self
            .times
            .iter()
            .zip(shares)
            .zip(&self.averaged)
            .map(|((time, share), count)| {
                let mean = if *count > 1 { format!(" (mean of {count})") } else { String::new() };
                format!("{:.2} % from {}{mean}", 100.0 * share, show_time(*time))
            })
            .collect();
        let mut lines = vec![format!("values: {}", shares.join(", "))];
        for (motion, time) in self.motion.iter().zip(&self.times[1..]) {
            if let Some(motion) = motion {
                let [down, right] = motion.shift_px;
                lines.push(format!(
                    "motion of {} against the next longer exposure: {down:+.2} down, {right:+.2} right",
                    show_time(*time)
                ));
            }
        }
        if self.discarded > 0 {
            lines.push(format!("discarded by the mask: {} pixels", self.discarded));
        }
        if let Some(hot) = self.hot_pixels {
            let filled = if hot > 0 { ", filled from their neighbours" } else { "" };
            lines.push(format!("hot pixels in the dark frames: {hot}{filled}"));
        }
        lines
    }
}
