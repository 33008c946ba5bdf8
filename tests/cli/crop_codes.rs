//! The command line: crop_codes.
