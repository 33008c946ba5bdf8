//! Analytic truth: panorama.
