//! Keeps images that have been read, as long as there is room.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::core::error::Result;
use crate::core::image::{Domain, Image};

/// Images by name, up to a number of bytes; what finds no room is read again every time.
///
/// Nothing is ever dropped for something newer: with samples drawn in random order any choice is as good.
#[derive(Debug)]
pub(super) struct ImageCache<D> {
    bytes: usize,
    kept: Mutex<Kept<D>>,
}

#[derive(Debug)]
struct Kept<D> {
    images: HashMap<String, Arc<Image<D>>>,
    bytes: usize,
}

impl<D: Domain> ImageCache<D> {
    pub(super) fn new(mebibytes: usize) -> Self {
        Self {
            bytes: mebibytes.saturating_mul(1 << 20),
            kept: Mutex::new(Kept { images: HashMap::new(), bytes: 0 }),
        }
    }

    /// The image of that name, from memory or by `read`.
    pub(super) fn get(&self, name: &str, read: impl FnOnce() -> Result<Image<D>>) -> Result<Arc<Image<D>>> {
        let lock = || self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(image) = lock().images.get(name) {
            return Ok(Arc::clone(image));
        }
        // Not under the lock: other threads read other images meanwhile.
        let image = Arc::new(read()?);
        let size = size_of_val(image.as_slice());
        let mut kept = lock();
        if kept.bytes + size <= self.bytes && !kept.images.contains_key(name) {
            kept.bytes += size;
            kept.images.insert(name.to_owned(), Arc::clone(&image));
        }
        Ok(image)
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
        let cache = ImageCache::new(1);
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
