//! Memory in which several threads read and write at once, each where a plan says.
//!
//! Builds with debug assertions watch over the plan: tasks say when they begin ([`Slots::turn`]), and those that could
//! meet at the same floats, one writing, end in a panic. Other builds do nothing of this.

#[cfg(debug_assertions)]
mod watch;

use std::marker::PhantomData;
use std::ops::Range;

/// Stretches of one buffer, known by their numbers.
///
/// That what one thread writes is touched by no other is what [`Slots::read`] and [`Slots::write`] demand of their
/// callers.
pub(crate) struct Slots<'a> {
    base: *mut f32,
    /// Where each slot lies in the buffer.
    places: Vec<Range<usize>>,
    buffer: PhantomData<&'a mut [f32]>,
    #[cfg(debug_assertions)]
    watch: watch::Watch,
}

/// A task of those that use the slots at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Turn {
    /// Its number.
    pub(crate) task: usize,
    /// It begins when all tasks with a smaller number than this are finished.
    pub(crate) needs: usize,
    /// What it does, for messages: the step of the network,
    pub(crate) step: usize,
    /// its first row,
    pub(crate) first: usize,
    /// and one past its last.
    pub(crate) end: usize,
}

/// Lasts while the thread that made it computes a task.
pub(crate) struct InTurn {
    #[cfg(debug_assertions)]
    _guard: watch::Guard,
}

// SAFETY: the buffer is borrowed exclusively for as long as this lives, and floats may be used by any thread; that they
// are not used by two at once, one writing, is what the callers of `read` and `write` promise.
unsafe impl Sync for Slots<'_> {}

impl<'a> Slots<'a> {
    /// Cuts a buffer into slots of the lengths given, each of them `space(length)` floats from the next.
    ///
    /// # Panics
    /// When the buffer is too short.
    pub(crate) fn new(buffer: &'a mut [f32], lengths: &[usize], space: impl Fn(usize) -> usize) -> Self {
        let mut end = 0;
        let mut next = |&len: &usize| {
            let start = end;
            end += space(len).max(len);
            start..start + len
        };
        let places = lengths.iter().map(&mut next).collect();
        assert!(end <= buffer.len(), "slots of {end} floats in a buffer of {}", buffer.len());
        Self {
            base: buffer.as_mut_ptr(),
            places,
            buffer: PhantomData,
            #[cfg(debug_assertions)]
            watch: watch::Watch::new(lengths.len()),
        }
    }

    /// Says which task the thread computes while what is returned lives.
    pub(crate) fn turn(&self, turn: Turn) -> InTurn {
        #[cfg(not(debug_assertions))]
        let _ = turn;
        InTurn {
            #[cfg(debug_assertions)]
            _guard: watch::Guard::new(turn),
        }
    }

    /// Says that all tasks are finished: what comes now may use what they used.
    pub(crate) fn all_finished(&mut self) {
        #[cfg(debug_assertions)]
        self.watch.forget();
    }

    /// Some floats of a slot.
    ///
    /// # Safety
    /// While the slice lives nobody writes them.
    ///
    /// # Panics
    /// When the slot does not have them; in builds with debug assertions also when a task that this one is not kept apart
    /// from writes them.
    #[inline]
    pub(crate) unsafe fn read(&self, slot: usize, floats: Range<usize>) -> &[f32] {
        let (start, len) = self.stretch(slot, &floats);
        #[cfg(debug_assertions)]
        self.watch.note(slot, &floats, false);
        // SAFETY: the stretch lies within the buffer, which is borrowed for longer than `self` and holds floats; the
        // caller promises that nobody writes it.
        unsafe { std::slice::from_raw_parts(self.base.add(start), len) }
    }

    /// Some floats of a slot, to be written.
    ///
    /// # Safety
    /// While the slice lives nobody else reads or writes them.
    ///
    /// # Panics
    /// When the slot does not have them; in builds with debug assertions also when a task that this one is not kept apart
    /// from uses them.
    #[inline]
    #[expect(clippy::mut_from_ref, reason = "that the slices do not overlap is the caller's promise")]
    pub(crate) unsafe fn write(&self, slot: usize, floats: Range<usize>) -> &mut [f32] {
        let (start, len) = self.stretch(slot, &floats);
        #[cfg(debug_assertions)]
        self.watch.note(slot, &floats, true);
        // SAFETY: the stretch lies within the buffer, which is borrowed exclusively and for longer than `self`; the
        // caller promises that nobody else uses it.
        unsafe { std::slice::from_raw_parts_mut(self.base.add(start), len) }
    }

    /// Where some floats of a slot lie in the buffer, and how many there are.
    #[inline]
    fn stretch(&self, slot: usize, floats: &Range<usize>) -> (usize, usize) {
        let place = &self.places[slot];
        assert!(
            floats.start <= floats.end && floats.end <= place.len(),
            "floats {floats:?} of a slot of {}",
            place.len()
        );
        (place.start + floats.start, floats.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_do_not_overlap() {
        let mut buffer = vec![0.0; 30];
        let slots = Slots::new(&mut buffer, &[4, 10, 3], |len| len + 2);
        for (slot, len, value) in [(0, 4, 1.0), (1, 10, 2.0), (2, 3, 3.0)] {
            // SAFETY: nobody else uses the slot.
            unsafe { slots.write(slot, 0..len).fill(value) };
        }
        for (slot, len, value) in [(0, 4, 1.0), (1, 10, 2.0), (2, 3, 3.0)] {
            // SAFETY: nobody writes any more.
            assert!(unsafe { slots.read(slot, 0..len) }.iter().all(|found| *found == value));
        }
        let sum: f32 = buffer.iter().sum();
        assert!((sum - 33.0).abs() < 1e-6, "{sum}");
    }

    #[test]
    #[should_panic(expected = "floats 2..5 of a slot of 4")]
    fn what_a_slot_does_not_have_is_refused() {
        let mut buffer = vec![0.0; 20];
        let slots = Slots::new(&mut buffer, &[4, 10], |len| len);
        // SAFETY: nobody else uses the slot.
        unsafe { slots.write(0, 2..5) };
    }
}
