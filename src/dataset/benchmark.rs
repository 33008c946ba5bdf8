//! Times how a dataset's images come from where they are kept: single files or archives, on a disk or a cluster's file system.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rand::seq::SliceRandom as _;
use rayon::prelude::*;

use super::Dataset;
use crate::core::error::Result;
use crate::core::image::Linear;
use crate::core::progress::Progress;
use crate::core::rng;
use crate::io;

/// How fast files were read by all threads together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadSpeed {
    /// Files that were read.
    pub files: usize,
    /// Their bytes, as they are stored.
    pub bytes: u64,
    /// Time in seconds.
    pub seconds: f64,
}

/// What is done with a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// It is read.
    Stored,
    /// It is read and decoded, as a training does.
    Decoded,
}

/// Reads the images of a dataset in an order that is drawn from `seed`, each once, until all are read or `patience` is over.
///
/// What the system keeps of files in memory comes from there.
///
/// # Errors
/// Those of reading an image; [`Error::Interrupted`](crate::core::error::Error::Interrupted) after an interrupt.
pub fn time_reading(
    dataset: &Dataset,
    reading: Reading,
    patience: Duration,
    seed: u64,
    progress: &Progress,
) -> Result<ReadSpeed> {
    let named = dataset.triplets.iter().flat_map(|triplet| [&triplet.gt, &triplet.degraded]);
    let mut names: Vec<&String> = named.collect();
    names.sort_unstable();
    names.dedup();
    names.shuffle(&mut rng::stream(seed, "reading"));
    let (files, bytes) = (AtomicUsize::new(0), AtomicU64::new(0));
    let started = Instant::now();
    names.par_iter().with_max_len(1).try_for_each(|name| {
        progress.check()?;
        if started.elapsed() > patience {
            return Ok(());
        }
        let path = dataset.root.join(name);
        match reading {
            Reading::Stored => drop(io::read_bytes(&path)?),
            Reading::Decoded => drop(io::read_image::<Linear>(&path)?),
        }
        files.fetch_add(1, Ordering::Relaxed);
        bytes.fetch_add(io::file_bytes(&path)?, Ordering::Relaxed);
        Ok(())
    })?;
    let seconds = started.elapsed().as_secs_f64();
    Ok(ReadSpeed { files: files.into_inner(), bytes: bytes.into_inner(), seconds })
}
