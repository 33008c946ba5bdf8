//! The two precisions of a transform.

use std::sync::{LazyLock, Mutex};

use rustfft::{FftNum, FftPlanner};

/// A floating-point number that planes are transformed in.
pub(super) trait Real: FftNum + Default + From<f32> {
    const HALF: Self;

    /// Plans are made once for each length in the whole program.
    fn planner() -> &'static Mutex<FftPlanner<Self>>;

    /// 1 / `count`.
    fn reciprocal(count: usize) -> Self;

    fn to_f32(self) -> f32;
}

impl Real for f32 {
    const HALF: Self = 0.5;

    fn planner() -> &'static Mutex<FftPlanner<Self>> {
        static PLANNER: LazyLock<Mutex<FftPlanner<f32>>> = LazyLock::new(|| Mutex::new(FftPlanner::new()));
        &PLANNER
    }

    fn reciprocal(count: usize) -> Self {
        1.0 / count as Self
    }

    fn to_f32(self) -> f32 {
        self
    }
}

impl Real for f64 {
    const HALF: Self = 0.5;

    fn planner() -> &'static Mutex<FftPlanner<Self>> {
        static PLANNER: LazyLock<Mutex<FftPlanner<f64>>> = LazyLock::new(|| Mutex::new(FftPlanner::new()));
        &PLANNER
    }

    fn reciprocal(count: usize) -> Self {
        1.0 / count as Self
    }

    #[expect(clippy::cast_possible_truncation, reason = "images are 32-bit floats")]
    fn to_f32(self) -> f32 {
        self as f32
    }
}
