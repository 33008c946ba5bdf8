//! Turns two folders into pairs of a restored image and its ground truth, matched by name.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::core::error::{Error, Result};
use crate::core::image::{Linear, ToneMapped, ToneMappedImage};
use crate::core::tone::ToneCurve;
use crate::io::{self, DomainTag, Format};

use super::alike::Appearance;
use super::tone::curve_of_file;

/// A restored image and its ground truth, of one name but perhaps of two formats.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilePair {
    /// The name of both without extension.
    pub id: String,
    /// The restored image's file.
    pub restored: PathBuf,
    /// The ground truth's file.
    pub ground_truth: PathBuf,
}

/// The images of two folders: pairs, and what has no partner.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FolderPairs {
    /// The pairs, by name.
    pub pairs: Vec<FilePair>,
    /// Names that only one of the folders has, with what is missing.
    pub unmatched: Vec<(String, &'static str)>,
}

/// Matches the image files of two folders by their names without extension.
///
/// # Errors
/// [`Error::Format`] when a folder holds no image, or two of the same name; [`Error::Io`] when one cannot be
/// read.
pub fn pair_folders(restored: &Path, ground_truth: &Path) -> Result<FolderPairs> {
    let mut restored = images_by_stem(restored)?;
    let mut ground_truth = images_by_stem(ground_truth)?;
    let ids: BTreeSet<String> = restored.keys().chain(ground_truth.keys()).cloned().collect();
    let mut found = FolderPairs::default();
    for id in ids {
        match (restored.remove(&id), ground_truth.remove(&id)) {
            (Some(restored), Some(ground_truth)) => found.pairs.push(FilePair { id, restored, ground_truth }),
            (Some(_), None) => found.unmatched.push((id, "has no ground truth")),
            (None, _) => found.unmatched.push((id, "has no restored image")),
        }
    }
    Ok(found)
}

fn images_by_stem(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    if !folder.is_dir() {
        return Err(Error::format(folder, "is no folder; name a folder of images"));
    }
    let mut named: BTreeMap<String, PathBuf> = BTreeMap::new();
    for path in io::expand_inputs(&[folder.to_owned()])? {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if let Some(other) = named.get(&stem) {
            let reason = format!("holds {} and {}: which one is meant?", other.display(), path.display());
            return Err(Error::format(folder, reason));
        }
        named.insert(stem, path);
    }
    Ok(named)
}

/// An image that was read to be compared with another.
#[derive(Clone, Debug)]
pub struct ComparedImage {
    /// The image.
    pub image: ToneMappedImage,
    /// What its file says of its colours, and of how it lies.
    pub appearance: Appearance,
    /// What the file's colour tags say against what the user says.
    pub contradiction: Option<String>,
}

/// Reads an image of either domain and returns it tone-mapped by `curve`.
///
/// A tone-mapped file that says another curve is mapped back by its own first; one that says none is taken as it is.
///
/// The file's own declaration of its domain decides; where it has none, or is made for viewing, `domain` does, sRGB being
/// decoded to linear light first. Without either, Radiance files are linear.
///
/// # Errors
/// Those of [`io::read_image`]; [`Error::Format`] when nothing says what the values are, or the file is made for
/// viewing and `domain` does not say what to take it for.
pub fn read_tone_mapped(path: &Path, domain: Option<DomainTag>, curve: &ToneCurve) -> Result<ComparedImage> {
    let (mut pixels, encoding) = io::inspect_image(path)?;
    let appearance = Appearance::of(&pixels, encoding.format);
    let is_for_viewing = pixels.domain == Some(DomainTag::Display);
    let told = domain.filter(|_| pixels.domain.is_none() || is_for_viewing);
    let contradiction = pixels.tell(path, told)?;
    pixels.check_told(path)?;
    let image = match pixels.domain.or((encoding.format == Format::Hdr).then_some(DomainTag::Linear)) {
        Some(DomainTag::Linear | DomainTag::Srgb) => curve.tone_map(&io::image_of::<Linear>(path, pixels)?),
        Some(DomainTag::ToneMapped) => {
            let own = curve_of_file(path, pixels.provenance.as_ref())?;
            let image = io::image_of::<ToneMapped>(path, pixels)?;
            match own.filter(|own| own != curve) {
                Some(own) => curve.tone_map_in_place(own.inverse_tone_map_in_place(image)),
                None => image,
            }
        }
        Some(DomainTag::Display) => {
            let reason = "is made for viewing, as `udc finish` writes images, and its values are neither light nor tone-mapped \
                          light: give the image as it was before `udc finish`, or add --domain linear, --domain tone-mapped \
                          or --domain srgb to take the values for that";
            return Err(Error::format(path, reason));
        }
        None => {
            let reason = "does not say whether its values are linear, tone-mapped or sRGB: add --domain linear, --domain \
                          tone-mapped or --domain srgb";
            return Err(Error::format(path, reason));
        }
    };
    Ok(ComparedImage { image, appearance, contradiction })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    fn write(path: &Path, value: f32) {
        let image = ToneMappedImage::from_planes(Array3::from_elem((3, 4, 4), value)).unwrap();
        io::write_image(path, &image, &io::WriteOptions::default()).unwrap();
    }

    #[test]
    fn matches_by_name_whatever_the_format() {
        let scratch = tempfile::tempdir().unwrap();
        let (restored, truth) = (scratch.path().join("restored"), scratch.path().join("gt"));
        std::fs::create_dir_all(&restored).unwrap();
        std::fs::create_dir_all(&truth).unwrap();
        write(&restored.join("a.png"), 0.5);
        write(&restored.join("b.exr"), 0.5);
        write(&truth.join("a.exr"), 0.5);
        write(&truth.join("c.exr"), 0.5);
        let found = pair_folders(&restored, &truth).unwrap();
        assert_eq!(found.pairs.len(), 1);
        assert_eq!(found.pairs[0].id, "a");
        let expected = [("b".to_owned(), "has no ground truth"), ("c".to_owned(), "has no restored image")];
        assert_eq!(found.unmatched, expected);

        write(&restored.join("a.exr"), 0.5);
        assert!(pair_folders(&restored, &truth).unwrap_err().to_string().contains("which one"));
    }

    #[test]
    fn reads_each_domain_as_the_file_declares_it() {
        let scratch = tempfile::tempdir().unwrap();
        let curve = ToneCurve::default();
        let (declared, bare) = (scratch.path().join("declared.exr"), scratch.path().join("bare.npy"));
        write(&declared, 0.25);
        write(&bare, 0.25);
        assert_eq!(read_tone_mapped(&declared, None, &curve).unwrap().image.max(), 0.25);
        assert_eq!(read_tone_mapped(&declared, Some(DomainTag::Linear), &curve).unwrap().image.max(), 0.25);
        assert_eq!(read_tone_mapped(&bare, Some(DomainTag::Linear), &curve).unwrap().image.max(), 0.5);
        let message = read_tone_mapped(&bare, None, &curve).unwrap_err().to_string();
        assert!(message.contains("--domain"), "{message}");
    }
}
