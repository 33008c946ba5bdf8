//! Turns samples on a grid into values between them.

mod spline;

pub use spline::CubicSpline;
