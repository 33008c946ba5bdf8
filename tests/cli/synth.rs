//! The command line: synth.
