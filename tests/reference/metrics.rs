//! Reference vectors: metrics.
