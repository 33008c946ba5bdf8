//! Turns images of any kind into a page of nothing but their viewer, with all values as half floats.

use std::path::Path;

use image::imageops::thumbnail;
use ndarray::Array3;

use super::compressed::{bytes_of, half_floats, jpeg};
use super::page::Block;
use super::viewer::{Scene, ShownBy, ViewedPicture, Viewer};
use crate::capture::Told;
use crate::core::color::{srgb_decode, srgb_encode};
use crate::core::error::{Error, Result};
use crate::core::primaries::Primaries;
use crate::core::progress::Progress;
use crate::core::provenance::Provenance;
use crate::core::tone::ToneCurve;
use crate::finish::ColorMatrix;
use crate::io::{self, DomainTag, Pixels};
use crate::restore::Capture;

/// Pixels of one image at most: its half floats are one text in the page, and browsers take texts of 2²⁹ characters.
const LARGEST_IMAGE: usize = 60_000_000;

/// Pixels of all images at most: pages of more than two gigabytes are not opened.
const LARGEST_PAGE: usize = 240_000_000;

/// The longest side of a still, in pixels, and its quality.
const STILL_SIDE: usize = 640;
const STILL_QUALITY: u8 = 85;

/// An image as the viewer takes it.
#[derive(Clone, Debug)]
pub struct OpenedImage {
    name: String,
    size: [usize; 2],
    /// What its values were, in words.
    values: String,
    /// Whether it was made for viewing, so that the curve of sRGB shows it as it was.
    is_display: bool,
    range: Option<[f32; 2]>,
    not_finite: usize,
    still: Vec<u8>,
    light: Vec<u8>,
    note: String,
    provenance: Option<Provenance>,
}

/// Whether an image says that it is a PSF, simulated or measured.
pub fn is_psf(provenance: Option<&Provenance>) -> bool {
    provenance.is_some_and(|made| match made.command.as_str() {
        "psf" => true,
        "fuse" => made.config.get("psf").is_some_and(|psf| !psf.is_null()),
        _ => false,
    })
}

impl OpenedImage {
    /// Reads an image of any format and domain: as what the user `told`, or as what the file says; else floats are linear
    /// light, and integers are encoded by sRGB. A camera's raw file is developed.
    ///
    /// # Errors
    /// As [`io::read_pixels`], [`Pixels::tell`] and [`Capture::open`]; [`Error::Unsupported`] for an image that is too large
    /// for browsers.
    pub fn open(name: &str, path: &Path, told: Option<DomainTag>, progress: &Progress) -> Result<Self> {
        let mut pixels = io::read_pixels(path)?;
        let (_, height, width) = pixels.planes.dim();
        if height * width > LARGEST_IMAGE {
            return Err(Error::Unsupported(format!(
                "{}: {width} × {height} pixels are too many for a browser, which takes {LARGEST_IMAGE}; cut out a part \
                 with `udc crop` or another program",
                path.display()
            )));
        }
        if pixels.raw.is_some() {
            let told = Told { domain: told, ..Told::default() };
            let (capture, mut notes) = Capture::open(path, &told, progress)?;
            notes.insert(0, "developed from the camera's raw file".to_owned());
            let light = capture.image.into_linear(ToneCurve::default()).into_planes();
            let values = ("linear light".to_owned(), false);
            return Ok(Self::of_light(name, light, values, (notes, pixels.provenance)));
        }
        let mut notes: Vec<String> = pixels.tell(path, told)?.into_iter().collect();
        let provenance = pixels.provenance.take();
        let curve = provenance.as_ref().and_then(Provenance::tone_curve).unwrap_or_default();
        let primaries = pixels.capture.as_ref().and_then(|capture| capture.primaries);
        let (mut light, values, is_display) = light_of(path, pixels, curve, &mut notes)?;
        notes.extend(primaries.and_then(|primaries| to_srgb(&mut light, primaries)));
        Ok(Self::of_light(name, light, (values, is_display), (notes, provenance)))
    }

    fn of_light(
        name: &str,
        light: Array3<f32>,
        (values, is_display): (String, bool),
        (mut notes, provenance): (Vec<String>, Option<Provenance>),
    ) -> Self {
        let (_, height, width) = light.dim();
        let finite = || light.iter().copied().filter(|value| value.is_finite());
        let range = finite().fold(None, |range: Option<[f32; 2]>, value| {
            let [low, high] = range.unwrap_or([value; 2]);
            Some([low.min(value), high.max(value)])
        });
        let not_finite = light.len() - finite().count();
        if not_finite > 0 {
            notes.push(format!("{not_finite} values are NaN or infinite; NaN is shown in magenta"));
        }
        let beyond = finite().filter(|value| value.abs() > half::f16::MAX.to_f32()).count();
        if beyond > 0 {
            notes.push(format!("{beyond} values beyond ±65504, the largest half float, are shown as that"));
        }
        let note = if notes.is_empty() { String::new() } else { format!("{name}: {}.", notes.join("; ")) };
        let still = still_of(&light, is_display);
        let light = half_floats(light.view());
        let name = name.to_owned();
        let size = [height, width];
        Self { name, size, values, is_display, range, not_finite, still, light, note, provenance }
    }

    /// What the file says of its making.
    pub fn provenance(&self) -> Option<&Provenance> {
        self.provenance.as_ref()
    }
}

/// Turns light of `primaries` into that of sRGB, which the page shows; says so.
fn to_srgb(light: &mut Array3<f32>, primaries: Primaries) -> Option<String> {
    ColorMatrix::of(primaries.matrix_to(&Primaries::SRGB)?).apply(light);
    Some(format!(
        "converted from {} to those of sRGB, of which all values are here",
        Primaries::name_of(Some(primaries))
    ))
}

/// The linear light of pixels, which were mapped by `curve` if they are tone-mapped; what they were in words, and whether they
/// were made for viewing.
fn light_of(
    path: &Path,
    pixels: Pixels,
    curve: ToneCurve,
    notes: &mut Vec<String>,
) -> Result<(Array3<f32>, String, bool)> {
    let (domain, is_integer) = (pixels.domain, pixels.is_integer);
    let mut light = io::to_rgb(path, pixels.planes)?;
    let (values, is_display) = match domain {
        Some(DomainTag::Linear) => ("linear light", false),
        Some(DomainTag::ToneMapped) => {
            light.par_mapv_inplace(|value| curve.expand(value));
            return Ok((light, format!("tone-mapped, x/(x+{})", curve.alpha), false));
        }
        // Told so, and decoded by that.
        Some(DomainTag::Srgb) => ("sRGB", true),
        None if !is_integer => ("linear light, as nothing else is said", false),
        Some(DomainTag::Display) | None => {
            if domain.is_none() {
                notes.push(
                    "taken for sRGB, as the file does not say what it holds (--domain says it)".to_owned(),
                );
            }
            #[expect(clippy::cast_possible_truncation, reason = "images are f32")]
            light.par_mapv_inplace(|value| srgb_decode(f64::from(value)) as f32);
            ("sRGB, for viewing", true)
        }
    };
    Ok((light, values.to_owned(), is_display))
}

/// A small picture for paper and for browsers without scripts.
fn still_of(light: &Array3<f32>, is_display: bool) -> Vec<u8> {
    let curve = ToneCurve::default();
    #[expect(clippy::cast_possible_truncation, reason = "images are f32")]
    let show = |value: f32| match is_display {
        true => srgb_encode(f64::from(value.clamp(0.0, 1.0))) as f32,
        false => curve.compress(value),
    };
    let picture = bytes_of(light.view(), show);
    let longest = picture.width().max(picture.height()) as usize;
    if longest <= STILL_SIDE {
        return jpeg(&picture, STILL_QUALITY);
    }
    #[expect(clippy::cast_possible_truncation, reason = "smaller than the picture's side")]
    let side = |side: u32| (side as usize * STILL_SIDE / longest).max(1) as u32;
    jpeg(&thumbnail(&picture, side(picture.width()), side(picture.height())), STILL_QUALITY)
}

/// Shows images in one viewer: those of one size are compared with each other; `reference` is the one that differences are
/// taken from, by its place among them, or the last of each size.
///
/// # Errors
/// [`Error::Unsupported`] when the images together are too large for browsers.
pub fn view(images: Vec<OpenedImage>, reference: Option<usize>) -> Result<Vec<Block>> {
    let pixels: usize = images.iter().map(|image| image.size[0] * image.size[1]).sum();
    if pixels > LARGEST_PAGE {
        return Err(Error::Unsupported(format!(
            "{pixels} pixels are too many for one page, which takes {LARGEST_PAGE}; choose fewer images"
        )));
    }
    let mut blocks = vec![Block::Heading("Pictures".to_owned())];
    let table = table_of(&images);
    let shown_by = match images.iter().all(|image| image.is_display) {
        true => ShownBy::Srgb,
        false => ShownBy::ToneMapping,
    };
    let mut scenes: Vec<Scene> = Vec::new();
    for (index, image) in images.into_iter().enumerate() {
        let at = scenes.iter().position(|scene| scene.size == image.size).unwrap_or(scenes.len());
        if at == scenes.len() {
            let [height, width] = image.size;
            scenes.push(Scene {
                name: format!("{width} × {height} pixels"),
                size: image.size,
                curve: ToneCurve::default(),
                pictures: Vec::new(),
                reference: None,
                regions: None,
                note: String::new(),
            });
        }
        if reference == Some(index) {
            scenes[at].reference = Some(scenes[at].pictures.len());
        }
        let OpenedImage { name, still, light, note, .. } = image;
        scenes[at].pictures.push(ViewedPicture { name, still, light: Some(light), note });
    }
    if scenes.len() > 1 {
        let text = "The images differ in size: those of each size are compared with each other, and are chosen under Scene.";
        blocks.push(Block::Text(text.to_owned()));
    }
    for scene in &mut scenes {
        let last = scene.pictures.len() - 1;
        scene.reference = scene.reference.or((last > 0).then_some(last));
        if last == 0 {
            scene.name = format!("{}, {}", scene.pictures[0].name, scene.name);
        }
    }
    blocks.push(Block::Viewer(Box::new(Viewer {
        scenes,
        shown_by,
        stills: "Small pictures of all".to_owned(),
    })));
    blocks.push(table);
    Ok(blocks)
}

fn table_of(images: &[OpenedImage]) -> Block {
    let head = ["image", "width", "height", "values", "smallest", "largest", "not finite"];
    let row = |image: &OpenedImage| {
        let [height, width] = image.size;
        let [low, high] = match image.range {
            Some(range) => range.map(|value| format!("{value:.4}")),
            None => ["–", "–"].map(str::to_owned),
        };
        let counted = [width, height].map(|side| side.to_string());
        let mut row = vec![image.name.clone()];
        row.extend(counted);
        row.extend([image.values.clone(), low, high, image.not_finite.to_string()]);
        row
    };
    Block::Table(head.map(str::to_owned).to_vec(), images.iter().map(row).collect())
}
