//! Convolves real images by fast Fourier transforms.

use serde::{Deserialize, Serialize};

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
