//! Measures the images of one folder against those of another.

use std::path::Path;

use anyhow::{Context as _, Result, bail};

use udc::experiment::{
    self, EvalConfig, Evaluation, FolderPairs, Label, Method, Sample, ToneFlags, ToneSource,
};
use udc::io::DomainTag;

use crate::commands::Session;

/// Pairs of files, and what those hold that do not say it.
pub(super) struct Folders {
    name: String,
    found: FolderPairs,
    domain: Option<DomainTag>,
    tone: ToneSource,
}

impl Folders {
    pub(super) fn open(
        restored: &Path,
        ground_truth: &Path,
        (domain, flags): (Option<DomainTag>, ToneFlags),
        allow_missing: bool,
    ) -> Result<Self> {
        let found = experiment::pair_folders(restored, ground_truth)?;
        if let (Some((id, fault)), false) = (found.unmatched.first(), allow_missing) {
            let count = found.unmatched.len();
            bail!(
                "{count} images have no partner; {id} {fault}; add them, or leave them out with --allow-missing"
            );
        }
        let tone = ToneSource::of_pairs(&found.pairs, flags)?;
        Ok(Self { name: super::name_of(restored), found, domain, tone })
    }

    pub(super) fn measure(&self, config: &EvalConfig, session: &Session) -> Result<Evaluation> {
        let bar = session.progress.bar(self.found.pairs.len() as u64, "images");
        let read = |path: &Path| {
            let (image, contradiction) = experiment::read_tone_mapped(path, self.domain, &self.tone.curve)?;
            contradiction.into_iter().for_each(|contradiction| session.warn(contradiction));
            Ok(image)
        };
        let samples = self.found.pairs.iter().map(|pair| {
            let sample = || {
                session.progress.check()?;
                bar.inc(1);
                let images = vec![read(&pair.restored)?];
                Ok(Sample { ground_truth: read(&pair.ground_truth)?, images, regions: None })
            };
            (Label::scene(&pair.id), sample())
        });
        let mut evaluation = experiment::measure(config, vec![Method::restored(&self.name)], samples)
            .with_context(|| format!("measuring the images of {}", self.name))?;
        evaluation.tone = Some(self.tone);
        for (id, fault) in &self.found.unmatched {
            evaluation.exclude(&Label::scene(id), *fault);
        }
        bar.finish_and_clear();
        Ok(evaluation)
    }
}
