//! `udc plan`.

mod measure;
mod process;

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::Args;
use serde_json::json;

use udc::experiment::markdown;
use udc::io;
use udc::plan::{Study, StudyPlan};
use udc::train::TrainConfig;

use super::Session;
use measure::{Check, Laboratory};

/// By how much a prediction may miss, as a share of what was measured.
const TOLERANCE: f64 = 0.2;

/// Plan a study: machine hours and disk of each stage, for any number of workers
///
/// A little of each stage is done first, in a folder that goes again: some scenes, a PSF, some rotations, and samples of the
/// synthesis, the trainings and the evaluation, which takes half a minute for small images and some minutes for large ones.
/// A worker is a machine like this one, with as many --threads. Stages follow each other; the jobs of a stage are its
/// shards, and what is not divided, such as a training, is one job. The workflow of the project does what is planned here.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  udc plan workflow/study.toml --workers 1,8,64\n  \
    udc plan workflow/study.toml --workers 1,10,100,1000 --shards 1000 --json\n  \
    udc plan study.toml --check")]
pub(crate) struct PlanArgs {
    /// Study, as workflow/study.toml shows it
    #[arg(value_name = "STUDY")]
    study: PathBuf,
    /// Numbers of workers
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [1, 8, 64],
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    workers: Vec<usize>,
    /// Number of shards of each stage, instead of the study's
    #[arg(long, value_name = "N", value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..))]
    shards: Option<usize>,
    /// Do a small study too, and compare what it takes with what is predicted for it; fails when core time is off by more
    /// than 20 %
    #[arg(long)]
    check: bool,
}

impl PlanArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let mut study = Study::read(&self.study)?;
        if let Some(shards) = self.shards {
            (study.shards.scenes, study.shards.synth, study.shards.eval) = (shards, shards, shards);
        }
        check_trainings(&study, &self.study)?;
        let panoramas = match &study.scenes.panoramas[..] {
            [] => Vec::new(),
            named => io::expand_inputs(named)?,
        };
        let scratch = io::scratch_folder(&self.study)?;
        let mut laboratory = Laboratory::new(&study, &panoramas, scratch.path(), session)?;
        let stages = laboratory.measure()?;
        if self.check {
            return self.compare(&laboratory.check()?, session);
        }
        let plan = StudyPlan::of(&stages, &self.workers, rayon::current_num_threads());
        if session.is_json {
            return session.say(json!(plan));
        }
        session.say(markdown(&plan.rows()).trim_end())?;
        if let (Some(stage), Some(most)) = (plan.bottleneck(), self.workers.last()) {
            session.say(format_args!(
                "\nWith {most} workers most of the time goes to {}: {} jobs, of which {:.0} % is start-up. Machines of {} \
                 threads.",
                stage.name,
                stage.jobs,
                100.0 * stage.fixed_share,
                plan.threads
            ))?;
        }
        Ok(())
    }

    /// Tells by how much predictions miss.
    fn compare(&self, checks: &[Check], session: &Session) -> Result<()> {
        let predicted: f64 = checks.iter().map(|check| check.predicted.core_seconds).sum();
        let measured: f64 = checks.iter().map(|check| check.measured.core_seconds).sum();
        let deviation = predicted / measured - 1.0;
        if session.is_json {
            session.say(json!({
                "stages": checks, "predicted-core-seconds": predicted, "measured-core-seconds": measured,
                "deviation": deviation, "tolerance": TOLERANCE,
            }))?;
        } else {
            let heading = [
                "stage",
                "items",
                "predicted core s",
                "measured core s",
                "deviation",
                "predicted s",
                "measured s",
            ];
            let rows = checks.iter().map(|check| {
                let (predicted, measured) = (check.predicted, check.measured);
                vec![
                    check.stage.clone(),
                    check.items.to_string(),
                    format!("{:.2}", predicted.core_seconds),
                    format!("{:.2}", measured.core_seconds),
                    format!("{:+.0} %", 100.0 * (predicted.core_seconds / measured.core_seconds - 1.0)),
                    format!("{:.2}", predicted.seconds),
                    format!("{:.2}", measured.seconds),
                ]
            });
            let rows: Vec<Vec<String>> =
                [heading.map(str::to_owned).to_vec()].into_iter().chain(rows).collect();
            session.say(markdown(&rows))?;
            session.say(format_args!(
                "all: predicted {predicted:.1} core seconds, measured {measured:.1}: {:+.0} %",
                100.0 * deviation
            ))?;
        }
        if deviation.abs() > TOLERANCE {
            bail!(
                "the prediction is off by {:+.0} %, more than {:.0} %; a busy machine is measured badly",
                100.0 * deviation,
                100.0 * TOLERANCE
            );
        }
        Ok(())
    }
}

/// Refuses trainings that no step could be made of, before anything is measured for them.
fn check_trainings(study: &Study, path: &Path) -> Result<()> {
    for config in study.networks.values() {
        let text = io::read_configuration(config)?;
        TrainConfig::from_toml(&text, &study.training.set).with_context(|| {
            format!("reading {} with the settings of [training] in {}", config.display(), path.display())
        })?;
    }
    Ok(())
}
