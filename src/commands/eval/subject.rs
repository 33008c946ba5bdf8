//! What `udc eval` measures: models on a dataset, or one folder of images against another.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};

use udc::core::dataset::{Dataset, Split, Triplet};
use udc::core::error;
use udc::core::io::DomainTag;
use udc::core::progress::Progress;
use udc::core::tone::ToneCurve;
use udc::eval::{self, EvalConfig, Evaluation, FolderPairs, Label, Method, Sample};
use udc::network::Model;
use udc::restore::{Conditioning, NetworkRestorer, Tiling, restore_tiled};

use super::super::Session;
use super::Pictures;

/// Memory that one restoration may take; larger images are restored in tiles, with the same result.
const MEMORY_BYTES: u64 = 2 << 30;

/// Inputs that have been opened and found to fit together.
pub(super) enum Subject {
    /// Models, by name, on triplets of a dataset.
    Models { dataset: Box<Dataset>, models: Vec<(String, Model)>, triplets: Vec<Triplet> },
    /// Pairs of files, and what the undeclared ones hold.
    Folders { name: String, pairs: FolderPairs, domain: Option<DomainTag> },
}

impl Subject {
    pub(super) fn dataset(
        root: &Path,
        models: &[PathBuf],
        split: Split,
        limit: Option<usize>,
    ) -> Result<Self> {
        let dataset = Box::new(Dataset::open(root)?);
        let load = |path: &PathBuf| Ok((name_of(path), Model::load(path)?));
        let models: Vec<(String, Model)> = models.iter().map(load).collect::<error::Result<_>>()?;
        for (name, model) in &models {
            let (needed, found) = (model.architecture().code_dim, dataset.code_dim());
            if model.architecture().condition.uses_code() && needed != found {
                bail!(
                    "{name} needs kernel codes of {needed} numbers, and those of {} have {found}",
                    root.display()
                );
            }
        }
        let limit = limit.unwrap_or(usize::MAX);
        let triplets = dataset.split(split)?.into_iter().take(limit).cloned().collect();
        Ok(Self::Models { dataset, models, triplets })
    }

    pub(super) fn folders(
        restored: &Path,
        gt: &Path,
        domain: Option<DomainTag>,
        allow_missing: bool,
    ) -> Result<Self> {
        let pairs = eval::pair_folders(restored, gt)?;
        if let (Some((id, fault)), false) = (pairs.unmatched.first(), allow_missing) {
            let count = pairs.unmatched.len();
            bail!(
                "{count} images have no partner; {id} {fault}; add them, or leave them out with --allow-missing"
            );
        }
        Ok(Self::Folders { name: name_of(restored), pairs, domain })
    }

    /// What may be wrong and need not be.
    pub(super) fn warnings(&self) -> Vec<String> {
        let Self::Models { dataset, models, .. } = self else {
            return Vec::new();
        };
        let own = dataset.config.as_ref().map(|config| config.bank_sha256.as_str());
        let foreign = |model: &Model| {
            let trained = model.origin().kernel_bank_sha256.as_deref();
            model.architecture().condition.uses_code() && own.is_some() && trained.is_some() && own != trained
        };
        let warn = |(name, _): &(String, Model)| {
            format!(
                "{name} was trained with another kernel bank than the dataset's: its codes mean other PSFs"
            )
        };
        models.iter().filter(|(_, model)| foreign(model)).map(warn).collect()
    }

    /// Measures every image; pictures are kept of the models' only.
    pub(super) fn measure(
        &self,
        config: &EvalConfig,
        pictures: &Pictures,
        session: &Session,
    ) -> Result<Evaluation> {
        match self {
            Self::Models { dataset, models, triplets } => {
                let run = ModelRun { dataset, models, pictures, session };
                run.measure(config, triplets)
            }
            Self::Folders { name, pairs, domain } => measure_folders(config, session, name, pairs, *domain),
        }
    }
}

/// Models that restore the images of a dataset.
struct ModelRun<'a> {
    dataset: &'a Dataset,
    models: &'a [(String, Model)],
    pictures: &'a Pictures,
    session: &'a Session,
}

impl ModelRun<'_> {
    fn measure(&self, config: &EvalConfig, triplets: &[Triplet]) -> Result<Evaluation> {
        let curve = self.dataset.formation.curve()?;
        let bar = self.session.progress.bar(triplets.len() as u64, "triplets");
        let mut methods = vec![Method { name: "degraded".to_owned(), baseline: true }];
        let restored = self.models.iter().map(|(name, _)| Method { name: name.clone(), baseline: false });
        methods.extend(restored);
        let named = methods.clone();
        let samples = triplets.iter().enumerate().map(|(index, triplet)| {
            let label = Label { id: triplet.id.clone(), kernel: Some(triplet.kernel.clone()) };
            let scene = format!("{}_{}", triplet.id, triplet.kernel);
            let sample = self.restore(triplet, curve).and_then(|sample| {
                self.pictures.keep((index, triplets.len()), &scene, &named, &sample)?;
                Ok(sample)
            });
            bar.inc(1);
            (label, sample)
        });
        let evaluation = eval::measure(config, methods, samples)
            .with_context(|| format!("measuring on {}", self.dataset.root.display()))?;
        bar.finish_and_clear();
        Ok(evaluation)
    }

    fn restore(&self, triplet: &Triplet, curve: ToneCurve) -> error::Result<Sample> {
        self.session.progress.check()?;
        let degraded = curve.tone_map(&self.dataset.read_degraded(triplet)?);
        let ground_truth = curve.tone_map(&self.dataset.read_ground_truth(triplet)?);
        let mut images = vec![degraded.clone()];
        for (_, model) in self.models {
            let code = match model.architecture().condition.uses_code() {
                true => Conditioning::Code(self.dataset.code(triplet)?),
                false => Conditioning::None,
            };
            let restorer = NetworkRestorer::new(model, code)?;
            let tiling = Tiling::within(degraded.height(), degraded.width(), MEMORY_BYTES, &restorer)?;
            images.push(restore_tiled(&degraded, &tiling, &restorer, &Progress::default())?);
        }
        Ok(Sample { ground_truth, images })
    }
}

fn measure_folders(
    config: &EvalConfig,
    session: &Session,
    name: &str,
    found: &FolderPairs,
    domain: Option<DomainTag>,
) -> Result<Evaluation> {
    let bar = session.progress.bar(found.pairs.len() as u64, "images");
    let label = |id: &str| Label { id: id.to_owned(), kernel: None };
    let samples = found.pairs.iter().map(|pair| {
        let read = |path| eval::read_tone_mapped(path, domain, &ToneCurve::default());
        let sample = || {
            session.progress.check()?;
            bar.inc(1);
            Ok(Sample { ground_truth: read(&pair.ground_truth)?, images: vec![read(&pair.restored)?] })
        };
        (label(&pair.id), sample())
    });
    let method = Method { name: name.to_owned(), baseline: false };
    let mut evaluation = eval::measure(config, vec![method], samples)
        .with_context(|| format!("measuring the images of {name}"))?;
    for (id, fault) in &found.unmatched {
        evaluation.exclude(&label(id), *fault);
    }
    bar.finish_and_clear();
    Ok(evaluation)
}

/// What a model or a folder is called in tables: its name, with its folder's where the name says little.
fn name_of(path: &Path) -> String {
    let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let own = name(path).unwrap_or_else(|| path.display().to_string());
    match path.parent().and_then(name) {
        Some(folder) if own == "model.safetensors" => format!("{folder}/{own}"),
        _ => own,
    }
}
