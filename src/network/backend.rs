//! Names the Burn backends that the program can compute on.

use std::str::FromStr;

use burn::tensor::Device;

use crate::core::error::{Error, Result};

/// A Burn backend of this build.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// burn-flex, the CPU backend.
    #[default]
    Flex,
    /// burn-ndarray, its predecessor; in builds with the feature `ndarray-backend`.
    #[cfg(feature = "ndarray-backend")]
    NdArray,
}

impl Backend {
    /// The device that computes without gradients.
    pub fn device(self) -> Device {
        match self {
            Self::Flex => Device::flex(),
            #[cfg(feature = "ndarray-backend")]
            #[expect(deprecated, reason = "burn-flex succeeds it; it is kept for comparison")]
            Self::NdArray => Device::ndarray(),
        }
    }
}

impl FromStr for Backend {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        match name {
            "flex" => Ok(Self::Flex),
            #[cfg(feature = "ndarray-backend")]
            "ndarray" => Ok(Self::NdArray),
            #[cfg(not(feature = "ndarray-backend"))]
            "ndarray" => Err(Error::Unsupported(
                "this build has no ndarray backend; build with `cargo build --release --features \
                 ndarray-backend`, or use flex"
                    .to_owned(),
            )),
            other => Err(Error::config("backend", format!("must be flex or ndarray, found {other}"))),
        }
    }
}
