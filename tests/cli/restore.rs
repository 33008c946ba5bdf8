//! The command line: restore.
