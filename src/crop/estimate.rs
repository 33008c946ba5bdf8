//! Says beforehand what cutting views takes.

use std::path::{Path, PathBuf};
use std::time::Duration;

use super::Cut;
use super::cut::name_by_stem;
use crate::batch::{Estimate, HEADER_BYTES, PROCESS_BYTES, Sampler};
use crate::core::error::Result;
use crate::core::image::{CHANNELS, Linear};
use crate::core::progress::Progress;
use crate::core::shard::Shard;
use crate::io;

/// Bytes for each pixel of a panorama: as its file holds it, as it was decoded, as planes, and as it is sampled.
const PANORAMA_PIXEL_BYTES: u64 = 48;

/// Bytes for each pixel of a view: as it is rendered, as planes, and as its file.
const VIEW_PIXEL_BYTES: u64 = 48;

impl Cut {
    /// Says what cutting the shard's views into `folder` takes, after cutting some of the first panorama for about
    /// `patience`.
    ///
    /// # Errors
    /// As [`Cut::run`].
    pub fn estimate(
        &self,
        panoramas: Vec<PathBuf>,
        folder: &Path,
        patience: Duration,
        progress: &Progress,
    ) -> Result<Estimate> {
        self.check()?;
        let work = self.share(name_by_stem(panoramas)?)?;
        let mut largest = 0;
        for panorama in &work {
            progress.check()?;
            let [height, width] = io::read_image_size::<Linear>(&panorama.path, self.told)?;
            largest = largest.max((height * width) as u64);
        }
        let views: u64 = work.iter().map(|panorama| panorama.views.len() as u64).sum();
        let pixels = |side: usize| (side + 2 * self.margin).pow(2) as u64;
        let view_pixels = self.views.iter().map(|view| pixels(view.size)).max().unwrap_or(0);
        let sample_bytes = CHANNELS as u64 * if self.half { 2 } else { 4 };
        let sampler = Sampler::new(patience);
        let scratch = io::scratch_folder(folder)?;
        let sample = Self { shard: Shard::WHOLE, resume: false, ..self.clone() };
        let first: Vec<PathBuf> = work.first().map(|panorama| panorama.path.clone()).into_iter().collect();
        sampler.end(sample.run(first, scratch.path(), &sampler.progress(progress), |_| {}), progress)?;
        let cost = sampler.cost();
        // Each panorama is read.
        let fixed = cost.fixed.times(work.len() as f64);
        Ok(Estimate {
            items: views,
            unit: "views",
            disk_bytes: views * (view_pixels * sample_bytes + HEADER_BYTES),
            memory_bytes: PROCESS_BYTES + largest * PANORAMA_PIXEL_BYTES + view_pixels * VIEW_PIXEL_BYTES,
            cost: fixed.and(cost.each.times(views as f64)),
            fixed,
            threads: rayon::current_num_threads(),
            measured: format!("{} views of one panorama", sampler.steps()),
        })
    }
}
