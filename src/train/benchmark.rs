//! Times a step of the training: forward, L1, backward, Adam.

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use ndarray::Array3;

use super::{InMemory, Patch, TrainConfig, Trainer, TrainingData as _};
use crate::core::error::Result;
use crate::core::image::ToneMappedImage;
use crate::core::kernel_code::KernelCode;
use crate::core::progress::Progress;
use crate::kernels::benchmark::best_time;
use crate::kernels::keep_freed_memory;
use crate::network::{Backend, Planes, Precision};

/// Side of the largest square whose pixels a batch may have: more would take most machines' memory many times over.
pub const LARGEST_SIDE: u32 = 8192;

/// The shape of a training batch: so many square crops of so many pixels a side, as `4x128`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BatchShape {
    /// Number of crops.
    pub crops: usize,
    /// Side of each in pixels.
    pub side: usize,
}

impl FromStr for BatchShape {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Option<(usize, usize)> =
            text.split_once('x').and_then(|(crops, side)| Some((crops.parse().ok()?, side.parse().ok()?)));
        let largest = (LARGEST_SIDE as usize).pow(2);
        match parts {
            Some((crops, side)) if crops > 0 && side > 0 => {
                let pixels = side.checked_mul(side).and_then(|pixels| pixels.checked_mul(crops));
                match pixels.filter(|pixels| *pixels <= largest) {
                    Some(_) => Ok(Self { crops, side }),
                    None => Err(format!("must have at most {largest} pixels in all")),
                }
            }
            _ => Err("must be a number of crops and their side, as 4x128".to_owned()),
        }
    }
}

impl fmt::Display for BatchShape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}×{}²", self.crops, self.side)
    }
}

/// The best time in seconds, within about `patience`, of a step that trains the published network on such a batch.
///
/// # Errors
/// Those of [`Trainer::new`] and [`Trainer::step`]; [`Error::Interrupted`](crate::core::error::Error::Interrupted) after an
/// interrupt.
pub fn time_step(
    (backend, precision): (Backend, Precision),
    BatchShape { crops, side }: BatchShape,
    patience: Duration,
    progress: &Progress,
) -> Result<f64> {
    progress.check()?;
    let mut config = TrainConfig { precision, ..TrainConfig::default() };
    (config.data.batch, config.data.accumulate, config.data.crop) = (crops, 1, side);
    let image = |value| ToneMappedImage::from_planes(Array3::from_elem((3, side, side), value));
    let code = Some(KernelCode::zeros(config.architecture.code_dim));
    let data = InMemory(vec![Patch {
        degraded: image(0.5)?,
        ground_truth: image(0.25)?,
        code,
        planes: Planes::default(),
    }]);
    keep_freed_memory();
    let mut trainer = Trainer::new(&config, None, data.len(), backend)?;
    let mut outcome = Ok(());
    let seconds = best_time(patience, &|| progress.check().is_err(), || {
        if outcome.is_ok() {
            outcome = progress.check().and_then(|()| trainer.step(&data)).map(|_| ());
        }
    });
    outcome.and_then(|()| progress.check()).map(|()| seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn batches_are_crops_and_their_side() {
        assert_eq!("4x128".parse(), Ok(BatchShape { crops: 4, side: 128 }));
        assert_eq!(BatchShape { crops: 4, side: 128 }.to_string(), "4×128²");
        for (text, reason) in [
            ("128", "as 4x128"),
            ("0x64", "as 4x128"),
            ("1x8193", "67108864 pixels"),
            ("2x18446744073709551615", "67108864 pixels"),
        ] {
            let refusal = text.parse::<BatchShape>().unwrap_err();
            assert!(refusal.contains(reason), "{text}: {refusal}");
        }
    }
}
