//! The memory of a process: large blocks, and settings of the system's allocator. Programs choose these, the library never does.

#[cfg(target_os = "linux")]
mod idle;

use std::alloc::{GlobalAlloc, Layout, System};

/// Bytes from which on a block is in large pages, by itself: two of those at least.
const LARGE_BYTES: usize = 4 << 20;

/// The system's allocator, but for blocks of megabytes, which lie in large pages and are used again: a program names it as
/// its `#[global_allocator]`.
///
/// Planes and spectra of large captures are read across their rows, a page for every few numbers, and are freed and asked
/// for again all the time: the system clears each page anew at two gigabytes a second. What is kept for the next request never makes
/// large blocks more than they were at most. Where the system is not Linux, all blocks are the system's.
#[derive(Clone, Copy, Debug, Default)]
pub struct LargePages;

// SAFETY: blocks of a size are the system allocator's below a limit and `large`'s above it, which both keep the promise; all
// that decides is the layout, which is the same for a block's birth and end.
#[cfg(target_os = "linux")]
unsafe impl GlobalAlloc for LargePages {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        match large::is_large(layout) {
            true => large::block(layout.size(), false),
            // SAFETY: what the caller promises.
            false => unsafe { System.alloc(layout) },
        }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        match large::is_large(layout) {
            true => large::block(layout.size(), true),
            // SAFETY: what the caller promises.
            false => unsafe { System.alloc_zeroed(layout) },
        }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        match large::is_large(layout) {
            true => large::free(block, layout.size()),
            // SAFETY: what the caller promises: such a block is of the system's allocator.
            false => unsafe { System.dealloc(block, layout) },
        }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller promises that the size is one that a layout can have.
        let wanted = unsafe { Layout::from_size_align_unchecked(size, layout.align()) };
        match (large::is_large(layout), large::is_large(wanted)) {
            // SAFETY: what the caller promises: such a block is of the system's allocator.
            (false, false) => unsafe { System.realloc(block, layout, size) },
            (true, true) => large::resize(block, layout.size(), size),
            // SAFETY: both blocks have the bytes that are copied; the old one is the caller's to give.
            _ => unsafe {
                let new = self.alloc(wanted);
                if !new.is_null() {
                    new.copy_from_nonoverlapping(block, size.min(layout.size()));
                    self.dealloc(block, layout);
                }
                new
            },
        }
    }
}

// SAFETY: every call is the system's allocator's.
#[cfg(not(target_os = "linux"))]
unsafe impl GlobalAlloc for LargePages {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: what the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: what the caller promises.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: what the caller promises.
        unsafe { System.dealloc(block, layout) };
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: what the caller promises.
        unsafe { System.realloc(block, layout, size) }
    }
}

/// Blocks of megabytes, from the system and back, by way of those that are idle.
#[cfg(target_os = "linux")]
mod large {
    use std::alloc::Layout;
    use std::ptr;
    use std::sync::{Mutex, MutexGuard, PoisonError};

    use super::LARGE_BYTES;
    use super::idle::{Idle, Range};

    /// Bytes of a large page, which a block's address is a multiple of.
    const PAGE: usize = 2 << 20;

    static IDLE: Mutex<Idle> = Mutex::new(Idle::new());

    pub(super) fn is_large(layout: Layout) -> bool {
        layout.size() >= LARGE_BYTES && layout.align() <= PAGE
    }

    /// The bytes of the address space that a block of so many takes.
    pub(super) fn whole(size: usize) -> usize {
        size.next_multiple_of(PAGE)
    }

    /// A block of so many bytes, zero if asked for, or null if the system has none.
    pub(super) fn block(size: usize, is_zeroed: bool) -> *mut u8 {
        let whole = whole(size);
        let mut idle = lock();
        let (block, filled) = match idle.take(whole) {
            Some(start) => (ptr::with_exposed_provenance_mut(start), whole),
            None => {
                let block = map(whole);
                if block.is_null() {
                    return block;
                }
                (block, fill(&mut idle, block, 0, whole))
            }
        };
        drop(idle);
        advise(block, size);
        if is_zeroed {
            // SAFETY: the block has these bytes, and nobody uses it.
            unsafe { block.write_bytes(0, filled.min(size)) };
        }
        block
    }

    /// Makes a block that [`block`] made of some bytes one of others, which begins with the same, or gives null if the system has none.
    pub(super) fn resize(block: *mut u8, size: usize, wanted: usize) -> *mut u8 {
        let (range, wanted_whole) = (Range { start: block.expose_provenance(), bytes: whole(size) }, whole(wanted));
        if wanted_whole <= range.bytes {
            if wanted_whole < range.bytes {
                let rest = Range { start: range.start + wanted_whole, bytes: range.bytes - wanted_whole };
                give(&mut lock(), rest);
            }
            return block;
        }
        let larger = map(wanted_whole);
        if !larger.is_null() {
            move_pages(range, larger);
            fill(&mut lock(), larger, range.bytes, wanted_whole);
            advise(larger, wanted);
        }
        larger
    }

    fn lock() -> MutexGuard<'static, Idle> {
        IDLE.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Moves idle pages to a fresh block from one offset on, at most up to another. Gives the offset up to which there were some.
    fn fill(idle: &mut Idle, block: *mut u8, mut from: usize, to: usize) -> usize {
        while from < to
            && let Some(part) = idle.take_part(to - from)
        {
            // SAFETY: the block has bytes up to the second offset, and the part no more than are left of them.
            move_pages(part, unsafe { block.add(from) });
            from += part.bytes;
        }
        from
    }

    fn give(idle: &mut Idle, range: Range) {
        if let Some(range) = idle.give(range) {
            unmap(range);
        }
    }

    /// Takes back a block that [`block`] made of so many bytes.
    pub(super) fn free(block: *mut u8, size: usize) {
        let range = Range { start: block.expose_provenance(), bytes: whole(size) };
        give(&mut lock(), range);
    }

    /// Fresh pages, of which none is in memory before it is used.
    fn map(bytes: usize) -> *mut u8 {
        let Some(with_margin) = bytes.checked_add(PAGE) else { return ptr::null_mut() };
        let (protection, flags) = (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS);
        // SAFETY: a new mapping at an address that the system chooses touches nothing that exists.
        let mapped = unsafe { libc::mmap(ptr::null_mut(), with_margin, protection, flags, -1, 0) };
        if mapped == libc::MAP_FAILED {
            return ptr::null_mut();
        }
        let mapped: *mut u8 = mapped.cast();
        let before = mapped.align_offset(PAGE);
        // SAFETY: the margin of a page has the bytes before the first multiple of one.
        let block = unsafe { mapped.add(before) };
        let start = mapped.expose_provenance();
        unmap(Range { start, bytes: before });
        unmap(Range { start: start + before + bytes, bytes: PAGE - before });
        block
    }

    /// Moves the pages of a range to a place of as many bytes, which was mapped and not yet used.
    ///
    /// A page at a time: the system refuses to move at once what it has mapped in parts, after it has cleared the place for it.
    fn move_pages(range: Range, place: *mut u8) {
        let flags = libc::MREMAP_MAYMOVE | libc::MREMAP_FIXED;
        for offset in (0..range.bytes).step_by(PAGE) {
            let page = Range { start: range.start + offset, bytes: PAGE };
            let from: *mut u8 = ptr::with_exposed_provenance_mut(page.start);
            // SAFETY: the page is this module's to move, and what it replaces was never used.
            let moved = unsafe {
                let place = place.add(offset);
                libc::mremap(from.cast(), PAGE, PAGE, flags, place) != libc::MAP_FAILED
            };
            if !moved {
                // SAFETY: the place is left as it was where the system may not remember more parts; both have a page.
                unsafe { place.add(offset).copy_from_nonoverlapping(from, PAGE) };
                unmap(page);
            }
        }
    }

    /// Gives pages back to the system.
    fn unmap(range: Range) {
        if range.bytes > 0 {
            // SAFETY: the range is of a mapping of this module's, and nobody uses it. A refusal leaves it mapped, unused.
            unsafe { libc::munmap(ptr::with_exposed_provenance_mut(range.start), range.bytes) };
        }
    }

    /// Asks for large pages where a block fills them.
    fn advise(block: *mut u8, size: usize) {
        // SAFETY: the pages lie within the block. A refusal is as good as none.
        unsafe { libc::madvise(block.cast(), size / PAGE * PAGE, libc::MADV_HUGEPAGE) };
    }
}

/// Asks the allocator for one heap for all threads, where what one has freed another can use. To be called before there
/// are other threads, who otherwise begin a heap each.
///
/// With a heap of each thread a restoration takes some megabytes more; and the largest blocks fit none but the first
/// thread's: in training on large batches most of the time goes to getting them from the system and giving them back.
pub fn share_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: the call changes the allocator's parameters only, under the allocator's own lock.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, 1)
    };
}

/// Asks the allocator for blocks of megabytes from the system, each by itself, whatever was freed before: they go back whole.
///
/// Otherwise it takes blocks of up to 32 MiB out of its heap once such were freed, which then keeps what lies between those in use:
/// up to 100 MB of the gigabyte that 8 megapixels take.
pub fn return_large_blocks() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // The second is what the allocator chooses by itself beside the first, and no longer does once that is told.
    for (parameter, bytes) in [(libc::M_MMAP_THRESHOLD, 8 << 20), (libc::M_TRIM_THRESHOLD, 16 << 20)] {
        // SAFETY: the call changes the allocator's parameters only, under the allocator's own lock.
        unsafe { libc::mallopt(parameter, bytes) };
    }
}

/// Asks the allocator to keep what is freed for the next request, for loops that take and free the same large
/// buffers again and again: a training step. Without it each buffer's pages come fresh from the system; so do those of
/// the largest unless [`share_freed_memory`] was called.
pub fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // No blocks beside the heap, which go back to the system when they are freed, and a heap that never gets smaller.
    for (parameter, value) in [(libc::M_MMAP_MAX, 0), (libc::M_TRIM_THRESHOLD, -1)] {
        // SAFETY: the call changes the allocator's parameters only, under the allocator's own lock.
        unsafe { libc::mallopt(parameter, value) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks below and above the limit, zeroed, filled and made larger, hold what they should.
    #[test]
    fn large_blocks_are_blocks() {
        for size in [100, LARGE_BYTES - 1, LARGE_BYTES, LARGE_BYTES + 12_345] {
            let layout = Layout::from_size_align(size, 8).unwrap();
            let larger = size + LARGE_BYTES;
            // SAFETY: the layout has a size, and blocks are used within it and freed with the layout they have.
            unsafe {
                let block = LargePages.alloc_zeroed(layout);
                assert!(!block.is_null());
                let bytes = std::slice::from_raw_parts_mut(block, size);
                assert!(bytes.iter().all(|byte| *byte == 0));
                bytes.fill(7);
                let block = LargePages.realloc(block, layout, larger);
                assert!(!block.is_null());
                assert!(std::slice::from_raw_parts(block, size).iter().all(|byte| *byte == 7));
                LargePages.dealloc(block, Layout::from_size_align(larger, 8).unwrap());
                let block = LargePages.alloc(layout);
                assert!(!block.is_null());
                LargePages.dealloc(block, layout);
            }
        }
    }
}
