//! Memory in which several threads read and write at once, each where a plan says.

use std::marker::PhantomData;
use std::ops::Range;

/// Stretches of one buffer, known by their numbers.
///
/// Nobody checks here that what one thread writes is touched by no other: that is what [`Slots::read`] and
/// [`Slots::write`] demand of their callers.
pub(crate) struct Slots<'a> {
    base: *mut f32,
    /// Where each slot lies in the buffer.
    places: Vec<Range<usize>>,
    buffer: PhantomData<&'a mut [f32]>,
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
        Self { base: buffer.as_mut_ptr(), places, buffer: PhantomData }
    }

    /// Some floats of a slot.
    ///
    /// # Safety
    /// While the slice lives nobody writes them.
    ///
    /// # Panics
    /// When the slot does not have them.
    #[inline]
    pub(crate) unsafe fn read(&self, slot: usize, floats: Range<usize>) -> &[f32] {
        let (start, len) = self.stretch(slot, &floats);
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
    /// When the slot does not have them.
    #[inline]
    #[expect(clippy::mut_from_ref, reason = "that the slices do not overlap is the caller's promise")]
    pub(crate) unsafe fn write(&self, slot: usize, floats: Range<usize>) -> &mut [f32] {
        let (start, len) = self.stretch(slot, &floats);
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
