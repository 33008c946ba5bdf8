//! Reference vectors: training.
