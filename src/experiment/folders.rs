//! Measures the images of one folder against those of another.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::path::Path;

use serde_json::json;

use super::alike::check_alike;
use super::names::name_of;
use super::{
    ComparedMethod, EvalConfig, FilePair, FolderPairs, Label, Listener, Measurement, Sample, ToneSource,
    measure_part, pair_folders, read_tone_mapped,
};
use crate::core::error::{Error, Result};
use crate::core::image::ToneMappedImage;
use crate::core::shard::Shard;
use crate::core::tone::{ToneCurve, ToneFlags};
use crate::io::DomainTag;

/// Pairs of files, and what those hold that do not say it.
#[derive(Clone, Debug)]
pub struct Folders {
    name: String,
    found: FolderPairs,
    domain: Option<DomainTag>,
    tone: ToneSource,
}

impl Folders {
    /// Pairs the images of two folders by their names; `domain` is what files hold that do not say it, and `flags` is what
    /// is said of the tone curve.
    ///
    /// # Errors
    /// Those of [`pair_folders`] and [`ToneSource::of_pairs`]; [`Error::Config`] for one folder twice; [`Error::Unsupported`] when
    /// an image has no partner, unless such images may be missing.
    pub fn open(
        restored: &Path,
        ground_truth: &Path,
        (domain, flags): (Option<DomainTag>, ToneFlags),
        allow_missing: bool,
    ) -> Result<Self> {
        let found = pair_folders(restored, ground_truth)?;
        if restored.canonicalize().is_ok_and(|place| ground_truth.canonicalize().ok() == Some(place)) {
            let reason = format!("{} is the folder of the restored images itself", ground_truth.display());
            return Err(Error::config("gt", reason));
        }
        if let (Some((id, fault)), false) = (found.unmatched.first(), allow_missing) {
            let count = found.unmatched.len();
            return Err(Error::Unsupported(format!(
                "{count} images have no partner; {id} {fault}; add them, or leave them out with --allow-missing"
            )));
        }
        let tone = ToneSource::of_pairs(&found.pairs, flags)?;
        Ok(Self { name: name_of(restored), found, domain, tone })
    }

    /// Measures every pair of a shard, of which the last names what has no partner.
    ///
    /// # Errors
    /// Those of [`measure`](super::measure) but for the absence of images; more shards than there are pairs.
    pub fn measure(&self, config: &EvalConfig, shard: Shard, listener: Listener<'_>) -> Result<Measurement> {
        shard.check(self.found.pairs.len(), "images")?;
        let own = &self.found.pairs[shard.block(self.found.pairs.len())];
        let bar = listener.progress.bar(own.len() as u64, "images");
        let read = |path: &Path| {
            let read = read_tone_mapped(path, self.domain, &self.tone.curve)?;
            read.contradiction.iter().for_each(|contradiction| (listener.warn)(contradiction));
            Ok((read.image, read.appearance))
        };
        let is_told = Cell::new(false);
        let samples = own.iter().map(|pair| {
            let sample = || {
                listener.progress.check()?;
                bar.inc(1);
                let FilePair { restored, ground_truth, .. } = pair;
                let ((image, seen), (truth, seen_truth)) = (read(restored)?, read(ground_truth)?);
                let doubt = check_alike((restored, seen), (ground_truth, seen_truth))?;
                doubt.iter().for_each(|doubt| (listener.warn)(doubt));
                if let Some(median) = median_of_flat(&truth, self.tone.curve).filter(|_| !is_told.replace(true)) {
                    (listener.warn)(&format!(
                        "{}: its median is {median:.4} and the tone curve's α {}, so that differences hardly count: name one as bright as \
                         the scenes by --alpha",
                        ground_truth.display(),
                        self.tone.curve.alpha
                    ));
                }
                Ok(Sample { ground_truth: truth, images: vec![image], regions: None })
            };
            Ok((Label::scene(&pair.id), sample()))
        });
        let methods = vec![ComparedMethod::restored(&self.name)];
        let doing = format!("measuring the images of {}", self.name);
        let mut evaluation = measure_part(config, methods, samples)
            .map_err(|error| error.while_doing_unless_interrupted(&doing))?;
        evaluation.tone = Some(self.tone);
        if shard.index + 1 == shard.count {
            for (id, fault) in &self.found.unmatched {
                evaluation.exclude(&Label::scene(id), *fault);
            }
        }
        bar.finish_and_clear();
        Ok(Measurement::of(evaluation, doing))
    }

    /// Everything that decides the numbers, by what it is called; of the images, their names.
    pub fn describe(&self, config: &EvalConfig) -> BTreeMap<String, String> {
        let mut described = config.describe();
        let names: Vec<&str> = self.found.pairs.iter().map(|pair| pair.id.as_str()).collect();
        for (key, value) in [
            ("restored", json!(self.name)),
            ("images", json!(names)),
            ("domain", json!(self.domain.map(DomainTag::name))),
            ("tone", json!(self.tone)),
        ] {
            described.insert(key.to_owned(), value.to_string());
        }
        described
    }
}

/// The median light of an image of which most is mapped to where a tone curve is flat, as counts of a sensor are by a curve of light.
fn median_of_flat(image: &ToneMappedImage, curve: ToneCurve) -> Option<f32> {
    /// Light in multiples of α that is hardly told apart.
    const FLAT: f32 = 32.0;
    let mut values = image.channel(1).iter().copied().collect::<Vec<f32>>();
    let middle = values.len() / 2;
    let median = curve.expand(*values.select_nth_unstable_by(middle, f32::total_cmp).1);
    (median > FLAT * curve.alpha).then_some(median)
}

#[cfg(test)]
mod tests {
    use ndarray::Array3;

    use super::*;
    use crate::core::image::LinearImage;

    #[test]
    fn counts_under_a_curve_of_light_are_flat_and_bright_scenes_are_not() {
        let curve = ToneCurve::new(0.25, 5000.0).unwrap();
        let median = |light: f32| {
            let image = LinearImage::from_planes(Array3::from_elem((3, 4, 5), light)).unwrap();
            median_of_flat(&curve.tone_map(&image), curve)
        };
        assert!(median(700.0).is_some_and(|median| (median / 700.0 - 1.0).abs() < 0.01));
        assert_eq!([median(0.2), median(4.0), median(0.0)], [None; 3]);
    }
}
