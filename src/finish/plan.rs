//! Finishes image files as a plan says: each read with what belongs to it, finished and written.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::pairs::Job;
use super::{Companions, Curve, FinishInputs, Look, Photograph, Style, read_color_matrix, reference};
use crate::batch::{self, Destination, Selection, Stages, Watcher, timed};
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::exif::Exif;
use crate::core::provenance::Provenance;
use crate::core::tone::{ToneCurve, ToneFlags};
use crate::io::{
    AnyImage, DomainTag, Format, ImageReading, WriteOptions, check_display, inspect_any_image, read_pixels,
};

/// How image files are finished.
#[derive(Clone, Debug, Default)]
pub struct FinishPlan {
    /// What the values of the images are, where the user says it.
    pub domain: Option<DomainTag>,
    /// What the user says of the tone mapping of tone-mapped images, against what their files say; captures of unknown levels clip
    /// at its `x_max`.
    pub tone: ToneFlags,
    /// How the pictures shall look.
    pub style: Style,
    /// What the user says of the captures, against what their files say: levels, orientation and baseline exposure.
    pub told: CaptureInfo,
    /// Bits of PNG and TIFF, if not the usual ones: 8 for PNG, 16 for TIFF.
    pub bits: Option<u8>,
    /// Whether what cameras say of their pictures is left out.
    pub leaves_out_exif: bool,
    /// Whether pictures that exist are replaced.
    pub overwrite: bool,
}

impl FinishPlan {
    /// Finishes all images, or those of the destination's shard; with `resume`, the pictures that are there are kept.
    ///
    /// # Errors
    /// When a setting is out of range, an image does not exist or has no companion where all have one, or an output may not
    /// be written; and those of [`batch::run`].
    pub fn run(
        &self,
        inputs: &FinishInputs,
        destination: &Destination<'_>,
        resume: bool,
        watcher: &dyn Watcher,
    ) -> Result<()> {
        self.style.check()?;
        self.tone.over(ToneCurve::default())?;
        let jobs = inputs.jobs(destination, watcher)?;
        jobs.iter().try_for_each(|job| check_display(&job.output))?;
        self.check_bits(&jobs)?;
        self.check_hdr(&jobs)?;
        let finishing = Finishing { plan: self, leaves_out_ccm: inputs.ccm == Companions::Nowhere, watcher };
        batch::run(&finishing, jobs, Selection { shard: destination.shard, resume }, watcher)
    }

    /// Refuses a number of bits that the format of an output does not have.
    fn check_bits(&self, jobs: &[Job]) -> Result<()> {
        let Some(bits) = self.bits else { return Ok(()) };
        let ignores = |job: &&Job| match Format::of_extension(&job.output) {
            Ok(Format::Png | Format::Tiff) | Err(_) => false,
            Ok(Format::Jpeg) => bits != 8,
            Ok(_) => true,
        };
        let Some(job) = jobs.iter().find(ignores) else { return Ok(()) };
        Err(Error::Unsupported(format!(
            "--bits {bits} is for PNG and TIFF, and {} would ignore it; leave it out",
            job.output.display()
        )))
    }

    /// Refuses gains for HDR displays in formats that have none, and beside reference pictures, whose curve has no shoulder.
    fn check_hdr(&self, jobs: &[Job]) -> Result<()> {
        if self.style.hdr_stops.is_none() {
            return Ok(());
        }
        let is_jpeg =
            |job: &Job| Format::of_extension(&job.output).is_ok_and(|format| format == Format::Jpeg);
        if let Some(job) = jobs.iter().find(|job| !is_jpeg(job)) {
            let output = job.output.display();
            return Err(Error::Unsupported(format!("--hdr is for JPEG, and {output} is none: name a .jpg")));
        }
        match jobs.iter().any(|job| !self.style.is_automatic(job.reference.is_some()))
            && self.style.curve.is_none()
        {
            true => Err(Error::config("hdr", "belongs to the automatic exposure: leave out --reference")),
            false => Ok(()),
        }
    }

    /// Whether a file is written with 8 bits.
    fn is_eight_bit(&self, output: &Path) -> bool {
        match (Format::of_extension(output).ok(), self.bits) {
            (Some(Format::Jpeg), _) => true,
            (Some(Format::Png), bits) => bits != Some(16),
            (Some(Format::Tiff), bits) => bits == Some(8),
            _ => false,
        }
    }
}

/// An image that was read, and what belongs to it.
struct Read {
    image: AnyImage,
    /// The curve that its origin says.
    tone: Option<ToneCurve>,
    look: Look,
    exif: Option<Exif>,
}

/// A plan at work.
struct Finishing<'a> {
    plan: &'a FinishPlan,
    /// Whether the colour matrices of cameras are left out.
    leaves_out_ccm: bool,
    watcher: &'a dyn Watcher,
}

impl Finishing<'_> {
    /// The look that is said of a capture, what the user says of it, and what belongs to the image.
    fn look(&self, job: &Job, said: CaptureInfo) -> Result<Look> {
        let told = &self.plan.told;
        let mut look = Look::of_capture(&CaptureInfo {
            // Without it, other primaries than those of sRGB are converted still.
            color: said.color.filter(|_| !self.leaves_out_ccm),
            saturation: told.saturation.or(said.saturation),
            orientation: told.orientation.or(said.orientation),
            baseline_exposure_ev: told.baseline_exposure_ev.or(said.baseline_exposure_ev),
            ..said
        });
        if let Some(path) = &job.ccm {
            let ccm = read_color_matrix(path)?;
            if ccm.looks_transposed() {
                self.watcher.warn(&format_args!(
                    "the columns of {} sum to one, not its rows, so that grey becomes coloured; it may be transposed",
                    path.display()
                ));
            }
            look.ccm = Some(ccm);
        }
        if let Some(path) = &job.reference {
            // Not light but a look: its values are compared with those that are shown.
            look.reference_means = Some(reference::means_of(path, &read_pixels(path)?.planes)?);
        }
        Ok(look)
    }

    /// How a job's picture was made, by which curve of a tone-mapped image, and where its files lay.
    fn provenance(&self, job: &Job, photograph: &Photograph, curve: Option<ToneCurve>) -> Result<Provenance> {
        let mut described = self.describe(job);
        described["tone-of-input"] = json!(curve);
        // Where the files lay; what they are is told by their contents.
        let text = |path: &PathBuf| path.to_string_lossy().into_owned();
        described["input"] = json!(text(&job.input));
        described["ccm"] = json!(job.ccm.as_ref().map(text));
        described["reference"] = json!(job.reference.as_ref().map(text));
        let [input, ccm, reference] = job.sha256()?;
        described["input-sha256"] = json!(input);
        described["ccm-sha256"] = json!(ccm);
        described["reference-sha256"] = json!(reference);
        described["look"] = json!(photograph.look);
        described["curve"] = json!(photograph.curve);
        Ok(Provenance::new("finish", &described))
    }
}

impl Stages for Finishing<'_> {
    type Job = Job;
    type Input = Read;
    type Output = (Photograph, Option<ToneCurve>);

    fn doing(&self, job: &Job) -> String {
        format!("finishing {}", job.input.display())
    }

    fn output<'a>(&self, job: &'a Job) -> &'a Path {
        &job.output
    }

    fn describe(&self, job: &Job) -> Value {
        let FinishPlan { domain, tone, style, told, .. } = self.plan;
        let tone = tone.over(ToneCurve::default()).ok();
        let finish = style.describe(job.reference.is_some(), self.plan.is_eight_bit(&job.output));
        json!({
            "domain": domain.map(DomainTag::name), "tone": tone, "finish": finish,
            "orientation": told.orientation, "saturation": told.saturation, "camera-matrix": !self.leaves_out_ccm,
            "baseline-exposure-ev": told.baseline_exposure_ev, "exif": !self.plan.leaves_out_exif,
        })
    }

    fn identify(&self, job: &Job) -> Result<Value> {
        let [input, ccm, reference] = job.sha256()?;
        Ok(json!({ "input-sha256": input, "ccm-sha256": ccm, "reference-sha256": reference }))
    }

    fn read(&self, job: &Job) -> Result<Self::Input> {
        // Before the pixels, so that they are not older than it.
        job.sha256()?;
        let read = || {
            let reading = inspect_any_image(&job.input, self.plan.domain, self.plan.tone)?;
            reading.contradictions.iter().for_each(|contradiction| self.watcher.warn(contradiction));
            Ok(reading)
        };
        let reading = timed(self.watcher, format_args!("reading {}", job.input.display()), read)?;
        let ImageReading { image, info, tone, .. } = reading;
        let mut said = info.unwrap_or_default();
        let exif = said.exif.take().filter(|_| !self.plan.leaves_out_exif);
        let look = self.look(job, said)?;
        Ok(Read { image, tone, look, exif })
    }

    fn compute(&self, job: &Job, Read { image, tone: own, look, exif }: Read) -> Result<Self::Output> {
        let FinishPlan { style, tone, .. } = self.plan;
        let usual = tone.over(ToneCurve::default())?;
        let curve = (image.domain() == DomainTag::ToneMapped).then(|| image.curve().unwrap_or(usual));
        let image = image.into_linear(usual);
        let ceiling = match (own, tone.x_max) {
            // Light of which nobody says that it ends somewhere goes on to the brightest.
            (None, None) => usual.x_max.max(image.max()),
            _ => own.unwrap_or(usual).x_max,
        };
        let config = style.config_of(&image, &look, self.plan.is_eight_bit(&job.output), ceiling);
        if let Curve::Photographic { grey, white } = config.curve {
            let input = job.input.display();
            self.watcher
                .detail(&format_args!("{input}: middle grey at light {grey:.4}, white at {white:.4}"));
        }
        let photograph = timed(self.watcher, self.doing(job), || Photograph::of(image, look, &config))?;
        Ok((Photograph { exif, ..photograph }, curve))
    }

    fn write(&self, job: &Job, (photograph, curve): Self::Output) -> Result<()> {
        let provenance = Some(self.provenance(job, &photograph, curve)?);
        let options = WriteOptions { overwrite: self.plan.overwrite, provenance, ..WriteOptions::default() };
        let write = || photograph.write(&job.output, &options);
        timed(self.watcher, format_args!("writing {}", job.output.display()), write)
    }
}
