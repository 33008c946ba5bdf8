//! The folder of an evaluation's results: the names of its files, and writing them over those of an earlier one.

use std::path::Path;

use super::document::Document;
use super::evaluation::Evaluation;
use super::pictures::{self, PictureName};
use super::results::Results;
use crate::core::error::Result;
use crate::core::metrics::Metric;
use crate::io::{self, MadeFolder};

/// The files that every evaluation writes.
pub const RESULTS: [&str; 3] = ["metrics.json", "metrics.csv", "table.md"];

/// The regions' numbers.
pub const REGIONS: &str = "regions.csv";

/// The matrices of right and wrong kernels.
pub const MISMATCH: [&str; 2] = ["mismatch.json", "mismatch.csv"];

/// What a monitor as the source would miss.
pub const LDR: [&str; 3] = ["ldr.json", "ldr.csv", "ldr.png"];

/// Where pictures lie until the evaluation is done.
const UNFINISHED: &str = "pictures.partial";

/// The files that hold a metric's plots: by rotation, and how it is distributed.
pub fn plots_of(metric: Metric) -> [String; 2] {
    ["by-rotation", "distribution"].map(|what| format!("{}-{what}.svg", metric.name()))
}

/// The file that holds the drawn matrix of a metric of the method of this number, from 1.
pub fn plot_of_matrix(metric: Metric, number: usize) -> String {
    format!("mismatch-{number}-{}.svg", metric.name())
}

/// Whether a file's name is that of a plot.
fn is_plot(file: &str) -> bool {
    let is_of = |metric: Metric| plots_of(metric).iter().any(|name| name == file);
    is_matrix(file).is_some() || Metric::ALL.into_iter().any(is_of)
}

fn is_matrix(file: &str) -> Option<()> {
    let (number, _) = file.strip_prefix("mismatch-")?.strip_suffix(".svg")?.split_once('-')?;
    number.parse::<usize>().ok().map(|_| ())
}

/// A folder whose files may be written; one that was made for results and gets none goes again.
#[derive(Debug)]
pub struct ResultsFolder<'a> {
    folder: &'a Path,
    overwrite: bool,
    _made: MadeFolder,
}

impl<'a> ResultsFolder<'a> {
    /// Makes the folder and checks, before the work starts, that files of these names may be written, and that those of
    /// an earlier evaluation may be removed.
    ///
    /// # Errors
    /// Those of [`io::check_output`] for the first that may not; [`Error::Io`](crate::core::error::Error::Io) when the
    /// folder cannot be made.
    pub fn prepare(folder: &'a Path, names: &[String], overwrite: bool) -> Result<Self> {
        let earlier = earlier_results(folder)?.into_iter().chain(earlier_pictures(folder)?);
        for path in names.iter().cloned().chain(earlier).map(|name| folder.join(name)) {
            if path.symlink_metadata().is_ok() {
                io::check_output(&path, overwrite)?;
            }
        }
        Ok(Self { folder, overwrite, _made: MadeFolder::create(folder)? })
    }

    /// Writes a file.
    ///
    /// # Errors
    /// Those of [`io::write_atomically`].
    pub fn write(&self, name: &str, contents: &[u8]) -> Result<()> {
        io::write_atomically(&self.folder.join(name), self.overwrite, |file| file.write_all(contents))
    }

    /// Writes the files of [`RESULTS`]; `results` are those of the evaluation.
    ///
    /// # Errors
    /// Those of [`write`](Self::write).
    pub fn write_results(&self, evaluation: &Evaluation, results: &Results) -> Result<()> {
        let texts = [results.to_json(), evaluation.to_csv(), evaluation.to_markdown()];
        RESULTS.iter().zip(texts).try_for_each(|(name, text)| self.write(name, text.as_bytes()))
    }

    /// Does `work`, which writes pictures into a folder of results that it is given, and puts them in the place of an earlier
    /// evaluation's, which may be of other images or methods; those stay where the work fails.
    ///
    /// # Errors
    /// The work's; those of [`io::remove`] and [`io::publish`].
    pub fn with_new_pictures<T>(&self, work: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
        let unfinished = self.folder.join(UNFINISHED);
        let clear = || if unfinished.is_dir() { io::remove(&unfinished) } else { Ok(()) };
        // What a run left that was killed.
        clear()?;
        let done = work(&unfinished).and_then(|done| {
            self.remove_earlier_pictures()?;
            let [from, to] = [&unfinished, self.folder].map(|folder| folder.join(pictures::FOLDER));
            let names = list(&from)?;
            if !names.is_empty() {
                io::create_folder(&to)?;
            }
            names.iter().try_for_each(|name| io::publish(&from.join(name), &to.join(name)))?;
            Ok(done)
        });
        clear()?;
        done
    }

    /// Removes the pictures of an earlier evaluation, which may be of other images or methods.
    ///
    /// # Errors
    /// Those of [`io::remove`].
    pub fn remove_earlier_pictures(&self) -> Result<()> {
        self.remove(&earlier_pictures(self.folder)?)
    }

    /// Removes the results of an earlier evaluation, which may have had more of them.
    ///
    /// # Errors
    /// Those of [`io::remove`].
    pub fn remove_earlier_results(&self) -> Result<()> {
        self.remove(&earlier_results(self.folder)?)
    }

    fn remove(&self, names: &[String]) -> Result<()> {
        names.iter().try_for_each(|name| io::remove(&self.folder.join(name)))
    }
}

fn earlier_results(folder: &Path) -> Result<Vec<String>> {
    let is_own = |name: &String| {
        let own = RESULTS.iter().chain(&MISMATCH).chain(&LDR).chain([&REGIONS]);
        own.into_iter().any(|own| own == name) || is_plot(name)
    };
    Ok(list(folder)?.into_iter().filter(is_own).collect())
}

fn earlier_pictures(folder: &Path) -> Result<Vec<String>> {
    let mut names = list(&folder.join(pictures::FOLDER))?;
    names.retain(|name| PictureName::of_file(name).is_some());
    Ok(names.into_iter().map(|name| format!("{}/{name}", pictures::FOLDER)).collect())
}

/// The names in a folder; none where there is none.
fn list(folder: &Path) -> Result<Vec<String>> {
    if folder.is_dir() { io::list_folder(folder) } else { Ok(Vec::new()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::error::Error;

    #[test]
    fn only_what_an_evaluation_writes_is_replaced_and_only_when_told() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path().join("results");
        let plots = Metric::ALL.into_iter().flat_map(plots_of).chain([plot_of_matrix(Metric::Ssim, 12)]);
        let own: Vec<String> = RESULTS.map(str::to_owned).into_iter().chain(plots).collect();
        let others = ["notes.txt", "mismatch-net-psnr.svg", "psnr.svg"].map(str::to_owned);
        let names = || io::list_folder(&folder).unwrap();
        let first = ResultsFolder::prepare(&folder, &own, false).unwrap();
        own.iter().chain(&others).for_each(|name| first.write(name, b"earlier").unwrap());

        let refused = ResultsFolder::prepare(&folder, &[], false).unwrap_err();
        assert!(matches!(refused, Error::Io { action: "create", .. }), "{refused}");
        ResultsFolder::prepare(&folder, &own, true).unwrap().remove_earlier_results().unwrap();
        let mut left = others.to_vec();
        left.sort();
        assert_eq!(names(), left);
    }

    #[test]
    fn a_folder_that_gets_no_results_goes_again() {
        let scratch = tempfile::tempdir().unwrap();
        let folder = scratch.path().join("new/results");
        let results = ResultsFolder::prepare(&folder, &[], false).unwrap();
        let failed: Result<()> = results.with_new_pictures(|_| Err(Error::Unsupported("damaged".to_owned())));
        assert!(failed.is_err() && folder.is_dir());
        drop(results);
        assert!(io::list_folder(scratch.path()).unwrap().is_empty());
    }

    #[test]
    fn pictures_are_replaced_by_those_of_work_that_is_done() {
        let scratch = tempfile::tempdir().unwrap();
        let names = || io::list_folder(&scratch.path().join(pictures::FOLDER)).unwrap();
        let results = ResultsFolder::prepare(scratch.path(), &[], true).unwrap();
        let write = |folder: &Path, name: &str| {
            io::create_folder(&folder.join(pictures::FOLDER))?;
            io::write_atomically(&folder.join(pictures::FOLDER).join(name), false, |file| {
                file.write_all(b"new")
            })
        };
        let made = |name: &str| {
            results.with_new_pictures(|folder| write(folder, name)).unwrap();
        };
        made("a.1-wiener.png");
        let failed: Result<()> = results.with_new_pictures(|folder| {
            write(folder, "b.1-joint.png")?;
            Err(Error::Unsupported("damaged".to_owned()))
        });
        assert!(failed.is_err());
        assert_eq!(names(), ["a.1-wiener.png"]);
        made("c.1-joint.png");
        assert_eq!(names(), ["c.1-joint.png"]);
        assert_eq!(io::list_folder(scratch.path()).unwrap(), [pictures::FOLDER], "nothing is left over");
    }
}
