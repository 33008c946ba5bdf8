//! The command line: eval.
