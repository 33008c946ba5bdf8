//! `udc fuse`.

mod positions;
mod summary;

use std::path::PathBuf;

use anyhow::{Context as _, Result};
use clap::Args;
use serde_json::json;

use super::Session;
use super::bracket::BracketArgs;
use super::choices::Choices;
use super::domain::SceneDomainArgs;
use super::psf::check_float_output;
use udc::batch::check_kept;
use udc::capture::{Developed, PSF_BRACKET, SCENE_BRACKET, Told, names_of, read_mask, uncorrected};
use udc::core::provenance::Provenance;
use udc::io::{
    WriteOptions, check_distinct, check_output, expand_inputs, what_is_lost, write_image, write_psf,
};
use udc::psf::{MeasureConfig, Normalization, measure_psf};

use positions::Light;
use summary::Summary;

/// Fuse a bracket of exposures to one linear HDR image or PSF
#[derive(Args, Debug)]
#[command(
    after_help = "Example: udc fuse --exposures 1,1/32,1/768 long.exr middle.exr short.exr -o psf.exr --point-source\n\n\
    Give the times in the order of the files; files of one time are averaged. Levels above 1 are in the integers of the file: --white 16383 \
    --black 64 for 14 bits in a 16-bit PNG. DNGs say times, levels, mosaic and gains themselves"
)]
pub(crate) struct FuseArgs {
    /// Pictures of the bracket; a folder or pattern stands for its files by name
    #[arg(value_name = "IN", required = true)]
    inputs: Vec<PathBuf>,
    /// Image to write
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    #[command(flatten)]
    bracket: BracketArgs,
    #[command(flatten)]
    scene: SceneDomainArgs,
    /// Each folder is a bracket of one point source at another position: a mosaic sees a narrow core whole only from four,
    /// displaced by a pixel right, down, and both
    ///
    /// The folders, or one folder that holds them, are of equal exposures: --exposures are those of each. Displacements are
    /// found from the pictures; each colour is taken from its own photosites alone, and nothing is interpolated.
    #[arg(long, requires = "point_source", conflicts_with = "mask")]
    positions: bool,
    /// Picture that is black where pixels are to be discarded and filled from their neighbours
    #[arg(long, value_name = "MASK")]
    mask: Option<PathBuf>,
    /// The bracket is of a point source: cut out its PSF (background subtracted, main peak centred, cropped, normalised)
    #[arg(long)]
    point_source: bool,
    /// Side of the square PSF in pixels [default: 800]
    #[arg(long, value_name = "N", requires = "point_source")]
    size: Option<usize>,
    /// How the PSF is normalised [default: channel]
    #[arg(long, value_name = "WHAT", value_parser = NORMALIZATIONS, requires = "point_source")]
    normalize: Option<Normalization>,
}

const NORMALIZATIONS: Choices<Normalization> = Choices(&[
    ("channel", Normalization::Channel, "Each channel sums to 1"),
    ("total", Normalization::Total, "All channels together sum to 3"),
    ("none", Normalization::None, "As measured"),
]);

impl FuseArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        if self.point_source {
            check_float_output(&self.output)?;
        }
        check_output(&self.output, session.overwrite)?;
        let measure = self.point_source.then(|| self.measure_config());
        measure.as_ref().map_or(Ok(()), MeasureConfig::check)?;

        let told = self.told()?;
        let light = match self.positions {
            false => {
                let inputs = expand_inputs(&self.inputs)?;
                check_distinct("pictures", &inputs)?;
                Light::of_bracket(inputs, &told, session)?
            }
            true => Light::of_positions(&self.inputs, &told, session)?,
        };
        self.check_output_is_not_read(&light.inputs)?;
        let Light { inputs, developed: Developed { fused, info, raw, config, exposures, .. }, positions } =
            light;
        let doing = || format!("fusing bracket {}", names_of(&inputs));
        session.progress.check()?;
        let cut_out = |measure| measure_psf(&fused.image, told.mask.as_ref(), measure);
        let measured =
            measure.as_ref().map(|measure| session.timed("measuring the PSF", || cut_out(measure)));
        let measured = measured.transpose().with_context(doing)?;
        session.progress.check()?;

        let resolved = json!({"inputs": inputs, "exposures": exposures, "fuse": config, "psf": measure});
        let provenance = Some(Provenance::new("fuse", &resolved));
        let info = measured.is_none().then_some(info);
        let lost = info.as_ref().and_then(|info| what_is_lost(&self.output, info));
        lost.iter().for_each(|lost| session.note(lost));
        if let Some(warning) = raw.as_ref().and_then(uncorrected) {
            session.warn(warning);
        }
        let options = WriteOptions {
            overwrite: session.overwrite,
            provenance,
            capture: info,
            ..WriteOptions::default()
        };
        match (&measured, &measure) {
            (Some(measured), Some(MeasureConfig { normalize: Normalization::Channel, .. })) => {
                write_psf(&self.output, &measured.psf, &options)?;
            }
            (Some(measured), _) => write_image(&self.output, &measured.image, &options)?,
            (None, _) => write_image(&self.output, &fused.image, &options)?,
        }
        let summary = Summary {
            output: &self.output,
            fused: &fused,
            measured: measured.as_ref(),
            positions: &positions,
        };
        summary.warnings().into_iter().for_each(|warning| session.warn(warning));
        session.results_of(summary.json());
        session.say(summary.text())
    }

    /// Refuses to write over a picture, a dark frame or the mask.
    fn check_output_is_not_read(&self, pictures: &[PathBuf]) -> Result<()> {
        let darks = self.bracket.dark_frames();
        let darks = if darks.is_empty() { Vec::new() } else { expand_inputs(darks)? };
        let read: Vec<&PathBuf> = pictures.iter().chain(&darks).chain(&self.mask).collect();
        Ok(check_kept(std::slice::from_ref(&self.output), &read)?)
    }

    /// What the flags say of the pictures.
    fn told(&self) -> Result<Told> {
        Ok(Told {
            default_times: Some(if self.point_source { PSF_BRACKET } else { SCENE_BRACKET }),
            demosaic_linear: self.point_source,
            mask: self.mask.as_deref().map(read_mask).transpose()?,
            ..self.bracket.told(self.scene.domain)?
        })
    }

    fn measure_config(&self) -> MeasureConfig {
        let default = MeasureConfig::default();
        MeasureConfig {
            size: self.size.unwrap_or(default.size),
            normalize: self.normalize.unwrap_or(default.normalize),
        }
    }
}
