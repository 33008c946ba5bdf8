//! Says beforehand what an evaluation takes, from parts of the first image by every candidate.

use super::run::Experiment;
use crate::batch::{Estimate, HEADER_BYTES, PROCESS_BYTES, Spent, spent_on};
use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;
use crate::core::progress::Progress;

/// Bytes for each pixel of an image that is measured, beside those of its restoration: the clean and the degraded image
/// as they are and as their files, regions, and the planes of the metrics.
const PIXEL_BYTES: u64 = 120;

/// Bytes of a part or of tables for each image and candidate.
const ROW_BYTES: u64 = 2048;

impl Experiment<'_> {
    /// Says what measuring the shard's images takes, after restoring and measuring two parts of the first image of each
    /// dataset.
    ///
    /// # Errors
    /// Those of reading, restoring and measuring it.
    pub fn estimate(&self, progress: &Progress) -> Result<Estimate> {
        let mut estimate = Estimate {
            items: 0,
            unit: "images",
            disk_bytes: HEADER_BYTES,
            memory_bytes: 0,
            cost: Spent::default(),
            fixed: Spent::default(),
            threads: rayon::current_num_threads(),
            measured: "two parts of an image by each candidate".to_owned(),
        };
        let mut largest = 0;
        for comparison in self.comparisons() {
            let Some((_, triplet)) = comparison.own().next() else { continue };
            let (clean, degraded) = comparison.read(triplet)?;
            let size = [clean.height(), clean.width()];
            let pixels = (size[0] * size[1]) as u64;
            let curve = comparison.dataset.formation.curve()?;
            let truth = curve.tone_map(&clean);
            largest = largest.max(pixels);
            let mut cost = spent_on(|| comparison.read(triplet).map(|_| ()))?;
            let mut memory = 0;
            let kernels = comparison.dataset.kernel_names().len() as f64;
            let measures = &self.config().measuring;
            let measuring = spent_on(|| {
                let shown = curve.tone_map(&degraded);
                let measured = measures.metrics.iter();
                measured
                    .map(|m| m.compare(&shown, &truth, &measures.definition))
                    .try_for_each(|found| found.map(|_| ()))
            })?;
            for candidate in comparison.candidates() {
                let (time, bytes) = comparison.cost(candidate, (triplet, &degraded), progress)?;
                let each = time.of(pixels as f64).and(measuring);
                let mismatch = self.config().mismatch && candidate.knows_the_kernel();
                cost = cost.and(each.times(if mismatch { 1.0 + kernels } else { 1.0 }));
                memory = memory.max(bytes);
            }
            let (own, candidates) = (comparison.own().len() as u64, comparison.candidates().len() as u64);
            let beside = pixels * (PIXEL_BYTES + (candidates + 1) * (CHANNELS * size_of::<f32>()) as u64);
            estimate.items += own;
            estimate.cost = estimate.cost.and(cost.times(own as f64));
            estimate.disk_bytes += own * candidates * ROW_BYTES;
            estimate.memory_bytes = estimate.memory_bytes.max(PROCESS_BYTES + memory + beside);
        }
        estimate.disk_bytes += self.pictures_kept().len() as u64 * (largest * CHANNELS as u64 + HEADER_BYTES);
        if estimate.items == 0 {
            return Err(Error::Unsupported("there is no image to measure".to_owned()));
        }
        Ok(estimate)
    }
}
