//! Applies the tone mapping φ, or its inverse, to image files.

use std::path::{Path, PathBuf};
use std::sync::Once;

use serde_json::{Value, json};

use super::{Destination, Selection, Stages, Watcher, run};
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::{Linear, LinearImage};
use crate::core::provenance::Provenance;
use crate::core::tone::{ToneCurve, ToneFlags};
use crate::io::{
    AnyImage, DomainTag, ImageReading, WriteOptions, any_image_of, check_output_domain, expand_inputs,
    image_of, read_pixels, what_is_lost, what_is_lost_of_mapping, without_repeats,
};

/// How image files are tone-mapped.
#[derive(Clone, Copy, Debug)]
pub struct ToneMapping {
    /// What the user says of the curve: for the rest, tone-mapped values are mapped back as their file says, all else by the usual
    /// one.
    pub tone: ToneFlags,
    /// Whether tone-mapped values are mapped back to linear light.
    pub inverse: bool,
    /// What the values of the images are, where the user says it; the inverse takes them for tone-mapped.
    pub domain: Option<DomainTag>,
    /// Whether half floats are written, in formats that have them.
    pub half: bool,
    /// Whether outputs that exist are replaced.
    pub overwrite: bool,
}

impl ToneMapping {
    /// Maps image files, folders or patterns; refuses outputs that exist before any work.
    ///
    /// # Errors
    /// When a number of the curve is out of range, an input does not exist or an output may not be written, and those of [`run`].
    pub fn run(
        &self,
        inputs: &[PathBuf],
        destination: &Destination<'_>,
        watcher: &dyn Watcher,
    ) -> Result<()> {
        self.tone.over(ToneCurve::default())?;
        let files = without_repeats(expand_inputs(inputs)?);
        let outputs = destination.place_files(&files, inputs)?;
        if !self.inverse {
            outputs.iter().try_for_each(|output| check_output_domain(output, DomainTag::ToneMapped))?;
        }
        let jobs = files.into_iter().zip(outputs).map(|(input, output)| Job { input, output });
        run(&Mapping { how: self, watcher, lost: Once::new() }, jobs.collect(), Selection::default(), watcher)
    }
}

/// One image to make.
struct Job {
    input: PathBuf,
    output: PathBuf,
}

/// An image before or after its mapping by a curve.
struct Mapped {
    image: AnyImage,
    info: Option<CaptureInfo>,
    curve: ToneCurve,
}

struct Mapping<'a> {
    how: &'a ToneMapping,
    watcher: &'a dyn Watcher,
    /// Done when it was said what files cannot say of their mapping.
    lost: Once,
}

impl Stages for Mapping<'_> {
    type Job = Job;
    type Input = Mapped;
    type Output = Mapped;

    fn doing(&self, job: &Job) -> String {
        format!("tone mapping {}", job.input.display())
    }

    fn output<'a>(&self, job: &'a Job) -> &'a Path {
        &job.output
    }

    fn describe(&self, job: &Job) -> Value {
        json!({
            "input": job.input.to_string_lossy(), "inverse": self.how.inverse,
            "domain": self.how.domain.map(DomainTag::name),
        })
    }

    fn read(&self, job: &Job) -> Result<Self::Input> {
        let path = &job.input;
        let told = if self.how.inverse { Some(DomainTag::ToneMapped) } else { self.how.domain };
        let mut pixels = read_pixels(path)?;
        let usual = ToneCurve::default();
        if !self.how.inverse {
            pixels.tell(path, told)?.iter().for_each(|contradiction| self.watcher.warn(contradiction));
            pixels.check_told_light(path)?;
            let info = pixels.capture.take();
            let (image, curve) = (image_of::<Linear>(path, pixels)?, self.how.tone.over(usual)?);
            if self.how.tone.x_max.is_none()
                && let Some(cut) = told_cut(&image, curve)
            {
                self.watcher.warn(&format_args!("{}: {cut}", path.display()));
            }
            return Ok(Mapped { image: AnyImage::Linear(image), info, curve });
        }
        if pixels.domain == Some(DomainTag::Linear) {
            let reason = "is linear already, as the file itself says: there is no tone mapping to invert";
            return Err(Error::format(path, reason));
        }
        let ImageReading { image, info, contradictions, .. } =
            any_image_of(path, pixels, told, self.how.tone)?;
        contradictions.iter().for_each(|contradiction| self.watcher.warn(contradiction));
        let curve = image.curve().map_or_else(|| self.how.tone.over(usual), Ok)?;
        Ok(Mapped { image, info, curve })
    }

    fn compute(&self, _: &Job, Mapped { image, info, curve }: Mapped) -> Result<Mapped> {
        let image = match image {
            AnyImage::Linear(image) => AnyImage::ToneMapped(curve.tone_map(&image), Some(curve)),
            AnyImage::ToneMapped(image, _) => AnyImage::Linear(curve.inverse_tone_map(&image)),
        };
        let info = info.map(|info| info.cut_at(curve.x_max));
        Ok(Mapped { image, info, curve })
    }

    fn write(&self, job: &Job, Mapped { image, info, curve }: Mapped) -> Result<()> {
        let lost = info.as_ref().and_then(|info| what_is_lost(&job.output, info));
        lost.iter().for_each(|lost| self.watcher.note(lost));
        if let Some(lost) = what_is_lost_of_mapping(&job.output, curve).filter(|_| !self.how.inverse) {
            self.lost.call_once(|| self.watcher.warn(&lost));
        }
        let mut described = self.describe(job);
        described["tone"] = json!(curve);
        let options = WriteOptions {
            half: self.how.half,
            overwrite: self.how.overwrite,
            provenance: Some(Provenance::new("tonemap", &described)),
            capture: info,
        };
        let domain = image.domain();
        image.write(&job.output, domain, curve, &options)
    }
}

/// What to tell of light above an x_max that nobody told.
fn told_cut(image: &LinearImage, curve: ToneCurve) -> Option<String> {
    let cut = image.as_slice().iter().filter(|&&value| value > curve.x_max).count();
    (cut > 0).then(|| {
        format!(
            "{:.2} % of its values lie above the usual x-max of {} and are cut to it, the brightest from {}: give --x-max the light \
             at which it saturates",
            100.0 * cut as f64 / image.as_slice().len() as f64,
            curve.x_max,
            image.max()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::testing::Notes;
    use crate::core::shard::Shard;
    use crate::io::{read_capture_info, read_image, write_image};
    use ndarray::Array3;

    /// The mapping by a curve.
    fn by(tone: ToneFlags) -> ToneMapping {
        ToneMapping { tone, inverse: false, domain: None, half: false, overwrite: false }
    }

    fn to(path: &Path) -> Destination<'_> {
        let extension = "exr";
        Destination { path, extension, is_asked: false, accepts_existing: false, shard: Shard::WHOLE }
    }

    #[test]
    fn files_return_from_their_tone_mapping() {
        let scratch = tempfile::tempdir().unwrap();
        let [light, back] = ["light", "back"].map(|name| scratch.path().join(name));
        std::fs::create_dir(&light).unwrap();
        let image = |value: f32| LinearImage::from_planes(Array3::from_elem((3, 2, 3), value)).unwrap();
        for (name, value) in [("a.exr", 0.5), ("b.exr", 20.0)] {
            write_image(&light.join(name), &image(value), &WriteOptions::default()).unwrap();
        }
        let (mapped, notes) = (scratch.path().join("mapped/"), Notes::default());
        let how = by(ToneFlags { alpha: Some(0.1), x_max: None });
        how.run(std::slice::from_ref(&light), &to(&mapped), &notes).unwrap();
        // By the curve that they say themselves.
        let inverse = ToneMapping { inverse: true, tone: ToneFlags::default(), ..how };
        inverse.run(std::slice::from_ref(&mapped), &to(&back), &notes).unwrap();
        for (name, value) in [("a.exr", 0.5), ("b.exr", 20.0)] {
            let returned = read_image::<Linear>(&back.join(name)).unwrap();
            assert!((returned.max() / value - 1.0).abs() < 1e-5, "{}", returned.max());
        }
        assert_eq!(notes.take().len(), 4, "each file is told of");
        assert!(how.run(std::slice::from_ref(&light), &to(&mapped), &notes).is_err(), "nothing is replaced");
        let again = scratch.path().join("again.exr");
        let said = inverse.run(&[light.join("a.exr")], &to(&again), &notes).unwrap_err().in_full();
        assert!(said.contains("a.exr: is linear already") && !said.contains("udc tonemap"), "{said}");
    }

    /// The half float nearest to φ(16) stands for 15.75, which is no longer saturated.
    #[test]
    fn clipped_light_stays_clipped_in_half_floats() {
        let scratch = tempfile::tempdir().unwrap();
        let [light, mapped, back] = ["a.exr", "b.exr", "c.exr"].map(|name| scratch.path().join(name));
        let image = Array3::from_shape_fn((3, 1, 3), |(.., x)| [0.5, 15.0, 20.0][x]);
        let image = LinearImage::from_planes(image).unwrap();
        write_image(&light, &image, &WriteOptions::default()).unwrap();
        let how = ToneMapping { half: true, ..by(ToneFlags { alpha: None, x_max: Some(16.0) }) };
        how.run(std::slice::from_ref(&light), &to(&mapped), &Notes::default()).unwrap();
        let inverse = ToneMapping { inverse: true, tone: ToneFlags::default(), half: false, ..how };
        inverse.run(std::slice::from_ref(&mapped), &to(&back), &Notes::default()).unwrap();
        let returned = read_image::<Linear>(&back).unwrap();
        let values = &returned.as_slice()[..3];
        assert!((values[2] - 16.0).abs() < 1e-4, "{values:?}");
        // One half float: 2⁻¹² of y, by (x+α)²/α.
        assert!((values[0] - 0.5).abs() < 1e-3 && (values[1] - 15.0).abs() < 0.23, "{values:?}");
    }

    #[test]
    fn what_is_cut_at_x_max_saturates_there() {
        let scratch = tempfile::tempdir().unwrap();
        let [light, mapped] = ["light.exr", "mapped.exr"].map(|name| scratch.path().join(name));
        let image = LinearImage::from_planes(Array3::from_elem((3, 2, 3), 9.0)).unwrap();
        let info = CaptureInfo { saturation: Some([16.0, 3.0, 16.0]), ..CaptureInfo::default() };
        write_image(&light, &image, &WriteOptions { capture: Some(info), ..WriteOptions::default() })
            .unwrap();
        let how = by(ToneFlags { alpha: None, x_max: Some(4.0) });
        how.run(&[light], &to(&mapped), &Notes::default()).unwrap();
        let info = read_capture_info(&mapped).unwrap().unwrap();
        assert_eq!(info.saturation, Some([4.0, 3.0, 4.0]));
    }

    #[test]
    fn light_above_an_x_max_that_nobody_told_is_told_of() {
        let image = |value: f32| LinearImage::from_planes(Array3::from_elem((3, 2, 3), value)).unwrap();
        let usual = ToneCurve::default();
        assert_eq!(told_cut(&image(500.0), usual), None);
        let said = told_cut(&image(16383.0), usual).unwrap();
        assert!(said.starts_with("100.00 % of its values lie above") && said.contains("16383"), "{said}");
    }
}
