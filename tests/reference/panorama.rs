//! Reference vectors: panorama.
