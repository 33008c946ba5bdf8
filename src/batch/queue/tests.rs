//! Files of text that are copied, by jobs of which some fail.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use ndarray::Array3;
use serde_json::json;

use super::*;
use crate::batch::testing::Notes;
use crate::core::image::LinearImage;
use crate::core::progress::Progress;
use crate::core::provenance::Provenance;
use crate::io::{WriteOptions, read_image, write_image};

/// Writes grey images; those of zero fail.
struct Greys {
    setting: u32,
    interrupted: Arc<AtomicBool>,
    /// The grey whose making is interrupted.
    stops_at: Option<u8>,
}

struct Job {
    grey: u8,
    output: PathBuf,
}

impl Greys {
    fn with(setting: u32) -> Self {
        Self { setting, interrupted: Arc::default(), stops_at: None }
    }
}

const RESUME: Selection = Selection { shard: Shard::WHOLE, resume: true };

impl Stages for Greys {
    type Job = Job;
    type Input = u8;
    type Output = LinearImage;

    fn doing(&self, job: &Job) -> String {
        format!("making {}", job.grey)
    }

    fn output<'a>(&self, job: &'a Job) -> &'a Path {
        &job.output
    }

    fn describe(&self, _: &Job) -> Value {
        json!({ "setting": self.setting })
    }

    fn identify(&self, job: &Job) -> Result<Value> {
        Ok(json!({ "grey": job.grey }))
    }

    fn read(&self, job: &Job) -> Result<u8> {
        if job.grey == 0 { Err(Error::Unsupported("there is no light".to_owned())) } else { Ok(job.grey) }
    }

    fn compute(&self, _: &Job, grey: u8) -> Result<LinearImage> {
        if self.stops_at == Some(grey) {
            self.interrupted.store(true, Ordering::Relaxed);
            return Err(Error::Interrupted.while_doing("counting photons"));
        }
        LinearImage::from_planes(Array3::from_elem((3, 2, 2), f32::from(grey)))
    }

    fn write(&self, job: &Job, image: LinearImage) -> Result<()> {
        let described = json!({ "setting": self.setting, "grey": job.grey });
        let provenance = Some(Provenance::new("grey", &described));
        write_image(&job.output, &image, &WriteOptions { provenance, ..WriteOptions::default() })
    }
}

fn jobs(folder: &Path, greys: &[u8]) -> Vec<Job> {
    let job = |&grey: &u8| Job { grey, output: folder.join(format!("{grey}.exr")) };
    greys.iter().map(job).collect()
}

#[test]
fn a_job_that_fails_does_not_keep_the_others_from_being_done() {
    let scratch = tempfile::tempdir().unwrap();
    let (folder, notes) = (scratch.path().join("out"), Notes::default());
    let error = run(&Greys::with(1), jobs(&folder, &[1, 0, 2]), Selection::default(), &notes).unwrap_err();
    assert_eq!(error.to_string(), "1 of 3 images were not done: making 0: there is no light");
    let written = |grey: u8| folder.join(format!("{grey}.exr")).display().to_string();
    assert_eq!(notes.take(), [written(1), "warning: making 0: there is no light".to_owned(), written(2)]);
    let image = read_image::<crate::core::image::Linear>(&folder.join("2.exr")).unwrap();
    assert_eq!(image.max(), 2.0);
}

#[test]
fn a_single_job_fails_with_what_was_being_done_and_leaves_no_folder() {
    let scratch = tempfile::tempdir().unwrap();
    let (folder, notes) = (scratch.path().join("out"), Notes::default());
    let error = run(&Greys::with(1), jobs(&folder, &[0]), Selection::default(), &notes).unwrap_err();
    assert_eq!(error.in_full(), "making 0: there is no light");
    assert!(notes.take().is_empty() && !folder.exists());
}

#[test]
fn an_interrupt_ends_the_work_and_keeps_what_is_done() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path().join("out");
    let greys = Greys { stops_at: Some(2), ..Greys::with(1) };
    let notes = Notes::of(Progress::new(None, Arc::clone(&greys.interrupted)));
    let error = run(&greys, jobs(&folder, &[1, 2, 3]), Selection::default(), &notes).unwrap_err();
    assert!(error.is_interrupt(), "{error}");
    assert!(folder.join("1.exr").exists() && !folder.join("3.exr").exists());
    // Who asked before the work began gets nothing.
    let error = run(&greys, jobs(&folder, &[3, 4]), Selection::default(), &notes).unwrap_err();
    assert!(error.is_interrupt() && !folder.join("3.exr").exists());
}

#[test]
fn resuming_keeps_what_was_made_in_the_same_way() {
    let scratch = tempfile::tempdir().unwrap();
    let (folder, notes) = (scratch.path(), Notes::default());
    run(&Greys::with(1), jobs(folder, &[1, 2]), Selection::default(), &notes).unwrap();
    notes.take();
    run(&Greys::with(1), jobs(folder, &[1, 2, 3]), RESUME, &notes).unwrap();
    let third = folder.join("3.exr").display().to_string();
    assert_eq!(notes.take(), ["2 of 3 images are there".to_owned(), third]);
    let refused = |greys: &Greys, jobs| run(greys, jobs, RESUME, &notes).unwrap_err().to_string();
    let other_settings = refused(&Greys::with(2), jobs(folder, &[1, 4]));
    assert!(other_settings.contains("1.exr was made with other settings"), "{other_settings}");
    let other_files = vec![Job { grey: 7, output: folder.join("1.exr") }];
    assert!(refused(&Greys::with(1), other_files).contains("of other files"));
    assert!(!folder.join("4.exr").exists(), "refused before any work");
    let image = LinearImage::from_planes(Array3::zeros((3, 2, 2))).unwrap();
    write_image(&folder.join("5.exr"), &image, &WriteOptions::default()).unwrap();
    assert!(refused(&Greys::with(1), jobs(folder, &[5])).contains("is not of this program"));
}

/// As after a crash, or on a disk that was full.
#[test]
fn resuming_makes_anew_what_was_not_written_to_its_end() {
    let scratch = tempfile::tempdir().unwrap();
    let (folder, notes) = (scratch.path(), Notes::default());
    run(&Greys::with(1), jobs(folder, &[1, 2, 3]), Selection::default(), &notes).unwrap();
    let path = |grey: u8| folder.join(format!("{grey}.exr"));
    let whole = std::fs::read(path(2)).unwrap();
    std::fs::write(path(1), "").unwrap();
    std::fs::write(path(2), &whole[..whole.len() - 1]).unwrap();
    notes.take();
    run(&Greys::with(1), jobs(folder, &[1, 2, 3]), RESUME, &notes).unwrap();
    let [first, second] = [1, 2].map(|grey| path(grey).display().to_string());
    let said = |name: &str| format!("warning: {name} was not written to its end, and is made anew");
    let expected = [said(&first), said(&second), "1 of 3 images are there".to_owned(), first, second];
    assert_eq!(notes.take(), expected);
    assert_eq!(std::fs::read(path(2)).unwrap(), whole);
    assert_eq!(read_image::<crate::core::image::Linear>(&path(1)).unwrap().max(), 1.0);
}
