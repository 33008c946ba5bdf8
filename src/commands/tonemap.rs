//! `udc tonemap`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};
use serde_json::json;

use super::Session;
use udc::core::image::{Linear, ToneMapped};
use udc::core::io::{WriteOptions, check_output, expand_inputs, read_image, write_image};
use udc::core::provenance::Provenance;
use udc::core::tone::ToneCurve;

/// Apply the tone mapping or its inverse
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc tonemap scene.exr -o scene.png\n         udc tonemap --inverse restored.png -o \
                        restored.exr\n\nThe mapping is x/(x+alpha) of x clipped to x-max"
)]
pub(crate) struct TonemapArgs {
    /// Images, folders or patterns
    #[arg(required = true, value_name = "IN")]
    inputs: Vec<PathBuf>,
    /// Image to write; a folder for several inputs
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Map tone-mapped values back to linear light
    #[arg(long)]
    inverse: bool,
    /// Irradiance that is mapped to one half
    #[arg(long, value_name = "A", default_value_t = ToneCurve::default().alpha)]
    alpha: f32,
    /// Irradiance at which the sensor saturates
    #[arg(long, value_name = "X", default_value_t = ToneCurve::default().x_max)]
    x_max: f32,
    /// Format of the files in an output folder
    #[arg(long, value_enum, default_value_t = FormatArg::Exr)]
    format: FormatArg,
    /// Write half floats, in formats that have them
    #[arg(long)]
    half: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FormatArg {
    Exr,
    Npy,
    Png,
    Tif,
}

impl TonemapArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let curve = ToneCurve::new(self.alpha, self.x_max)?;
        for (input, output) in self.pairs(session)? {
            session.progress.check()?;
            self.convert(&input, &output, curve, session)
                .with_context(|| format!("tone mapping {}", input.display()))?;
            session.tell(output.display());
        }
        Ok(())
    }

    /// The output of each input; makes the output folder and refuses outputs that exist, before any work.
    fn pairs(&self, session: &Session) -> Result<Vec<(PathBuf, PathBuf)>> {
        let inputs = expand_inputs(&self.inputs)?;
        let to_folder = inputs.len() > 1 || self.output.is_dir();
        if to_folder {
            std::fs::create_dir_all(&self.output)
                .with_context(|| format!("creating the folder {}", self.output.display()))?;
        }
        let extension = self.format.to_possible_value().expect("no format is hidden").get_name().to_owned();
        let output_of = |input: &Path| match input.file_stem() {
            Some(stem) if to_folder => {
                let mut name = stem.to_owned();
                name.push(".");
                name.push(&extension);
                self.output.join(name)
            }
            _ => self.output.clone(),
        };
        let pairs: Vec<(PathBuf, PathBuf)> =
            inputs.into_iter().map(|input| (input.clone(), output_of(&input))).collect();
        for (index, (input, output)) in pairs.iter().enumerate() {
            check_output(output, session.overwrite)?;
            if let Some((other, _)) = pairs[..index].iter().find(|(_, earlier)| earlier == output) {
                bail!(
                    "{} and {} would both be written to {}",
                    other.display(),
                    input.display(),
                    output.display()
                );
            }
        }
        Ok(pairs)
    }

    fn convert(&self, input: &Path, output: &Path, curve: ToneCurve, session: &Session) -> Result<()> {
        let config = json!({"input": input.to_string_lossy(), "inverse": self.inverse, "tone": curve});
        let options = WriteOptions {
            half: self.half,
            overwrite: session.overwrite,
            provenance: Some(Provenance::new("tonemap", &config)),
        };
        if self.inverse {
            let image = read_image::<ToneMapped>(input)?;
            write_image(output, &curve.inverse_tone_map(&image), &options)?;
        } else {
            let image = read_image::<Linear>(input)?;
            write_image(output, &curve.tone_map(&image), &options)?;
        }
        Ok(())
    }
}
