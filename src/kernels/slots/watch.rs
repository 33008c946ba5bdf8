//! Who uses which floats of the slots: two tasks that nothing keeps apart must not use the same ones, if one writes.
//!
//! Builds with debug assertions write down every use of a portion's tasks and compare each with all others of its slot.
//! Two tasks are kept apart when one waits for the other, whether or not they met this time: so a schedule that would
//! let them meet is found at its first run, on one thread as on many.

use std::cell::Cell;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use super::Turn;

thread_local! {
    /// The task that this thread computes.
    static CURRENT: Cell<Option<Turn>> = const { Cell::new(None) };
}

/// The uses of every slot since all tasks were finished.
pub(super) struct Watch {
    slots: Vec<Mutex<Vec<Use>>>,
}

#[derive(Clone, PartialEq)]
struct Use {
    turn: Turn,
    floats: Range<usize>,
    writes: bool,
}

impl Watch {
    /// Watches as many slots.
    pub(super) fn new(slots: usize) -> Self {
        Self { slots: (0..slots).map(|_| Mutex::default()).collect() }
    }

    /// Writes down what the thread's task does; what is done outside of tasks, when none is under way, is nobody's.
    ///
    /// # Panics
    /// When another task uses the same floats, one of the two writes, and neither waits for the other.
    pub(super) fn note(&self, slot: usize, floats: &Range<usize>, writes: bool) {
        let Some(turn) = CURRENT.get() else { return };
        let now = Use { turn, floats: floats.clone(), writes };
        let mut uses = self.slots[slot].lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(other) = uses.iter().find(|other| now.collides_with(other)) {
            panic!("slot {slot}: {} while {}, and neither waits for the other", now.tell(), other.tell());
        }
        if writes || !uses.contains(&now) {
            uses.push(now);
        }
    }

    /// Forgets the uses of tasks that are all finished.
    pub(super) fn forget(&mut self) {
        for uses in &mut self.slots {
            uses.get_mut().unwrap_or_else(PoisonError::into_inner).clear();
        }
    }
}

impl Use {
    fn collides_with(&self, other: &Self) -> bool {
        let overlap = self.floats.start < other.floats.end && other.floats.start < self.floats.end;
        overlap && (self.writes || other.writes) && !self.turn.is_apart_from(&other.turn)
    }

    fn tell(&self) -> String {
        let Turn { task, needs, step, first, end } = self.turn;
        let verb = if self.writes { "writes" } else { "reads" };
        format!(
            "step {step}, rows {first}..{end} (task {task}, after those below {needs}) {verb} floats {:?}",
            self.floats
        )
    }
}

impl Turn {
    /// Whether one of two tasks waits for the other. A task waits for all below a number, so that what those waited for
    /// is below it too.
    fn is_apart_from(&self, other: &Self) -> bool {
        self.task < other.needs || other.task < self.needs
    }
}

/// Lasts as long as a thread computes a task.
pub(super) struct Guard;

impl Guard {
    pub(super) fn new(turn: Turn) -> Self {
        CURRENT.set(Some(turn));
        Self
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        CURRENT.set(None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What comes of two uses of one slot, by task 4 and by task 7, which waits for those below `needs`.
    fn after(needs: usize, uses: [(Range<usize>, bool); 2]) -> Result<(), String> {
        let watch = Watch::new(3);
        let turn = |task, needs| Turn { task, needs, step: task / 2, first: 8, end: 12 };
        let [(before, is_written), (now, writes)] = uses;
        let both = || {
            let first = Guard::new(turn(4, 0));
            watch.note(1, &before, is_written);
            drop(first);
            let _second = Guard::new(turn(7, needs));
            watch.note(1, &now, writes);
        };
        let caught = std::panic::catch_unwind(std::panic::AssertUnwindSafe(both));
        caught.map_err(|panic| *panic.downcast::<String>().expect("panics with a message"))
    }

    #[test]
    fn uses_of_the_same_floats_are_told_unless_one_task_waits_for_the_other() {
        for (is_written, writes) in [(true, false), (false, true), (true, true)] {
            let overlapping = || [(0..16, is_written), (15..20, writes)];
            let said = after(4, overlapping()).unwrap_err();
            assert!(said.contains("slot 1") && said.contains("rows 8..12 (task 7"), "{said}");
            assert!(said.contains("task 4") && said.contains("floats 15..20"), "{said}");
            assert_eq!(after(5, overlapping()), Ok(()), "task 7 waits for task 4");
            assert_eq!(after(4, [(0..16, is_written), (16..20, writes)]), Ok(()), "side by side");
        }
        assert_eq!(after(0, [(0..16, false), (0..16, false)]), Ok(()), "two readers");
    }

    #[test]
    fn a_task_must_not_read_what_it_writes_and_finished_ones_are_forgotten() {
        let mut watch = Watch::new(1);
        let turn = Turn { task: 2, needs: 2, step: 0, first: 0, end: 4 };
        let guard = Guard::new(turn);
        watch.note(0, &(0..4), true);
        let twice = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| watch.note(0, &(3..5), false)));
        assert!(twice.is_err());
        drop(guard);
        watch.note(0, &(0..4), true);
        watch.forget();
        let _later = Guard::new(Turn { task: 0, needs: 0, ..turn });
        watch.note(0, &(0..4), true);
    }
}
