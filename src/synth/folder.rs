//! Writes a dataset folder so that it can be interrupted at any moment and resumed.
//!
//! `dataset.toml` and the bank come first, then for every scene its ground truth, its degraded images and, at
//! last, its lines in the list of triplets; where archives keep the images, the lines of all in one when it has its name.
//! What is listed is there, and a mark beside the list tells that it is not all until it is. A run holds its list to its end, so that no other run makes the same part. Temporary files of
//! runs that were killed are removed when a run takes the folder up or begins anew, and nobody has changed them for an hour.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::core::error::Result;
use crate::core::image::LinearImage;
use crate::dataset::{CONFIG_FILE, DatasetConfig, FIELD_FILE, Split, Triplet, TripletFiles};
use crate::io::{self, LineLog, WriteOptions};

use super::archives::{Archives, archives_of, member_of};
use super::existing::{Existing, Place};
use super::kept::check_scenes;
use super::list::{file_of, finished_triplets, to_line};
use super::scenes::Scene;
use super::synthesis::Synthesis;

/// A dataset folder that is being written.
#[derive(Debug)]
pub(super) struct DatasetFolder {
    root: PathBuf,
    list: PathBuf,
    log: LineLog,
    /// Scenes and kernels.
    finished: BTreeSet<(String, String)>,
    /// Where images are kept that are not a file each.
    archives: Option<Archives>,
    /// What became of images that were there, in words for warnings.
    pub(super) warnings: Vec<String>,
}

impl DatasetFolder {
    /// Prepares the folder: describes the dataset, stores its bank, and finds what is finished.
    ///
    /// # Errors
    /// [`Error::Config`] when the folder holds a dataset and `existing` does not allow for it, or one made
    /// otherwise; [`Error::Io`] when the folder cannot be written.
    pub(super) fn prepare(root: &Path, synthesis: &Synthesis, existing: Existing) -> Result<Self> {
        io::create_folder(root)?;
        // Shards that start together come here one after the other.
        let turn = io::lock_folder(root);
        let place = Place::find(root, synthesis, existing)?;
        if existing != Existing::TakeOver {
            place.check_free()?;
        }
        if existing == Existing::Overwrite {
            place.remove_lists()?;
        }
        describe(root, synthesis, &place, existing == Existing::Overwrite)?;
        let list = place.list();
        let log = LineLog::open(&list)?;
        if existing != Existing::TakeOver {
            log.try_lock()?;
        }
        drop(turn);
        if existing != Existing::Refuse {
            remove_unfinished(root)?;
        }
        let root = root.to_owned();
        let (finished, warnings) = (BTreeSet::new(), place.warnings);
        let mut folder = Self { root, list, log, finished, archives: None, warnings };
        match existing {
            Existing::Resume | Existing::TakeOver => folder.resume(synthesis)?,
            Existing::Refuse | Existing::Overwrite => folder.restart_list(&[])?,
        }
        io::write_atomically(&TripletFiles::mark_of(&folder.list), true, |_| Ok(()))?;
        if let Some(full_bytes) = synthesis.config.archive_bytes {
            folder.archives = Some(Archives::new(&folder.root, &folder.list, full_bytes)?);
        }
        Ok(folder)
    }

    /// Makes the folders of the images, where they are a file each.
    pub(super) fn create_image_folders(&self, kernels: &[String]) -> Result<()> {
        if self.archives.is_some() {
            return Ok(());
        }
        io::create_folder(&self.root.join("gt"))?;
        kernels.iter().try_for_each(|name| io::create_folder(&self.root.join("degraded").join(name)))
    }

    /// Takes finished triplets up again; their scenes may have been divided anew since.
    fn resume(&mut self, synthesis: &Synthesis) -> Result<()> {
        let by_id: BTreeMap<&str, &Scene> =
            synthesis.scenes.iter().map(|scene| (scene.id.as_str(), scene)).collect();
        let mut triplets = finished_triplets(&self.root, &self.list)?;
        self.warnings.extend(check_scenes(&self.root, synthesis, &triplets)?);
        let mut moved = BTreeMap::new();
        for triplet in &mut triplets {
            if let Some(scene) = by_id.get(triplet.id.as_str()) {
                if triplet.split != scene.split {
                    moved.insert(scene.id.as_str(), (triplet.split, scene.split));
                }
                triplet.split = scene.split;
                triplet.source = scene.source.clone();
            }
        }
        self.warnings.extend(tell_of_moved(&moved));
        // A run that was killed may have left half a line behind: the list is written anew.
        self.restart_list(&triplets)?;
        // And an archive that it did not come to list.
        let names = io::list_folder(&self.root)?;
        archives_of(&self.list, &names, &triplets).try_for_each(|name| io::remove(&self.root.join(name)))?;
        for triplet in triplets {
            self.finished.insert((triplet.id, triplet.kernel));
        }
        Ok(())
    }

    /// Replaces the list. The new file is held before it has its name, and the old one until then. Where files cannot be
    /// locked, another run of this part, as one that a cluster has begun again, goes on with a list that nobody reads: the
    /// last one that begins makes all that is not listed, and lists it.
    fn restart_list(&mut self, triplets: &[Triplet]) -> Result<()> {
        let text: String = triplets.iter().map(|triplet| to_line(triplet) + "\n").collect();
        self.log = LineLog::replace(&self.list, &text)?;
        Ok(())
    }

    /// Whether the triplet of a scene and a kernel is there and intact.
    pub(super) fn is_finished(&self, id: &str, kernel: &str) -> bool {
        self.finished.contains(&(id.to_owned(), kernel.to_owned()))
    }

    /// The path of a scene's ground truth, or of its image through a kernel: in the folder, or in its current archive.
    pub(super) fn path_of(&self, id: &str, kernel: Option<&str>, extension: &str) -> String {
        match (&self.archives, kernel) {
            (Some(_), kernel) => member_of(id, &format!("{}.{extension}", kernel.unwrap_or("gt"))),
            (None, kernel) => file_of(id, kernel, extension),
        }
    }

    /// Writes an image that is a file of its own; encodes another, which is to be [`kept`](Self::keep) then.
    pub(super) fn write(&self, path: &str, image: &LinearImage, options: &WriteOptions) -> Result<Image> {
        let file = self.root.join(path);
        if self.archives.is_some() {
            let bytes = io::encode_image(&file, image, options)?;
            return Ok(Image { sha256: io::sha256_of_bytes(&bytes), bytes: Some(bytes) });
        }
        io::write_image(&file, image, options)?;
        Ok(Image { sha256: io::sha256_of_file(&file)?, bytes: None })
    }

    /// Keeps an image in the current archive, if it is not in a file.
    pub(super) fn keep(&mut self, path: &str, image: &Image) -> Result<()> {
        match (&mut self.archives, &image.bytes) {
            (Some(archives), Some(bytes)) => archives.append(path, bytes),
            _ => Ok(()),
        }
    }

    /// Lists triplets as finished whose images are kept: at once, or when their archive is.
    pub(super) fn record(&mut self, triplets: impl Iterator<Item = Triplet>) -> Result<()> {
        match &mut self.archives {
            Some(archives) => {
                archives.hold(triplets);
                Ok(())
            }
            None => self.list(triplets),
        }
    }

    /// Ends a scene; `code` has the codes of kernels.
    pub(super) fn end_scene(&mut self, id: &str, code: impl Fn(&Triplet) -> Vec<f32>) -> Result<()> {
        let Some(archives) = &mut self.archives else { return Ok(()) };
        let listed = archives.end_scene(id, code)?;
        self.list(listed.into_iter())
    }

    /// Finishes what is still open: to be called whatever happened, so that nothing that was made is lost.
    pub(super) fn finish(&mut self) -> Result<()> {
        let Some(archives) = &mut self.archives else { return Ok(()) };
        let listed = archives.finish()?;
        self.list(listed.into_iter())
    }

    /// Says that all is there which the run was to make.
    pub(super) fn complete(&self) -> Result<()> {
        io::remove(&TripletFiles::mark_of(&self.list))
    }

    fn list(&mut self, triplets: impl Iterator<Item = Triplet>) -> Result<()> {
        for triplet in triplets {
            self.log.append(&to_line(&triplet))?;
        }
        self.log.sync()
    }
}

/// Says which finished scenes are in another split than they were, in words for a warning; nothing where there is none.
fn tell_of_moved(moved: &BTreeMap<&str, (Split, Split)>) -> Option<String> {
    let of_first =
        |(id, (from, to)): (&&str, &(Split, Split))| format!("{id} from {} to {}", from.name(), to.name());
    let first = moved.iter().next().map(of_first)?;
    let consequence = if moved.values().any(|(from, _)| *from == Split::Train) {
        "a network that was trained on this dataset before has learned from what it would be tested on now"
    } else {
        "a network that is trained now learns from what others were tested on before"
    };
    Some(format!(
        "{} finished scenes are in another split than before, as the scenes are divided anew: first {first}; {consequence}; \
         to keep the splits, make the new scenes in another folder",
        moved.len()
    ))
}

/// An image of a dataset on its way to where it is kept.
pub(super) struct Image {
    /// Of its file.
    pub(super) sha256: String,
    /// Its file, if it is not written yet.
    bytes: Option<Vec<u8>>,
}

/// How long a temporary file is left alone after its last change: any file is written in much less, and a file of a run
/// that still goes on must not be taken away.
const ABANDONED_AFTER: Duration = Duration::from_secs(60 * 60);

/// Removes the temporary files of killed runs wherever a run writes.
fn remove_unfinished(root: &Path) -> Result<()> {
    let degraded = root.join("degraded");
    let kernels = if degraded.is_dir() { io::list_folder(&degraded)? } else { Vec::new() };
    let folders = kernels.iter().map(|name| degraded.join(name));
    let folders = folders.chain([root.to_owned(), root.join("gt"), root.join(FIELD_FILE).with_extension("")]);
    folders.into_iter().try_for_each(|folder| io::remove_unfinished(&folder, ABANDONED_AFTER))
}

fn describe(root: &Path, synthesis: &Synthesis, place: &Place, overwrite: bool) -> Result<()> {
    let Synthesis { config, bank_file, .. } = synthesis;
    let write = |config: &DatasetConfig| {
        let text = config.to_toml();
        io::write_atomically(&root.join(CONFIG_FILE), true, |file| file.write_all(text.as_bytes()))
    };
    let shared = place.shared.as_ref();
    if overwrite || !root.join(CONFIG_FILE).is_file() {
        let bank = bank_file.read()?;
        let (bank_path, config_path) = (root.join(&config.bank), root.join(CONFIG_FILE));
        if overwrite {
            io::write_atomically(&bank_path, true, |file| file.write_all(&bank))?;
        } else {
            // Another shard may describe the same dataset at this moment, with the same words, and read them.
            io::write_once(&bank_path, &bank)?;
        }
        if let Some(field) = &synthesis.field {
            io::write_psf_field(&root.join(FIELD_FILE), field)?;
        }
        return if overwrite {
            write(shared.unwrap_or(config))
        } else {
            io::write_once(&config_path, config.to_toml().as_bytes())
        };
    }
    shared.map_or(Ok(()), write)
}
