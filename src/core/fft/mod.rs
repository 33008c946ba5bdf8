//! Convolves real images by fast Fourier transforms.
//!
//! A [`Convolver`] belongs to one image size, kernel size and [`Boundary`]. It turns PSFs into [`Otf`]s and
//! images into [`Spectrum`]s, each once, and multiplies any of one with any of the other: nine kernels cost
//! nine products and inverse transforms, not nine convolutions.

mod convolver;
mod geometry;
mod lanes;
mod operator;
mod plane;
mod pool;
mod real;
mod transform;

use serde::{Deserialize, Serialize};

pub use convolver::{Convolver, Otf, SINGLE_PEAK, SINGLE_RMS, Spectrum};
pub use geometry::fast_length;
pub use operator::{PlaneOperator, TransferFunction, TransformPrecision};
pub use plane::PlaneSpectrum;
pub(crate) use pool::{Loan, Pool};
pub use transform::copy_row;

pub use crate::kernels::fourier::{Damping, Response};

/// What lies beyond the border of an image while it is convolved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Boundary {
    /// Darkness.
    #[default]
    Zero,
    /// The border pixels, repeated: `aaa|abcd|ddd`.
    Replicate,
    /// The image mirrored about its border pixels, which are not repeated: `dcb|abcd|cba`.
    Reflect,
    /// The image again, as if it tiled the plane: `bcd|abcd|abc`.
    Periodic,
}
