//! The command line: train.
