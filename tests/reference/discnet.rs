//! Reference vectors: discnet.
