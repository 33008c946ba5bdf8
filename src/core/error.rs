//! The library's one error type: few variants, one for each kind of person who can fix it.

use std::io::ErrorKind;
use std::iter::successors;
use std::path::{Path, PathBuf};

/// The result of every fallible function of the library.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// What went wrong, by who can mend it.
///
/// Messages say what to do next; the command line adds what was being done.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused: a missing file, an unwritable folder, a full disk.
    #[error("cannot {action} {}", path.display())]
    Io {
        /// What was tried, as a verb: `read`, `write`, `create`.
        action: &'static str,
        /// The file or folder it was tried on.
        path: PathBuf,
        /// The operating system's reason.
        #[source]
        source: std::io::Error,
    },
    /// A file is not what its reader expects.
    #[error("{}: {reason}", path.display())]
    Format {
        /// The offending file.
        path: PathBuf,
        /// What is wrong with it, and what would be right.
        reason: String,
    },
    /// Two arrays that must fit together do not.
    #[error("{what}: expected {expected}, found {found}")]
    Shape {
        /// What has the wrong shape.
        what: String,
        /// The shape that was needed.
        expected: String,
        /// The shape that was given.
        found: String,
    },
    /// A setting is out of range, unknown, or contradicts another.
    #[error("{key}: {reason}")]
    Config {
        /// The key or flag, as the user wrote it.
        key: String,
        /// What is wrong, and which values are accepted.
        reason: String,
    },
    /// The request is understood and cannot be served.
    #[error("{0}")]
    Unsupported(String),
    /// A training, or a network that it left, computes numbers that are not finite or out of all bounds.
    #[error("{0}")]
    Diverged(String),
    /// Another error, with what was being done: which of several pieces of work went wrong.
    #[error("{doing}")]
    While {
        /// What was being done, as in `opening the dataset`.
        doing: String,
        /// What went wrong.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A device could not do a piece of work, as where its memory does not suffice: smaller pieces may do.
    #[error("{0}")]
    Device(String),
    /// The user asked the program to stop.
    #[error("interrupted; finished files were kept, unfinished ones removed")]
    Interrupted,
}

impl Error {
    /// Wraps an operating-system error with what was tried on which path.
    pub fn io(action: &'static str, path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io { action, path: path.as_ref().to_owned(), source: explained(source) }
    }

    /// Describes a file whose contents are not what was expected.
    pub fn format(path: impl AsRef<Path>, reason: impl Into<String>) -> Self {
        Self::Format { path: path.as_ref().to_owned(), reason: reason.into() }
    }

    /// Describes arrays that do not fit together.
    pub fn shape(what: impl Into<String>, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Shape { what: what.into(), expected: expected.into(), found: found.into() }
    }

    /// Describes a setting that cannot be used.
    pub fn config(key: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Config { key: key.into(), reason: reason.into() }
    }

    /// Adds what was being done, as in `opening the dataset`.
    #[must_use]
    pub fn while_doing(self, doing: impl Into<String>) -> Self {
        Self::While { doing: doing.into(), source: Box::new(self) }
    }

    /// As [`while_doing`](Self::while_doing), but for an interruption, which is none of what was being done.
    #[must_use]
    pub fn while_doing_unless_interrupted(self, doing: impl Into<String>) -> Self {
        if self.is_interrupt() { self } else { self.while_doing(doing) }
    }

    /// What was being done, what went wrong with it and why, in one line.
    pub fn in_full(&self) -> String {
        self.chain().map(ToString::to_string).collect::<Vec<_>>().join(": ")
    }

    /// Whether the work ended because the user asked for it, whatever was being done.
    pub fn is_interrupt(&self) -> bool {
        self.chain().any(|cause| matches!(cause.downcast_ref(), Some(Self::Interrupted)))
    }

    /// Whether a device could not do it, and smaller pieces may do.
    pub fn is_of_device(&self) -> bool {
        self.chain().any(|cause| matches!(cause.downcast_ref(), Some(Self::Device(_))))
    }

    /// Whether a file could not be made because one of its name is there.
    pub fn is_already_there(&self) -> bool {
        let exists = |error: &std::io::Error| error.kind() == ErrorKind::AlreadyExists;
        self.chain().any(|cause| cause.downcast_ref().is_some_and(exists))
    }

    /// The error, what caused it, and so on.
    fn chain(&self) -> impl Iterator<Item = &(dyn std::error::Error + 'static)> {
        successors(Some(self as &(dyn std::error::Error + 'static)), |error| error.source())
    }
}

/// The system's reason with what to do, where that is known whatever was tried.
fn explained(source: std::io::Error) -> std::io::Error {
    let advice = match source.kind() {
        // Errors of our own say it already.
        _ if source.raw_os_error().is_none() => return source,
        ErrorKind::IsADirectory => "it is a folder, and a file is needed; name one",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            "there is no space left; what is finished is kept, and once there is space --resume goes on with it, in commands that \
             have it"
        }
        _ => return source,
    };
    std::io::Error::new(source.kind(), advice)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error as _;

    /// Whoever walks the chain finds the error itself behind what was being done.
    #[test]
    fn what_was_being_done_stands_before_what_went_wrong() {
        let error = Error::Interrupted.while_doing("opening the dataset");
        assert_eq!(error.to_string(), "opening the dataset");
        let source = error.source().and_then(|source| source.downcast_ref());
        assert!(matches!(source, Some(Error::Interrupted)), "{source:?}");
    }

    /// The numbers are those of Linux.
    #[test]
    #[cfg(target_os = "linux")]
    fn reasons_of_the_system_say_what_to_do() {
        let said = |number| Error::io("write", "a", std::io::Error::from_raw_os_error(number)).in_full();
        assert!(said(21).starts_with("cannot write a: it is a folder"), "{}", said(21));
        assert!(said(28).contains("--resume goes on"), "{}", said(28));
        assert!(said(13).contains("os error 13"), "{}", said(13));
    }

    #[test]
    fn an_error_in_full_says_its_causes_and_an_interrupt_stays_one() {
        let missing = std::io::Error::new(ErrorKind::NotFound, "no such file");
        let error = Error::io("read", "a.exr", missing).while_doing("restoring a.exr");
        assert_eq!(error.in_full(), "restoring a.exr: cannot read a.exr: no such file");
        assert!(!error.is_interrupt() && !error.is_already_there());
        let exists = std::io::Error::from(ErrorKind::AlreadyExists);
        assert!(Error::io("create", "a.exr", exists).while_doing("restoring a.exr").is_already_there());
        assert!(Error::Interrupted.while_doing("restoring a.exr").is_interrupt());
    }
}
