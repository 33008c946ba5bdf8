//! The two precisions of a transform.

use std::sync::{LazyLock, Mutex};

use rustfft::num_traits::ToPrimitive;
use rustfft::{FftNum, FftPlanner};

/// A floating-point number that planes are transformed in.
pub(super) trait Real: FftNum + Default + From<f32> + ToPrimitive {
    /// Plans are made once for each length in the whole program.
    fn planner() -> &'static Mutex<FftPlanner<Self>>;

    /// Takes samples that come as 32-bit floats; those which are not written are zeros.
    fn fill(samples: &mut [Self], write: impl FnOnce(&mut [f32]));
}

static SINGLE: LazyLock<Mutex<FftPlanner<f32>>> = LazyLock::new(|| Mutex::new(FftPlanner::new()));
static DOUBLE: LazyLock<Mutex<FftPlanner<f64>>> = LazyLock::new(|| Mutex::new(FftPlanner::new()));

impl Real for f32 {
    fn planner() -> &'static Mutex<FftPlanner<Self>> {
        &SINGLE
    }

    fn fill(samples: &mut [Self], write: impl FnOnce(&mut [f32])) {
        write(samples);
    }
}

impl Real for f64 {
    fn planner() -> &'static Mutex<FftPlanner<Self>> {
        &DOUBLE
    }

    fn fill(samples: &mut [Self], write: impl FnOnce(&mut [f32])) {
        let mut narrow = vec![0.0; samples.len()];
        write(&mut narrow);
        samples.iter_mut().zip(narrow).for_each(|(sample, value)| *sample = value.into());
    }
}
