//! Turns files and folders of results into the blocks of a page, each recognised by what it holds.

use std::path::Path;

use super::page::{Block, Figure};
use super::{plots, sections};
use crate::core::error::{Error, Result};
use crate::dataset::Dataset;
use crate::experiment::{Document, LDR, MISMATCH, Mismatch, PICTURES, PictureName, RESULTS, Results};
use crate::io;

/// The log of a training, in its run's folder.
const LOG: &str = "metrics.jsonl";

/// Whether a file is a kernel bank by its name.
pub fn is_bank(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "safetensors")
}

/// The section of a kernel bank, or of a folder: an evaluation's results, a training run, a dataset.
///
/// # Errors
/// [`Error::Format`] for results that are damaged or of another layout; [`Error::Config`] for a log that is damaged;
/// [`Error::Unsupported`] when the folder holds none of these; those of reading banks and datasets.
pub fn gather(name: &str, input: &Path) -> Result<Vec<Block>> {
    if is_bank(input) {
        return Ok(sections::bank(name, &io::read_bank(input)?));
    }
    let [results, ..] = RESULTS.map(|file| input.join(file));
    let log = input.join(LOG);
    if results.is_file() {
        let mut blocks = sections::evaluation(name, &Results::read(&results)?);
        blocks.splice(2..2, pictures(&input.join(PICTURES))?);
        blocks.extend(further_plots(input)?);
        Ok(blocks)
    } else if log.is_file() {
        sections::training(name, &io::read_text(&log)?)
    } else if input.join("dataset.toml").is_file() || input.join("synthetic_data").is_dir() {
        Ok(sections::dataset(name, &Dataset::open(input)?))
    } else {
        let reason = "it holds no results: neither metrics.json (`udc eval`) nor metrics.jsonl (`udc train`) nor \
                      dataset.toml (`udc synth`)";
        Err(Error::Unsupported(reason.to_owned()))
    }
}

/// What an evaluation found of wrong kernels and of scenes of a monitor's range.
fn further_plots(results: &Path) -> Result<Vec<Block>> {
    let mut blocks = Vec::new();
    let [_, _, ldr] = LDR.map(|file| results.join(file));
    if ldr.is_file() {
        let caption = "Clean, degraded and added light; below, the same scene clipped to a monitor's range.";
        let figure = Figure { png: io::read_bytes(&ldr)?, caption: caption.to_owned() };
        blocks.push(Block::Figures(vec![figure]));
    }
    // Drawn anew from the numbers: a drawing in the folder may be anybody's, and would act in the page as its own.
    let [mismatch, _] = MISMATCH.map(|file| results.join(file));
    if mismatch.is_file() {
        let caption = "Restored under the kernel of every rotation, right (diagonal) and wrong.";
        let chart = |matrix| Block::Chart(plots::heat_map_of(matrix), caption.to_owned());
        blocks.extend(Mismatch::read(&mismatch)?.matrices.iter().map(chart));
    }
    Ok(blocks)
}

/// The pictures that an evaluation kept, a row for each scene.
fn pictures(folder: &Path) -> Result<Vec<Block>> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let files = io::list_folder(folder)?;
    let mut named: Vec<_> =
        files.iter().filter_map(|file| Some((PictureName::of_file(file)?, file))).collect();
    named.sort();
    let figure = |(name, file): &(PictureName<'_>, &String)| {
        let png = io::read_bytes(&folder.join(file))?;
        Ok(Figure { png, caption: format!("{}: {}", name.scene, name.what) })
    };
    let rows = named.chunk_by(|(a, _), (b, _)| a.scene == b.scene);
    rows.map(|row| Ok(Block::Figures(row.iter().map(figure).collect::<Result<_>>()?))).collect()
}
