//! Working memory: 64-byte aligned floats, kept by each thread from one task to the next.

use std::cell::Cell;

/// Sixteen floats on a cache line of their own: what a 512-bit vector moves at once.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct CacheLine([f32; 16]);

/// A growable buffer of floats that begins on a cache line.
#[derive(Default)]
pub(crate) struct AlignedBuffer {
    lines: Vec<CacheLine>,
    len: usize,
}

impl AlignedBuffer {
    /// Allocates `len` zeros.
    pub(crate) fn zeros(len: usize) -> Self {
        Self { lines: vec![CacheLine([0.0; 16]); len.div_ceil(16)], len }
    }

    /// Makes the buffer at least `len` long; what it holds is left as it is.
    fn grow(&mut self, len: usize) {
        if self.lines.len() * 16 < len {
            *self = Self::zeros(len);
        }
        self.len = len;
    }

    /// The floats.
    pub(crate) fn as_slice(&self) -> &[f32] {
        // SAFETY: a `CacheLine` is sixteen floats without padding (its size equals its alignment), the
        // vector holds at least `len / 16` of them, rounded up, and all of them are initialised.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.len) }
    }

    /// The floats, writable.
    pub(crate) fn as_mut_slice(&mut self) -> &mut [f32] {
        // SAFETY: as for `as_slice`; the exclusive borrow of the vector is passed on.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.len) }
    }
}

thread_local! {
    static KEPT: Cell<AlignedBuffer> = Cell::default();
}

/// The thread's working memory, given back when dropped.
///
/// Lent as a value and not to a closure, because kernels must not use vectors within closures.
pub(crate) struct Lent(AlignedBuffer);

/// Lends `len` floats of the thread's working memory, holding anything; a second loan is fresh memory.
pub(crate) fn lend(len: usize) -> Lent {
    let mut buffer = KEPT.take();
    buffer.grow(len);
    Lent(buffer)
}

impl Lent {
    /// The floats, to be cut into parts.
    pub(crate) fn scratch(&mut self) -> Scratch<'_> {
        Scratch(self.0.as_mut_slice())
    }
}

impl Drop for Lent {
    fn drop(&mut self) {
        KEPT.set(std::mem::take(&mut self.0));
    }
}

/// Working memory from which parts are cut off one by one.
pub(crate) struct Scratch<'a>(&'a mut [f32]);

impl<'a> Scratch<'a> {
    /// Cuts off the next `len` floats, a multiple of 16 to keep what follows aligned.
    pub(crate) fn take(&mut self, len: usize) -> &'a mut [f32] {
        debug_assert_eq!(len % 16, 0, "parts of the working memory are whole cache lines");
        let (part, rest) = std::mem::take(&mut self.0).split_at_mut(len);
        self.0 = rest;
        part
    }
}

/// Rounds a length up to whole cache lines.
pub(crate) fn whole_lines(len: usize) -> usize {
    len.next_multiple_of(16)
}
