//! Plans the memory of a restoration.

use super::super::deconvolution::{DeconvolutionConfig, Method, deconvolution_bytes};
use super::super::memory::{MemoryBudget, MemoryPlan, floats_of_pixel};
use super::super::mirrored::mirrored_floats_of_pixel;
use super::super::network::NetworkOperator;
use super::super::tiles::{SHORTEST_TILE, Tiling, WindowCost as _};
use super::{How, Restoration};
use crate::core::error::Result;
use crate::core::image::CHANNELS;
use crate::network::Model;

impl Restoration {
    /// Plans the memory for a capture of `[height, width]`.
    ///
    /// # Errors
    /// [`Error::Config`](crate::core::error::Error::Config) or [`Error::Unsupported`](crate::core::error::Error::Unsupported) when it
    /// takes more than there is, naming what would do, or the side of the tiles does not suit the network.
    pub fn plan(&self, size: [usize; 2]) -> Result<MemoryPlan> {
        match &self.how {
            How::Network(model) => {
                let beside = self.bytes_beside(model, size);
                let operator = NetworkOperator::new(model);
                let windows = |memory: &MemoryBudget| memory.plan_windows(size, self.tile, beside, &operator);
                if model.architecture().planes().is_empty() {
                    return windows(&self.memory);
                }
                let deconvolution = self.solution_bytes(size)?;
                let whole = windows(&self.memory);
                let is_too_large = self.memory.limit_bytes < deconvolution;
                let has_no_room = is_too_large || self.tile.is_none() && whole.is_err();
                if let (true, Some(plan)) = (has_no_room, self.plan_parts(model, size)) {
                    return plan;
                }
                if is_too_large {
                    // What is named must do for both.
                    windows(&MemoryBudget { limit_bytes: deconvolution, ..self.memory })?;
                    self.memory.plan_whole(size, deconvolution)?;
                }
                let mut plan = whole?;
                plan.bytes = plan.bytes.max(deconvolution);
                Ok(plan)
            }
            How::Deconvolution(config) => {
                self.memory.plan_whole(size, self.deconvolution_bytes(size, config)?)
            }
        }
    }

    /// Bytes that a part of an image takes at least.
    pub(in crate::restore) fn part_bytes(&self, model: &Model, size: [usize; 2]) -> Result<u64> {
        let operator = NetworkOperator::new(model);
        let tile = SHORTEST_TILE.next_multiple_of(operator.alignment());
        let network = Tiling::with_tile(size, tile, &operator)?.bytes(&operator);
        Ok(self.solution_bytes(size)?.max(network + self.bytes_beside(model, size)))
    }

    /// Bytes that are taken beside the windows of a network.
    fn bytes_beside(&self, model: &Model, size: [usize; 2]) -> u64 {
        let pixel = floats_of_pixel(&self.kernel, model) + mirrored_floats_of_pixel(model, size);
        (pixel * size_of::<f32>() * size[0] * size[1]) as u64 + self.memory.others(size, self.kernel_bytes, 1)
    }

    /// Bytes that a scene takes while it is solved for with its errors, and all else that is held meanwhile.
    fn solution_bytes(&self, size: [usize; 2]) -> Result<u64> {
        let config =
            DeconvolutionConfig { border: self.border, ..DeconvolutionConfig::of_method(Method::Joint) };
        // Beside what a restoration takes, the solution tells the errors: two planes of each colour.
        let told = 2 * CHANNELS * size_of::<f32>() * size[0] * size[1];
        Ok(self.deconvolution_bytes(size, &config)? + told as u64)
    }

    /// Bytes that a deconvolution takes, and all else that is held meanwhile.
    fn deconvolution_bytes(&self, size: [usize; 2], config: &DeconvolutionConfig) -> Result<u64> {
        let psf = self.kernel.sized_psf()?;
        let of_psf = [psf.height(), psf.width()];
        // As the file, as the PSF, and as what it is prepared to.
        let kernel_bytes = 5 * (CHANNELS * size_of::<f32>() * of_psf[0] * of_psf[1]) as u64;
        let others = self.memory.others(size, kernel_bytes, rayon::current_num_threads());
        Ok(deconvolution_bytes(size, of_psf, config) + others)
    }
}
