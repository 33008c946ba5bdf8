//! From a bracket of exposures or a display layout to a point spread function.
//!
//! Two ways lead there. Measured: [`fuse()`] makes one linear image of a bracket, [`measure`] cuts the PSF out
//! of it. Simulated: [`display`] describes panel, lens and sensor, [`propagate`] sends light through them.

pub mod alignment;
pub mod background;
pub mod bayer;
pub mod bracket;
pub mod chirp_z;
mod darks;
pub mod display;
mod exposure_times;
mod frames;
pub mod fuse;
mod haze;
pub mod inpaint;
pub mod layout;
pub mod measure;
pub mod optics;
pub mod orders;
pub mod pixel;
pub mod propagate;
pub mod pupil;
pub mod quality;
pub mod sampling;
pub mod shape;

pub use alignment::Motion;
pub use background::Background;
pub use bracket::{Bracket, show_time};
pub use display::DisplayConfig;
pub use exposure_times::{SAME_TIME, relative_times};
pub use frames::Uneven;
pub use fuse::{FuseConfig, Fused, MergeRule, fuse};
pub use measure::{MeasureConfig, MeasuredPsf, Normalization, measure_psf};
pub use propagate::{SimulatedPsf, simulate_psf, simulate_turned};
pub use quality::{PsfQuality, assess_psf};

/// The largest side of a PSF in pixels: more than any sensor's frame is a typing error.
const MAX_SIZE_PX: usize = 8192;
