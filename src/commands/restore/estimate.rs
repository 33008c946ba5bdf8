//! Says beforehand what restoring captures takes.

use udc::batch::{Clock, Estimate, HEADER_BYTES, LinearCost, Spent, Stages as _};
use udc::core::error;
use udc::core::image::CHANNELS;
use udc::core::shard::Shard;
use udc::io::{Format, read_any_image_size, scratch_folder};
use udc::restore::Capture;

use super::Run;
use super::files::Job;

impl Run<'_> {
    /// Says what restoring the captures of a shard takes, after restoring two parts of the first.
    pub(super) fn estimate(&self, jobs: Vec<Job>, shard: Shard) -> error::Result<Estimate> {
        shard.check(jobs.len(), "images")?;
        let jobs = shard.choose(jobs);
        let mut estimate = Estimate {
            items: jobs.len() as u64,
            unit: "images",
            disk_bytes: 0,
            memory_bytes: 0,
            cost: Spent::default(),
            fixed: Spent::default(),
            threads: rayon::current_num_threads(),
            measured: "two parts of the first image".to_owned(),
        };
        let Some(first) = jobs.first() else { return Ok(estimate) };
        let clock = Clock::start();
        let capture = self.read(first)?;
        let first_size = capture.image.size();
        let pixels_of = |[height, width]: [usize; 2]| (height * width) as f64;
        let reading = clock.spent();
        let cost = self.restoration.cost(&capture, &self.progress)?;
        let files = reading.and(self.cost_of_writing(first, capture)?).times(1.0 / pixels_of(first_size));
        let cost = LinearCost { fixed: cost.fixed, each: cost.each.and(files) };
        for job in &jobs {
            // Raw pictures and brackets are taken to be of the first one's size: their headers do not tell it.
            let own = match &job.inputs[..] {
                [input] if !self.told.is_raw() => read_any_image_size(input, self.args.domain).ok(),
                _ => None,
            };
            let size = own.unwrap_or(first_size);
            let plan = self.restoration.plan(size)?;
            let (pieces, pixels) = plan.pieces(pixels_of(size));
            estimate.cost = estimate.cost.and(cost.of(pixels).times(pieces as f64));
            estimate.memory_bytes = estimate.memory_bytes.max(plan.bytes);
            estimate.disk_bytes += self.disk_bytes(job, size);
        }
        Ok(estimate)
    }

    /// What writing an image of a capture's size costs.
    fn cost_of_writing(&self, job: &Job, capture: Capture) -> error::Result<Spent> {
        let scratch = scratch_folder(&job.output)?;
        let path = scratch.path().join("sample.exr");
        let clock = Clock::start();
        let options = udc::io::WriteOptions { half: self.args.half, ..Default::default() };
        match capture.image {
            udc::io::AnyImage::Linear(image) => udc::io::write_image(&path, &image, &options)?,
            udc::io::AnyImage::ToneMapped(image, _) => udc::io::write_image(&path, &image, &options)?,
        }
        Ok(clock.spent())
    }

    /// Bytes of an image's file at most.
    fn disk_bytes(&self, job: &Job, [height, width]: [usize; 2]) -> u64 {
        let sample = match Format::of_extension(&job.output) {
            Ok(Format::Png | Format::Jpeg) => 1,
            Ok(Format::Tiff) => 2,
            _ if self.args.half => 2,
            _ => 4,
        };
        (CHANNELS * height * width * sample) as u64 + HEADER_BYTES
    }
}
