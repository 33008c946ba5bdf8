//! Turns panics of decoders into errors.
//!
//! The decoders that are used here are meant to refuse damaged data, and nearly always do. Where one of them
//! panics instead — exr 1.74 on some damaged B44 blocks, when overflow checks are on — the file is at fault, not
//! the program: the user gets one line that names the file.

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Once;

thread_local! {
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Runs a decoder on data that may be damaged; its panic becomes an error, and prints nothing.
///
/// The decoder must not leave work to other threads: their panics would still be printed.
pub(super) fn guarded<T>(decode: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    static SILENCE: Once = Once::new();
    SILENCE.call_once(|| {
        let report = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !GUARDED.get() {
                report(info);
            }
        }));
    });
    let outer = GUARDED.replace(true);
    // Whatever the decoder was building is dropped with the panic, so no broken state can be seen.
    let result = panic::catch_unwind(AssertUnwindSafe(decode));
    GUARDED.set(outer);
    result.unwrap_or_else(|_| Err("is damaged: its contents contradict each other".into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_an_error() {
        let empty: &[u8] = &[];
        assert!(guarded(|| Ok(empty[empty.len()])).unwrap_err().contains("damaged"));
        assert_eq!(guarded(|| Ok(1)), Ok(1));
    }
}
