//! The flag that says what networks compute on.

use anyhow::Result;
use clap::Args;

use udc::network::{Backend, DeviceChoice};

use super::Session;

/// Where networks compute.
#[derive(Args, Clone, Copy, Debug)]
pub(crate) struct DeviceArgs {
    /// What networks compute on: cpu, gpu (the first), gpu:N (`udc info --devices` lists them), or auto, a GPU where there is
    /// one
    #[arg(long, default_value = "cpu", value_name = "DEVICE")]
    device: DeviceChoice,
}

impl DeviceArgs {
    /// Looks for the device, and says with -v which it is.
    pub(super) fn find(self, session: &Session) -> Result<Backend> {
        self.find_or(Backend::default(), session)
    }

    /// The same with another backend on the CPU.
    pub(super) fn find_or(self, cpu: Backend, session: &Session) -> Result<Backend> {
        let backend = self.device.find(cpu)?;
        if !backend.is_cpu() {
            session.detail(format_args!("computing on {backend}"));
        }
        Ok(backend)
    }
}
