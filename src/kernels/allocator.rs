//! Settings of the system's allocator, which belong to the process: a program calls these, the library never does.

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
