//! Blocks of megabytes, from the system and back, by way of pages that are idle.

use std::alloc::Layout;
use std::ptr;
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::idle::{Idle, Range};

/// Bytes from which on a block is in large pages: two of those at least.
pub(super) const LARGE_BYTES: usize = 4 << 20;

/// Bytes of a large page, which a block's address is a multiple of.
const PAGE: usize = 2 << 20;

static IDLE: Mutex<Idle> = Mutex::new(Idle::new());

/// Whether a block is one of these.
pub(super) fn is_large(layout: Layout) -> bool {
    layout.size() >= LARGE_BYTES && layout.align() <= PAGE
}

/// The bytes of the address space that a block of so many takes.
fn whole(size: usize) -> usize {
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
            (block, fill(&mut idle, block, [0, whole]))
        }
    };
    drop(idle);
    if filled < whole {
        tidy();
    }
    advise(block, size);
    if is_zeroed {
        // SAFETY: the block has these bytes, and nobody uses it.
        unsafe { block.write_bytes(0, filled.min(size)) };
    }
    block
}

/// Makes a block that [`block`] made of some bytes one of others, which begins with the same; gives null, and leaves it, if the system
/// has none.
pub(super) fn resize(block: *mut u8, size: usize, wanted: usize) -> *mut u8 {
    let range = Range { start: block.expose_provenance(), bytes: whole(size) };
    let wanted_whole = whole(wanted);
    if wanted_whole <= range.bytes {
        let rest = Range { start: range.start + wanted_whole, bytes: range.bytes - wanted_whole };
        give(rest);
        return block;
    }
    let larger = map(wanted_whole);
    if !larger.is_null() {
        move_pages(range, larger);
        fill(&mut lock(), larger, [range.bytes, wanted_whole]);
        advise(larger, wanted);
    }
    larger
}

/// Takes back a block that [`block`] or [`resize`] made of so many bytes.
pub(super) fn free(block: *mut u8, size: usize) {
    give(Range { start: block.expose_provenance(), bytes: whole(size) });
}

fn lock() -> MutexGuard<'static, Idle> {
    IDLE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps a range of a block for others, or gives it back to the system where there are too many.
fn give(range: Range) {
    let surplus = lock().give(range);
    if let Some(range) = surplus {
        unmap(range);
    }
}

/// Moves idle pages to a fresh block between two offsets. Gives the offset up to which there were some.
fn fill(idle: &mut Idle, block: *mut u8, [mut from, to]: [usize; 2]) -> usize {
    while from < to
        && let Some(part) = idle.take_part(to - from)
    {
        // SAFETY: the block has bytes up to the second offset, and the part no more than are left of them.
        move_pages(part, unsafe { block.add(from) });
        from += part.bytes;
    }
    from
}

/// Fresh pages, of which none is in memory before it is used; null if the system has none.
fn map(bytes: usize) -> *mut u8 {
    let Some(with_margin) = bytes.checked_add(PAGE) else { return ptr::null_mut() };
    let (protection, flags) = (libc::PROT_READ | libc::PROT_WRITE, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS);
    // SAFETY: a new mapping at an address that the system chooses touches nothing that exists.
    let mapped = unsafe { libc::mmap(ptr::null_mut(), with_margin, protection, flags, -1, 0) };
    if mapped == libc::MAP_FAILED {
        return ptr::null_mut();
    }
    let start = mapped.expose_provenance();
    let before = start.next_multiple_of(PAGE) - start;
    unmap(Range { start, bytes: before });
    unmap(Range { start: start + before + bytes, bytes: PAGE - before });
    ptr::with_exposed_provenance_mut(start + before)
}

/// Moves the pages of a range to a place of as many bytes, which was mapped and not yet used.
///
/// A page at a time: what was mapped in parts the system does not move at once, and refuses after it has unmapped the place.
fn move_pages(range: Range, place: *mut u8) {
    let flags = libc::MREMAP_MAYMOVE | libc::MREMAP_FIXED;
    for offset in (0..range.bytes).step_by(PAGE) {
        let page = Range { start: range.start + offset, bytes: PAGE };
        let from: *mut u8 = ptr::with_exposed_provenance_mut(page.start);
        // SAFETY: the place has the range's bytes.
        let place = unsafe { place.add(offset) };
        // SAFETY: nobody else uses the page, and what it replaces was never used.
        let moved = unsafe { libc::mremap(from.cast(), PAGE, PAGE, flags, place) };
        if moved == libc::MAP_FAILED {
            // SAFETY: both have a page; the place is as it was where the system may not remember more mappings.
            unsafe { place.copy_from_nonoverlapping(from, PAGE) };
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

/// Makes room for fresh pages: what was freed of small blocks goes back to the system, some ten megabytes beside a gigabyte of large ones.
fn tidy() {
    #[cfg(target_env = "gnu")]
    // SAFETY: the call may be made at any time.
    unsafe {
        libc::malloc_trim(0)
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that tell pages apart, and whether a block holds them.
    fn mark(block: *mut u8, size: usize, salt: u8) {
        for page in 0..size / PAGE {
            // SAFETY: the block has these bytes.
            unsafe { block.add(page * PAGE + page).write(u8::try_from(page).unwrap() ^ salt) };
        }
    }

    fn is_marked(block: *mut u8, size: usize, salt: u8) -> bool {
        // SAFETY: the block has these bytes.
        (0..size / PAGE)
            .all(|page| unsafe { block.add(page * PAGE + page).read() } == u8::try_from(page).unwrap() ^ salt)
    }

    /// Blocks that others were freed before and between, of sizes that fit none of them, hold what was written, or zeros if asked for.
    #[test]
    fn pages_serve_blocks_of_any_size() {
        let sizes = [3, 7, 4, 9, 2].map(|pages: usize| pages * PAGE - 123);
        let blocks = sizes.map(|size| block(size, true));
        for (salt, (block, size)) in (1..).zip(blocks.into_iter().zip(sizes)) {
            mark(block, size, salt);
        }
        free(blocks[1], sizes[1]);
        free(blocks[3], sizes[3]);
        let large = 14 * PAGE + 5;
        let zeroed = block(large, true);
        // SAFETY: the block has these bytes.
        assert!(unsafe { std::slice::from_raw_parts(zeroed, large) }.iter().all(|byte| *byte == 0));
        mark(zeroed, large, 99);
        for at in [0, 2, 4] {
            assert!(is_marked(blocks[at], sizes[at], u8::try_from(at + 1).unwrap()), "{at}");
            free(blocks[at], sizes[at]);
        }
        assert!(is_marked(zeroed, large, 99));
        free(zeroed, large);
    }

    #[test]
    fn resized_blocks_begin_as_they_did() {
        let (small, middle, large) = (3 * PAGE, 5 * PAGE + 1, 11 * PAGE);
        let first = block(small, false);
        mark(first, small, 7);
        let second = resize(first, small, middle);
        assert!(is_marked(second, small, 7));
        mark(second, middle, 8);
        let third = resize(second, middle, large);
        assert!(is_marked(third, middle, 8));
        assert_eq!(third.addr() % PAGE, 0);
        let fourth = resize(third, large, small);
        assert_eq!(fourth, third);
        assert!(is_marked(fourth, small, 8));
        free(fourth, small);
    }

    /// An address space has no room for these.
    #[test]
    fn what_the_system_has_not_is_null() {
        assert!(block(1 << 62, false).is_null());
        let small = block(LARGE_BYTES, false);
        mark(small, LARGE_BYTES, 3);
        assert!(resize(small, LARGE_BYTES, 1 << 62).is_null());
        assert!(is_marked(small, LARGE_BYTES, 3));
        free(small, LARGE_BYTES);
    }
}
