//! Memory asked for before it is used, a few cache lines at a time, while the CPU multiplies.
//!
//! A layer's rows are too long for the second-level cache, so that what reads and writes them waits for memory, where
//! more than a few lines cannot be under way at once. Products keep to the first two levels meanwhile. Asking for the
//! rows between one register tile and the next fills that time, the more so the slower memory is.

use super::scratch::LINE;
use super::simd::prefetch;

/// Runs of floats of which equal shares are asked for in turn.
pub(crate) struct Ahead<'a, const RUNS: usize> {
    /// What has not been asked for.
    runs: [&'a [f32]; RUNS],
    /// Floats per share of each.
    shares: [usize; RUNS],
}

impl<'a, const RUNS: usize> Ahead<'a, RUNS> {
    /// Divides the runs into as many shares.
    #[inline(always)]
    pub(crate) fn new(runs: [&'a [f32]; RUNS], shares: usize) -> Self {
        let mut lengths = [0; RUNS];
        for (length, run) in lengths.iter_mut().zip(&runs) {
            *length = run.len().div_ceil(shares).next_multiple_of(LINE);
        }
        Self { runs, shares: lengths }
    }

    /// Asks for the next share of each run; there may be none left.
    #[inline(always)]
    pub(crate) fn fetch(&mut self) {
        for (run, share) in self.runs.iter_mut().zip(self.shares) {
            let (now, later) = run.split_at(share.min(run.len()));
            for at in (0..now.len()).step_by(LINE) {
                prefetch(now, at);
            }
            *run = later;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_of_every_run_is_asked_for_by_the_last_share() {
        let memory = vec![0.0; 1000];
        for (lengths, shares) in [([1000, 0], 7), ([5, 640], 18), ([16, 17], 1)] {
            let mut ahead = Ahead::new(lengths.map(|len| &memory[..len]), shares);
            for share in 0..shares {
                assert!(share == 0 || ahead.runs.iter().any(|run| run.len() < memory.len()));
                ahead.fetch();
            }
            assert_eq!(ahead.runs, [&[0.0f32; 0][..]; 2], "{lengths:?} in {shares}");
            ahead.fetch();
        }
    }
}
