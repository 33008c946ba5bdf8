//! `udc view`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use clap::Args;

use udc::core::psf::Psf;
use udc::experiment::name_among;
use udc::io::{self, DomainTag, PsfOptions};
use udc::report::page::{Block, Page};
use udc::report::{self, OpenedImage, Origin, is_psf, psf_section};

use super::choices::DOMAINS;
use super::{Session, browser};

/// Look at images side by side in a browser
///
/// Writes one self-contained page with all values of the images, as half floats: two of them lie under one divider, are
/// moved and magnified together down to single pixels, and are developed by the page: exposure, difference, the values of
/// the pixel under the pointer. Images of different sizes are shown, and those of one size compared. PSFs that this program
/// made are shown with how they spread their light.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  udc view degraded.exr restored.exr clean.exr --reference clean.exr\n  \
    udc view results/pictures/*.exr -o pictures.html\n  udc view photo.jpg scan.png --domain srgb\n  \
    udc view psf.exr -o psf.html --open")]
pub(crate) struct ViewArgs {
    /// Images of any format that is read, folders or patterns
    #[arg(required = true, value_name = "IMAGE")]
    images: Vec<PathBuf>,
    /// The page to write [default: one in the folder for temporary files, which is opened]
    #[arg(short, long, value_name = "PAGE.html")]
    output: Option<PathBuf>,
    /// Open the page in a browser, as is done without --output
    #[arg(long)]
    open: bool,
    /// The image that differences are taken from, one of those given [default: the last]
    #[arg(long, value_name = "IMAGE")]
    reference: Option<PathBuf>,
    /// What the images hold, where they do not say so themselves; else floats are taken for linear light, and 8- and 16-bit
    /// files for sRGB
    #[arg(long, value_name = "DOMAIN", value_parser = DOMAINS)]
    domain: Option<DomainTag>,
    /// Show all images as PSFs
    #[arg(long, conflicts_with_all = ["reference"])]
    as_psf: bool,
    /// Title of the page
    #[arg(long, default_value = "Pictures")]
    title: String,
}

/// What is read of the files: images, and PSFs with their names.
#[derive(Default)]
struct Found {
    images: Vec<OpenedImage>,
    psfs: Vec<(String, Psf)>,
    origins: Vec<Origin>,
    reference: Option<usize>,
}

impl ViewArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        if let Some(output) = &self.output {
            io::check_extension(output, "html")?;
            io::check_output(output, session.overwrite)?;
        }
        let found = self.read(session)?;
        let page = Page { title: self.title.clone(), blocks: blocks_of(found)? };
        let html = page.to_html();
        let (path, overwrite) = match &self.output {
            Some(output) => (output.clone(), session.overwrite),
            None => (temporary_page()?, true),
        };
        io::write_atomically(&path, overwrite, |file| file.write_all(html.as_bytes()))?;
        session.tell(format_args!("wrote {}", path.display()));
        if self.open || self.output.is_none() {
            browser::open(&path, session);
        }
        Ok(())
    }

    fn read(&self, session: &Session) -> Result<Found> {
        let files = io::expand_inputs(&self.images)?;
        let reference = match &self.reference {
            Some(reference) => {
                let is_it = |file: &&PathBuf| io::identity(file) == io::identity(reference);
                Some(files.iter().find(is_it).cloned().with_context(|| {
                    format!(
                        "--reference {} is none of the images; give it among them too",
                        reference.display()
                    )
                })?)
            }
            None => None,
        };
        let mut found = Found::default();
        for file in &files {
            session.progress.check()?;
            let (name, opening) = (name_among(&files, file), || format!("opening {}", file.display()));
            if reference.as_ref() == Some(file) {
                found.reference = Some(found.images.len());
            }
            self.open(&name, file, session, &mut found).with_context(opening)?;
        }
        Ok(found)
    }

    fn open(&self, name: &str, file: &Path, session: &Session, found: &mut Found) -> Result<()> {
        let origin = Origin::of(name, file)?;
        if self.as_psf || (self.reference.is_none() && is_psf(origin.provenance.as_ref())) {
            let domain = self.domain.filter(|domain| *domain != DomainTag::ToneMapped);
            let reading = io::inspect_psf(file, PsfOptions { domain, ..PsfOptions::default() })?;
            reading.warnings().into_iter().for_each(|warning| session.warn(warning));
            found.psfs.push((name.to_owned(), reading.psf));
        } else {
            found.images.push(OpenedImage::open(name, file, self.domain, &session.progress)?);
        }
        found.origins.push(origin);
        Ok(())
    }
}

fn blocks_of(found: Found) -> Result<Vec<Block>> {
    let Found { images, psfs, origins, reference } = found;
    let mut blocks = if images.is_empty() { Vec::new() } else { report::view(images, reference)? };
    if !psfs.is_empty() {
        blocks.extend(psf_section::psfs(&psfs));
    }
    blocks.extend(report::origins(&origins));
    Ok(blocks)
}

/// A page of a name of its own in the folder for temporary files, where it stays.
fn temporary_page() -> Result<PathBuf> {
    let file = tempfile::Builder::new().prefix("udc-view-").suffix(".html").tempfile();
    let file = file.context("making a page in the folder for temporary files; name one by --output")?;
    Ok(file.into_temp_path().keep()?)
}
