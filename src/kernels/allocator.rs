//! The memory of a process: blocks of megabytes, and settings of the system's allocator. Programs choose these, the library never does.

#[cfg(target_os = "linux")]
mod idle;
#[cfg(target_os = "linux")]
mod large;

#[cfg(target_os = "linux")]
use std::alloc::{GlobalAlloc, Layout, System};

/// The system's allocator, but for blocks of megabytes, which lie in large pages that are used again: a program names it as
/// its `#[global_allocator]`.
///
/// Planes and spectra of large captures are read across their rows, a page for every few numbers, and are freed and asked
/// for all the time, where the system clears every page anew, at two gigabytes a second: 8 megapixels with lamps are restored in
/// 0.85 to 0.95 of the time. Pages that were freed serve the next block wherever they are, so that large blocks never take more than
/// they did at most.
#[cfg(target_os = "linux")]
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

/// Asks the allocator for one heap for all threads, where what one has freed another can use. To be called before there
/// are other threads, who otherwise begin a heap each.
///
/// With a heap of each thread a restoration takes some megabytes more; and where a program does without [`LargePages`], the largest
/// blocks fit none but the first thread's: in training on large batches most of the time goes to getting them from the system.
pub fn share_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: the call changes the allocator's parameters only, under the allocator's own lock.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, 1)
    };
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

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::large::LARGE_BYTES;
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
