//! The command line: files.
