//! `udc examples`.

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::json;

use udc::core::shard::Shard;
use udc::examples::{ExampleSet, ExamplesConfig, MadeExamples};
use udc::io;
use udc::synth::Existing;

use super::{Session, psf_file, text_of};

/// Make examples that a network learns to restore captures of any panel from
///
/// Each example has a panel, a pose, a scene, a sensor and a range of exposure of its own, drawn from the seed and the
/// example's number alone. It is a capture with its ground truth and the planes that a restoration makes of the capture and
/// of a PSF that differs from the true one as a measurement does. Panels, panoramas and paintings of the examples for
/// validation are in no other example. A part of all is harder than the simulator: demosaiced, white-balanced, with stray
/// light, and with a PSF of twice the support and of another spectrum than the one that is told.
#[derive(Args, Debug)]
#[command(
    after_help = "Examples:\n  udc examples configs/guided.toml --scenes panoramas/*.hdr -o examples\n  \
    udc examples configs/guided.toml --scenes panoramas/*.hdr -o examples --count 20000 --resume\n  \
    udc examples configs/guided.toml --scenes panoramas/*.hdr -o examples --shard 2/8\n  \
    udc train configs/guided.toml --data examples -o guided"
)]
pub(crate) struct ExamplesArgs {
    /// Configuration of a training with a section [examples]
    config: PathBuf,
    /// Folder for the examples
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Equirectangular HDR panoramas to cut views out of, instead of the configuration's: files, folders or patterns
    #[arg(long, value_name = "PANORAMA", num_args = 1..)]
    scenes: Vec<PathBuf>,
    /// Number of examples, instead of the configuration's
    #[arg(long, value_name = "N")]
    count: Option<usize>,
    /// Seed, instead of the configuration's
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(..=i64::MAX.cast_unsigned()))]
    seed: Option<u64>,
    /// Make only the I-th of N parts; all parts may be made at the same time
    #[arg(long, value_name = "I/N", default_value = "1/1")]
    shard: Shard,
    /// Go on with a folder that was begun with the same configuration, which may ask for more examples now
    #[arg(long)]
    resume: bool,
    /// As --resume, even where another process holds the same part: one of a machine that is gone, whose locks a network file
    /// system has kept
    #[arg(long)]
    take_over: bool,
}

impl ExamplesArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        session.check_resume(self.resume || self.take_over)?;
        let set = ExampleSet { config: self.read_config()?, shard: self.shard };
        session.configured(&set.config);
        set.config.panels.psf.as_deref().map_or(Ok(()), |psf| psf_file::look(psf, session))?;
        let existing = match (session.overwrite, self.resume, self.take_over) {
            (true, ..) => Existing::Overwrite,
            (false, _, true) => Existing::TakeOver,
            (false, true, false) => Existing::Resume,
            (false, false, false) => Existing::Refuse,
        };
        let MadeExamples { made, kept, validation } = set
            .make(&self.output, existing, &session.progress, |warning| session.warn(warning))
            .with_context(|| format!("making examples in {}", self.output.display()))?;
        session.results_of(json!({
            "output": text_of(&self.output), "made": made, "kept": kept, "validation": validation,
        }));
        let kept = if kept == 0 { String::new() } else { format!(", {kept} were there") };
        let root = self.output.display();
        session.say(format_args!("{root}: {made} examples made{kept}; {validation} are for validation"))
    }

    fn read_config(&self) -> Result<ExamplesConfig> {
        let mut config = ExamplesConfig::from_toml(&io::read_configuration(&self.config)?)
            .with_context(|| format!("reading {}", self.config.display()))?;
        if !self.scenes.is_empty() {
            config.scenes.panoramas = io::expand_inputs(&self.scenes)?;
        }
        config.count = self.count.unwrap_or(config.count);
        config.seed = self.seed.unwrap_or(config.seed);
        Ok(config)
    }
}
