//! Keeps images, or what else has been read, as long as there is room.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::core::error::Result;
use crate::core::image::{Domain, Image};

/// What a cache keeps.
pub(super) trait Kept {
    /// Bytes that it takes.
    fn bytes(&self) -> usize;
}

impl<D: Domain> Kept for Image<D> {
    fn bytes(&self) -> usize {
        size_of_val(self.as_slice())
    }
}

/// Images or the like by name, up to a number of bytes; what finds no room is read again every time.
///
/// Nothing is ever dropped for something newer: with samples drawn in random order any choice is as good.
#[derive(Debug)]
pub(super) struct Cache<T> {
    bytes: usize,
    kept: Mutex<Entries<T>>,
}

#[derive(Debug)]
struct Entries<T> {
    values: HashMap<String, Arc<T>>,
    bytes: usize,
}

impl<T: Kept> Cache<T> {
    pub(super) fn new(mebibytes: usize) -> Self {
        Self {
            bytes: mebibytes.saturating_mul(1 << 20),
            kept: Mutex::new(Entries { values: HashMap::new(), bytes: 0 }),
        }
    }

    /// The value of that name, from memory or by `read`.
    pub(super) fn get(&self, name: &str, read: impl FnOnce() -> Result<T>) -> Result<Arc<T>> {
        let lock = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(value) = lock().values.get(name) {
            return Ok(Arc::clone(value));
        }
        // Not under the lock: other threads read other images meanwhile.
        let value = Arc::new(read()?);
        let size = value.bytes();
        let mut kept = lock();
        if kept.bytes + size <= self.bytes && !kept.values.contains_key(name) {
            kept.bytes += size;
            kept.values.insert(name.to_owned(), Arc::clone(&value));
        }
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::LinearImage;
    use ndarray::Array3;
    use std::cell::Cell;

    #[test]
    fn reads_again_only_what_found_no_room() {
        let cache = Cache::new(1);
        let reads = Cell::new(0);
        let read = || {
            reads.set(reads.get() + 1);
            LinearImage::from_planes(Array3::zeros((3, 256, 256))) // 0.75 MiB
        };
        for name in ["a", "a", "b", "b", "a"] {
            cache.get(name, read).unwrap();
        }
        assert_eq!(reads.get(), 3, "a once, b twice");
    }
}
