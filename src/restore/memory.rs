//! Plans a restoration so that it stays under a limit of memory.

use std::fmt;

use super::kernel::KernelKnowledge;
use super::tiles::{FRAMES_IN_MEMORY, Tiling, WindowCost};
use crate::core::bytes::format_bytes;
use crate::core::error::{Error, Result};
use crate::core::image::CHANNELS;
use crate::network::{Kind, Model};

/// The memory that is taken where nothing else is said.
const USUAL_BYTES: u64 = 2 << 30;

/// The program's code and data, and the tables of transforms.
const PROGRAM_BYTES: u64 = 24 << 20;

/// Stack and working memory of a thread.
const THREAD_BYTES: u64 = 2 << 20;

/// The memory that there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryBudget {
    /// Bytes to stay under.
    pub limit_bytes: u64,
    /// Whether all that the process takes is counted, its threads, kernels and itself too; else a restoration alone.
    pub counts_process: bool,
    /// RGB frames of 32-bit floats that the caller holds beside the image in work.
    pub queued_frames: u64,
}

impl Default for MemoryBudget {
    fn default() -> Self {
        Self { limit_bytes: USUAL_BYTES, counts_process: true, queued_frames: 0 }
    }
}

/// How the memory for an image is used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MemoryPlan {
    /// Height and width of the image.
    pub size: [usize; 2],
    /// Bytes that its restoration takes at most.
    pub bytes: u64,
    /// The windows that a network restores it in, one after another; none where there is none, and where each of its parts has its own.
    pub tiling: Option<Tiling>,
    /// The overlapping parts that it is deconvolved in, where there is no memory for the whole.
    pub parts: Option<Tiling>,
    /// Threads that restore it.
    pub threads: usize,
    /// Bytes that the threads may take beyond the least.
    pub(super) room: u64,
}

impl MemoryBudget {
    /// Bytes that are taken beside the work by so many threads, if all images are of this size; `kernel_bytes` by kernels.
    pub(super) fn others(&self, size: [usize; 2], kernel_bytes: u64, threads: usize) -> u64 {
        let own = PROGRAM_BYTES + kernel_bytes + threads as u64 * THREAD_BYTES;
        self.queued_bytes(size) + if self.counts_process { own } else { 0 }
    }

    /// Plans the windows of an image, `beside` which so many bytes are taken, in tiles of a given side or as they fit.
    ///
    /// Tiles are chosen by what one thread takes: they, and results with them, do not depend on how many there are.
    pub(super) fn plan_windows(
        &self,
        size: [usize; 2],
        tile: Option<usize>,
        beside: u64,
        operator: &dyn WindowCost,
    ) -> Result<MemoryPlan> {
        let tiling = match tile {
            None => Tiling::within(size, self.limit_bytes, beside, operator)?,
            Some(tile) => {
                let tiling = Tiling::with_tile(size, tile, operator)?;
                self.require(tiling.bytes(operator) + beside, size)?;
                tiling
            }
        };
        let least = tiling.bytes(operator) + beside;
        let room = self.limit_bytes.saturating_sub(least);
        let thread_bytes = if self.counts_process { THREAD_BYTES } else { 0 };
        let affordable = room
            .checked_div(thread_bytes)
            .map_or(usize::MAX, |threads| usize::try_from(threads).unwrap_or(usize::MAX));
        let more_threads = affordable.min(rayon::current_num_threads() - 1);
        let thread_bytes = more_threads as u64 * thread_bytes;
        let room = room - thread_bytes;
        let (height, width) = tiling.window();
        let more = operator.window_bytes(height, width, room) - operator.window_bytes(height, width, 0);
        let bytes = least + thread_bytes + more;
        Ok(MemoryPlan { size, bytes, tiling: Some(tiling), parts: None, threads: 1 + more_threads, room })
    }

    /// Plans the restoration of an image as a whole by all threads, which takes so many bytes.
    pub(super) fn plan_whole(&self, size: [usize; 2], bytes: u64) -> Result<MemoryPlan> {
        self.require(bytes, size)?;
        let threads = rayon::current_num_threads();
        Ok(MemoryPlan { size, bytes, tiling: None, parts: None, threads, room: 0 })
    }

    /// Plans the restoration of an image in parts, each by all threads; `part` tells what one takes, the process included.
    pub(super) fn plan_parts(&self, size: [usize; 2], part: &dyn WindowCost) -> Result<MemoryPlan> {
        let queued = self.queued_bytes(size);
        let parts = Tiling::within(size, self.limit_bytes, queued, part)?;
        let bytes = parts.bytes(part) + queued;
        let threads = rayon::current_num_threads();
        Ok(MemoryPlan { size, bytes, tiling: None, parts: Some(parts), threads, room: 0 })
    }

    /// The memory that is left for one part of an image.
    pub(super) fn of_part(&self, size: [usize; 2]) -> Self {
        let around = self.queued_bytes(size) + FRAMES_IN_MEMORY * frame_bytes(size);
        let limit_bytes = self.limit_bytes.saturating_sub(around);
        Self { limit_bytes, queued_frames: 0, ..*self }
    }

    /// Bytes of the frames that the caller holds, if they are of this size.
    fn queued_bytes(&self, size: [usize; 2]) -> u64 {
        self.queued_frames * frame_bytes(size)
    }

    fn require(&self, bytes: u64, [height, width]: [usize; 2]) -> Result<()> {
        if bytes > self.limit_bytes {
            return Err(Error::Unsupported(format!(
                "{height} × {width} pixels take {}, more than the {} of --max-memory; allow at least {}",
                format_bytes(bytes),
                format_bytes(self.limit_bytes),
                format_bytes(bytes)
            )));
        }
        Ok(())
    }
}

impl MemoryPlan {
    /// How many pieces an image of so many pixels is restored in, one after another, each like a whole one, and the pixels of each.
    pub fn pieces(&self, pixels: f64) -> (usize, f64) {
        self.parts
            .as_ref()
            .map_or((1, pixels), |parts| (parts.len(), pixels * parts.times() / parts.len() as f64))
    }

    /// What the limit costs, where that is much.
    fn cost_of_parts(&self) -> Option<String> {
        const MUCH: f64 = 2.0;
        let times = self.parts.as_ref()?.times();
        (times >= MUCH).then(|| {
            format!("; they overlap and are {times:.1} times the pixels: a larger --max-memory takes as much less time")
        })
    }
}

impl fmt::Display for MemoryPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [height, width] = self.size;
        write!(f, "{height} × {width}: ")?;
        if let Some(tiling) = self.parts.as_ref().or(self.tiling.as_ref()) {
            let windows = if tiling.len() == 1 { "window" } else { "windows" };
            let (height, width) = tiling.window();
            write!(f, "{} {windows} of up to {height} × {width}, ", tiling.len())?;
        }
        write!(f, "memory up to {}{}", format_bytes(self.bytes), self.cost_of_parts().unwrap_or_default())
    }
}

/// Bytes of an RGB frame of 32-bit floats.
fn frame_bytes([height, width]: [usize; 2]) -> u64 {
    (CHANNELS * size_of::<f32>() * height * width) as u64
}

/// Runs work on so many threads, where there are more.
pub(super) fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> Result<T> + Send) -> Result<T> {
    if threads >= rayon::current_num_threads() {
        return work();
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|error| Error::Unsupported(format!("cannot start {threads} threads: {error}")))?
        .install(work)
}

/// Floats that are kept of every pixel of an image beside the image itself: planes, with them the capture before it was
/// tone-mapped, and a code that changes.
pub(super) fn floats_of_pixel(kernel: &KernelKnowledge, model: &Model) -> usize {
    let planes = match model.architecture().planes().len() {
        0 => 0,
        planes => CHANNELS * (planes + 1),
    };
    // Red and blue of the deconvolved image, while they are brought to green.
    let planes = if model.architecture().kind == Kind::Guided { planes + CHANNELS - 1 } else { planes };
    match (kernel, model.architecture().code_len()) {
        (KernelKnowledge::Field { .. }, Some(code)) => planes + code,
        _ => planes,
    }
}
