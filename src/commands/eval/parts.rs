//! `udc eval --shard` and `--merge`: a part of the images measured, and parts joined to results.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Result, bail};

use udc::core::shard::Shard;
use udc::experiment::{
    Experiment, LDR, LdrRow, Measurement, MergedParts, PICTURES, Part, PartFiles, ResultsFolder,
    files_of_evaluation,
};
use udc::io;
use udc::report::picture;

use super::EvalArgs;
use crate::commands::{Session, text_of};

impl EvalArgs {
    /// Measures the images of a shard on datasets, and writes them as a part.
    pub(super) fn compare_part(
        &self,
        shard: Shard,
        experiment: &Experiment<'_>,
        session: &Session,
    ) -> Result<()> {
        let pictures = experiment.pictures_kept();
        let names = pictures.iter().map(|name| format!("{PICTURES}/{name}"));
        self.prepare_part(shard, names, session)?;
        let (measurement, rows) = experiment.measure(&self.output)?;
        let mut described = experiment.describe();
        // Those that come with the program are known by their name.
        for model in self.model.iter().filter(|model| model.is_file()) {
            described.insert(format!("model {}", text_of(model)), io::sha256_of_file(model)?);
        }
        described.extend(self.metrics.describe()?);
        self.write_part(Part::new(shard, described, pictures, measurement), &rows, session)
    }

    /// Writes the part of a shard of two folders' images.
    pub(super) fn write_part_of_folders(
        &self,
        shard: Shard,
        mut described: BTreeMap<String, String>,
        measurement: Measurement,
        session: &Session,
    ) -> Result<()> {
        described.extend(self.metrics.describe()?);
        self.write_part(Part::new(shard, described, Vec::new(), measurement), &[], session)
    }

    /// Makes the folder and checks, before the work, that what the shard writes may be written; other shards' files stay.
    pub(super) fn prepare_part(
        &self,
        shard: Shard,
        more: impl Iterator<Item = String>,
        session: &Session,
    ) -> Result<()> {
        let files = PartFiles::of(shard);
        io::create_folder(&self.output)?;
        for name in [files.part, files.ldr].into_iter().chain(more) {
            let path = self.output.join(name);
            if path.symlink_metadata().is_ok() {
                io::check_output(&path, session.overwrite)?;
            }
        }
        Ok(())
    }

    fn write_part(&self, part: Part, rows: &[LdrRow], session: &Session) -> Result<()> {
        let (files, overwrite) = (PartFiles::of(part.shard), session.overwrite);
        if !rows.is_empty() {
            let png = picture::grid(rows);
            io::write_atomically(&self.output.join(files.ldr), overwrite, |file| file.write_all(&png))?;
        }
        // Last: a part that is there is whole.
        part.write(&self.output, overwrite)?;
        session.say(self.output.join(files.part).display())
    }

    /// Joins parts to the results of one run.
    pub(super) fn join_parts(&self, session: &Session) -> Result<()> {
        let merged = MergedParts::read(&self.merge)?;
        merged.warnings.iter().for_each(|warning| session.warn(warning));
        if let Some(picture) = merged.pictures.iter().find(|picture| is_within(picture, &self.output)) {
            bail!(
                "{} lies in the folder for the results, which would replace it; name another one with -o",
                picture.display()
            );
        }
        let findings = merged.measurement.into_findings()?;
        let pictures = merged.pictures.iter().map(|path| (picture_name(path), path));
        let pictures: Vec<_> = pictures.collect();
        let ldr = merged.ldr.map(|path| (LDR[2].to_owned(), path));
        let names = files_of_evaluation(findings.evaluation.metrics.iter().copied()).into_iter();
        let more =
            pictures.iter().map(|(name, _)| name.clone()).chain(ldr.iter().map(|(name, _)| name.clone()));
        let outputs =
            ResultsFolder::prepare(&self.output, &names.chain(more).collect::<Vec<_>>(), session.overwrite)?;
        outputs.remove_earlier_pictures()?;
        if !pictures.is_empty() {
            io::create_folder(&self.output.join(PICTURES))?;
        }
        pictures.iter().try_for_each(|(name, path)| outputs.write(name, &io::read_bytes(path)?))?;
        let ldr = ldr.map(|(_, path)| io::read_bytes(&path)).transpose()?;
        self.write(&findings, ldr.as_deref(), outputs, session)
    }
}

fn picture_name(path: &Path) -> String {
    format!("{PICTURES}/{}", path.file_name().unwrap_or_default().to_string_lossy())
}

/// Whether a picture lies where the results' pictures go.
fn is_within(picture: &Path, results: &Path) -> bool {
    let folder = picture.parent().and_then(|folder| folder.canonicalize().ok());
    folder.is_some() && folder == results.join(PICTURES).canonicalize().ok()
}
