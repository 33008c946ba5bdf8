//! `udc crop`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use clap::{Args, ValueEnum};
use serde::Serialize;

use udc::core::image::Linear;
use udc::core::provenance::Provenance;
use udc::crop::{Panorama, View, crop_with_margin, spread_views};
use udc::io::{self, WriteOptions};

use super::Session;
use super::domain::SceneDomainArgs;

/// Cut perspective views out of equirectangular HDR panoramas
///
/// The default views step evenly around the horizon, level, 30° up and 30° down in turn. Yaw 0 looks at the
/// panorama's centre and positive yaw to the right. Each pixel is the mean of the panorama over its area.
#[derive(Args, Debug)]
#[command(after_help = "Examples:\n  udc crop panoramas/*.hdr -o views\n  \
    udc crop street.exr -o views --yaw=-90,0,90 --pitch 10 --fov 60 --size 512\n  \
    udc crop panoramas/*.hdr -o views --margin 400")]
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
    #[arg(long, value_enum, default_value_t = ViewFormat::Exr)]
    format: ViewFormat,
    /// Write half floats
    #[arg(long)]
    half: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ViewFormat {
    Exr,
    Npy,
}

/// What a view's provenance says.
#[derive(Serialize)]
struct Origin<'a> {
    panorama: &'a str,
    #[serde(flatten)]
    view: View,
    /// The key by which `udc synth` finds it.
    margin: usize,
}

impl CropArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let views = self.list_views();
        views.iter().try_for_each(|view| view.check_margin(self.margin))?;
        if self.margin > 0 && matches!(self.format, ViewFormat::Npy) {
            session.warn(format_args!(
                ".npy does not say that these views have a margin of {0}: give `udc synth --margin {0}`, or write .exr",
                self.margin
            ));
        }
        let panoramas = name_by_stem(io::expand_inputs(&self.panoramas)?)?;
        if self.output.exists() {
            for stem in panoramas.keys() {
                (1..=views.len())
                    .try_for_each(|n| io::check_output(&self.path(stem, n), session.overwrite))?;
            }
        }
        let bar = session.progress.bar((panoramas.len() * views.len()) as u64, "views");
        for (stem, path) in &panoramas {
            let started = Instant::now();
            let reading = || format!("reading the panorama {}", path.display());
            let (panorama, contradiction) =
                io::read_image_told::<Linear>(path, self.scene.told()).with_context(reading)?;
            contradiction.into_iter().for_each(|contradiction| session.warn(contradiction));
            let panorama = Panorama::new(panorama).with_context(reading)?;
            session.detail(format_args!("{stem}: read in {:.2?}", started.elapsed()));
            std::fs::create_dir_all(&self.output)
                .with_context(|| format!("creating the folder {}", self.output.display()))?;
            for (i, view) in views.iter().enumerate() {
                session.progress.check()?;
                let started = Instant::now();
                let image = crop_with_margin(&panorama, view, self.margin);
                session.detail(format_args!("{stem} view {}: rendered in {:.2?}", i + 1, started.elapsed()));
                let provenance =
                    Provenance::new("crop", &Origin { panorama: stem, view: *view, margin: self.margin });
                let (half, overwrite) = (self.half, session.overwrite);
                let provenance = Some(provenance);
                let options = WriteOptions { half, overwrite, provenance, ..WriteOptions::default() };
                io::write_image(&self.path(stem, i + 1), &image, &options)?;
                bar.inc(1);
            }
        }
        bar.finish_and_clear();
        let count = panoramas.len() * views.len();
        let margin = match self.margin {
            0 => String::new(),
            margin => format!(" and a margin of {margin} on each side"),
        };
        session.say(format_args!(
            "{}: {count} views of {} panoramas, {} × {} pixels{margin}",
            self.output.display(),
            panoramas.len(),
            self.size,
            self.size
        ))
    }

    fn list_views(&self) -> Vec<View> {
        if self.yaw.is_empty() && self.pitch.is_empty() {
            return spread_views(self.views, self.fov, self.size);
        }
        let or_level = |angles: &[f64]| if angles.is_empty() { vec![0.0] } else { angles.to_vec() };
        let (fov_deg, size, yaws) = (self.fov, self.size, or_level(&self.yaw));
        let views_at = |pitch_deg: f64| {
            yaws.iter().map(move |&yaw_deg| View { yaw_deg, pitch_deg, fov_deg, size }).collect::<Vec<_>>()
        };
        or_level(&self.pitch).into_iter().flat_map(views_at).collect()
    }

    fn path(&self, stem: &str, number: usize) -> PathBuf {
        let extension = match self.format {
            ViewFormat::Exr => "exr",
            ViewFormat::Npy => "npy",
        };
        self.output.join(format!("{stem}_{number:02}.{extension}"))
    }
}

/// Files by their names without extension, which name their views.
fn name_by_stem(paths: Vec<PathBuf>) -> Result<BTreeMap<String, PathBuf>> {
    let mut named: BTreeMap<String, PathBuf> = BTreeMap::new();
    for path in paths {
        let stem =
            path.file_stem().unwrap_or(Path::new("panorama").as_os_str()).to_string_lossy().into_owned();
        if let Some(other) = named.get(&stem) {
            bail!(
                "{} and {} would write the same views; rename one of them",
                other.display(),
                path.display()
            );
        }
        named.insert(stem, path);
    }
    Ok(named)
}
