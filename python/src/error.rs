//! Turns the crate's errors into exceptions of Python.

use std::error::Error as _;

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

use udc::core::error::Error;

/// The exception of an error: `UdcError`, or one of its kinds that is an `OSError` too where the system refused.
pub(crate) fn to_python(error: &Error) -> PyErr {
    if error.is_interrupt() {
        return PyKeyboardInterrupt::new_err(());
    }
    exception(&error.in_full(), error_number(error))
}

/// The exception of a misuse.
pub(crate) fn misuse(reason: &str) -> PyErr {
    exception(reason, None)
}

fn exception(reason: &str, number: Option<i32>) -> PyErr {
    Python::attach(|py| {
        let made =
            py.import("udc._errors").and_then(|errors| errors.call_method1("exception", (reason, number)));
        made.map_or_else(|error| error, PyErr::from_value)
    })
}

/// The system's number of what it refused, 0 where it has none.
fn error_number(error: &Error) -> Option<i32> {
    let mut cause: Option<&(dyn std::error::Error + 'static)> = match error {
        Error::Io { source, .. } => Some(source),
        other => other.source(),
    };
    while let Some(found) = cause {
        if let Some(io) = found.downcast_ref::<std::io::Error>() {
            return Some(io.raw_os_error().unwrap_or_else(|| number_of(io.kind())));
        }
        cause = found.source();
    }
    None
}

/// The number of a refusal that the crate itself made, as of a file that exists.
fn number_of(kind: std::io::ErrorKind) -> i32 {
    const MISSING: i32 = 2;
    const EXISTS: i32 = 17;
    match kind {
        std::io::ErrorKind::NotFound => MISSING,
        std::io::ErrorKind::AlreadyExists => EXISTS,
        _ => 0,
    }
}
