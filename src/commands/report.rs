//! `udc report`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::Args;

use udc::dataset::Dataset;
use udc::experiment::Matrix;
use udc::io;
use udc::report::page::{Block, Figure, Page};
use udc::report::sections;

use super::Session;
use super::eval::pictures::{self, PictureName};
use super::eval::{MISMATCH, plots};
use super::psf_file::PsfFileArgs;

/// Gather results in one self-contained page
///
/// Each input is recognised by what it holds: a PSF image, a kernel bank, a dataset, a training run, or the
/// results of an evaluation. The page needs no other file and loads nothing.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  udc report psf.exr bank.safetensors dataset run results -o report.html")]
pub(crate) struct ReportArgs {
    /// PSF images, kernel banks, datasets, runs and results, in the order of the page
    #[arg(required = true, value_name = "DIR|FILE")]
    inputs: Vec<PathBuf>,
    /// The page to write
    #[arg(short, long, value_name = "REPORT.html")]
    output: PathBuf,
    /// Title of the page
    #[arg(long, default_value = "Under-display camera: results")]
    title: String,
    #[command(flatten)]
    psf_file: PsfFileArgs,
}

impl ReportArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        io::check_output(&self.output, session.overwrite)?;
        let mut page = Page { title: self.title, blocks: Vec::new() };
        let mut psfs = Vec::new();
        for input in &self.inputs {
            if !input.is_dir() && !is_bank(input) {
                psfs.push((name_of(input), self.psf_file.read(input, session)?));
                continue;
            }
            page.blocks.extend(section(input).with_context(|| format!("reading {}", input.display()))?);
        }
        if !psfs.is_empty() {
            page.blocks.splice(0..0, sections::psfs(&psfs));
        }
        let html = page.to_html();
        io::write_atomically(&self.output, session.overwrite, |file| file.write_all(html.as_bytes()))?;
        session.tell(format_args!("wrote {}", self.output.display()));
        Ok(())
    }
}

fn is_bank(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "safetensors")
}

fn name_of(path: &Path) -> String {
    path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

fn section(input: &Path) -> Result<Vec<Block>> {
    let name = name_of(input);
    if is_bank(input) {
        return Ok(sections::bank(&name, &io::read_bank(input)?));
    }
    let (log, results) = (input.join("metrics.jsonl"), input.join("metrics.json"));
    if results.is_file() {
        let metrics = serde_json::from_str(&io::read_text(&results)?)
            .with_context(|| format!("{} is damaged; run `udc eval` again", results.display()))?;
        let mut blocks = sections::evaluation(&name, &metrics);
        blocks.splice(2..2, pictures(&input.join(pictures::FOLDER))?);
        blocks.extend(further_plots(input)?);
        Ok(blocks)
    } else if log.is_file() {
        Ok(sections::training(&name, &io::read_text(&log)?)?)
    } else if input.join("dataset.toml").is_file() || input.join("synthetic_data").is_dir() {
        Ok(sections::dataset(&name, &Dataset::open(input)?))
    } else {
        bail!(
            "it holds no results: neither metrics.json (`udc eval`) nor metrics.jsonl (`udc train`) nor \
             dataset.toml (`udc synth`)"
        )
    }
}

/// What an evaluation drew of wrong kernels and of scenes of a monitor's range.
fn further_plots(results: &Path) -> Result<Vec<Block>> {
    let mut blocks = Vec::new();
    let ldr = results.join("ldr.png");
    if ldr.is_file() {
        let caption = "Clean, degraded and added light; below, the same scene clipped to a monitor's range.";
        let figure = Figure { png: io::read_bytes(&ldr)?, caption: caption.to_owned() };
        blocks.push(Block::Figures(vec![figure]));
    }
    // Drawn anew from the numbers: a drawing in the folder may be anybody's, and would act in the page as its own.
    let mismatch = results.join(MISMATCH[0]);
    if mismatch.is_file() {
        let damaged = || format!("{} is damaged; run `udc eval --mismatch` again", mismatch.display());
        let numbers = serde_json::from_str(&io::read_text(&mismatch)?).with_context(damaged)?;
        for matrix in Matrix::list_from_json(&numbers).map_err(anyhow::Error::msg).with_context(damaged)? {
            let caption = "Restored under the kernel of every rotation, right (diagonal) and wrong.";
            blocks.push(Block::Chart(plots::heat_map_of(&matrix), caption.to_owned()));
        }
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
