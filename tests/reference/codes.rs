//! Reference vectors: codes.
