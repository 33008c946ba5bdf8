//! Reference vectors: wiener.
