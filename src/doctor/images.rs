//! Looks at what images hold: domains, values, sizes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::Findings;
use crate::core::error::Error;
use crate::inspect::ImageDescription;
use crate::io::{DomainTag, Pixels, read_pixels};

pub(super) const MEND_DAMAGED: &str = "copy it again, or make it anew";

/// Heights and widths of images.
pub(super) type Sizes = BTreeSet<[usize; 2]>;

/// Values this much above x-max are at it: half floats are off by 2⁻¹¹ of themselves.
const X_MAX_TOLERANCE: f32 = 1.0 + 1.0 / (1 << 10) as f32;

/// Looks at an image that belongs to nothing.
pub(super) fn look_alone(path: &Path, image: &ImageDescription, findings: &mut Findings) {
    let about = path.display();
    if image.non_finite > 0 {
        let what = format!("{} of its values are NaN or infinite", image.non_finite);
        let mend = "write it anew without them: every command refuses it";
        findings.fail(&about, "not-finite", what, mend);
    }
    let values = image.width * image.height * image.channels.len();
    if image.negative > 0 {
        let share = 100.0 * image.negative as f64 / values as f64;
        let what = format!("{share:.2} % of its values are negative");
        findings.warn(
            &about,
            "negative",
            what,
            "subtract less black level; noise around zero is as it should be",
        );
    }
    if image.channels.iter().all(|channel| channel.max <= 0.0) {
        findings.warn(&about, "dark", "it is black", "see whether its exposure or its black level is right");
    }
    for doubt in &image.doubts {
        findings.warn(&about, "image-doubt", doubt.clone(), "mend the file, if what is not heeded matters");
    }
    let is_integer = image.sample_type.starts_with('u');
    if is_integer && image.domain.is_none() && image.raw.is_none() {
        let what = "it holds integers, and does not say whether they are linear, tone-mapped or of sRGB";
        findings.warn(
            &about,
            "domain-untold",
            what,
            "say it to commands: --domain linear, tone-mapped or srgb",
        );
    }
    if image.domain == Some(DomainTag::Display.name()) {
        let what = "it was finished for viewing: no light can be computed of it";
        findings.warn(&about, "domain", what, "name the image as it was before `udc finish`");
    }
    let domain = image.domain.unwrap_or("domain not said");
    let what = format!("an image of {} × {}, {domain}", image.height, image.width);
    findings.ok_unless_failed(&about, "image", what);
}

/// What is wrong with images of a set, each kind with the number of images and the first of them.
#[derive(Debug, Default)]
pub(super) struct Faults(BTreeMap<Fault, (usize, String)>);

/// What may be wrong with an image of a dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Fault {
    Unreadable,
    NotFinite,
    Domain,
    Channels,
    SizesDiffer,
    HashDiffers,
    OtherScene,
    AboveXMax,
    Negative,
    Dark,
    NotDegraded,
}

impl Fault {
    /// Its name, whether it is an error, what it means of images, and what mends it.
    fn describe(self) -> (&'static str, bool, &'static str, &'static str) {
        let anew = "take the files that `udc synth` wrote, or make them anew: remove them and give `udc synth` its flags with \
                    --resume";
        match self {
            Self::Unreadable => ("image-unreadable", true, "cannot be read", anew),
            Self::NotFinite => ("not-finite", true, "hold NaN or infinite values", anew),
            Self::Domain => (
                "domain",
                true,
                "are not linear, as the images of a dataset are",
                "convert them with `udc tonemap --inverse`, or make them anew",
            ),
            Self::Channels => (
                "channels",
                true,
                "have neither three channels nor one",
                "write them with three channels: red, green, blue",
            ),
            Self::SizesDiffer => ("sizes-differ", true, "are of another size than their ground truth", anew),
            Self::HashDiffers => {
                ("hash-differs", true, "are not those that the dataset lists (SHA-256)", anew)
            }
            Self::OtherScene => {
                ("other-scene", true, "say that they are the ground truth of another scene", anew)
            }
            Self::AboveXMax => (
                "above-x-max",
                true,
                "hold light above the dataset's x-max, at which they were clipped",
                "dataset.toml is of other images: put the right one back, or make the dataset anew",
            ),
            Self::Negative => {
                ("negative", false, "hold negative light", "clip the scenes at zero before `udc synth`")
            }
            Self::Dark => {
                ("dark", false, "are black", "leave these scenes out: nothing is learned from them")
            }
            Self::NotDegraded => (
                "not-degraded",
                false,
                "are the same as their ground truth",
                "see whether the PSF of the bank is that of a panel, and whether files were mixed up",
            ),
        }
    }
}

impl Faults {
    pub(super) fn note(&mut self, fault: Fault, name: String) {
        self.0.entry(fault).or_insert((0, name)).0 += 1;
    }

    /// Takes those of others too.
    pub(super) fn extend(&mut self, other: Self) {
        for (fault, (count, name)) in other.0 {
            self.0.entry(fault).or_insert((0, name)).0 += count;
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Tells of all that is wrong, of `looked` images in all.
    pub(super) fn tell(&self, about: &str, looked: usize, findings: &mut Findings) {
        for (fault, (count, first)) in &self.0 {
            let (check, is_error, what, mend) = fault.describe();
            let what = format!("{count} of {looked} images looked at {what}, the first is {first}");
            if is_error {
                findings.fail(about, check, what, mend);
            } else {
                findings.warn(about, check, what, mend);
            }
        }
    }
}

/// Reads an image of a dataset, and notes what is wrong with it by itself.
pub(super) fn read(path: &Path, name: &str, faults: &mut Faults) -> Option<Pixels> {
    let pixels = match read_pixels(path) {
        Ok(pixels) => pixels,
        Err(error) => {
            faults.note(Fault::Unreadable, format!("{name} ({})", without_path(&error, path)));
            return None;
        }
    };
    let values = &pixels.planes;
    if values.iter().any(|value| !value.is_finite()) {
        faults.note(Fault::NotFinite, name.to_owned());
    } else if values.iter().any(|value| *value < 0.0) {
        faults.note(Fault::Negative, name.to_owned());
    } else if values.iter().all(|value| *value <= 0.0) {
        faults.note(Fault::Dark, name.to_owned());
    }
    if pixels.domain.is_some_and(|domain| domain != DomainTag::Linear) {
        faults.note(Fault::Domain, name.to_owned());
    }
    if !matches!(values.dim().0, 1 | 3) {
        faults.note(Fault::Channels, name.to_owned());
    }
    Some(pixels)
}

/// Whether any light is above what an image was clipped at.
pub(super) fn exceeds(pixels: &Pixels, x_max: f32) -> bool {
    pixels.planes.iter().any(|value| *value > x_max * X_MAX_TOLERANCE)
}

/// What is wrong with a file, without its name.
fn without_path(error: &Error, path: &Path) -> String {
    let said = error.in_full();
    let prefix = format!("{}: ", path.display());
    said.strip_prefix(&prefix).unwrap_or(&said).to_owned()
}
