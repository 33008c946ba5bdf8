//! Analytic truth: rotation.
