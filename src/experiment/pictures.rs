//! Keeps some of the measured images as pictures to look at.

use std::path::PathBuf;

use super::{ComparedMethod, Sample};
use crate::core::capture::CaptureInfo;
use crate::core::error::Result;
use crate::core::image::ToneMappedImage;
use crate::core::primaries::Primaries;
use crate::core::spread::spread;
use crate::core::tone::ToneCurve;
use crate::io::{self, WriteOptions};

/// The folder of the pictures, within that of the results.
pub const FOLDER: &str = "pictures";

/// Which samples are kept as pictures, and where.
#[derive(Clone, Debug, Default)]
pub struct KeptPictures {
    /// The folder that they are written to; it is made with the first.
    pub folder: PathBuf,
    /// How many of the samples.
    pub count: usize,
    /// What their names begin with.
    pub prefix: String,
    /// Their red, green and blue, where these are others than those of sRGB; files of light say them.
    pub primaries: Option<Primaries>,
}

/// What the name of a picture says.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PictureName<'a> {
    /// The scene with its kernel.
    pub scene: &'a str,
    /// Its place among the pictures of the scene, from 1.
    number: usize,
    /// What restored it, or that it is the ground truth.
    pub what: &'a str,
}

impl<'a> PictureName<'a> {
    /// Reads a file's name; none for files that an evaluation does not write.
    pub fn of_file(file: &'a str) -> Option<Self> {
        // A dot separates the scene from what the picture shows.
        let name = file.strip_suffix(".png").or_else(|| file.strip_suffix(".exr"))?;
        let (scene, shown) = name.rsplit_once('.')?;
        let (number, what) = shown.split_once('-')?;
        Some(Self { scene, number: number.parse().ok()?, what })
    }
}

impl KeptPictures {
    /// The files of sample `index` of `total`: none unless it is one of those to keep, which are spread evenly. Of the first,
    /// the light is kept too, in half floats before the pictures: a picture holds little of what is much brighter than white.
    pub(super) fn files(
        &self,
        (index, total): (usize, usize),
        scene: &str,
        methods: &[ComparedMethod],
    ) -> Vec<String> {
        if !spread(self.count, total).any(|kept| kept == index) {
            return Vec::new();
        }
        let name = |method: &ComparedMethod| {
            method.name.trim_end_matches(".safetensors").replace(['/', '\\', '.'], "-")
        };
        let shown = methods.iter().map(name).chain(["ground truth".to_owned()]);
        let prefix = &self.prefix;
        let pictures: Vec<String> = shown
            .enumerate()
            .map(|(index, what)| format!("{prefix}{scene}.{}-{what}.png", index + 1))
            .collect();
        let is_first = spread(self.count, total).next() == Some(index);
        let light = pictures.iter().filter(|_| is_first).map(|name| name.replace(".png", ".exr"));
        light.chain(pictures.iter().cloned()).collect()
    }

    /// Writes the images of a sample, tone-mapped by `curve`, to its files.
    pub(super) fn keep(&self, files: &[String], sample: &Sample, curve: ToneCurve) -> Result<()> {
        if !files.is_empty() {
            io::create_folder(&self.folder)?;
        }
        let images = sample.images.iter().chain([&sample.ground_truth]).cycle();
        files.iter().zip(images).try_for_each(|(file, image)| self.write(file, image, curve))
    }

    fn write(&self, file: &str, image: &ToneMappedImage, curve: ToneCurve) -> Result<()> {
        let path = self.folder.join(file);
        let capture = self.primaries.map(CaptureInfo::of_primaries);
        let options = WriteOptions { overwrite: true, half: true, capture, ..WriteOptions::default() };
        if file.ends_with(".exr") {
            return io::write_image(&path, &curve.inverse_tone_map(image), &options);
        }
        let shown: ToneMappedImage = image.map_values(|value| value.clamp(0.0, 1.0));
        io::write_image(&path, &shown, &options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_scene_place_and_method_whatever_the_method_is_called() {
        let pictures = KeptPictures { count: 2, prefix: "a.b_".to_owned(), ..KeptPictures::default() };
        let methods: Vec<ComparedMethod> =
            (0..11).map(|number| ComparedMethod::restored(format!("{number}.pth"))).collect();
        let files = pictures.files((3, 4), "street_r+00", &methods);
        let mut read: Vec<_> = files.iter().map(|file| PictureName::of_file(file).unwrap()).collect();
        assert_eq!(read[0], PictureName { scene: "a.b_street_r+00", number: 1, what: "0-pth" });
        assert_eq!(read[11].what, "ground truth");
        let order: Vec<String> = read.iter().map(|name| name.what.to_owned()).collect();
        read.reverse();
        read.sort();
        assert_eq!(read.iter().map(|name| name.what).collect::<Vec<_>>(), order);
        assert!(files.iter().all(|file| file.ends_with(".png")), "the light of the first alone is kept");
        assert!(pictures.files((1, 4), "street_r+00", &methods).is_empty());
        let first = pictures.files((0, 4), "street_r+00", &methods[..1]);
        let what = ["1-0-pth.exr", "2-ground truth.exr", "1-0-pth.png", "2-ground truth.png"];
        assert_eq!(first, what.map(|what| format!("a.b_street_r+00.{what}")));
        assert_eq!(PictureName::of_file(&first[0]).unwrap().what, "0-pth");
        assert_eq!(PictureName::of_file("holiday.png"), None);
        assert_eq!(PictureName::of_file("a.b-c.png"), None);
    }
}
