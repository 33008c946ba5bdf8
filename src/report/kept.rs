//! Turns the pictures that an evaluation kept into a viewer that takes no more room than a page can give it.

use std::path::{Path, PathBuf};

use super::compressed::{half_floats, jpeg_of, png_of_regions};
use super::viewer::{Scene, ShownBy, ViewedPicture, Viewer};
use crate::core::error::Result;
use crate::core::image::{Linear, LinearImage, ToneMapped, ToneMappedImage};
use crate::core::tone::ToneCurve;
use crate::experiment::{Definition, PICTURES, PictureName, Regions};
use crate::io::{self, DomainTag};

/// Qualities of JPEG that are tried, best first.
const QUALITIES: [u8; 5] = [92, 85, 75, 60, 45];

/// The share of the room that stills may take; the rest is for half floats.
const SHARE_OF_STILLS: f64 = 0.6;

/// What scenes differ by from those that the size of all is estimated by.
const RESERVE: f64 = 1.15;

/// What an evaluation calls the images that nothing was done to, and those that they should be.
const DEGRADED: &str = "degraded";
const GROUND_TRUTH: &str = "ground truth";

/// The pictures that an evaluation kept, found and not yet read.
#[derive(Clone, Debug)]
pub struct KeptScenes {
    scenes: Vec<KeptScene>,
}

#[derive(Clone, Debug)]
struct KeptScene {
    name: String,
    curve: ToneCurve,
    pictures: Vec<KeptPicture>,
}

#[derive(Clone, Debug)]
struct KeptPicture {
    name: String,
    /// Tone-mapped values in 16 bits.
    png: PathBuf,
    /// The light as it was measured, of the first scene.
    exr: Option<PathBuf>,
}

impl KeptScenes {
    /// Finds the pictures in the folder of an evaluation's results; none where it kept none.
    ///
    /// # Errors
    /// Those of [`io::list_folder`].
    pub(super) fn find(results: &Path, definition: &Definition) -> Result<Option<Self>> {
        let folder = results.join(PICTURES);
        if !folder.is_dir() {
            return Ok(None);
        }
        let files = io::list_folder(&folder)?;
        let mut named: Vec<_> = files
            .iter()
            .filter(|file| file.ends_with(".png"))
            .filter_map(|file| Some((PictureName::of_file(file)?, file)))
            .collect();
        named.sort();
        let picture = |(name, file): &(PictureName<'_>, &String)| {
            let exr = file.replace(".png", ".exr");
            let exr = files.contains(&exr).then(|| folder.join(exr));
            KeptPicture { name: name.what.to_owned(), png: folder.join(file), exr }
        };
        let scene = |row: &[(PictureName<'_>, &String)]| KeptScene {
            name: row[0].0.scene.to_owned(),
            curve: curve_of(definition, row[0].0.scene),
            pictures: row.iter().map(picture).collect(),
        };
        let mut scenes: Vec<KeptScene> =
            named.chunk_by(|(a, _), (b, _)| a.scene == b.scene).map(scene).collect();
        // That of which the light is kept comes first: it is what a reader sees before choosing.
        scenes.sort_by_key(|scene| scene.pictures.iter().all(|picture| picture.exr.is_none()));
        Ok((!scenes.is_empty()).then_some(Self { scenes }))
    }

    /// Reads the pictures and compresses them so that their viewer takes no more than `room` bytes of the page; what finds
    /// no room is left out, and said.
    ///
    /// # Errors
    /// Those of reading pictures.
    pub fn embed(&self, room: usize) -> Result<Viewer> {
        let room = room as f64;
        let first = self.scenes[0].read()?;
        let quality = self.quality(&first, SHARE_OF_STILLS * room)?;
        let mut scenes = vec![first.compress(quality)];
        let mut taken = scenes[0].bytes();
        for kept in &self.scenes[1..] {
            let scene = kept.read()?.compress(quality);
            if taken + scene.bytes() > room {
                break;
            }
            taken += scene.bytes();
            scenes.push(scene);
        }
        let shown = scenes.len();
        self.scenes[0].embed_light(&mut scenes[0], &first.images, room - taken)?;
        let mut stills = format!("All pictures: {shown} scenes, JPEG of quality {quality}");
        if shown < self.scenes.len() {
            stills += &format!("; {} more scenes find no room in the page", self.scenes.len() - shown);
            scenes[0].note += &format!(
                " {} of {} scenes find no room in the page.",
                self.scenes.len() - shown,
                self.scenes.len()
            );
        }
        Ok(Viewer { scenes, shown_by: ShownBy::ToneMapping, stills })
    }

    /// The best quality by which all scenes are estimated to take at most so many bytes; the least where none does.
    fn quality(&self, first: &ReadScene, room: f64) -> Result<u8> {
        let size = |picture: &KeptPicture| {
            let [height, width] =
                io::read_image_size::<ToneMapped>(&picture.png, Some(DomainTag::ToneMapped))?;
            Ok((height * width) as f64)
        };
        let mut pixels = 0.0;
        for picture in self.scenes.iter().flat_map(|scene| &scene.pictures) {
            pixels += size(picture)?;
        }
        let measured: f64 = first.images.iter().map(|image| (image.height() * image.width()) as f64).sum();
        let fits = |quality: &&u8| {
            let bytes: usize = first.images.iter().map(|image| jpeg_of(image, **quality).len()).sum();
            RESERVE * in_base64(bytes) * pixels / measured <= room
        };
        Ok(*QUALITIES.iter().find(fits).unwrap_or(&QUALITIES[QUALITIES.len() - 1]))
    }
}

impl KeptScene {
    fn read(&self) -> Result<ReadScene<'_>> {
        let read = |picture: &KeptPicture| {
            let told = Some(DomainTag::ToneMapped);
            io::read_image_told::<ToneMapped>(&picture.png, told).map(|(image, _)| image)
        };
        Ok(ReadScene { kept: self, images: self.pictures.iter().map(read).collect::<Result<_>>()? })
    }

    /// Adds the light of the pictures to those of the page as far as there is room: clean and degraded, then what was
    /// restored, the last first; says what finds none.
    fn embed_light(&self, scene: &mut Scene, images: &[ToneMappedImage], mut room: f64) -> Result<()> {
        let count = self.pictures.len();
        let mut left_out = Vec::new();
        for index in
            std::iter::once(count - 1).chain((0..count - 1).take(1)).chain((1..count.max(1) - 1).rev())
        {
            let [height, width] = scene.size;
            let bytes = in_base64(2 * 3 * height * width);
            if bytes > room || images[index].height() != height || images[index].width() != width {
                left_out.push(self.pictures[index].name.as_str());
                continue;
            }
            room -= bytes;
            let light = self.light(index, &images[index])?;
            scene.pictures[index].light = Some(half_floats(light.planes()));
        }
        if !left_out.is_empty() {
            scene.note += &format!(
                " The light of {} finds no room in the page: ≈ marks values of compressed pictures.",
                left_out.join(", ")
            );
        }
        Ok(())
    }

    /// The light of a picture: as it was kept, or what its tone-mapped values stand for.
    fn light(&self, index: usize, image: &ToneMappedImage) -> Result<LinearImage> {
        match &self.pictures[index].exr {
            Some(exr) => io::read_image::<Linear>(exr),
            None => Ok(self.curve.inverse_tone_map(image)),
        }
    }
}

/// A scene whose pictures were read.
struct ReadScene<'a> {
    kept: &'a KeptScene,
    images: Vec<ToneMappedImage>,
}

impl ReadScene<'_> {
    fn compress(&self, quality: u8) -> Scene {
        let picture = |(kept, image): (&KeptPicture, &ToneMappedImage)| ViewedPicture {
            name: kept.name.clone(),
            still: jpeg_of(image, quality),
            light: None,
            note: String::new(),
        };
        let place = |name: &str| self.kept.pictures.iter().position(|picture| picture.name == name);
        let (degraded, clean) = (place(DEGRADED), place(GROUND_TRUTH));
        let linear = |at: usize| self.kept.curve.inverse_tone_map(&self.images[at]);
        let size = [self.images[0].height(), self.images[0].width()];
        let regions = degraded.zip(clean).filter(|_| self.is_of_one_size());
        let regions = regions.map(|(degraded, clean)| {
            png_of_regions(&Regions::divide(&linear(clean), &linear(degraded), self.kept.curve))
        });
        Scene {
            name: self.kept.name.clone(),
            size,
            curve: self.kept.curve,
            pictures: self.kept.pictures.iter().zip(&self.images).map(picture).collect(),
            reference: clean,
            regions,
            note: String::new(),
        }
    }

    fn is_of_one_size(&self) -> bool {
        self.images.iter().all(|image| image.planes().dim() == self.images[0].planes().dim())
    }
}

impl Scene {
    /// Bytes that the scene takes in the page, but for its half floats and some text.
    fn bytes(&self) -> f64 {
        let regions = self.regions.as_ref().map_or(0, Vec::len);
        in_base64(regions + self.pictures.iter().map(|picture| picture.still.len()).sum::<usize>())
    }
}

/// The characters that so many bytes become.
fn in_base64(bytes: usize) -> f64 {
    bytes as f64 * 4.0 / 3.0
}

/// The curve of a scene's dataset, whose name the scene's begins with where there are several.
fn curve_of(definition: &Definition, scene: &str) -> ToneCurve {
    let datasets = &definition.datasets;
    let is_own = |name: &String| scene.starts_with(&format!("{}_", name.replace(['/', '\\'], "-")));
    let own = datasets.iter().find(|measured| measured.dataset.as_ref().is_some_and(is_own));
    let curve = own.or(datasets.first()).map(|measured| ToneCurve::new(measured.alpha, measured.x_max));
    curve.and_then(Result::ok).unwrap_or_default()
}
