//! Memory asked for before it is used, a few cache lines at a time, while the CPU multiplies.
//!
//! A layer's rows are too long for the second-level cache, so that what reads and writes them waits for memory, where
//! more than a few lines cannot be under way at once. Products keep to the first two levels meanwhile. Asking for the
//! rows between one register tile and the next fills that time, the more so the slower memory is.

use super::scratch::LINE;
use super::simd::prefetch;

/// Runs of floats that are asked for one after another, in equal shares.
pub(crate) struct Prefetcher<'a, const RUNS: usize> {
    /// What has not been asked for.
    runs: [&'a [f32]; RUNS],
    /// The run that is next.
    current: usize,
    /// Floats per share.
    share: usize,
}

impl<'a, const RUNS: usize> Prefetcher<'a, RUNS> {
    /// Divides the runs into as many shares.
    #[inline(always)]
    pub(crate) fn new(runs: [&'a [f32]; RUNS], shares: usize) -> Self {
        let mut floats = 0;
        for run in &runs {
            floats += run.len().next_multiple_of(LINE);
        }
        Self { runs, current: 0, share: floats.div_ceil(shares).next_multiple_of(LINE) }
    }

    /// Asks for the next share; there may be none left.
    #[inline(always)]
    pub(crate) fn fetch(&mut self) {
        let mut left = self.share;
        while left > 0 && self.current < RUNS {
            let run = &mut self.runs[self.current];
            let (now, later) = run.split_at(left.min(run.len()));
            for at in (0..now.len()).step_by(LINE) {
                prefetch(now, at);
            }
            *run = later;
            left -= now.len().next_multiple_of(LINE).min(left);
            self.current += usize::from(later.is_empty());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_run_is_asked_for_by_the_last_share_and_a_share_at_a_time() {
        let memory = vec![0.0; 1000];
        for (lengths, shares) in [([1000, 0], 7), ([5, 640], 18), ([16, 17], 1)] {
            let mut ahead = Prefetcher::new(lengths.map(|len| &memory[..len]), shares);
            let left = |ahead: &Prefetcher<'_, 2>| ahead.runs.iter().map(|run| run.len()).sum::<usize>();
            for _ in 0..shares {
                let before = left(&ahead);
                ahead.fetch();
                assert!(before - left(&ahead) <= ahead.share, "{lengths:?} in {shares}");
            }
            assert_eq!(left(&ahead), 0, "{lengths:?} in {shares}");
            ahead.fetch();
        }
    }
}
