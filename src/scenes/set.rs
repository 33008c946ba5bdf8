//! Paints numbered natural scenes into a folder.

use std::path::{Path, PathBuf};

use half::f16;
use rand::Rng as _;
use rayon::prelude::*;
use serde::Serialize;

use super::natural::{NaturalKind, paint_natural};
use crate::batch::{Kept, is_broken, is_made, tell_of_others, write_or_keep};
use crate::core::error::{Error, Result};
use crate::core::image::LinearImage;
use crate::core::progress::Progress;
use crate::core::provenance::Provenance;
use crate::core::rng;
use crate::io::{self, WriteOptions};

/// The largest side of a scene in pixels, margin included.
pub const MOST_PIXELS: usize = 8192;

/// The largest number of scenes of one set: another seed has others.
pub const MOST_SCENES: usize = 1_000_000;

/// Natural scenes of an endless sequence, and how their files are written.
#[derive(Clone, Debug)]
pub struct SceneSet {
    /// Which of the endless sequences.
    pub seed: u64,
    /// What the scenes show, in turn; none for all kinds, drawn by their shares.
    pub kinds: Vec<NaturalKind>,
    /// The scenes' places in the sequence.
    pub numbers: Vec<usize>,
    /// Height and width in pixels, without any margin.
    pub size: [usize; 2],
    /// Pixels more on each side.
    pub margin: usize,
    /// Extension of the files: `exr` or `npy`.
    pub image_format: &'static str,
    /// Whether half floats are written, to whose largest number of 65504 brighter lights are clipped.
    pub half: bool,
    /// Whether files that are there may be replaced.
    pub overwrite: bool,
    /// Whether scenes that are there are kept.
    pub resume: bool,
}

/// What a scene's provenance says.
#[derive(Serialize)]
struct Origin {
    kind: &'static str,
    /// Of the sequence.
    seed: u64,
    number: usize,
    /// Of the scene: what [`paint_natural`] paints it of.
    scene_seed: u64,
    size: [usize; 2],
    /// The key by which `udc synth` finds it.
    margin: usize,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    half: bool,
}

/// The seed of a scene of the endless sequence that belongs to a seed, for [`paint_natural`].
///
/// Sequences of different seeds have no scene in common.
pub fn scene_seed(seed: u64, number: usize) -> u64 {
    rng::stream(seed, &format!("natural/scene/{number}")).next_u64()
}

impl SceneSet {
    /// Paints all scenes into `folder`, several at a time, as `<kind>-s<seed>-<number>.<format>`. Returns how many were there.
    ///
    /// # Errors
    /// Those of [`check`](Self::check) and [`is_made`]; [`Error::Interrupted`] after an interrupt; [`Error::Io`] when a file exists
    /// or cannot be written.
    pub fn run(&self, folder: &Path, progress: &Progress) -> Result<Kept> {
        self.check()?;
        let (mut todo, mut kept) = (Vec::new(), Kept::default());
        for &number in &self.numbers {
            progress.check()?;
            let path = self.path(folder, number);
            let is_broken = self.resume && is_broken(&path)?;
            if self.resume && !is_broken && is_made(&path, &self.provenance(number))? {
                kept.whole += 1;
                continue;
            }
            kept.broken += usize::from(is_broken);
            if folder.exists() {
                io::check_output(&path, self.overwrite || is_broken)?;
            }
            todo.push(number);
        }
        io::create_folder(folder)?;
        let bar = progress.bar(self.numbers.len() as u64, "scenes");
        bar.start_at(kept.whole as u64);
        todo.par_iter().try_for_each(|&number| {
            progress.check()?;
            self.write(folder, number)?;
            bar.inc(1);
            Ok(())
        })?;
        bar.finish_and_clear();
        Ok(kept)
    }

    /// Tells of images in `folder` that are none of these scenes, in words for a warning; none where there are none.
    ///
    /// # Errors
    /// [`Error::Io`] when the folder cannot be listed.
    pub fn tell_of_others(&self, folder: &Path) -> Result<Option<String>> {
        tell_of_others(folder, self.numbers.iter().map(|&number| self.path(folder, number)))
    }

    /// Checks that the scenes can be painted.
    ///
    /// # Errors
    /// [`Error::Config`] for a size or margin that is out of range.
    pub fn check(&self) -> Result<()> {
        let [height, width] = self.size;
        if height.min(width) < 16 || height.max(width) > MOST_PIXELS {
            let reason =
                format!("{height}x{width} is out of range; give sides of 16 to {MOST_PIXELS} pixels");
            return Err(Error::config("size", reason));
        }
        if self.margin > (MOST_PIXELS - height.max(width)) / 2 {
            let reason = format!(
                "{} on each side of {height} × {width} makes more than {MOST_PIXELS} pixels; give less",
                self.margin
            );
            return Err(Error::config("margin", reason));
        }
        Ok(())
    }

    fn write(&self, folder: &Path, number: usize) -> Result<()> {
        let size = self.size.map(|side| side + 2 * self.margin);
        let image = paint_natural(self.kind(number), scene_seed(self.seed, number), size)?.image;
        let (path, provenance) = (self.path(folder, number), self.provenance(number));
        let (half, overwrite, origin) = (self.half, self.overwrite, Some(provenance.clone()));
        let options = WriteOptions { half, overwrite, provenance: origin, ..WriteOptions::default() };
        let image = self.fit(image);
        write_or_keep(&path, self.resume, &provenance, || io::write_image(&path, &image, &options))
    }

    /// How a scene is made.
    fn provenance(&self, number: usize) -> Provenance {
        let &Self { seed, size, margin, half, .. } = self;
        let (kind, scene_seed) = (self.kind(number).name(), scene_seed(seed, number));
        Provenance::new("scenes", &Origin { kind, seed, number, scene_seed, size, margin, half })
    }

    /// What a scene shows.
    fn kind(&self, number: usize) -> NaturalKind {
        match self.kinds.len() {
            0 => NaturalKind::of_seed(scene_seed(self.seed, number)),
            count => self.kinds[number % count],
        }
    }

    /// The image within the range of the numbers that it is written in.
    fn fit(&self, image: LinearImage) -> LinearImage {
        if self.half { image.map_in_place(|value| value.min(f16::MAX.to_f32())) } else { image }
    }

    fn path(&self, folder: &Path, number: usize) -> PathBuf {
        let kind = self.kind(number).name();
        // No `_`, which would make all of them views of one panorama to `udc synth`.
        folder.join(format!("{kind}-s{}-{number:05}.{}", self.seed, self.image_format))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::Linear;

    fn set(numbers: std::ops::Range<usize>, half: bool) -> SceneSet {
        let numbers = numbers.collect();
        SceneSet {
            seed: 5,
            kinds: Vec::new(),
            numbers,
            size: [24, 32],
            margin: 4,
            image_format: "exr",
            half,
            overwrite: false,
            resume: false,
        }
    }

    #[test]
    fn a_scene_is_the_same_alone_and_among_others() {
        let root = tempfile::tempdir().unwrap();
        let [all, one] = ["all", "one"].map(|name| root.path().join(name));
        set(0..4, false).run(&all, &Progress::default()).unwrap();
        set(2..3, false).run(&one, &Progress::default()).unwrap();
        let path = set(2..3, false).path(&one, 2);
        let image = io::read_image::<Linear>(&path).unwrap();
        assert_eq!((image.height(), image.width()), (32, 40));
        assert_eq!(image, io::read_image::<Linear>(&set(0..4, false).path(&all, 2)).unwrap());
        let provenance = io::read_provenance(&path).unwrap().unwrap();
        assert_eq!((provenance.margin(), &provenance.config["seed"]), (Some(4), &5.into()));
        let again = set(2..5, false).run(&one, &Progress::default()).unwrap_err().to_string();
        assert!(again.contains("s5-00002.exr"), "{again}");
        assert_eq!(std::fs::read_dir(&one).unwrap().count(), 1);
    }

    #[test]
    fn scenes_that_are_there_are_kept_if_they_are_those() {
        let root = tempfile::tempdir().unwrap();
        let run = |numbers, size| {
            let set = SceneSet { resume: true, size, ..set(numbers, false) };
            set.run(root.path(), &Progress::default())
        };
        assert_eq!(run(0..2, [24, 32]).unwrap(), Kept::default());
        let first = set(0..1, false).path(root.path(), 0);
        let before = std::fs::metadata(&first).unwrap().modified().unwrap();
        assert_eq!(run(0..3, [24, 32]).unwrap(), Kept { whole: 2, broken: 0 });
        assert_eq!(std::fs::metadata(&first).unwrap().modified().unwrap(), before);
        let whole = std::fs::read(&first).unwrap();
        std::fs::write(&first, &whole[..whole.len() / 2]).unwrap();
        assert_eq!(run(0..3, [24, 32]).unwrap(), Kept { whole: 2, broken: 1 });
        assert_eq!(std::fs::read(&first).unwrap(), whole);
        assert!(run(0..3, [24, 33]).unwrap_err().to_string().contains("made with other settings"));
    }

    /// As where two runs go on with one folder, and both have looked before either has painted.
    #[test]
    fn a_scene_that_another_run_has_painted_meanwhile_is_kept() {
        let root = tempfile::tempdir().unwrap();
        let resuming = SceneSet { resume: true, ..set(0..1, false) };
        io::create_folder(root.path()).unwrap();
        resuming.write(root.path(), 0).unwrap();
        resuming.write(root.path(), 0).unwrap();
        let said = SceneSet { margin: 5, ..resuming }.write(root.path(), 0).unwrap_err().to_string();
        assert!(said.contains("made with other settings"), "{said}");
        assert!(set(0..1, false).write(root.path(), 0).is_err(), "without --resume nothing is kept");
    }

    #[test]
    fn half_floats_hold_the_brightest_lights() {
        let planes = ndarray::Array3::from_elem((3, 2, 2), 9e5);
        let image = LinearImage::from_planes(planes).unwrap();
        assert_eq!(set(0..1, true).fit(image.clone()).max(), 65504.0);
        assert_eq!(set(0..1, false).fit(image).max(), 9e5);
    }

    #[test]
    fn refuses_sizes_that_are_out_of_range() {
        let refused =
            |size, margin| SceneSet { size, margin, ..set(0..1, false) }.check().unwrap_err().to_string();
        assert!(refused([8, 64], 0).starts_with("size: 8x64"));
        assert!(refused([64, 9000], 0).starts_with("size: 64x9000"));
        assert!(refused([64, 8000], 97).starts_with("margin: 97"));
    }
}
