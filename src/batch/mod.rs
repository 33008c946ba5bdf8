//! Works through many files: where what becomes of them is written, what is there already, and reading, computing and
//! writing at the same time.

mod destination;
mod estimate;
mod others;
mod queue;
mod resume;
mod tone_mapping;
mod watcher;

pub use destination::{Destination, Unplaced, check_kept};
pub use estimate::{
    Clock, Estimate, HEADER_BYTES, LinearCost, PROCESS_BYTES, Sampler, Span, Spent, spent_on,
};
pub use others::tell_of_others;
pub use queue::{Selection, Stages, run};
pub use resume::{Kept, is_broken, is_made, write_or_keep};
pub use tone_mapping::ToneMapping;
#[cfg(test)]
pub(crate) use watcher::testing;
pub use watcher::{Watcher, timed};
