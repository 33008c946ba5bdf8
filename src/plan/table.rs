//! What the stages of a study cost: for all machines together, and by the clock for so many workers.

use serde::Serialize;

use crate::batch::{LinearCost, Span, Spent};
use crate::core::bytes::format_bytes;

/// Seconds of an hour.
const HOUR: f64 = 3600.0;

/// A stage of a study, whose jobs are alike.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Its name: the command's.
    pub name: String,
    /// Number of jobs, which may run at the same time.
    pub jobs: usize,
    /// Things that all jobs make together.
    pub items: usize,
    /// What a job costs by the number of its items.
    pub cost: LinearCost,
    /// Bytes on disk of each item.
    pub disk_bytes_each: f64,
    /// Memory of a job.
    pub memory_bytes: u64,
}

/// What a stage comes to.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct StageTotals {
    /// Its name.
    pub name: String,
    /// Number of jobs.
    pub jobs: usize,
    /// Number of items.
    pub items: usize,
    /// Hours of machines, each with as many threads as were measured with.
    pub machine_hours: f64,
    /// Hours of single cores.
    pub core_hours: f64,
    /// Share of that which jobs take before they do anything: it grows with the number of shards.
    pub fixed_share: f64,
    /// Bytes on disk.
    pub disk_bytes: f64,
    /// Memory of a job.
    pub memory_bytes: u64,
    /// Hours by the clock, for each number of workers.
    pub hours: Vec<f64>,
}

/// A study for so many workers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct Workers {
    /// How many.
    pub workers: usize,
    /// Hours by the clock, stage after stage.
    pub hours: f64,
    /// Share of the workers' time in which they work.
    pub utilisation: f64,
}

/// What a study comes to.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub struct StudyPlan {
    /// Threads of a job.
    pub threads: usize,
    /// Stage after stage.
    pub stages: Vec<StageTotals>,
    /// All of them.
    pub machine_hours: f64,
    /// All of them.
    pub core_hours: f64,
    /// All of them.
    pub disk_bytes: f64,
    /// For each number of workers.
    pub workers: Vec<Workers>,
}

impl Stage {
    /// What all jobs cost together.
    pub fn spent(&self) -> Spent {
        self.cost.fixed.times(self.jobs as f64).and(self.cost.each.times(self.items as f64))
    }

    /// Seconds by the clock for so many workers, each of which does one job after another.
    pub fn seconds(&self, workers: usize) -> f64 {
        let rounds = self.jobs.div_ceil(workers.max(1));
        let job = self.cost.of(self.items as f64 / self.jobs.max(1) as f64);
        rounds as f64 * job.seconds
    }

    fn totals(&self, workers: &[usize]) -> StageTotals {
        let spent = self.spent();
        let fixed = self.cost.fixed.seconds * self.jobs as f64;
        StageTotals {
            name: self.name.clone(),
            jobs: self.jobs,
            items: self.items,
            machine_hours: spent.seconds / HOUR,
            core_hours: spent.core_seconds / HOUR,
            fixed_share: if spent.seconds > 0.0 { fixed / spent.seconds } else { 0.0 },
            disk_bytes: self.disk_bytes_each * self.items as f64,
            memory_bytes: self.memory_bytes,
            hours: workers.iter().map(|workers| self.seconds(*workers) / HOUR).collect(),
        }
    }
}

impl StudyPlan {
    /// Adds up stages that follow each other.
    pub fn of(stages: &[Stage], workers: &[usize], threads: usize) -> Self {
        let totals: Vec<StageTotals> = stages.iter().map(|stage| stage.totals(workers)).collect();
        let machine_hours: f64 = totals.iter().map(|stage| stage.machine_hours).sum();
        let of_workers = |(index, workers): (usize, &usize)| {
            let hours: f64 = totals.iter().map(|stage| stage.hours[index]).sum();
            let utilisation = if hours > 0.0 { machine_hours / (hours * *workers as f64) } else { 0.0 };
            Workers { workers: *workers, hours, utilisation }
        };
        Self {
            threads,
            machine_hours,
            core_hours: totals.iter().map(|stage| stage.core_hours).sum(),
            disk_bytes: totals.iter().map(|stage| stage.disk_bytes).sum(),
            workers: workers.iter().enumerate().map(of_workers).collect(),
            stages: totals,
        }
    }

    /// The rows of a table, the first of them its heading.
    pub fn rows(&self) -> Vec<Vec<String>> {
        let fixed =
            ["stage", "jobs", "items", "machine time", "core time", "start-up", "disk", "memory of a job"];
        let heading = fixed.map(str::to_owned).into_iter();
        let heading = heading.chain(self.workers.iter().map(|found| workers_in_words(found.workers)));
        let span = |hours: f64| Span(hours * HOUR).to_string();
        let row = |stage: &StageTotals| {
            let cells = [
                stage.name.clone(),
                stage.jobs.to_string(),
                stage.items.to_string(),
                span(stage.machine_hours),
                span(stage.core_hours),
                format!("{:.0} %", 100.0 * stage.fixed_share),
                disk(stage.disk_bytes),
                format_bytes(stage.memory_bytes),
            ];
            cells.into_iter().chain(stage.hours.iter().map(|hours| span(*hours))).collect()
        };
        let dash = || "–".to_owned();
        let total = [
            "all".to_owned(),
            self.stages.iter().map(|stage| stage.jobs).sum::<usize>().to_string(),
            dash(),
            span(self.machine_hours),
            span(self.core_hours),
            dash(),
            disk(self.disk_bytes),
            format_bytes(self.stages.iter().map(|stage| stage.memory_bytes).max().unwrap_or(0)),
        ];
        let of_workers =
            |found: &Workers| format!("{} ({:.0} % busy)", span(found.hours), 100.0 * found.utilisation);
        let total = total.into_iter().chain(self.workers.iter().map(of_workers)).collect();
        [heading.collect()].into_iter().chain(self.stages.iter().map(row)).chain([total]).collect()
    }

    /// What keeps the largest number of workers from being used: the stage that takes most of the time by the clock.
    pub fn bottleneck(&self) -> Option<&StageTotals> {
        let last = |stage: &StageTotals| stage.hours.last().copied().unwrap_or(0.0);
        self.stages.iter().max_by(|a, b| last(a).total_cmp(&last(b)))
    }
}

fn workers_in_words(workers: usize) -> String {
    if workers == 1 { "1 worker".to_owned() } else { format!("{workers} workers") }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bytes of files")]
fn disk(bytes: f64) -> String {
    format_bytes(bytes.ceil() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stage(jobs: usize, items: usize) -> Stage {
        let spent = |seconds| Spent { seconds, core_seconds: 2.0 * seconds };
        Stage {
            name: "synth".to_owned(),
            jobs,
            items,
            cost: LinearCost { fixed: spent(36.0), each: spent(3.6) },
            disk_bytes_each: 1e6,
            memory_bytes: 1 << 30,
        }
    }

    /// A thousand items in ten jobs: 3600 s of items, 360 s of starting up.
    #[test]
    fn workers_do_jobs_in_rounds_and_each_job_starts_up() {
        let stage = stage(10, 1000);
        assert_eq!(stage.spent(), Spent { seconds: 3960.0, core_seconds: 7920.0 });
        assert_eq!(stage.seconds(1), 3960.0);
        assert_eq!((stage.seconds(4), stage.seconds(10), stage.seconds(99)), (3.0 * 396.0, 396.0, 396.0));
        let plan = StudyPlan::of(&[stage], &[1, 10, 20], 2);
        assert!((plan.machine_hours - 1.1).abs() < 1e-12 && (plan.core_hours - 2.2).abs() < 1e-12);
        assert_eq!(plan.disk_bytes, 1e9);
        let busy: Vec<f64> = plan.workers.iter().map(|found| found.utilisation).collect();
        assert!((busy[0] - 1.0).abs() < 1e-12 && (busy[1] - 1.0).abs() < 1e-12, "{busy:?}");
        assert!((busy[2] - 0.5).abs() < 1e-12, "ten jobs for twenty workers: {busy:?}");
        assert!((plan.stages[0].fixed_share - 1.0 / 11.0).abs() < 1e-12);
        assert_eq!(plan.bottleneck().unwrap().name, "synth");
        let rows = plan.rows();
        assert_eq!(rows[1][..4], ["synth", "10", "1000", "66.0 min"].map(str::to_owned));
        assert_eq!(rows[2].last().unwrap(), "6.6 min (50 % busy)");
    }
}
