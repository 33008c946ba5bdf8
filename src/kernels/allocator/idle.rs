//! Ranges of memory that nobody uses at the moment: which of them serves a request, and which have to go.

/// Ranges that are remembered at most; what is given beyond goes back to the system.
const MOST: usize = 128;

/// A range of addresses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Range {
    pub(super) start: usize,
    pub(super) bytes: usize,
}

impl Range {
    const NONE: Self = Self { start: 0, bytes: 0 };

    fn end(self) -> usize {
        self.start + self.bytes
    }
}

/// Idle ranges, no two of which touch. Nothing here allocates.
#[derive(Debug)]
pub(super) struct Idle {
    ranges: [Range; MOST],
    count: usize,
}

impl Idle {
    pub(super) const fn new() -> Self {
        Self { ranges: [Range::NONE; MOST], count: 0 }
    }

    /// Hands out the address of so many bytes: of the smallest range that has them, whose rest stays idle.
    pub(super) fn take(&mut self, bytes: usize) -> Option<usize> {
        let fitting = (0..self.count).filter(|&at| self.ranges[at].bytes >= bytes);
        let best = fitting.min_by_key(|&at| self.ranges[at].bytes)?;
        let Range { start, .. } = self.ranges[best];
        self.shorten(best, bytes);
        Some(start)
    }

    /// Hands out a part of so many bytes, or less: of the largest range, whose rest stays idle.
    pub(super) fn take_part(&mut self, bytes: usize) -> Option<Range> {
        let largest = (0..self.count).max_by_key(|&at| self.ranges[at].bytes)?;
        let range = self.ranges[largest];
        let bytes = range.bytes.min(bytes);
        self.shorten(largest, bytes);
        Some(Range { start: range.start, bytes })
    }

    /// Takes a range that is no longer in use, and joins it with those that it touches. Hands it on where there are too many to remember.
    pub(super) fn give(&mut self, range: Range) -> Option<Range> {
        if range.bytes == 0 {
            return None;
        }
        let mut joined = range;
        for at in (0..self.count).rev() {
            let other = self.ranges[at];
            if other.end() == joined.start || joined.end() == other.start {
                joined = Range { start: joined.start.min(other.start), bytes: joined.bytes + other.bytes };
                self.forget(at);
            }
        }
        if self.count == MOST {
            return Some(joined);
        }
        self.ranges[self.count] = joined;
        self.count += 1;
        None
    }

    /// Cuts so many bytes from the beginning of a range, which has them.
    fn shorten(&mut self, at: usize, bytes: usize) {
        let Range { start, bytes: whole } = self.ranges[at];
        match whole == bytes {
            true => self.forget(at),
            false => self.ranges[at] = Range { start: start + bytes, bytes: whole - bytes },
        }
    }

    fn forget(&mut self, at: usize) {
        self.count -= 1;
        self.ranges[at] = self.ranges[self.count];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(start: usize, bytes: usize) -> Range {
        Range { start, bytes }
    }

    #[test]
    fn the_smallest_range_that_fits_serves() {
        let mut idle = Idle::new();
        for given in [range(100, 30), range(200, 10), range(300, 20)] {
            assert_eq!(idle.give(given), None);
        }
        assert_eq!(idle.take(15), Some(300));
        assert_eq!(idle.take(5), Some(315));
        assert_eq!(idle.take(31), None);
        assert_eq!(idle.take_part(31), Some(range(100, 30)));
        assert_eq!(idle.take_part(4), Some(range(200, 4)));
        assert_eq!(idle.take_part(40), Some(range(204, 6)));
        assert_eq!(idle.take_part(40), None);
    }

    #[test]
    fn ranges_that_touch_become_one() {
        let mut idle = Idle::new();
        for given in [range(100, 10), range(120, 10), range(110, 10), range(90, 10), range(95, 0)] {
            assert_eq!(idle.give(given), None);
        }
        assert_eq!(idle.take(40), Some(90));
        assert_eq!(idle.take_part(1), None);
    }

    #[test]
    fn what_cannot_be_remembered_is_handed_on() {
        let mut idle = Idle::new();
        for at in 0..MOST {
            assert_eq!(idle.give(range(100 * at, 10)), None);
        }
        assert_eq!(idle.give(range(100 * MOST, 10)), Some(range(100 * MOST, 10)));
        assert_eq!(idle.give(range(10, 10)), None);
        assert_eq!(idle.take(20), Some(0));
    }
}
