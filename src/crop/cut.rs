//! Cuts views out of the panoramas of files, and writes them to a folder.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::Serialize;

use super::{Panorama, View, crop_with_margin};
use crate::batch::{Kept, is_broken, is_made, tell_of_others, write_or_keep};
use crate::core::capture::CaptureInfo;
use crate::core::error::{Error, Result};
use crate::core::image::Linear;
use crate::core::primaries::Primaries;
use crate::core::progress::Progress;
use crate::core::provenance::Provenance;
use crate::core::shard::Shard;
use crate::io::{self, DomainTag, WriteOptions};

/// Views that are to be cut out of each panorama.
#[derive(Clone, Debug)]
pub struct Cut {
    /// The views; the n-th of a panorama becomes `<panorama>_<nn>`.
    pub views: Vec<View>,
    /// Pixels more on each side.
    pub margin: usize,
    /// What the user says that the panoramas' files hold.
    pub told: Option<DomainTag>,
    /// Extension of the views' files: `exr` or `npy`.
    pub image_format: &'static str,
    /// Whether half floats are written.
    pub half: bool,
    /// Whether files that are there may be replaced.
    pub overwrite: bool,
    /// Whether views that are there are kept.
    pub resume: bool,
    /// Whose views are cut: a block of all, so that few panoramas are read by several runs.
    pub shard: Shard,
}

/// What happened to a panorama.
#[derive(Clone, Debug)]
pub enum CutReport<'a> {
    /// Images of other runs are in the folder of one that replaces files, in words for a warning.
    Others(String),
    /// It was read.
    Read {
        /// Its name.
        panorama: &'a str,
        /// What its file says of its colours against what the user says, and what its views' files cannot say.
        warnings: Vec<String>,
        /// How long it took.
        time: Duration,
    },
    /// One of its views was rendered.
    Rendered {
        /// Its name.
        panorama: &'a str,
        /// Which of its views, from 1.
        view: usize,
        /// How long it took.
        time: Duration,
    },
}

/// How many there were of what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CutCount {
    /// Panoramas that were read.
    pub panoramas: usize,
    /// Views that were cut out of them, or are kept.
    pub views: usize,
    /// Those that were there.
    pub kept: Kept,
}

/// The views that one run cuts out of a panorama.
pub(super) struct PanoramaViews {
    stem: String,
    pub(super) path: PathBuf,
    /// Indices, from 0.
    pub(super) views: Range<usize>,
}

/// Views that have yet to be cut out of a panorama.
struct Todo {
    panorama: PanoramaViews,
    file: PanoramaSource,
    /// Indices, from 0.
    views: Vec<usize>,
    /// The others.
    kept: Kept,
}

/// What the views of a panorama are made of.
struct PanoramaSource {
    sha256: String,
    /// Where they are others than those of sRGB.
    primaries: Option<Primaries>,
}

/// What a view's provenance says.
#[derive(Serialize)]
struct Origin<'a> {
    panorama: &'a str,
    panorama_sha256: &'a str,
    /// Those of the panorama, which views of an older version do not have.
    #[serde(skip_serializing_if = "Option::is_none")]
    primaries: Option<Primaries>,
    /// What the user said that the panorama's file holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    domain: Option<&'static str>,
    #[serde(flatten)]
    view: View,
    /// The key by which `udc synth` finds it.
    margin: usize,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    half: bool,
}

impl Cut {
    /// Cuts the views of a shard out of the panoramas of files, into `folder`, telling `on_report` of each.
    ///
    /// # Errors
    /// [`Error::Unsupported`] when two panoramas would have views of one name; [`Error::Config`] for views that cannot
    /// be rendered; [`Error::Interrupted`] after an interrupt; else of reading or writing a file.
    pub fn run(
        &self,
        panoramas: Vec<PathBuf>,
        folder: &Path,
        progress: &Progress,
        mut on_report: impl FnMut(CutReport<'_>),
    ) -> Result<CutCount> {
        self.check()?;
        let work = self.share(name_by_stem(panoramas)?)?;
        // Shards share a folder.
        if self.overwrite && !self.shard.is_part() {
            let made = work.iter().flat_map(|PanoramaViews { stem, views, .. }| {
                views.clone().map(|view| self.path(folder, stem, view + 1))
            });
            tell_of_others(folder, made)?.into_iter().for_each(|others| on_report(CutReport::Others(others)));
        }
        let (panoramas, views) = (work.len(), work.iter().map(|panorama| panorama.views.len()).sum());
        let todo =
            work.into_iter().map(|panorama| self.todo(folder, panorama)).collect::<Result<Vec<_>>>()?;
        let kept = Kept {
            whole: todo.iter().map(|todo| todo.kept.whole).sum(),
            broken: todo.iter().map(|todo| todo.kept.broken).sum(),
        };
        let bar = progress.bar(views as u64, "views");
        bar.start_at(kept.whole as u64);
        for Todo { panorama: PanoramaViews { stem, path, .. }, file, views, .. } in &todo {
            if views.is_empty() {
                continue;
            }
            let started = Instant::now();
            let capture = file.primaries.map(CaptureInfo::of_primaries);
            let (panorama, mut warnings) = self
                .read(path)
                .map_err(|error| error.while_doing(format!("reading the panorama {}", path.display())))?;
            let first = self.path(folder, stem, views[0] + 1);
            warnings.extend(capture.as_ref().and_then(|capture| io::what_is_lost(&first, capture)));
            on_report(CutReport::Read { panorama: stem, warnings, time: started.elapsed() });
            io::create_folder(folder)?;
            for &index in views {
                progress.check()?;
                let started = Instant::now();
                let image = crop_with_margin(&panorama, &self.views[index], self.margin);
                on_report(CutReport::Rendered { panorama: stem, view: index + 1, time: started.elapsed() });
                let (path, provenance) =
                    (self.path(folder, stem, index + 1), self.provenance((stem, file), index));
                let (half, overwrite, origin) = (self.half, self.overwrite, Some(provenance.clone()));
                let options = WriteOptions { half, overwrite, provenance: origin, capture: capture.clone() };
                write_or_keep(&path, self.resume, &provenance, || io::write_image(&path, &image, &options))?;
                bar.inc(1);
            }
        }
        bar.finish_and_clear();
        Ok(CutCount { panoramas, views, kept })
    }

    /// The views of a panorama that are not there, or may be replaced.
    fn todo(&self, folder: &Path, panorama: PanoramaViews) -> Result<Todo> {
        // Before the pixels, so that they are not older than it.
        let sha256 = io::sha256_of_file(&panorama.path)?;
        let file = PanoramaSource { sha256, primaries: io::read_primaries(&panorama.path)? };
        let (mut views, mut kept) = (Vec::new(), Kept::default());
        for index in panorama.views.clone() {
            let path = self.path(folder, &panorama.stem, index + 1);
            let is_broken = self.resume && is_broken(&path)?;
            let wanted = self.provenance((&panorama.stem, &file), index);
            if self.resume && !is_broken && is_made(&path, &wanted)? {
                kept.whole += 1;
                continue;
            }
            kept.broken += usize::from(is_broken);
            if folder.exists() {
                io::check_output(&path, self.overwrite || is_broken)?;
            }
            views.push(index);
        }
        Ok(Todo { panorama, file, views, kept })
    }

    /// How the view of an index is made of a panorama of a name.
    fn provenance(&self, (panorama, file): (&str, &PanoramaSource), index: usize) -> Provenance {
        let (panorama_sha256, primaries) = (&*file.sha256, file.primaries);
        let (domain, view) = (self.told.map(DomainTag::name), self.views[index]);
        let (margin, half) = (self.margin, self.half);
        Provenance::new("crop", &Origin { panorama, panorama_sha256, primaries, domain, view, margin, half })
    }

    /// The panoramas of the shard, with its views of each.
    pub(super) fn share(&self, panoramas: BTreeMap<String, PathBuf>) -> Result<Vec<PanoramaViews>> {
        let each = self.views.len();
        self.shard.check(panoramas.len() * each, "views")?;
        let block = self.shard.block(panoramas.len() * each);
        let of = |(index, (stem, path)): (usize, (String, PathBuf))| {
            let within = |at: usize| at.clamp(index * each, (index + 1) * each) - index * each;
            PanoramaViews { stem, path, views: within(block.start)..within(block.end) }
        };
        let shared = panoramas.into_iter().enumerate().map(of);
        Ok(shared.filter(|panorama| !panorama.views.is_empty()).collect())
    }

    /// Checks that all views can be rendered.
    ///
    /// # Errors
    /// As [`View::check_margin`].
    pub fn check(&self) -> Result<()> {
        self.views.iter().try_for_each(|view| view.check_margin(self.margin))
    }

    /// A panorama, and what to warn of.
    fn read(&self, path: &Path) -> Result<(Panorama, Vec<String>)> {
        let (image, contradiction) = io::read_image_told::<Linear>(path, self.told)?;
        Ok((Panorama::new(image)?, contradiction.into_iter().collect()))
    }

    fn path(&self, folder: &Path, stem: &str, number: usize) -> PathBuf {
        folder.join(format!("{stem}_{number:02}.{}", self.image_format))
    }
}

/// Files by their names without extension, which name their views.
pub(super) fn name_by_stem(paths: Vec<PathBuf>) -> Result<BTreeMap<String, PathBuf>> {
    let mut named: BTreeMap<String, PathBuf> = BTreeMap::new();
    for path in paths {
        let stem = io::stem_of_input(&path);
        if let Some(other) = named.get(&stem) {
            return Err(Error::Unsupported(format!(
                "{} and {} would write the same views; rename one of them",
                other.display(),
                path.display()
            )));
        }
        named.insert(stem, path);
    }
    Ok(named)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::image::LinearImage;
    use crate::core::primaries::Primaries;
    use ndarray::Array3;

    #[test]
    fn views_are_of_the_primaries_of_their_panorama_or_it_is_said_that_they_cannot_say_so() {
        let root = tempfile::tempdir().unwrap();
        let image = LinearImage::from_planes(Array3::from_elem((3, 8, 16), 0.5)).unwrap();
        let path = root.path().join("street.exr");
        let capture = Some(CaptureInfo::of_primaries(Primaries::BT2020));
        io::write_image(&path, &image, &WriteOptions { capture, ..WriteOptions::default() }).unwrap();
        let cut = |image_format: &'static str| {
            let views = vec![View { yaw_deg: 0.0, pitch_deg: 0.0, fov_deg: 60.0, size: 8 }];
            let (told, half, overwrite, resume) = (None, false, false, false);
            let cut =
                Cut { views, margin: 0, told, image_format, half, overwrite, resume, shard: Shard::WHOLE };
            let mut said = Vec::new();
            let report = |report: CutReport<'_>| {
                if let CutReport::Read { warnings, .. } = report {
                    said.extend(warnings);
                }
            };
            cut.run(vec![path.clone()], root.path(), &Progress::default(), report).unwrap();
            said
        };
        assert!(cut("exr").is_empty());
        let found = io::read_primaries(&root.path().join("street_01.exr")).unwrap().unwrap();
        assert!(found.is_near(&Primaries::BT2020), "{found:?}");
        let said = cut("npy");
        assert!(said.len() == 1 && said[0].contains("street_01.npy cannot carry"), "{said:?}");
    }

    /// As those of a version that did not pass them on.
    #[test]
    fn a_view_that_lacks_the_primaries_of_its_panorama_is_not_kept() {
        let root = tempfile::tempdir().unwrap();
        let image = LinearImage::from_planes(Array3::from_elem((3, 8, 16), 0.5)).unwrap();
        let path = root.path().join("street.exr");
        let capture = Some(CaptureInfo::of_primaries(Primaries::BT2020));
        io::write_image(&path, &image, &WriteOptions { capture, ..WriteOptions::default() }).unwrap();
        let cut = Cut {
            views: vec![View { yaw_deg: 0.0, pitch_deg: 0.0, fov_deg: 60.0, size: 8 }],
            margin: 0,
            told: None,
            image_format: "exr",
            half: false,
            overwrite: false,
            resume: true,
            shard: Shard::WHOLE,
        };
        let run = || cut.run(vec![path.clone()], root.path(), &Progress::default(), |_| {});
        run().unwrap();
        assert_eq!(run().unwrap().kept.whole, 1);
        let view = root.path().join("street_01.exr");
        let mut provenance = io::read_provenance(&view).unwrap().unwrap();
        provenance.config.as_object_mut().unwrap().remove("primaries").unwrap();
        let image = io::read_image::<Linear>(&view).unwrap();
        let options =
            WriteOptions { provenance: Some(provenance), overwrite: true, ..WriteOptions::default() };
        io::write_image(&view, &image, &options).unwrap();
        let said = run().unwrap_err().to_string();
        assert!(said.contains("street_01.exr was made with other settings"), "{said}");
    }

    #[test]
    fn every_view_of_every_panorama_becomes_a_file() {
        let root = tempfile::tempdir().unwrap();
        let write = |name: &str| {
            let path = root.path().join(name);
            let image = LinearImage::from_planes(Array3::from_elem((3, 8, 16), 0.5)).unwrap();
            io::create_folder(path.parent().unwrap()).unwrap();
            io::write_image(&path, &image, &WriteOptions::default()).unwrap();
            path
        };
        let view = |yaw_deg| View { yaw_deg, pitch_deg: 0.0, fov_deg: 60.0, size: 16 };
        let views = vec![view(0.0), view(90.0)];
        let shard = Shard::WHOLE;
        let cut = Cut {
            views,
            margin: 1,
            told: None,
            image_format: "exr",
            half: false,
            overwrite: false,
            resume: false,
            shard,
        };
        let run = |paths: &[&PathBuf], on_report: &mut dyn FnMut(CutReport<'_>)| {
            let paths = paths.iter().map(|&path| path.clone()).collect();
            cut.run(paths, &root.path().join("views"), &Progress::default(), on_report)
        };
        let [street, beach, other] = ["street.npy", "beach.npy", "other/street.npy"].map(write);
        let mut reports = Vec::new();
        let count = run(&[&street, &beach], &mut |report| {
            reports.push(match report {
                CutReport::Others(others) => others,
                CutReport::Read { panorama, .. } => panorama.to_owned(),
                CutReport::Rendered { panorama, view, .. } => format!("{panorama} {view}"),
            });
        });
        assert_eq!(count.unwrap(), CutCount { panoramas: 2, views: 4, kept: Kept::default() });
        assert_eq!(reports, ["beach", "beach 1", "beach 2", "street", "street 1", "street 2"]);
        let path = root.path().join("views/street_02.exr");
        assert_eq!(io::read_image::<Linear>(&path).unwrap().height(), 18);
        assert_eq!(io::read_provenance(&path).unwrap().unwrap().margin(), Some(1));
        let again = run(&[&street], &mut |_| {}).unwrap_err().to_string();
        assert!(again.contains("street_01.exr"), "{again}");
        let twice = run(&[&street, &other], &mut |_| {}).unwrap_err().to_string();
        assert!(twice.contains("would write the same views"), "{twice}");

        std::fs::remove_file(&path).unwrap();
        let resume = Cut { resume: true, ..cut };
        let folder = root.path().join("views");
        let again = |cut: &Cut| cut.run(vec![street.clone()], &folder, &Progress::default(), |_| {});
        let kept = Kept { whole: 1, broken: 0 };
        assert_eq!(again(&resume).unwrap(), CutCount { panoramas: 1, views: 2, kept });
        assert!(path.is_file());
        std::fs::write(&path, "").unwrap();
        let kept = Kept { whole: 1, broken: 1 };
        assert_eq!(again(&resume).unwrap(), CutCount { panoramas: 1, views: 2, kept });
        assert_eq!(io::read_image::<Linear>(&path).unwrap().height(), 18);
        std::fs::rename(&other, &street).unwrap();
        let other = LinearImage::from_planes(Array3::from_elem((3, 8, 16), 0.25)).unwrap();
        io::write_image(&street, &other, &WriteOptions { overwrite: true, ..Default::default() }).unwrap();
        let said = again(&resume).unwrap_err().to_string();
        assert!(said.contains("street_01.exr was made with other settings or of other files"), "{said}");
    }
}
