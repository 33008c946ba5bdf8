//! `udc report`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;

use udc::io;
use udc::report::page::Page;
use udc::report::{self, sections};

use super::psf_file::PsfFileArgs;
use super::{Session, text_of};

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
        let bar = session.progress.bar(self.inputs.len() as u64, "inputs");
        for input in &self.inputs {
            if !input.is_dir() && !report::is_bank(input) {
                psfs.push((name_of(input), self.psf_file.read(input, session)?));
                bar.inc(1);
                continue;
            }
            let section = report::gather(&name_of(input), input);
            page.blocks.extend(section.with_context(|| format!("reading {}", input.display()))?);
            bar.inc(1);
        }
        if !psfs.is_empty() {
            page.blocks.splice(0..0, sections::psfs(&psfs));
        }
        let html = page.to_html();
        io::write_atomically(&self.output, session.overwrite, |file| file.write_all(html.as_bytes()))?;
        session.result("output", text_of(&self.output));
        session.tell(format_args!("wrote {}", self.output.display()));
        Ok(())
    }
}

fn name_of(path: &Path) -> String {
    path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
