//! `udc info`.

use std::fmt::Write as _;
use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::Args;
use serde_json::json;
use terminal_size::{Width, terminal_size};

use udc::inspect::{Thumbnail, inspect, subjects};
use udc::network::Isa;
use udc::network::gpu::{self, GpuInfo};

use super::layer::LayerArgs;
use super::psf_file::PsfFileArgs;
use super::{Session, misuse};

/// Describe a file or folder: image, PSF, kernel bank, model, dataset, examples, training run, pose, configuration
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc info scene.exr bank.safetensors model.pth dataset/ configs/sftmd.toml\n         udc info --as-psf \
                        psf.exr\n         udc info --picture capture.exr psf.exr\n         udc info --json captures/*.png | jq .channels[0].max"
)]
pub(crate) struct InfoArgs {
    /// Files, datasets, training runs, folders of images, or patterns
    #[arg(required_unless_present = "devices", value_name = "FILE")]
    inputs: Vec<PathBuf>,
    #[command(flatten)]
    layer: LayerArgs,
    /// Describe images as PSFs: peak, energy radii, identity
    #[arg(long, alias = "psf")]
    as_psf: bool,
    #[command(flatten)]
    psf_file: PsfFileArgs,
    /// List the GPUs that networks can compute on
    #[arg(long, conflicts_with = "inputs")]
    devices: bool,
    /// Draw images, PSFs and kernel banks (by decades of light) on the terminal, in 24-bit colour; with a number of columns also where stdout
    /// is no terminal, as for `less -R`
    #[arg(long, value_name = "COLUMNS", num_args = 0..=1, require_equals = true, default_missing_value = "0")]
    #[arg(value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(..=1000))]
    picture: Option<usize>,
}

impl InfoArgs {
    pub(crate) fn run(mut self, session: &Session) -> Result<()> {
        if self.devices {
            return list_devices(session);
        }
        if session.is_json && self.picture.is_some() {
            return Err(misuse(
                "info",
                "--picture draws for people, and --json writes for scripts: give one of them",
            ));
        }
        if self.picture == Some(AS_WIDE_AS_FITS) && !std::io::stdout().is_terminal() {
            session.warn("stdout is no terminal, and nothing is drawn; --picture=80 draws 80 columns anyway");
            self.picture = None;
        }
        let mut files: Vec<Result<PathBuf>> = Vec::new();
        for input in self.layer.of(&self.inputs) {
            match subjects(&input) {
                Ok(found) => files.extend(found.into_iter().map(Ok)),
                Err(error) => files.push(Err(error.into())),
            }
        }
        if files.len() == 1 {
            return self.show(&files.remove(0)?, session);
        }
        let (count, mut failed) = (files.len(), 0);
        for file in files {
            session.progress.check()?;
            if let Err(error) = file.and_then(|file| self.show(&file, session)) {
                // Output that nobody reads any more ends the program; a file that is damaged does not.
                if super::is_broken_pipe(&error) {
                    return Err(error);
                }
                session.warn(format_args!("{error:#}"));
                failed += 1;
            }
        }
        if failed > 0 {
            bail!("{failed} of {count} files could not be described");
        }
        Ok(())
    }

    fn show(&self, file: &Path, session: &Session) -> Result<()> {
        let found = inspect(file, self.as_psf.then(|| self.psf_file.options()))?;
        if session.is_json {
            let mut object = serde_json::to_value(&found)?;
            object["file"] = file.to_string_lossy().into();
            session.say(object)
        } else {
            session.say(format_args!("{}: {found}", file.display()))?;
            let columns = match self.picture {
                None => return Ok(()),
                Some(AS_WIDE_AS_FITS) => terminal_columns().unwrap_or(COLUMNS).min(MOST_COLUMNS),
                Some(columns) => columns,
            };
            match Thumbnail::of(file, &found, self.psf_file.options(), columns)? {
                Some(picture) => session.say(drawn(&picture)),
                None => Ok(()),
            }
        }
    }
}

/// Lists what `--device` chooses among.
fn list_devices(session: &Session) -> Result<()> {
    if session.is_json {
        let device = |gpu: &GpuInfo| {
            json!({
                "device": format!("gpu:{}", gpu.number), "name": gpu.name, "interface": gpu.interface, "card": gpu.is_card,
            })
        };
        return gpu::list().iter().try_for_each(|gpu| session.say(device(gpu)));
    }
    session.say(format_args!("cpu: {} threads, {}", rayon::current_num_threads(), Isa::current().name()))?;
    gpu::list().iter().try_for_each(|gpu| session.say(gpu))?;
    if !gpu::IS_BUILT {
        session.tell(
            "this build computes on the CPU alone; `cargo build --release --features gpu` makes one for GPUs",
        );
    }
    Ok(())
}

/// What `--picture` without a number means.
const AS_WIDE_AS_FITS: usize = 0;

/// Columns of a terminal that does not say how many it has, and the most that are drawn without being asked for.
const COLUMNS: usize = 80;
const MOST_COLUMNS: usize = 120;

/// The columns that the terminal has.
fn terminal_columns() -> Option<usize> {
    let (Width(columns), _) = terminal_size()?;
    Some(usize::from(columns)).filter(|columns| *columns > 0)
}

/// A picture as text: two rows of pixels a line, the upper one as the colour of a half block and the lower one as its
/// background.
fn drawn(picture: &Thumbnail) -> String {
    let mut lines = Vec::new();
    for rows in picture.pixels.chunks(2 * picture.width) {
        let (upper, lower) = rows.split_at(picture.width.min(rows.len()));
        let mut line = String::new();
        for (x, [r, g, b]) in upper.iter().enumerate() {
            let below = lower.get(x).map_or(String::new(), |[r, g, b]| format!("\x1b[48;2;{r};{g};{b}m"));
            let _ = write!(line, "\x1b[38;2;{r};{g};{b}m{below}▀");
        }
        lines.push(line + "\x1b[0m");
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_rows_make_a_line_and_the_last_may_be_alone() {
        let picture = Thumbnail { width: 1, pixels: vec![[1, 2, 3], [4, 5, 6], [7, 8, 9]] };
        let expected = "\x1b[38;2;1;2;3m\x1b[48;2;4;5;6m▀\x1b[0m\n\x1b[38;2;7;8;9m▀\x1b[0m";
        assert_eq!(drawn(&picture), expected);
    }
}
