//! Settings of the system's allocator, which belong to the process: a program calls these, the library never does.

use std::alloc::{GlobalAlloc, Layout, System};

/// Bytes from which on a block is asked to lie in large pages: two of those at least.
const LARGE_BYTES: usize = 4 << 20;

/// Bytes of a large page.
#[cfg(target_os = "linux")]
const LARGE_PAGE: usize = 2 << 20;

/// The system's allocator, which asks for large pages where a block has megabytes: a program names it as its
/// `#[global_allocator]`.
///
/// Planes and spectra of large captures are read across their rows, a page for every few numbers; 8 megapixels are
/// restored in a tenth less of the time. Where the system knows no such pages nothing changes.
#[derive(Clone, Copy, Debug, Default)]
pub struct LargePages;

// SAFETY: every call is the system's allocator's; advice about pages changes nothing that a program could see.
unsafe impl GlobalAlloc for LargePages {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: what the caller promises.
        in_large_pages(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: what the caller promises.
        in_large_pages(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: what the caller promises: the block is of the system's allocator.
        unsafe { System.dealloc(block, layout) };
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: what the caller promises: the block is of the system's allocator.
        in_large_pages(unsafe { System.realloc(block, layout, size) }, size)
    }
}

/// Asks for large pages within a block of so many bytes, if it is there and large.
#[inline]
fn in_large_pages(block: *mut u8, size: usize) -> *mut u8 {
    if size >= LARGE_BYTES && !block.is_null() {
        advise(block, size);
    }
    block
}

#[cfg(target_os = "linux")]
#[cold]
fn advise(block: *mut u8, size: usize) {
    let before = block.align_offset(LARGE_PAGE);
    let whole = size.saturating_sub(before) / LARGE_PAGE * LARGE_PAGE;
    if whole > 0 {
        // SAFETY: the pages lie within the block, which the caller has just been given. A refusal is as good as none.
        unsafe { libc::madvise(block.add(before).cast(), whole, libc::MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn advise(_: *mut u8, _: usize) {}

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
