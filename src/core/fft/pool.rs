//! Lends buffers and takes them back, so that repeated transforms and filters do not allocate.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};

/// Buffers that nobody uses at the moment.
#[derive(Debug)]
pub(crate) struct Pool<T> {
    idle: Mutex<Vec<T>>,
}

/// A buffer on loan, with whatever the last user left in it.
pub(crate) struct Loan<'a, T> {
    pool: &'a Pool<T>,
    /// Present until the loan ends.
    item: Option<T>,
}

impl<T> Pool<T> {
    pub(crate) fn new() -> Self {
        Self { idle: Mutex::new(Vec::new()) }
    }

    /// Lends an idle buffer, or a new one.
    pub(crate) fn lend(&self, make: impl FnOnce() -> T) -> Loan<'_, T> {
        Loan { pool: self, item: Some(self.take().unwrap_or_else(make)) }
    }

    /// Gives an idle buffer away.
    pub(super) fn take(&self) -> Option<T> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop()
    }

    /// Takes a buffer in.
    pub(super) fn put(&self, item: T) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(item);
    }
}

impl<T> Deref for Loan<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.item.as_ref().expect("a loan holds its item until it ends")
    }
}

impl<T> DerefMut for Loan<'_, T> {
    fn deref_mut(&mut self) -> &mut T {
        self.item.as_mut().expect("a loan holds its item until it ends")
    }
}

impl<T> Drop for Loan<'_, T> {
    fn drop(&mut self) {
        if let Some(item) = self.item.take() {
            self.pool.put(item);
        }
    }
}
