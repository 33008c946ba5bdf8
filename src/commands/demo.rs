//! `udc demo`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::{Args, Parser as _, value_parser};

use udc::dataset::{Dataset, Split};
use udc::io::{self, DomainTag, OwnedFolder, WriteOptions};
use udc::network::GUIDED;
use udc::scenes::point_source;

use super::choices::LIGHT_DOMAINS;
use super::synth::MOST_SEED;
use super::{Cli, Session, is_broken_pipe, text_of};

/// Run the whole pipeline on built-in scenes and write a page of results
///
/// Every step is a command that is printed before it runs, so that it can be repeated on files of your own.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  udc demo -o demo\n  udc demo --hdri panoramas -o demo")]
pub(crate) struct DemoArgs {
    /// Folder for everything that the demo makes
    #[arg(short, long, value_name = "DIR", default_value = "udc-demo")]
    output: PathBuf,
    /// Folder of HDR panoramas to use instead of the built-in scenes
    #[arg(long, value_name = "DIR")]
    hdri: Option<PathBuf>,
    /// What the panoramas hold, as in `udc crop`
    #[arg(long, value_name = "DOMAIN", value_parser = LIGHT_DOMAINS, requires = "hdri")]
    domain: Option<DomainTag>,
    /// Seed of the scenes, the noise and the training
    #[arg(long, value_name = "SEED", default_value_t = 1, value_parser = value_parser!(u64).range(..=MOST_SEED))]
    seed: u64,
    /// Take few small scenes and training steps: shows in seconds that every step works, and restores poorly
    #[arg(long)]
    quick: bool,
}

/// The panel that the demo simulates: a layout file as `udc psf` reads it.
const PANEL: &str = include_str!("demo/panel.toml");

/// The training of the demo: a configuration as `udc train` reads it.
const TRAINING: &str = include_str!("demo/training.toml");

/// How much the demo makes.
#[derive(Clone, Copy)]
struct Extent {
    /// Number of the scenes that are painted, and the side of the frame in their middle.
    scenes: usize,
    frame_px: usize,
    /// What the training's configuration is changed to.
    settings: &'static [&'static str],
}

const FULL: Extent = Extent { scenes: 18, frame_px: 288, settings: &[] };

/// Two scenes to test on; crops of 64 pixels fit, and the validation's get smaller.
const QUICK: Extent = Extent {
    scenes: 6,
    frame_px: 96,
    settings: &["iterations=8", "validation.every=4", "validation.crop=64", "checkpoint.every=4"],
};

/// Pixels of a scene around the frame: as far as the PSF throws light.
const MARGIN: usize = PSF_PX / 2;

/// What the scenes show: lamps, a sun, windows and text more often than chance would have it.
const KINDS: &str = "night,sky,indoor,page,foliage,glints";

/// Side of the PSF; the panel's file asks the sensor for as much.
const PSF_PX: usize = 129;

/// The kernel of the panel as it was measured, and those that results are measured with.
const UNTURNED: &str = "r+00";
const MEASURED_KERNELS: &str = "r-12,r+00,r+12";

/// The folder of a demo.
const FOLDER: OwnedFolder = OwnedFolder {
    owner: "a demo",
    marks: &[("panel.toml", PANEL), ("training.toml", TRAINING)],
    folders: &["psf", "scenes"],
    results: &["bank.safetensors", "dataset", "photograph.jpg", "run", "results", "report.html"],
};

impl DemoArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        if let Some(panoramas) = &self.hdri {
            let found = io::expand_inputs(std::slice::from_ref(panoramas))?.len();
            if found < 2 {
                bail!(
                    "{}: the demo needs two panoramas or more, one of them to test with",
                    panoramas.display()
                );
            }
        }
        let extent = if self.quick { QUICK } else { FULL };
        let demo = Demo { root: self.output, seed: self.seed, extent, session };
        let _held = FOLDER.prepare(&demo.root, session.overwrite)?;
        demo.measure_the_panel()?;
        match &self.hdri {
            Some(panoramas) => demo.crop(panoramas, self.domain)?,
            None => demo.paint()?,
        }
        demo.synthesise_restore_adapt_and_measure()?;
        session.result("report", text_of(&demo.path("report.html")));
        session.tell(format_args!("\nThe page with all results: {}", demo.path("report.html").display()));
        Ok(())
    }
}

struct Demo<'a> {
    root: PathBuf,
    seed: u64,
    extent: Extent,
    session: &'a Session,
}

impl Demo<'_> {
    fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Simulates the panel, records its PSF as a camera would, and measures it from the recording.
    fn measure_the_panel(&self) -> Result<()> {
        let size = PSF_PX.to_string();
        self.run(&["psf", "--display", "@panel.toml", "-o", "@psf/simulated.exr", "--size", &size])?;
        let psf = io::read_psf(&self.path("psf/simulated.exr"))?;
        let frames = point_source::expose(&psf, self.seed)?;
        let names: Vec<String> = (1..=frames.len()).map(|i| format!("psf/exposure-{i}.exr")).collect();
        for (frame, name) in frames.iter().zip(&names) {
            io::write_image(&self.path(name), frame, &WriteOptions::default())?;
        }
        self.session.tell("# its point spread function is recorded in three noisy 14-bit exposures");
        let names: Vec<String> = names.iter().map(|name| format!("@{name}")).collect();
        let mut fuse = vec!["fuse", "--point-source", "--exposures", "1,1/32,1/768", "--size", &size];
        fuse.extend(names.iter().map(String::as_str));
        fuse.extend(["-o", "@psf/measured.exr"]);
        self.run(&fuse)?;
        self.run(&["codes", "@psf/measured.exr", "--angles=-12:12:3", "-o", "@bank.safetensors"])
    }

    fn paint(&self) -> Result<()> {
        let Extent { scenes, frame_px, .. } = self.extent;
        let [count, size, margin, seed] =
            [scenes.to_string(), frame_px.to_string(), MARGIN.to_string(), self.seed.to_string()];
        let paint = ["scenes", "-o", "@scenes", "--count", &count, "--seed", &seed, "--kinds", KINDS];
        self.run(&[&paint[..], &["--size", &size, "--margin", &margin]].concat())
    }

    fn crop(&self, panoramas: &Path, domain: Option<DomainTag>) -> Result<()> {
        let panoramas = std::path::absolute(panoramas)?;
        let (size, margin) = (self.extent.frame_px.to_string(), MARGIN.to_string());
        let panoramas = panoramas.to_string_lossy();
        let crop = ["crop", &panoramas, "-o", "@scenes", "--size", &size, "--margin", &margin];
        let domain = domain.map(|domain| ["--domain", domain.name()]);
        let domain = domain.as_ref().map_or(&[][..], |domain| domain);
        self.run(&[&crop[..], &["--views", "6", "--fov", "60"], domain].concat())
    }

    fn synthesise_restore_adapt_and_measure(&self) -> Result<()> {
        let (seed, margin) = (self.seed.to_string(), MARGIN.to_string());
        let synth =
            ["synth", "@scenes", "--margin", &margin, "--bank", "@bank.safetensors", "-o", "@dataset"];
        self.run(&[&synth[..], &["--seed", &seed, "--test-fraction", "0.34"]].concat())?;
        self.session.tell("# a capture becomes a photograph: nothing but the PSF is needed");
        let capture = self.capture()?;
        self.run(&["restore", &capture, "--psf", "@psf/measured.exr", "-o", "@photograph.jpg"])?;
        self.session.tell("# the network for any panel is adapted to this one");
        let seed = format!("seed={seed}");
        let mut train = vec!["train", "@training.toml", "--data", "@dataset", "--init", GUIDED, "-o", "@run"];
        train.extend(["--set", &seed]);
        train.extend(self.extent.settings.iter().flat_map(|setting| ["--set", setting]));
        self.run(&train)?;
        let candidates = ["--method", "constrained,guided", "--model", "@run/best.safetensors"];
        let measured = ["--kernels", MEASURED_KERNELS, "--pictures", "6", "-o", "@results"];
        self.run(&[&["eval", "@dataset"][..], &candidates, &measured].concat())?;
        let psfs = ["@psf/simulated.exr", "@psf/measured.exr"];
        let folders = ["@bank.safetensors", "@dataset", "@run", "@results"];
        let report: Vec<_> = [&["report"][..], &psfs, &folders, &["-o", "@report.html"]].concat();
        self.run(&report)
    }

    /// A degraded image that is for testing, seen through the panel as it was measured.
    fn capture(&self) -> Result<String> {
        let root = self.path("dataset");
        let dataset = Dataset::open(&root)?;
        let mut of_test = dataset.triplets.iter().filter(|triplet| triplet.split == Split::Test);
        let capture =
            of_test.find(|triplet| triplet.kernel == UNTURNED).context("no image is for testing")?;
        Ok(format!("@dataset/{}", capture.degraded))
    }

    /// Prints a command of this program as the user would type it, and runs it; an argument that starts with
    /// `@` is a path in the demo's folder.
    fn run(&self, arguments: &[&str]) -> Result<()> {
        let place = |argument: &&str| match argument.strip_prefix('@') {
            Some(name) => self.path(name).to_string_lossy().into_owned(),
            None => (*argument).to_owned(),
        };
        let arguments: Vec<String> = arguments.iter().map(place).collect();
        let line = arguments.join(" ");
        self.session.stage(&format!("udc {line}"));
        self.session.tell(format_args!("$ udc {line}"));
        let cli = Cli::try_parse_from(std::iter::once("udc".to_owned()).chain(arguments))?;
        match self.session.within(|| cli.command.run(self.session)) {
            // A command says its result when all is written.
            Err(error) if is_broken_pipe(&error) => Ok(()),
            result => result.with_context(|| format!("running udc {line}")),
        }
    }
}
