//! Names what one training computes on: a backend, or several GPUs that train one network together.

use std::fmt;

use super::backend::Backend;
use super::gpu;
use crate::core::error::{Error, Result};

/// A backend, or several GPUs that exchange gradients.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Backends(Vec<Backend>);

impl Backends {
    /// GPUs by their numbers, as [`gpu::list`] counts them; the first keeps the weights.
    ///
    /// # Errors
    /// [`Error::Config`] without a number, or when one stands twice; [`Error::Unsupported`] when there is no such device, or
    /// when several are not all reached by CUDA, through which alone they exchange gradients.
    pub fn gpus(numbers: &[usize]) -> Result<Self> {
        let repeated = numbers.iter().enumerate().find(|(at, number)| numbers[..*at].contains(number));
        if let Some((_, number)) = repeated {
            return Err(Error::config(
                "devices",
                format!("must name each device once, {number} stands twice"),
            ));
        }
        match numbers {
            [] => return Err(Error::config("devices", "must name a device")),
            [number] => return Ok(Backend::Gpu(gpu::require(*number)?).into()),
            _ if !gpu::HAS_CUDA => return Err(alone("this build has no CUDA")),
            _ => {}
        }
        let gpus = numbers.iter().map(|number| gpu::require(*number)).collect::<Result<Vec<_>>>()?;
        if let Some(other) = gpus.iter().find(|gpu| !gpu.is_cuda()) {
            return Err(alone(&format!("{other} is another")));
        }
        Ok(Self(gpus.into_iter().map(Backend::Gpu).collect()))
    }

    /// Devices that exchange gradients in main memory.
    #[cfg(test)]
    pub(crate) fn as_devices(count: usize) -> Self {
        Self(vec![Backend::AsDevice; count])
    }

    /// The one that keeps the weights, and validates.
    pub fn first(&self) -> Backend {
        self.0[0]
    }

    /// All of them, the first at first.
    pub fn all(&self) -> &[Backend] {
        &self.0
    }
}

fn alone(why: &str) -> Error {
    Error::Unsupported(format!(
        "--devices: several devices train one network together where all are reached by CUDA, and {why}; build with `cargo \
         build --release --features cuda` for NVIDIA's cards, name one device, or train other configurations on the others, \
         each in a run of its own"
    ))
}

impl From<Backend> for Backends {
    fn from(backend: Backend) -> Self {
        Self(vec![backend])
    }
}

impl fmt::Display for Backends {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<String> = self.0.iter().map(Backend::to_string).collect();
        f.write_str(&names.join(" + "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_that_cannot_train_together_are_refused_with_what_to_do() {
        let message = |numbers: &[usize]| Backends::gpus(numbers).unwrap_err().to_string();
        assert!(message(&[]).contains("must name a device"));
        assert!(message(&[0, 1, 0]).contains("0 stands twice"), "{}", message(&[0, 1, 0]));
        if !gpu::HAS_CUDA {
            let refusal = message(&[0, 1]);
            assert!(refusal.contains("--features cuda") && refusal.contains("name one device"), "{refusal}");
        }
    }

    #[test]
    fn several_are_named_one_after_another() {
        assert_eq!(Backends::from(Backend::Flex).to_string(), "the CPU");
        assert_eq!(Backends::as_devices(2).to_string(), "the CPU as a device + the CPU as a device");
    }
}
