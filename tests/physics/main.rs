//! Checks every stage against analytic truth: laws that hold whatever software computes them.

mod convolution;
mod panorama;
mod propagation;
mod rotation;
mod sensor;
