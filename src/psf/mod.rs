//! From a fused capture or a display layout to a point spread function.
//!
//! Two ways lead there. Measured: [`measure`] cuts the PSF out of the linear image of a point source. Simulated: [`display`] describes panel, lens and sensor, [`random`] draws them, [`propagate`] sends light through them.

pub mod background;
pub mod chirp_z;
pub mod display;
pub mod layout;
pub mod measure;
pub mod optics;
pub mod orders;
mod panel;
pub mod pixel;
pub mod profile;
pub mod propagate;
pub mod pupil;
pub mod quality;
pub mod random;
pub mod sampling;
pub mod shape;
mod slope;
mod summary;

pub use background::Background;
pub use display::DisplayConfig;
pub use measure::{MeasureConfig, MeasuredPsf, Normalization, measure_psf};
pub use profile::PsfProfile;
pub use propagate::{SimulatedPsf, simulate_psf, simulate_turned};
pub use quality::{PsfQuality, assess_psf};
pub use random::random_display;

/// The largest side of a PSF in pixels: more than any sensor's frame is a typing error.
const MAX_SIZE_PX: usize = 8192;
