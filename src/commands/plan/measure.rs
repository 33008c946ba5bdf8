//! Measures the stages of a study by the commands that its jobs call, each in a process of its own.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use serde::{Deserialize, Serialize};

use udc::batch::{LinearCost, Spent};
use udc::io;
use udc::plan::{Stage, Study};

use super::process::output_of;
use crate::commands::{Session, text_of};

/// Scenes that are painted to see how long it takes: few, and then more.
const SCENES: [usize; 2] = [4, 12];

/// Scenes that are painted to check the prediction.
const MORE_SCENES: usize = 36;

/// Core seconds that a check of a training is to take.
const CHECKED_TRAINING: f64 = 6.0;

/// Memory of stages that do not say it beforehand: painting and simulating, at usual sizes.
const UNTOLD_MEMORY: u64 = 1 << 30;

/// What a command says beforehand, as far as it is needed here.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
struct Told {
    items: usize,
    disk_bytes: u64,
    memory_bytes: u64,
    #[serde(flatten)]
    cost: Spent,
    fixed: Spent,
}

/// What was predicted of a piece of work, and what it took.
#[derive(Debug, Serialize)]
pub(super) struct Check {
    pub(super) stage: String,
    pub(super) items: usize,
    pub(super) predicted: Spent,
    pub(super) measured: Spent,
}

/// Where commands are tried.
pub(super) struct Laboratory<'a> {
    study: &'a Study,
    panoramas: &'a [PathBuf],
    folder: &'a Path,
    session: &'a Session,
    /// What a process costs that does nothing.
    startup: Spent,
    scenes: LinearCost,
    codes: Option<LinearCost>,
    synth: LinearCost,
    networks: BTreeMap<String, LinearCost>,
    eval: LinearCost,
}

impl<'a> Laboratory<'a> {
    pub(super) fn new(
        study: &'a Study,
        panoramas: &'a [PathBuf],
        folder: &'a Path,
        session: &'a Session,
    ) -> Result<Self> {
        let mut laboratory = Self {
            study,
            panoramas,
            folder,
            session,
            startup: Spent::default(),
            scenes: LinearCost::default(),
            codes: None,
            synth: LinearCost::default(),
            networks: BTreeMap::new(),
            eval: LinearCost::default(),
        };
        laboratory.startup = laboratory.run(&["--version".to_owned()])?.1;
        Ok(laboratory)
    }

    /// Measures every stage, and says what it is for the whole study.
    pub(super) fn measure(&mut self) -> Result<Vec<Stage>> {
        let mut stages = Vec::new();
        stages.extend(self.psf()?);
        stages.push(self.codes()?);
        stages.push(self.scenes()?);
        stages.extend(self.crop()?);
        stages.push(self.synth()?);
        stages.extend(self.train()?);
        stages.push(self.eval()?);
        stages.retain(|stage| stage.items > 0);
        Ok(stages)
    }

    /// Runs the program, and returns what it wrote and what it took.
    fn run(&self, args: &[String]) -> Result<(String, Spent)> {
        self.session.progress.check()?;
        let program = std::env::current_exe().context("finding this program")?;
        let (begun, cores) = (Instant::now(), io::core_seconds_of_children());
        let threads = rayon::current_num_threads().to_string();
        let mut command = Command::new(program);
        command.args(args).args((args.len() > 1).then_some(["--threads", &threads]).into_iter().flatten());
        let output = output_of(&mut command, &self.session.progress)
            .with_context(|| format!("running udc {}", args.join(" ")))?;
        let seconds = begun.elapsed().as_secs_f64();
        let spent = cores.zip(io::core_seconds_of_children()).map(|(before, now)| now - before);
        let core_seconds = spent.unwrap_or(seconds * rayon::current_num_threads() as f64);
        if !output.status.success() {
            // A terminal's Ctrl-C reaches both.
            self.session.progress.check()?;
            let said = String::from_utf8_lossy(&output.stderr);
            let said = said.trim().trim_start_matches("error: ");
            bail!("udc {}: {said}", args.join(" "));
        }
        self.session.detail(format_args!("udc {}: {seconds:.2} s", args.join(" ")));
        Ok((String::from_utf8_lossy(&output.stdout).into_owned(), Spent { seconds, core_seconds }))
    }

    /// What a command says beforehand.
    fn ask(&self, args: &[String]) -> Result<Told> {
        let args = [args, &words("--dry-run --json")].concat();
        let (said, _) = self.run(&args)?;
        serde_json::from_str(&said).with_context(|| format!("reading what udc {} said", args.join(" ")))
    }

    fn path(&self, name: &str) -> String {
        text_of(&self.folder.join(name))
    }

    /// The first panel's PSF: where it is, or will be.
    fn psf_file(&self) -> Result<(&Path, String)> {
        let panel = self.study.panels.values().next().context("a study has a panel")?;
        let file = if is_layout(panel) { self.path("psf.exr") } else { text_of(panel) };
        Ok((panel, file))
    }

    fn psf(&self) -> Result<Option<Stage>> {
        let layouts = self.study.panels.values().filter(|panel| is_layout(panel)).count();
        let Some(panel) = self.study.panels.values().find(|panel| is_layout(panel)) else { return Ok(None) };
        let (_, spent) = self.run(
            &[words("psf --display"), vec![text_of(panel), "-o".to_owned(), self.path("psf.exr")]].concat(),
        )?;
        let disk_bytes_each = size_of(&self.folder.join("psf.exr")) as f64;
        let cost = LinearCost::of_each(spent);
        Ok(Some(stage("psf", (layouts, layouts), cost, disk_bytes_each, UNTOLD_MEMORY)))
    }

    fn codes(&mut self) -> Result<Stage> {
        let angles = self.study.angles()?;
        let (_, psf) = self.psf_file()?;
        let dim = self.study.rotations.dim;
        let few = dim + 1;
        let bank = |count: usize, name: &str| {
            let listed: Vec<String> = angles[..count].iter().map(f64::to_string).collect();
            let angles = format!("--angles={}", listed.join(","));
            let files = vec!["codes".to_owned(), psf.clone(), angles, "-o".to_owned(), self.path(name)];
            self.run(&[files, words(&format!("--dim {dim}"))].concat())
                .map(|(_, spent)| (count as f64, spent))
        };
        let first = bank(few, "bank.safetensors")?;
        let cost = match angles.len() {
            all if all > few => LinearCost::through(first, bank(all.min(few + 4), "more.safetensors")?),
            _ => LinearCost::of_each(first.1.times(1.0 / first.0)),
        };
        let bytes = size_of(&self.folder.join("bank.safetensors")) as f64 / few as f64;
        self.codes = Some(cost);
        let panels = self.study.panels.len();
        Ok(stage("codes", (panels, panels * angles.len()), cost, bytes, UNTOLD_MEMORY))
    }

    fn paint(&self, count: usize, name: &str) -> Result<Spent> {
        let scenes = &self.study.scenes;
        let mut args = words(&format!(
            "scenes --count {count} --seed {} --size {} --margin {} -o",
            self.study.seed, scenes.size, scenes.margin
        ));
        args.push(self.path(name));
        args.extend(scenes.half.then(|| "--half".to_owned()));
        Ok(self.run(&args)?.1)
    }

    /// Painted scenes are needed for the later stages, whatever the study's scenes are.
    fn scenes(&mut self) -> Result<Stage> {
        let few = self.paint(SCENES[0], "few")?;
        let more = self.paint(SCENES[1], "scenes")?;
        self.scenes = LinearCost::through((SCENES[0] as f64, few), (SCENES[1] as f64, more));
        let bytes = size_of(&self.folder.join("scenes")) as f64 / SCENES[1] as f64;
        let painted = self.study.scenes.painted;
        let jobs = self.study.shards.scenes.min(painted);
        Ok(stage("scenes", (jobs, painted), self.scenes, bytes, UNTOLD_MEMORY))
    }

    fn crop(&self) -> Result<Option<Stage>> {
        let scenes = &self.study.scenes;
        if self.panoramas.is_empty() {
            return Ok(None);
        }
        let mut args = words(&format!(
            "crop --views {} --size {} --margin {} -o",
            scenes.views, scenes.size, scenes.margin
        ));
        args.push(self.path("views"));
        args.extend(scenes.half.then(|| "--half".to_owned()));
        args.extend(self.panoramas.iter().map(|panorama| text_of(panorama)));
        let told = self.ask(&args)?;
        let jobs = self.study.shards.scenes.min(told.items);
        // Each job reads its own panoramas, and one that another job reads too.
        let reading = told.fixed.times(1.0 / self.panoramas.len() as f64);
        let cost = self.cost_of(&told, reading, told.items);
        Ok(Some(stage(
            "crop",
            (jobs, told.items),
            cost,
            told.disk_bytes as f64 / told.items as f64,
            told.memory_bytes,
        )))
    }

    /// The cost of a job by its items: starting up, what any number of items takes, and the rest by their number.
    fn cost_of(&self, told: &Told, fixed: Spent, items: usize) -> LinearCost {
        let rest = |all: f64, fixed: f64| ((all - fixed) / items.max(1) as f64).max(0.0);
        let each = Spent {
            seconds: rest(told.cost.seconds, fixed.seconds),
            core_seconds: rest(told.cost.core_seconds, fixed.core_seconds),
        };
        LinearCost { fixed: self.startup.and(fixed), each }
    }

    fn synth_args(&self, scenes: &str, output: &str) -> Result<Vec<String>> {
        let noise = self.study.noise.values().next().context("a study has noise")?;
        let mut args = vec!["synth".to_owned(), self.path(scenes), "--noise".to_owned(), noise.clone()];
        args.extend(["--bank".to_owned(), self.path("bank.safetensors"), "-o".to_owned(), self.path(output)]);
        args.extend(words("--test-fraction 0.5"));
        args.extend(self.study.scenes.half.then(|| "--half".to_owned()));
        args.extend(self.study.scenes.tar.iter().flat_map(|size| ["--tar".to_owned(), size.clone()]));
        Ok(args)
    }

    fn synth(&mut self) -> Result<Stage> {
        let told = self.ask(&self.synth_args("scenes", "dataset")?)?;
        self.synth = self.cost_of(&told, told.fixed, told.items);
        // The bank is stored once, and ground truths count as images.
        let bank = size_of(&self.folder.join("bank.safetensors"));
        let bytes = told.disk_bytes.saturating_sub(bank) as f64 / told.items as f64;
        self.run(&self.synth_args("few", "dataset")?)?;
        let scenes = self.study.scene_count(self.panoramas.len());
        let datasets = self.study.datasets();
        let images = datasets * scenes * self.study.angles()?.len();
        let jobs = datasets * self.study.shards.synth.min(scenes);
        Ok(stage("synth", (jobs, images), self.synth, bytes, told.memory_bytes))
    }

    fn train_args(&self, config: &Path, name: &str, more: &[String]) -> Vec<String> {
        let settings =
            self.study.training.set.iter().chain(more).flat_map(|set| ["--set".to_owned(), set.clone()]);
        let files = ["train".to_owned(), text_of(config), "--data".to_owned(), self.path("dataset")];
        let output = ["-o".to_owned(), self.path(&format!("run-{name}"))];
        files.into_iter().chain(output).chain(settings).collect()
    }

    /// One stage for each network, since their costs differ; a model of each is made for the evaluation.
    fn train(&mut self) -> Result<Vec<Stage>> {
        let mut stages = Vec::new();
        for (name, config) in &self.study.networks {
            let told = self.ask(&self.train_args(config, name, &[]))?;
            let cost = self.cost_of(&told, Spent::default(), told.items);
            let datasets = self.study.datasets();
            let bytes = told.disk_bytes as f64 / told.items.max(1) as f64;
            let all = (datasets, datasets * told.items);
            stages.push(stage(&format!("train {name}"), all, cost, bytes, told.memory_bytes));
            self.networks.insert(name.clone(), cost);
            let least = ["iterations=1", "data.batch=1", "data.accumulate=1"].map(str::to_owned);
            self.run(&self.train_args(config, name, &least))?;
        }
        Ok(stages)
    }

    fn eval_args(&self, dataset: &str, output: &str) -> Vec<String> {
        let study = self.study;
        let mut args = vec!["eval".to_owned(), self.path(dataset), "-o".to_owned(), self.path(output)];
        args.extend(["--metrics".to_owned(), study.evaluation.metrics.join(",")]);
        for name in study.networks.keys() {
            args.extend(["--model".to_owned(), self.path(&format!("run-{name}/model.safetensors"))]);
        }
        if !study.evaluation.methods.is_empty() {
            args.extend(["--method".to_owned(), study.evaluation.methods.join(",")]);
        }
        args
    }

    fn eval(&mut self) -> Result<Stage> {
        let told = self.ask(&self.eval_args("dataset", "results"))?;
        self.eval = self.cost_of(&told, told.fixed, told.items);
        let study = self.study;
        let scenes = study.scene_count(self.panoramas.len());
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of the scenes")]
        let tested = (scenes as f64 * study.scenes.test_fraction).round() as usize;
        let each = tested * study.angles()?.len();
        let jobs = study.datasets() * study.shards.eval.min(each);
        let bytes = told.disk_bytes as f64 / told.items.max(1) as f64;
        Ok(stage("eval", (jobs, study.datasets() * each), self.eval, bytes, told.memory_bytes))
    }

    /// Does a small study, and compares.
    pub(super) fn check(&self) -> Result<Vec<Check>> {
        let check = |stage: &str, items: usize, cost: LinearCost, measured: Spent| Check {
            stage: stage.to_owned(),
            items,
            predicted: cost.of(items as f64),
            measured,
        };
        let mut checks = Vec::new();
        let painted = self.paint(MORE_SCENES, "checked-scenes")?;
        checks.push(check("scenes", MORE_SCENES, self.scenes, painted));
        let images = MORE_SCENES * (self.study.rotations.dim + 1);
        let (_, spent) = self.run(&self.synth_args("checked-scenes", "checked-dataset")?)?;
        checks.push(check("synth", images, self.synth, spent));
        for (name, config) in &self.study.networks {
            let cost = self.networks[name];
            let wanted = (CHECKED_TRAINING / cost.each.core_seconds.max(1e-6)).clamp(2.0, 500.0);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
            let iterations = wanted as usize;
            let (run, set) = (format!("checked-{name}"), format!("iterations={iterations}"));
            let more = [set];
            let told = self.ask(&self.train_args(config, &run, &more))?;
            let cost = self.cost_of(&told, Spent::default(), told.items);
            let (_, spent) = self.run(&self.train_args(config, &run, &more))?;
            checks.push(check(&format!("train {name}"), iterations, cost, spent));
        }
        let args = self.eval_args("checked-dataset", "checked-results");
        let images = self.ask(&args)?.items;
        let (_, spent) = self.run(&args)?;
        checks.push(check("eval", images, self.eval, spent));
        Ok(checks)
    }
}

fn stage(
    name: &str,
    (jobs, items): (usize, usize),
    cost: LinearCost,
    disk_bytes_each: f64,
    memory_bytes: u64,
) -> Stage {
    Stage { name: name.to_owned(), jobs, items, cost, disk_bytes_each, memory_bytes }
}

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(str::to_owned).collect()
}

/// Whether a panel is the layout of a display, which is simulated, and not a PSF.
fn is_layout(panel: &Path) -> bool {
    panel.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
}

/// Bytes of a file, or of the files in a folder.
fn size_of(path: &Path) -> u64 {
    let Ok(entries) = std::fs::read_dir(path) else { return path.metadata().map_or(0, |file| file.len()) };
    entries.filter_map(|entry| Some(entry.ok()?.metadata().ok()?.len())).sum()
}
