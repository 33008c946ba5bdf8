//! Turns files and folders of results into the blocks of a page, each recognised by what it holds.

use std::path::Path;

use super::kept::KeptScenes;
use super::page::{Block, Figure};
use super::{plots, psf_section, sections};
use crate::core::error::{Error, Result};
use crate::dataset::{CONFIG_FILE, Dataset};
use crate::experiment::{Document, LDR, MISMATCH, Mismatch, RESULTS, Results};
use crate::io;

/// The log of a training, in its run's folder.
const LOG: &str = "metrics.jsonl";

/// Whether a file is a kernel bank by its name.
pub fn is_bank(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "safetensors")
}

/// The folder that a file of results belongs to: a page shows the folder as a whole.
pub fn folder_of_results(input: &Path) -> Option<&Path> {
    let [results, ..] = RESULTS;
    let names = [results, LOG, CONFIG_FILE];
    let is_one = input.file_name().is_some_and(|name| names.iter().any(|known| name == *known));
    let folder = input.parent().filter(|_| is_one && input.is_file())?;
    Some(if folder.as_os_str().is_empty() { Path::new(".") } else { folder })
}

/// What a page says of one input.
#[derive(Clone, Debug)]
pub struct Section {
    /// Its blocks, without the viewer.
    pub blocks: Vec<Block>,
    /// The pictures of its viewer, which take as much room as the page has left.
    pub pictures: Option<KeptScenes>,
    /// Name and definition of an evaluation, in short.
    pub measured: Option<(String, String)>,
}

/// What to tell where evaluations of one page are not defined alike, so that their numbers cannot be compared.
pub fn told_apart(sections: &[Section]) -> Option<String> {
    let mut measured = sections.iter().filter_map(|section| section.measured.as_ref());
    let (first, definition) = measured.next()?;
    let (other, differs) = measured.find(|(_, other)| other != definition)?;
    Some(format!(
        "the numbers of {first} ({definition}) and of {other} ({differs}) are defined otherwise and cannot be compared"
    ))
}

/// The place of an evaluation's viewer: behind heading and table.
const PLACE_OF_VIEWER: usize = 2;

impl Section {
    fn of_blocks(blocks: Vec<Block>) -> Self {
        Self { blocks, pictures: None, measured: None }
    }

    /// All blocks, the viewer among them, which takes no more than `room` bytes of the page.
    ///
    /// # Errors
    /// Those of [`KeptScenes::embed`].
    pub fn into_blocks(mut self, room: usize) -> Result<Vec<Block>> {
        if let Some(pictures) = &self.pictures {
            let viewer = pictures.embed(room)?;
            self.blocks.insert(PLACE_OF_VIEWER, Block::Viewer(Box::new(viewer)));
        }
        Ok(self.blocks)
    }
}

/// The section of a kernel bank, or of a folder: an evaluation's results, a training run, a dataset.
///
/// # Errors
/// [`Error::Format`] for results that are damaged or of another layout; [`Error::Config`] for a log that is damaged;
/// [`Error::Unsupported`] when the folder holds none of these; those of reading banks and datasets.
pub fn gather(name: &str, input: &Path) -> Result<Section> {
    if is_bank(input) {
        return Ok(Section::of_blocks(psf_section::bank(name, &io::read_bank(input)?)));
    }
    let [results, ..] = RESULTS.map(|file| input.join(file));
    let log = input.join(LOG);
    if results.is_file() {
        let results = Results::read(&results)?;
        let mut blocks = sections::evaluation(name, &results);
        blocks.extend(further_plots(input)?);
        let measured = Some((name.to_owned(), results.definition.in_short()));
        Ok(Section { blocks, pictures: KeptScenes::find(input, &results.definition)?, measured })
    } else if log.is_file() {
        Ok(Section::of_blocks(sections::training(name, &io::read_text(&log)?)?))
    } else if input.join(CONFIG_FILE).is_file() || input.join("synthetic_data").is_dir() {
        Ok(Section::of_blocks(sections::dataset(name, &Dataset::open(input)?)))
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
        let figure = Figure { picture: io::read_bytes(&ldr)?, caption: caption.to_owned() };
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
