//! Reference vectors: formation.
