//! The code of a capture whose panel is turned by an unknown angle.

use std::fmt;
use std::time::Instant;

use super::{WEAK_LEAD, search_angle};
use crate::codes::interpolate_code;
use crate::core::error::Result;
use crate::core::image::{CHANNELS, ToneMappedImage};
use crate::core::kernel_code::{KernelBank, KernelCode};
use crate::core::progress::Progress;
use crate::core::tone::ToneCurve;

/// The angle that was found in a capture.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundAngle {
    /// The angle between the kernels, in degrees.
    pub angle_deg: f64,
    /// The name of the nearest kernel.
    pub nearest: String,
    /// By how much it is more likely than any but its neighbours, in nats.
    pub lead: f64,
    /// How long the search took.
    pub seconds: f64,
}

impl FoundAngle {
    /// What to be warned of where the angle is poorly determined.
    pub fn warning(&self) -> Option<&'static str> {
        (self.lead < WEAK_LEAD).then_some(
            "the angle of the panel is poorly determined by this capture; lamps or texture in view would help, or give --angle a number \
             found in another capture of the same device",
        )
    }
}

impl fmt::Display for FoundAngle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { angle_deg, nearest, lead, seconds } = self;
        write!(
            f,
            "the panel is turned by {angle_deg:+.1}° (nearest kernel {nearest}, {lead:.0} nats ahead of all but its \
             neighbours; found in {seconds:.1} s)"
        )
    }
}

/// Finds the code of the angle that explains a capture best.
///
/// # Errors
/// Those of [`search_angle`] and [`interpolate_code`].
pub(in crate::restore) fn find_code(
    image: &ToneMappedImage,
    bank: &KernelBank,
    curves: [ToneCurve; CHANNELS],
    progress: &Progress,
) -> Result<(KernelCode, FoundAngle)> {
    let found = find_angle(image, bank, curves, progress)?;
    Ok((interpolate_code(&bank.to_codes(), found.angle_deg)?, found))
}

/// Finds the angle that explains a capture best.
///
/// # Errors
/// Those of [`search_angle`].
pub(super) fn find_angle(
    image: &ToneMappedImage,
    bank: &KernelBank,
    curves: [ToneCurve; CHANNELS],
    progress: &Progress,
) -> Result<FoundAngle> {
    let started = Instant::now();
    let search = search_angle(image, bank, curves, progress)?;
    Ok(FoundAngle {
        angle_deg: search.angle_deg,
        nearest: bank.kernel_name(search.best),
        lead: search.lead,
        seconds: started.elapsed().as_secs_f64(),
    })
}
