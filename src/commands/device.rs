//! The flag that says what networks compute on.

use std::fmt;

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
    /// Looks for the device, and says which it is where it is no CPU.
    pub(super) fn find(self, session: &Session) -> Result<Backend> {
        self.find_or(Backend::default(), session)
    }

    /// The same with another backend on the CPU.
    pub(super) fn find_or(self, cpu: Backend, session: &Session) -> Result<Backend> {
        let backend = self.device.find(cpu)?;
        if !backend.is_cpu() {
            tell(session, &backend);
        }
        Ok(backend)
    }
}

/// Says what computes where that is no CPU, and what to expect of it.
pub(super) fn tell(session: &Session, devices: &impl fmt::Display) {
    session.note(format_args!(
        "computing on {devices}; programs for it are compiled as they are first needed, so that the first image or step can take \
         minutes"
    ));
}
