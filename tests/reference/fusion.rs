//! Reference vectors: fusion.
