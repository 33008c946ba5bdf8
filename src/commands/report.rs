//! `udc report`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::Args;

use udc::io;
use udc::report::{self, Origin, PAGE_BYTES, psf_section};

use super::psf_file::PsfFileArgs;
use super::{Session, browser, text_of};

/// Gather results in one self-contained page
///
/// Each input is recognised by what it holds: a PSF image, a kernel bank, a dataset, a training run, or the
/// results of an evaluation. The page needs no other file and loads nothing. The pictures that `udc eval --pictures` kept
/// lie under one divider, to be magnified to single pixels, as far as they fit into 25 MB; the light of the first scene is
/// developed by the page itself.
#[derive(Args, Debug)]
#[command(
    after_help = "Examples:\n  udc report psf.exr bank.safetensors dataset run results -o report.html\n  \
    udc report results -o report.html --open"
)]
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
    /// Open the page in a browser
    #[arg(long)]
    open: bool,
    #[command(flatten)]
    psf_file: PsfFileArgs,
}

impl ReportArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        io::check_extension(&self.output, "html")?;
        io::check_output(&self.output, session.overwrite)?;
        let bar = session.progress.bar(self.inputs.len() as u64, "inputs");
        let (mut psfs, mut sections, mut origins) = (Vec::new(), Vec::new(), Vec::new());
        for input in &self.inputs {
            session.progress.check()?;
            if let Some(folder) = report::folder_of_results(input) {
                bail!(
                    "{}: is one file of its folder; name the folder, {}",
                    input.display(),
                    folder.display()
                );
            }
            let (name, reading) = (name_of(input), || format!("reading {}", input.display()));
            if input.is_dir() || report::is_bank(input) {
                sections.push(report::gather(&name, input).with_context(reading)?);
            } else {
                psfs.push((name.clone(), self.psf_file.read(input, session)?));
            }
            origins.push(Origin::of(&name, input)?);
            bar.inc(1);
        }
        if let Some(apart) = report::told_apart(&sections) {
            session.warn(apart);
        }
        let before = if psfs.is_empty() { Vec::new() } else { psf_section::psfs(&psfs) };
        let page = report::assemble(self.title, before, sections, report::origins(&origins))?;
        let html = page.to_html();
        io::write_atomically(&self.output, session.overwrite, |file| file.write_all(html.as_bytes()))?;
        session.result("output", text_of(&self.output));
        if html.len() > PAGE_BYTES {
            let megabytes = html.len() / 1_000_000;
            session.warn(format_args!(
                "the page has {megabytes} MB, more than is easily sent; give it fewer inputs"
            ));
        }
        session.tell(format_args!("wrote {}", self.output.display()));
        if self.open {
            browser::open(&self.output, session);
        }
        Ok(())
    }
}

fn name_of(path: &Path) -> String {
    path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
