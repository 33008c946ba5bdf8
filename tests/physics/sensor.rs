//! Analytic truth: sensor.
