//! Says beforehand what restoring captures takes.

use std::time::Instant;

use udc::batch::Stages as _;
use udc::core::error;
use udc::core::estimate::{Estimate, HEADER_BYTES, LinearTime};
use udc::core::image::{CHANNELS, Linear};
use udc::core::shard::Shard;
use udc::io::{Format, read_image_size, scratch_folder};
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
            seconds: 0.0,
            threads: rayon::current_num_threads(),
            measured: "two parts of the first image".to_owned(),
        };
        let Some(first) = jobs.first() else { return Ok(estimate) };
        let started = Instant::now();
        let capture = self.read(first)?;
        let first_size = capture.image.size();
        let pixels_of = |[height, width]: [usize; 2]| (height * width) as f64;
        let reading = started.elapsed().as_secs_f64() / pixels_of(first_size);
        let time = self.restoration.time(&capture, &self.progress)?;
        let writing = self.time_of_writing(first, capture)? / pixels_of(first_size);
        let time = LinearTime { fixed: time.fixed, each: time.each + reading + writing };
        for job in &jobs {
            // Raw pictures and brackets are taken to be of the first one's size: their headers do not tell it.
            let own = match &job.inputs[..] {
                [input] if !self.told.is_raw() => read_image_size::<Linear>(input, self.args.domain).ok(),
                _ => None,
            };
            let size = own.unwrap_or(first_size);
            estimate.seconds += time.of(pixels_of(size));
            estimate.memory_bytes = estimate.memory_bytes.max(self.restoration.plan(size)?.bytes);
            estimate.disk_bytes += self.disk_bytes(job, size);
        }
        Ok(estimate)
    }

    /// Seconds that writing an image of a capture's size takes.
    fn time_of_writing(&self, job: &Job, capture: Capture) -> error::Result<f64> {
        let scratch = scratch_folder(&job.output)?;
        let path = scratch.path().join("sample.exr");
        let started = Instant::now();
        let options = udc::io::WriteOptions { half: self.args.half, ..Default::default() };
        match capture.image {
            udc::io::AnyImage::Linear(image) => udc::io::write_image(&path, &image, &options)?,
            udc::io::AnyImage::ToneMapped(image) => udc::io::write_image(&path, &image, &options)?,
        }
        Ok(started.elapsed().as_secs_f64())
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
