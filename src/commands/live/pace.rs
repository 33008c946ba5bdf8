//! Finds out how fast work goes at present, and how long the rest takes.

use std::collections::VecDeque;

/// The time that the present is judged by, in seconds: short enough to follow a change, long enough for steps of seconds.
const WINDOW_S: f64 = 30.0;

/// Counts that are noted closer together than this are one.
const RESOLUTION_S: f64 = WINDOW_S / 60.0;

/// How many were done when, over the last [`WINDOW_S`] seconds or the last step, whichever is longer.
#[derive(Debug)]
pub(super) struct Pace {
    /// Seconds since the work began, and how many were done then.
    notes: VecDeque<(f64, u64)>,
}

impl Default for Pace {
    fn default() -> Self {
        Self::from(0.0, 0)
    }
}

impl Pace {
    /// Begins at a time, with so many done before.
    pub(super) fn from(seconds: f64, done: u64) -> Self {
        Self { notes: VecDeque::from([(seconds, done)]) }
    }

    /// Notes that so many are done.
    pub(super) fn note(&mut self, seconds: f64, done: u64) {
        let length = self.notes.len();
        if length > 1 && seconds - self.notes[length - 2].0 < RESOLUTION_S {
            self.notes.pop_back();
        }
        self.notes.push_back((seconds, done));
        while self.notes.len() > 2 && seconds - self.notes[1].0 >= WINDOW_S {
            self.notes.pop_front();
        }
    }

    /// How many are done in a second; none before the first is. A step that takes longer than those before it slows it.
    pub(super) fn per_second(&self, now: f64) -> Option<f64> {
        let ((begun, before), (last, done)) = (*self.notes.front()?, *self.notes.back()?);
        let steps = (done - before) as f64;
        let usual = (last - begun) / steps;
        let waited = now - last;
        let taken = if waited > usual { now - begun } else { last - begun };
        (steps > 0.0 && taken > 0.0).then(|| steps / taken)
    }

    /// How many seconds it takes until `total` are done.
    pub(super) fn seconds_left(&self, now: f64, total: u64) -> Option<f64> {
        let (last, done) = *self.notes.back()?;
        let left = total.saturating_sub(done) as f64 / self.per_second(now)?;
        // What the step that is under way has taken already is behind.
        Some((left - (now - last).min(left)).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_known_before_the_first_step() {
        let pace = Pace::default();
        assert_eq!((pace.per_second(9.0), pace.seconds_left(9.0, 5)), (None, None));
    }

    #[test]
    fn a_steady_pace_is_found_and_its_end() {
        let mut pace = Pace::default();
        (1..=40_u32).for_each(|step| pace.note(f64::from(step) * 2.0, u64::from(step)));
        assert!((pace.per_second(80.0).unwrap() - 0.5).abs() < 1e-12);
        assert!((pace.seconds_left(80.0, 100).unwrap() - 120.0).abs() < 1e-9);
        assert!((pace.seconds_left(81.0, 100).unwrap() - 119.0).abs() < 1e-9, "it counts down");
        assert!(pace.notes.len() < 20, "{}", pace.notes.len());
    }

    #[test]
    fn the_present_counts_and_not_the_past() {
        let mut pace = Pace::default();
        (1..=1000_u32).for_each(|step| pace.note(f64::from(step) * 0.1, u64::from(step)));
        (1..=60_u32).for_each(|step| pace.note(100.0 + f64::from(step), 1000 + u64::from(step)));
        assert!((pace.per_second(160.0).unwrap() - 1.0).abs() < 0.05);
    }

    #[test]
    fn a_step_that_hangs_slows_the_pace() {
        let mut pace = Pace::default();
        (1..=4_u32).for_each(|step| pace.note(f64::from(step), u64::from(step)));
        assert!((pace.per_second(4.5).unwrap() - 1.0).abs() < 1e-12, "it is within its time");
        assert!((pace.per_second(16.0).unwrap() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn what_an_earlier_process_did_took_no_time() {
        let mut pace = Pace::from(3.0, 900);
        assert_eq!(pace.per_second(3.0), None);
        pace.note(5.0, 901);
        assert!((pace.seconds_left(5.0, 911).unwrap() - 20.0).abs() < 1e-9);
    }
}
