//! Keeps what was used most recently, up to a number of bytes.

use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

/// Values by key, up to a number of bytes; the one that was used the longest ago makes room first.
///
/// A value is made without the lock: threads that want another one, or do other work while they wait for a part of it,
/// are never held up. Two threads may make the same value at once; the first to be done is kept.
pub(super) struct RecentlyUsed<K, V> {
    bytes: usize,
    /// The most recently used last.
    kept: Mutex<Vec<Entry<K, V>>>,
}

struct Entry<K, V> {
    key: K,
    bytes: usize,
    value: Arc<V>,
}

impl<K: PartialEq, V> RecentlyUsed<K, V> {
    /// Keeps at most `bytes`, but always the value that was used last.
    pub(super) fn new(bytes: usize) -> Self {
        Self { bytes, kept: Mutex::new(Vec::new()) }
    }

    /// The value of a key, kept or made: `make` gives it with its size in bytes.
    ///
    /// # Errors
    /// Those of `make`.
    pub(super) fn get<E>(&self, key: K, make: impl FnOnce() -> Result<(V, usize), E>) -> Result<Arc<V>, E> {
        if let Some(value) = self.find(&key) {
            return Ok(value);
        }
        let (value, bytes) = make()?;
        // Another thread may have been quicker.
        if let Some(value) = self.find(&key) {
            return Ok(value);
        }
        let value = Arc::new(value);
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.push(Entry { key, bytes, value: Arc::clone(&value) });
        while kept.len() > 1 && kept.iter().map(|entry| entry.bytes).sum::<usize>() > self.bytes {
            kept.remove(0);
        }
        Ok(value)
    }

    /// The value of a key, which becomes the most recently used.
    fn find(&self, key: &K) -> Option<Arc<V>> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let index = kept.iter().position(|entry| entry.key == *key)?;
        let entry = kept.remove(index);
        let value = Arc::clone(&entry.value);
        kept.push(entry);
        Some(value)
    }
}

impl<K, V> fmt::Debug for RecentlyUsed<K, V> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RecentlyUsed").field("bytes", &self.bytes).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;
    use std::sync::mpsc;
    use std::thread;
    use std::time::Duration;

    fn made(value: u32, bytes: usize) -> impl FnOnce() -> Result<(u32, usize), ()> {
        move || Ok((value, bytes))
    }

    #[test]
    fn what_was_used_the_longest_ago_makes_room() {
        let cache = RecentlyUsed::new(25);
        let makes = Cell::new(0);
        let get = |key: u32| {
            let make = || {
                makes.set(makes.get() + 1);
                made(key * 100, 10)()
            };
            *cache.get(key, make).unwrap()
        };
        for key in [1, 2, 1, 3] {
            assert_eq!(get(key), key * 100);
        }
        assert_eq!(makes.get(), 3, "1, 2 and 3 were made once");
        get(1);
        get(3);
        assert_eq!(makes.get(), 3, "2 made room for 3");
        get(2);
        assert_eq!(makes.get(), 4);
    }

    #[test]
    fn a_value_larger_than_the_room_is_kept_until_the_next_comes() {
        let cache = RecentlyUsed::new(1);
        for _ in 0..2 {
            assert_eq!(*cache.get(1, made(7, 100)).unwrap(), 7);
        }
        assert_eq!(*cache.get(1, || panic!("it is kept") as Result<_, ()>).unwrap(), 7);
        cache.get(2, made(8, 100)).unwrap();
        assert_eq!(cache.kept.lock().unwrap().len(), 1);
    }

    /// Were values made under the lock, the inner one would wait for ever.
    #[test]
    fn a_value_can_be_had_while_another_is_made() {
        let (done, wait) = mpsc::channel();
        thread::spawn(move || {
            let cache = RecentlyUsed::new(100);
            let inner = || made(*cache.get(2, made(20, 1)).unwrap() + 1, 1)();
            done.send(*cache.get(1, inner).unwrap()).unwrap();
        });
        assert_eq!(wait.recv_timeout(Duration::from_secs(20)), Ok(21));
    }

    #[test]
    fn what_cannot_be_made_is_tried_again() {
        let cache = RecentlyUsed::new(100);
        assert_eq!(cache.get(1, || Err::<(u32, usize), _>("no")), Err("no"));
        assert_eq!(cache.get(1, || Ok::<_, &str>((5, 1))).map(|value| *value), Ok(5));
    }
}
