//! `udc pose`.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use clap::{ArgGroup, Args};
use serde_json::{Value, json};

use udc::batch::check_kept;
use udc::capture::Told;
use udc::core::psf::Psf;
use udc::core::tone::{ToneCurve, ToneFlags};
use udc::io::{DomainTag, check_extension, check_output, expand_inputs};
use udc::restore::{
    Capture, FoundPose, FromOutside, Pose, PoseConfig, PoseEstimate, find_pose, find_pose_by_lamp_outside,
    psf_seen, write_pose,
};

use super::choices::DOMAINS;
use super::psf_file::{PSF_FILES, PsfAmongImagesArgs};
use super::{Session, text_of};

/// Find by how much a panel is turned and scaled against its PSF, from the flare of lamps
///
/// What the lamps of a capture throw over its surroundings tells in which pose the PSF explains it: to 0.02 degrees and 0.1 %
/// where flare is strong, be it of lamps in the frame or of a sun beyond its border. Captures of one device,
/// taken with the panel as it is, are combined, each by how much it tells; those without lamps, or with weak flare, tell
/// nothing. Turns of up to 1 degree and scales of up to 1.5 % are looked for.
#[derive(Args, Debug)]
#[command(group = ArgGroup::new(PSF_FILES).args(["psf"]).multiple(true))]
#[command(after_help = "Examples:\n  \
    udc pose night.exr --psf psf.exr -o pose.toml\n  \
    udc pose captures/*.dng --psf psf.exr -o pose.toml")]
pub(crate) struct PoseArgs {
    /// Captures of one device: images or raw pictures of one exposure, folders or patterns
    #[arg(required = true, value_name = "CAPTURE")]
    inputs: Vec<PathBuf>,
    /// PSF of the panel
    #[arg(long, value_name = "PSF")]
    psf: PathBuf,
    /// Pose to write (.toml)
    #[arg(short, long, value_name = "POSE")]
    output: PathBuf,
    #[command(flatten)]
    psf_file: PsfAmongImagesArgs,
    /// What the captures hold: srgb is decoded to linear light [default: what the file says, else linear; required for 8-
    /// and 16-bit files that do not say it]
    #[arg(long, value_name = "DOMAIN", value_parser = DOMAINS)]
    domain: Option<DomainTag>,
    /// Irradiance that the tone mapping maps to one half [default: what a tone-mapped file says, else 0.25]
    #[arg(long, value_name = "A")]
    alpha: Option<f32>,
    /// Irradiance at which the captures saturate, at most [default: what the file says, else the value that the brightest
    /// pixels share]
    #[arg(long, value_name = "X")]
    x_max: Option<f32>,
}

impl PoseArgs {
    pub(crate) fn run(self, session: &Session) -> Result<()> {
        let curve = self.tone().over(ToneCurve::default())?;
        let files = expand_inputs(&self.inputs)?;
        check_extension(&self.output, "toml")?;
        check_output(&self.output, session.overwrite)?;
        let read: Vec<&PathBuf> = files.iter().chain([&self.psf]).collect();
        check_kept(std::slice::from_ref(&self.output), &read)?;
        let psf = self.psf_file.read(&self.psf, session)?;
        let mut estimates = Vec::new();
        let count = if files.len() > 1 { files.len() as u64 } else { 0 };
        let bar = (count > 0).then(|| session.progress.bar(count, "captures"));
        for file in &files {
            let found = self.estimate(file, &psf, curve, session);
            let found = found.with_context(|| format!("finding the pose in {}", file.display()))?;
            match &found {
                Ok(found) => session.tell(format_args!("{}: {found}", file.display())),
                Err(why) => session.tell(format_args!("{}: tells nothing: {why}", file.display())),
            }
            session.found(&text_of(file), pose_for_scripts(&found));
            estimates.extend(found);
            bar.iter().for_each(|bar| bar.inc(1));
        }
        let Some(pose) = Pose::of_estimates(&psf, &estimates) else {
            let at = self.x_max.map_or(String::new(), |x_max| format!(" at --x-max {x_max}"));
            bail!(
                "no capture tells the pose{at}; take one of a bright lamp, small in the frame, before what is dark"
            );
        };
        if let Some(contradiction) = Pose::describe_contradiction(&estimates) {
            session.warn(contradiction);
        }
        write_pose(&self.output, &pose, session.overwrite)?;
        session.results_of(json!({
            "output": text_of(&self.output), "turn-deg": pose.turn_deg, "scale": pose.scale,
            "turn-sigma-deg": pose.turn_sigma_deg, "scale-sigma": pose.scale_sigma, "told-by": estimates.len(),
        }));
        session.say(format_args!(
            "{}: {pose}, told by {} of {}",
            self.output.display(),
            estimates.len(),
            files.len()
        ))
    }

    /// What the user says of the tone curve.
    fn tone(&self) -> ToneFlags {
        ToneFlags { alpha: self.alpha, x_max: self.x_max }
    }

    fn estimate(&self, file: &Path, psf: &Psf, curve: ToneCurve, session: &Session) -> Result<FoundPose> {
        let told = Told { domain: self.domain, tone: self.tone(), ..Told::default() };
        let (capture, warnings) = Capture::open(file, &told, &session.progress)?;
        warnings.iter().for_each(|warning| session.warn(warning));
        let own = capture.image.curve();
        let psf = psf_seen(&capture.image, psf)?;
        let image = capture.image.into_linear(curve);
        let mut config = PoseConfig::of_capture(capture.info.as_ref(), &image, (curve.alpha, self.x_max));
        if let Some(own) = own {
            // No light above is in the file.
            config.saturation = config.saturation.map(|level| level.min(own.x_max));
        }
        let find = || -> Result<FoundPose> {
            let found = find_pose(&image, &psf, &config, &session.progress)?;
            if found.is_ok() {
                return Ok(found);
            }
            Ok(match find_pose_by_lamp_outside(&image, &psf, &config, &session.progress)? {
                FromOutside::Lamp(by_lamp_outside) => by_lamp_outside,
                FromOutside::NoLamp => found,
            })
        };
        session.timed(format_args!("finding the pose in {}", file.display()), find)
    }
}

fn pose_for_scripts(found: &FoundPose) -> Value {
    match found {
        Ok(found) => json!({ "pose": estimate_for_scripts(found) }),
        Err(why) => json!({ "pose": null, "why": why.to_string() }),
    }
}

fn estimate_for_scripts(found: &PoseEstimate) -> Value {
    json!({
        "turn-deg": found.turn_deg, "scale": found.scale, "turn-sigma-deg": found.turn_sigma_deg,
        "scale-sigma": found.scale_sigma, "unexplained": found.unexplained,
    })
}
