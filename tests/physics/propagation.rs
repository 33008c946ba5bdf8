//! Analytic truth: propagation.
