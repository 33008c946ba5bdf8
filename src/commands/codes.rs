//! `udc codes`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use serde_json::json;

use udc::batch::check_kept;
use udc::codes::{self, CODE_DIM, PUBLISHED_ANGLES_DEG};
use udc::core::kernel_code::KernelBank;
use udc::core::psf::Psf;
use udc::io;
use udc::psf::DisplayConfig;

use super::psf_file::PsfFileArgs;
use super::{Session, text_of};

/// Make kernel codes: rotate a PSF, find its PCA basis, store both as a kernel bank
///
/// One PSF is rotated to each of the angles, by interpolation. With --display, the panel itself is turned, and its PSFs
/// are simulated: exact, nothing is interpolated. Several PSFs are the set as they are. With --project, the code of
/// another PSF in an existing bank is found instead, with what the code leaves out.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  udc codes psf.exr -o bank.safetensors\n  \
    udc codes psf.exr --angles=-5,0,5 --dim 2 -o bank.safetensors\n  \
    udc codes --display configs/display/pentile.toml --angles=-12:12:3 -o bank.safetensors\n  \
    udc codes --project bank.safetensors other.exr -o code.npy")]
pub(crate) struct CodesArgs {
    /// The PSF to rotate, or the PSFs of a set: files, folders or patterns
    #[arg(required_unless_present = "display", value_name = "PSF")]
    psfs: Vec<PathBuf>,
    /// Display file (TOML) of a panel to turn and simulate, instead of a PSF
    #[arg(long, value_name = "FILE", conflicts_with_all = ["psfs", "project"])]
    display: Option<PathBuf>,
    /// Side of the simulated PSFs in pixels, instead of the display file's
    #[arg(long, value_name = "N", requires = "display", conflicts_with_all = ["psfs", "project"])]
    size: Option<usize>,
    /// Kernel bank to write (.safetensors); with --project, the code to write (.npy)
    #[arg(short, long, value_name = "FILE", required_unless_present = "project")]
    output: Option<PathBuf>,
    /// Rotations of a single PSF, or of the panel, in degrees, counter-clockwise: start:stop:step or a comma-separated list
    /// [default: -12:12:3]
    #[arg(long, value_parser = parse_angles, allow_hyphen_values = true)]
    angles: Option<Angles>,
    /// Length of a kernel code
    #[arg(long, value_name = "B", default_value_t = CODE_DIM)]
    dim: usize,
    /// Also write the published layout: <bank>_psf_<i>.npy and <bank>_code_<i>.npy in this folder
    #[arg(long, value_name = "DIR")]
    npy: Option<PathBuf>,
    /// Print the code of a PSF in this bank instead of making one
    #[arg(long, value_name = "BANK", conflicts_with_all = ["angles", "dim", "npy"])]
    project: Option<PathBuf>,
    #[command(flatten)]
    psf_file: PsfFileArgs,
}

#[derive(Clone, Debug)]
struct Angles(Vec<f64>);

fn parse_angles(text: &str) -> udc::core::error::Result<Angles> {
    codes::parse_angles(text).map(Angles)
}

impl CodesArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let inputs = || io::expand_inputs(&self.psfs);
        match (&self.project, &self.output) {
            (Some(bank), _) => self.project(session, bank, &inputs()?),
            (None, Some(output)) => self.make(session, output),
            (None, None) => bail!("name the kernel bank to write with -o"),
        }
    }

    fn make(&self, session: &Session, output: &Path) -> Result<()> {
        io::check_extension(output, "safetensors")?;
        io::check_output(output, session.overwrite)?;
        let started = Instant::now();
        let task = session.progress.task("making kernels and their codes");
        let bank = match &self.display {
            Some(display) => self
                .turned_bank(session, display)
                .with_context(|| format!("turning the panel of {}", display.display()))?,
            None => self.bank_of(session, &io::expand_inputs(&self.psfs)?)?,
        };
        drop(task);
        session.detail(format_args!("{} kernels and codes: {:.2?}", bank.len(), started.elapsed()));
        if let Some(folder) = &self.npy {
            let name = output.file_stem().unwrap_or_default().to_string_lossy();
            io::write_published_bank(folder, &name, &bank, session.overwrite)?;
        }
        io::write_bank(output, &bank, session.overwrite)?;
        session.results_of(json!({
            "output": text_of(output), "kernels": bank.len(), "angles-deg": bank.angles_deg,
            "code-dim": bank.code_dim(), "codes": bank.codes.rows().into_iter().map(|code| code.to_vec()).collect::<Vec<_>>(),
            "bank-sha256": io::bank_sha256(output)?,
        }));
        codes::code_lines(&bank).into_iter().try_for_each(|line| session.say(line))?;
        session.say(format_args!("{}: {}", output.display(), codes::bank_in_words(&bank)))
    }

    fn angles(&self) -> &[f64] {
        self.angles.as_ref().map_or(&PUBLISHED_ANGLES_DEG, |angles| &angles.0)
    }

    /// The bank of a panel that is turned and simulated.
    fn turned_bank(&self, session: &Session, display: &Path) -> Result<KernelBank> {
        if self.psf_file.is_given() {
            bail!("--domain and --recenter are for PSFs that are read; leave them out with --display");
        }
        let config = DisplayConfig::read(display, self.size)?;
        Ok(codes::make_turned_bank(&config, self.angles(), self.dim, &session.progress)?)
    }

    /// The bank of a PSF that is rotated, or of a set.
    fn bank_of(&self, session: &Session, paths: &[PathBuf]) -> Result<KernelBank> {
        if self.angles.is_some() && paths.len() > 1 {
            bail!(
                "--angles rotates one PSF, and {} were given; leave it out to use them as the set",
                paths.len()
            );
        }
        io::check_distinct("psfs", paths)?;
        let psfs: Vec<Psf> =
            paths.iter().map(|path| self.psf_file.read(path, session)).collect::<Result<_>>()?;
        match &psfs[..] {
            [psf] => codes::make_rotated_bank(psf, self.angles(), self.dim)
                .with_context(|| format!("making codes of {}", paths[0].display())),
            _ => codes::make_bank(psfs, None, self.dim).context("making codes of the set"),
        }
    }

    fn project(&self, session: &Session, bank: &Path, paths: &[PathBuf]) -> Result<()> {
        if let Some(output) = &self.output {
            io::check_extension(output, "npy")?;
            io::check_output(output, session.overwrite)?;
            check_kept(std::slice::from_ref(output), paths)?;
            if paths.len() > 1 {
                bail!(
                    "-o holds the code of one PSF, and {} were given; project them one by one",
                    paths.len()
                );
            }
        }
        let kernels = io::read_bank(bank)?;
        for path in paths {
            let projection = codes::project(&kernels, &self.psf_file.read(path, session)?)
                .with_context(|| format!("projecting {} onto {}", path.display(), bank.display()))?;
            session.found(
                &text_of(path),
                json!({
                    "code": projection.code.to_vec(), "residual-l2": projection.residual_l2,
                    "limit-l2": projection.limit_l2, "fits": projection.fits(),
                    "nearest": kernels.kernel_name(projection.nearest),
                }),
            );
            session.say(format_args!(
                "{}\n  {}",
                path.display(),
                projection.summary(&kernels).join("\n  ")
            ))?;
            if !projection.fits() {
                session.warn(format_args!(
                    "the bank cannot describe {}: it is further off than any kernel of the bank is from the \
                     others; make a bank of this PSF",
                    path.display()
                ));
            }
            if let Some(output) = &self.output {
                io::write_array(output, &projection.code.into_dyn(), session.overwrite)?;
            }
        }
        Ok(())
    }
}
