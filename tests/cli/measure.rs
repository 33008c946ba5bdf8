//! The command line: measure.
