//! Analytic truth: convolution.
