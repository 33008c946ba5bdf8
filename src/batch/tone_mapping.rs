//! Applies the tone mapping φ, or its inverse, to image files.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::{Destination, Selection, Stages, Watcher, run};
use crate::core::capture::CaptureInfo;
use crate::core::error::Result;
use crate::core::image::{Linear, ToneMapped};
use crate::core::provenance::Provenance;
use crate::core::tone::ToneCurve;
use crate::io::{
    AnyImage, DomainTag, WriteOptions, expand_inputs, image_of, read_pixels, what_is_lost, without_repeats,
};

/// How image files are tone-mapped.
#[derive(Clone, Copy, Debug)]
pub struct ToneMapping {
    /// The curve.
    pub curve: ToneCurve,
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
    /// When an input does not exist or an output may not be written, and those of [`run`].
    pub fn run(
        &self,
        inputs: &[PathBuf],
        destination: &Destination<'_>,
        watcher: &dyn Watcher,
    ) -> Result<()> {
        let files = without_repeats(expand_inputs(inputs)?);
        let outputs = destination.place_files(&files, inputs)?;
        let jobs = files.into_iter().zip(outputs).map(|(input, output)| Job { input, output });
        run(&Mapping { how: self, watcher }, jobs.collect(), Selection::default(), watcher)
    }
}

/// One image to make.
struct Job {
    input: PathBuf,
    output: PathBuf,
}

struct Mapping<'a> {
    how: &'a ToneMapping,
    watcher: &'a dyn Watcher,
}

impl Stages for Mapping<'_> {
    type Job = Job;
    type Input = (AnyImage, Option<CaptureInfo>);
    type Output = (AnyImage, Option<CaptureInfo>);

    fn doing(&self, job: &Job) -> String {
        format!("tone mapping {}", job.input.display())
    }

    fn output<'a>(&self, job: &'a Job) -> &'a Path {
        &job.output
    }

    fn describe(&self, job: &Job) -> Value {
        json!({
            "input": job.input.to_string_lossy(), "inverse": self.how.inverse, "tone": self.how.curve,
            "domain": self.how.domain.map(DomainTag::name),
        })
    }

    fn read(&self, job: &Job) -> Result<Self::Input> {
        let path = &job.input;
        let told = if self.how.inverse { Some(DomainTag::ToneMapped) } else { self.how.domain };
        let mut pixels = read_pixels(path)?;
        pixels.tell(path, told)?.iter().for_each(|contradiction| self.watcher.warn(contradiction));
        let info = pixels.capture.take();
        let image = if self.how.inverse {
            AnyImage::ToneMapped(image_of::<ToneMapped>(path, pixels)?)
        } else {
            pixels.check_told_light(path)?;
            AnyImage::Linear(image_of::<Linear>(path, pixels)?)
        };
        Ok((image, info))
    }

    fn compute(&self, _: &Job, (image, info): Self::Input) -> Result<Self::Output> {
        let image = match image {
            AnyImage::Linear(image) => AnyImage::ToneMapped(self.how.curve.tone_map(&image)),
            AnyImage::ToneMapped(image) => AnyImage::Linear(self.how.curve.inverse_tone_map(&image)),
        };
        Ok((image, info))
    }

    fn write(&self, job: &Job, (image, info): Self::Output) -> Result<()> {
        let lost = info.as_ref().and_then(|info| what_is_lost(&job.output, info));
        lost.iter().for_each(|lost| self.watcher.note(lost));
        let options = WriteOptions {
            half: self.how.half,
            overwrite: self.how.overwrite,
            provenance: Some(Provenance::new("tonemap", &self.describe(job))),
            capture: info,
        };
        let domain = image.domain();
        image.write(&job.output, domain, self.how.curve, &options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::testing::Notes;
    use crate::core::image::LinearImage;
    use crate::core::shard::Shard;
    use crate::io::{read_image, write_image};
    use ndarray::Array3;

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
        let how = ToneMapping {
            curve: ToneCurve::default(),
            inverse: false,
            domain: None,
            half: false,
            overwrite: false,
        };
        let to = |path| Destination {
            path,
            extension: "exr",
            is_asked: false,
            accepts_existing: false,
            shard: Shard::WHOLE,
        };
        how.run(std::slice::from_ref(&light), &to(&mapped), &notes).unwrap();
        let inverse = ToneMapping { inverse: true, ..how };
        inverse.run(std::slice::from_ref(&mapped), &to(&back), &notes).unwrap();
        for (name, value) in [("a.exr", 0.5), ("b.exr", 20.0)] {
            let returned = read_image::<Linear>(&back.join(name)).unwrap();
            assert!((returned.max() / value - 1.0).abs() < 1e-5, "{}", returned.max());
        }
        assert_eq!(notes.take().len(), 4, "each file is told of");
        assert!(how.run(&[light], &to(&mapped), &notes).is_err(), "nothing is replaced");
    }
}
