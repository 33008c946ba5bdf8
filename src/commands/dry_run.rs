//! `--dry-run`: what a run would take, for people or as one JSON object.

use std::time::Duration;

use anyhow::Result;
use clap::Args;
use serde_json::json;

use udc::batch::Estimate;

use super::Session;

/// How long a sample of the work may take before it is asked to stop.
pub(super) const PATIENCE: Duration = Duration::from_secs(2);

/// Whether only to say what a run would take.
#[derive(Args, Debug)]
pub(super) struct DryRunArgs {
    /// Write nothing, and say what the run would take: items, bytes on disk, memory, and seconds, after some seconds of work
    /// on a sample
    ///
    /// With --json it is one JSON object, and no events are told.
    #[arg(long)]
    pub(super) dry_run: bool,
}

impl DryRunArgs {
    /// Tells what the run would take.
    pub(super) fn tell(&self, command: &str, estimate: &Estimate, session: &Session) -> Result<()> {
        if !session.is_json {
            return session.say(format_args!("udc {command} makes {estimate}"));
        }
        let mut told = json!(estimate);
        told["command"] = json!(command);
        session.say(told)
    }
}
