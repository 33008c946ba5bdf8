//! `udc crop`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde_json::json;

use udc::core::shard::Shard;
use udc::crop::{Cut, CutCount, CutReport, View, aimed_views, spread_views};
use udc::io;

use super::choices::FLOAT_FORMATS;
use super::domain::SceneDomainArgs;
use super::dry_run::{DryRunArgs, PATIENCE};
use super::{Session, text_of};

/// Cut perspective views out of equirectangular HDR panoramas
///
/// The default views step evenly around the horizon, level, 30° up and 30° down in turn. Yaw 0 looks at the
/// panorama's centre and positive yaw to the right. Each pixel is the mean of the panorama over its area.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  udc crop panoramas/*.hdr -o views\n  \
    udc crop street.exr -o views --yaw=-90,0,90 --pitch 10 --fov 60 --size 512\n  \
    udc crop panoramas/*.hdr -o views --margin 400\n  \
    udc crop panoramas/*.hdr -o views --shard 2/8")]
pub(crate) struct CropArgs {
    /// Panoramas, twice as wide as high: files, folders or patterns
    #[arg(required = true, value_name = "PANORAMA")]
    panoramas: Vec<PathBuf>,
    #[command(flatten)]
    scene: SceneDomainArgs,
    /// Folder for the views, <panorama>_<nn>.<format>
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Side of the square views in pixels
    #[arg(long, value_name = "PX", default_value_t = 800)]
    size: usize,
    /// Field of view in degrees, between the centres of the outermost pixels
    #[arg(long, value_name = "DEG", default_value_t = 90.0)]
    fov: f64,
    /// Pixels more on each side, at the same focal length: the view is the middle, and light from outside of it reaches
    /// it in `udc synth`, which reads the margin from .exr files. Half the side of the PSF is enough
    #[arg(long, value_name = "PX", default_value_t = 0)]
    margin: usize,
    /// Number of views spread over each panorama
    #[arg(long, value_name = "N", default_value_t = 18, conflicts_with_all = ["yaw", "pitch"],
        value_parser = clap::builder::RangedU64ValueParser::<usize>::new().range(1..=999))]
    views: usize,
    /// Directions to look in, in degrees to the right, instead of the spread views
    #[arg(long, value_name = "DEG,…", value_delimiter = ',', allow_hyphen_values = true)]
    yaw: Vec<f64>,
    /// Degrees to look up; every yaw is taken at every pitch
    #[arg(long, value_name = "DEG,…", value_delimiter = ',', allow_hyphen_values = true)]
    pitch: Vec<f64>,
    /// Format of the views; .exr carries their origin
    #[arg(long, value_name = "FORMAT", value_parser = FLOAT_FORMATS, default_value = "exr")]
    format: &'static str,
    /// Write half floats
    #[arg(long)]
    half: bool,
    /// Cut only the I-th of N parts; all parts may be cut at the same time, into one folder
    #[arg(long, value_name = "I/N", default_value = "1/1")]
    shard: Shard,
    /// Keep views that are there, and cut the others; .npy does not say what it was cut out of, and is kept
    #[arg(long)]
    resume: bool,
    #[command(flatten)]
    dry_run: DryRunArgs,
}

impl CropArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        session.check_resume(self.resume)?;
        let cut = Cut {
            views: self.list_views(),
            margin: self.margin,
            told: self.scene.domain,
            image_format: self.format,
            half: self.half,
            overwrite: session.overwrite,
            resume: self.resume,
            shard: self.shard,
        };
        cut.check()?;
        if self.margin > 0 && self.format == "npy" {
            session.warn(format_args!(
                ".npy does not say that these views have a margin of {0}: give `udc synth --margin {0}`, or write .exr",
                self.margin
            ));
        }
        let panoramas = io::expand_inputs(&self.panoramas)?;
        if self.dry_run.dry_run {
            let estimate = cut.estimate(panoramas, &self.output, PATIENCE, &session.progress)?;
            return self.dry_run.tell("crop", &estimate, session);
        }
        let CutCount { panoramas, views, kept } =
            cut.run(panoramas, &self.output, &session.progress, |report| match report {
                CutReport::Others(others) => session.warn(others),
                CutReport::Read { panorama, warnings, time } => {
                    warnings.into_iter().for_each(|warning| session.warn(warning));
                    session.detail(format_args!("{panorama}: read in {time:.2?}"));
                }
                CutReport::Rendered { panorama, view, time } => {
                    session.detail(format_args!("{panorama} view {view}: rendered in {time:.2?}"));
                }
            })?;
        session.results_of(
            json!({ "output": text_of(&self.output), "panoramas": panoramas, "views": views, "kept": kept.whole }),
        );
        let margin = match self.margin {
            0 => String::new(),
            margin => format!(" and a margin of {margin} on each side"),
        };
        session.say(format_args!(
            "{}: {views} views of {panoramas} panoramas, {} × {} pixels{margin}{kept}",
            self.output.display(),
            self.size,
            self.size
        ))
    }

    fn list_views(&self) -> Vec<View> {
        if self.yaw.is_empty() && self.pitch.is_empty() {
            return spread_views(self.views, self.fov, self.size);
        }
        aimed_views(&self.yaw, &self.pitch, self.fov, self.size)
    }
}
