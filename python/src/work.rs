//! Does work without Python's lock, on threads of its own, until it is done or the user asks to stop.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use udc::core::error::{Error, Result};
use udc::core::progress::Progress;
use udc::kernels::Isa;

use crate::error::{misuse, to_python};

/// How often Python is asked whether the user wants to stop: seldom enough to cost nothing, and soon enough for a hand.
const ASKING: Duration = Duration::from_millis(50);

/// The number of threads; 0 for as many as there are cores.
static THREADS: AtomicUsize = AtomicUsize::new(0);

/// The threads, and the process that they are of: a forked process has none of its parent's.
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// Does `work`; other threads of Python go on meanwhile.
pub(crate) fn run<T: Send>(py: Python<'_>, work: impl FnOnce(&Progress) -> Result<T> + Send) -> PyResult<T> {
    Isa::forced().map_err(|reason| misuse(&reason))?;
    let pool = pool()?;
    let interrupted = Arc::new(AtomicBool::new(false));
    let progress = Progress::new(None, Arc::clone(&interrupted));
    let (result, signal) = py.detach(|| {
        let (sender, receiver) = sync_channel(1);
        let progress = &progress;
        pool.in_place_scope(|scope| {
            scope.spawn(move |_| {
                // Who waits is there until this is sent.
                let _ = sender.send(work(progress));
            });
            let mut signal = None;
            loop {
                match receiver.recv_timeout(ASKING) {
                    Ok(result) => return (Some(result), signal),
                    // A panic, which the scope hands on.
                    Err(RecvTimeoutError::Disconnected) => return (None, signal),
                    Err(RecvTimeoutError::Timeout) if signal.is_none() => {
                        signal = Python::attach(|py| py.check_signals()).err();
                        interrupted.store(signal.is_some(), Ordering::Relaxed);
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                }
            }
        })
    });
    match (result, signal) {
        (_, Some(signal)) => Err(signal),
        (Some(result), None) => result.map_err(|error| to_python(&error)),
        (None, None) => Err(to_python(&Error::Interrupted)),
    }
}

/// Sets the number of threads that work is divided among; 0 is as many as there are cores.
#[pyfunction]
pub(crate) fn set_threads(threads: usize) {
    THREADS.store(threads, Ordering::Relaxed);
    *POOL.lock().unwrap_or_else(PoisonError::into_inner) = None;
}

fn pool() -> PyResult<Arc<ThreadPool>> {
    let mut kept = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    match kept.take() {
        Some((of, pool)) if of == process => {
            *kept = Some((of, Arc::clone(&pool)));
            return Ok(pool);
        }
        // Its threads are the parent's: there is nobody to end.
        Some(of_parent) => std::mem::forget(of_parent),
        None => {}
    }
    let made = ThreadPoolBuilder::new().num_threads(THREADS.load(Ordering::Relaxed)).build();
    let pool = Arc::new(made.map_err(|error| misuse(&format!("cannot start the threads: {error}")))?);
    *kept = Some((process, Arc::clone(&pool)));
    Ok(pool)
}
