//! Names what the program can compute on: the CPU backends of Burn, and GPUs in builds that have them.

use std::fmt;
use std::str::FromStr;

use burn::tensor::{Device, Tensor, TensorReadError};

use super::gpu::{self, Gpu};
use super::precision::Precision;
use crate::core::error::{Error, Result};

/// A Burn backend of this build, on one device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Backend {
    /// burn-flex, the CPU backend.
    #[default]
    Flex,
    /// burn-ndarray, its predecessor; in builds with the feature `ndarray-backend`.
    #[cfg(feature = "ndarray-backend")]
    NdArray,
    /// A GPU; in builds with the feature `gpu` or `cuda`.
    Gpu(Gpu),
    /// The CPU in a GPU's place: weights stay on the device, and tensors other than of 32-bit floats are computed with Burn's
    /// own operations.
    #[cfg(test)]
    AsDevice,
}

impl Backend {
    /// The device that computes without gradients.
    pub fn device(self) -> Device {
        match self {
            Self::Flex => Device::flex(),
            #[cfg(feature = "ndarray-backend")]
            #[expect(deprecated, reason = "burn-flex succeeds it; it is kept for comparison")]
            Self::NdArray => Device::ndarray(),
            Self::Gpu(gpu) => gpu.device(),
            #[cfg(test)]
            Self::AsDevice => Device::flex(),
        }
    }

    /// Whether it computes in main memory, by the kernels.
    pub fn is_cpu(self) -> bool {
        match self {
            Self::Flex => true,
            #[cfg(feature = "ndarray-backend")]
            Self::NdArray => true,
            Self::Gpu(_) => false,
            #[cfg(test)]
            Self::AsDevice => false,
        }
    }

    /// Whether tensors of such numbers can be computed with, as the device says.
    pub fn supports(self, precision: Precision) -> bool {
        self.device().supports_dtype(precision.dtype())
    }

    /// Checks that networks can be trained with such numbers.
    ///
    /// # Errors
    /// [`Error::Config`] naming the key.
    pub fn check_training(self, precision: Precision) -> Result<()> {
        let reason = match precision {
            Precision::F32 => return Ok(()),
            Precision::Bf16 if self.is_cpu() => {
                "bf16 is for trainings on a GPU: the CPU's kernels train with 32-bit floats alone; leave it out, or use \
                 --device gpu"
                    .to_owned()
            }
            Precision::Bf16 if !self.supports(precision) => format!(
                "{self} does not compute in bfloat16; train with f32, which is the default{}",
                gpu::BFLOAT16_ELSEWHERE
            ),
            Precision::Bf16 => return Ok(()),
        };
        Err(Error::config("precision", reason))
    }

    /// Checks that gradients of crops with so many pixels in a batch are sums over all of them.
    ///
    /// # Errors
    /// [`Error::Config`] for a program that takes a GPU's place: Mesa's ends every loop after 65 535 rounds, and a gradient would
    /// silently lack the rest.
    pub fn check_batch(self, pixels: usize) -> Result<()> {
        const MOST_ROUNDS: usize = 65_535;
        match self {
            Self::Gpu(gpu) if !gpu.is_card() && pixels > MOST_ROUNDS => Err(Error::config(
                "data.batch",
                format!(
                    "{self} sums no more than {MOST_ROUNDS} numbers rightly, and the batch has {pixels} pixels; use --device cpu, \
                     or a smaller data.batch or data.crop"
                ),
            )),
            _ => Ok(()),
        }
    }
}

impl fmt::Display for Backend {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flex => f.write_str("the CPU"),
            #[cfg(feature = "ndarray-backend")]
            Self::NdArray => f.write_str("the CPU (ndarray)"),
            Self::Gpu(gpu) => gpu.fmt(f),
            #[cfg(test)]
            Self::AsDevice => f.write_str("the CPU as a device"),
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

/// The numbers of a tensor, in order.
///
/// # Errors
/// Whatever failed on the device on the way shows here: [`Error::Device`] where less work may do, as where its memory does not
/// suffice; [`Error::Unsupported`] where it does nothing more.
pub(crate) fn numbers_of<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>> {
    tensor.try_into_vec_as().map_err(|reason| match reason {
        TensorReadError::Execution(reason) if reason.is_device_poisoned() => Error::Unsupported(format!(
            "the device has failed, and does nothing more in this process: {}; start again, or use --device cpu",
            reason.reason()
        )),
        TensorReadError::Execution(reason) => Error::Device(format!(
            "the device failed: {}; where its memory does not suffice, take a smaller --tile, crop or batch (data.batch), or \
             use --device cpu",
            reason.reason()
        )),
        reason => unreachable!("tensors are of 32-bit floats: {reason}"),
    })
}

/// What a user asks to compute on, before any device is looked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The first GPU where there is one, else the CPU.
    Auto,
    /// The CPU.
    #[default]
    Cpu,
    /// The first GPU.
    Gpu,
    /// A device of a number, as [`gpu::list`] counts them.
    Numbered(usize),
}

impl DeviceChoice {
    /// Looks for the device; `cpu` is the backend that stands for the CPU.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when there is no such device, or this build has no GPU backend.
    pub fn find(self, cpu: Backend) -> Result<Backend> {
        Ok(match self {
            Self::Cpu => cpu,
            Self::Auto => gpu::first().map_or(cpu, Backend::Gpu),
            Self::Gpu => Backend::Gpu(gpu::require_first()?),
            Self::Numbered(number) => Backend::Gpu(gpu::require(number)?),
        })
    }
}

impl FromStr for DeviceChoice {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        match name {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "gpu" => Ok(Self::Gpu),
            other => match other.strip_prefix("gpu:").map(str::parse) {
                Some(Ok(number)) => Ok(Self::Numbered(number)),
                _ => {
                    let reason = format!("must be auto, cpu, gpu or gpu:N with N from 0 on, found {other}");
                    Err(Error::config("device", reason))
                }
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_are_named_as_the_help_says() {
        for (name, choice) in [
            ("auto", DeviceChoice::Auto),
            ("cpu", DeviceChoice::Cpu),
            ("gpu", DeviceChoice::Gpu),
            ("gpu:0", DeviceChoice::Numbered(0)),
            ("gpu:12", DeviceChoice::Numbered(12)),
        ] {
            assert_eq!(name.parse::<DeviceChoice>().unwrap(), choice);
        }
        for name in ["", "GPU", "gpu:", "gpu:-1", "gpu:x", "cuda", "gpu 0"] {
            let message = name.parse::<DeviceChoice>().unwrap_err().to_string();
            assert!(message.contains("gpu:N"), "{name}: {message}");
        }
    }

    #[test]
    fn the_cpu_is_the_backend_that_stands_for_it() {
        assert_eq!(DeviceChoice::Cpu.find(Backend::Flex).unwrap(), Backend::Flex);
        assert!(Backend::Flex.is_cpu());
    }

    #[test]
    fn a_device_that_there_is_not_is_refused_with_what_to_do() {
        let message = DeviceChoice::Numbered(99).find(Backend::Flex).unwrap_err().to_string();
        let mend = if gpu::IS_BUILT { "udc info --devices" } else { "--features gpu" };
        assert!(message.contains(mend), "{message}");
    }
}
