//! Working memory: 64-byte aligned floats, kept by each thread from one task to the next.

use std::cell::Cell;
use std::mem::MaybeUninit;

use rayon::prelude::*;

/// Floats per cache line: what a 512-bit vector moves at once.
pub(crate) const LINE: usize = 16;

/// A growable buffer of floats that begins on a cache line.
#[derive(Default)]
pub(crate) struct AlignedBuffer {
    floats: Vec<f32>,
    /// Where the first whole cache line begins.
    start: usize,
    len: usize,
}

impl AlignedBuffer {
    /// Allocates `len` zeros; large buffers on huge pages, where the system grants them.
    ///
    /// Zeros come from the system, page by page when they are first used: by the threads that use them.
    pub(crate) fn zeros(len: usize) -> Self {
        let mut floats = vec![0.0; len + LINE];
        huge_pages::advise(&mut floats);
        let start = floats.as_ptr().align_offset(LINE * size_of::<f32>()).min(LINE);
        Self { floats, start, len }
    }

    /// Makes the buffer `len` long; it holds anything.
    pub(crate) fn grow(&mut self, len: usize) {
        if self.floats.len() < len + LINE {
            // The old memory goes back before new is asked for.
            *self = Self::default();
            *self = Self::zeros(len);
        }
        self.len = len;
    }

    /// The floats.
    pub(crate) fn as_slice(&self) -> &[f32] {
        &self.floats[self.start..self.start + self.len]
    }

    /// The floats, writable.
    pub(crate) fn as_mut_slice(&mut self) -> &mut [f32] {
        &mut self.floats[self.start..self.start + self.len]
    }
}

/// Asks the system for huge pages: a row of tiles reads dozens of streams, each on a page of its own, more
/// than the first level of address translation holds of the small ones.
mod huge_pages {
    /// The size that Linux gives on x86-64 and on most others; smaller buffers gain nothing.
    #[cfg(target_os = "linux")]
    const HUGE_PAGE: usize = 2 << 20;

    /// Advises memory that nothing has touched yet; a refusal changes speed only.
    #[cfg(target_os = "linux")]
    pub(super) fn advise(memory: &mut [f32]) {
        let (start, bytes) = (memory.as_mut_ptr().addr(), size_of_val(memory));
        let first = start.next_multiple_of(HUGE_PAGE);
        let whole = (start + bytes).saturating_sub(first) / HUGE_PAGE * HUGE_PAGE;
        if whole == 0 {
            return;
        }
        let pointer = memory.as_mut_ptr().cast::<u8>().wrapping_add(first - start);
        // SAFETY: the range lies within the slice, which is borrowed exclusively, begins on a page, and the
        // advice changes how it is backed, not what it holds.
        unsafe { libc::madvise(pointer.cast(), whole, libc::MADV_HUGEPAGE) };
    }

    #[cfg(not(target_os = "linux"))]
    pub(super) fn advise(_memory: &mut [f32]) {}
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
        Scratch::of(&mut self.0)
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
    /// Makes a buffer's floats available.
    pub(crate) fn of(buffer: &'a mut AlignedBuffer) -> Self {
        Self(buffer.as_mut_slice())
    }

    /// Cuts off the next `len` floats, a multiple of 16 to keep what follows aligned.
    pub(crate) fn take(&mut self, len: usize) -> &'a mut [f32] {
        debug_assert_eq!(len % 16, 0, "parts of the working memory are whole cache lines");
        let (part, rest) = std::mem::take(&mut self.0).split_at_mut(len);
        self.0 = rest;
        part
    }
}

/// Zeros for an operation's result, written by all threads: half of the serial time of a training step would
/// go to this otherwise.
pub(crate) fn zeros(len: usize) -> Vec<f32> {
    const SHARE: usize = 1 << 16;
    (0..len).into_par_iter().with_min_len(SHARE).map(|_| 0.0).collect()
}

/// Floats of a result that a task is about to write.
pub(crate) enum Target<'a> {
    /// They hold something.
    Written(&'a mut [f32]),
    /// Nothing has touched them yet.
    Fresh(&'a mut [MaybeUninit<f32>]),
}

impl<'a> Target<'a> {
    /// The floats, zeros if nothing has touched them: by the task that writes them, so that they are in its cache.
    pub(crate) fn ready(self) -> &'a mut [f32] {
        match self {
            Self::Written(floats) => floats,
            Self::Fresh(floats) => {
                floats.fill(MaybeUninit::new(0.0));
                // SAFETY: every float was given a value on the line above.
                unsafe { floats.assume_init_mut() }
            }
        }
    }
}

/// A vector of `len` floats that `write` makes: it must hand every one of them to a [`Target`] and get it ready.
///
/// # Safety
/// `write` gets every float that it is lent ready before it returns.
pub(crate) unsafe fn written(len: usize, write: impl FnOnce(&mut [MaybeUninit<f32>])) -> Vec<f32> {
    let mut floats = Vec::with_capacity(len);
    write(&mut floats.spare_capacity_mut()[..len]);
    // SAFETY: there is room for `len` floats, and the caller promises that they hold values.
    unsafe { floats.set_len(len) };
    floats
}

/// A vector of `len` floats, written chunk by chunk in parallel: `write` is given a chunk's number and its zeros.
pub(crate) fn by_chunks<T: Send>(
    len: usize,
    chunk: usize,
    write: impl Fn(usize, &mut [f32]) -> T + Sync,
) -> (Vec<f32>, Vec<T>) {
    let mut results = Vec::new();
    let fill = |floats: &mut [MaybeUninit<f32>]| {
        let chunks = floats.par_chunks_mut(chunk).enumerate();
        chunks.map(|(i, floats)| write(i, Target::Fresh(floats).ready())).collect_into_vec(&mut results);
    };
    // SAFETY: the chunks are all floats, and each is made ready.
    let floats = unsafe { written(len, fill) };
    (floats, results)
}

/// Rounds a length up to whole cache lines.
pub(crate) fn whole_lines(len: usize) -> usize {
    len.next_multiple_of(16)
}
